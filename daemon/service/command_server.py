"""The doors by which operators reach the daemon: a local socket, and UDP with keys.

Law of this file: sockets only; what bytes mean is in protocol.command_*. Nothing waits:
``poll`` is called after each reply to the robot and handles a bounded number of messages,
so that no flood of commands costs the robot a cycle. Without a robot the loop's own
readers call it. A handler that raises costs its request, never the daemon.
"""

import asyncio
import contextlib
import ipaddress
import logging
import os
import select
import socket
import stat
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from linemate.drivers import port_holder
from linemate.drivers.sole_sender import attach
from linemate.protocol.command.authenticated import CommandServer
from linemate.protocol.command.conversation import REFUSED, CommandOrder, ControlLease
from linemate.protocol.command.frame_codec import MAGIC, MAX_FRAME_BYTES, Role
from linemate.protocol.command.local_server import LocalAccess, LocalServer
from linemate.protocol.command.preshared_keys import PresharedKey
from linemate.protocol.command.requests import OPERATIONS

Result = Mapping[str, Any]
Handler = Callable[[str, dict[str, Any], str, str], Result | asyncio.Future[Any]]
"""``handle(op, params, role, who) -> result``; ``{"refused": reason}`` says no. A promise of a
result is answered when it is kept."""
Snapshot = Callable[[], Mapping[str, Any]]

RECEIVE_BYTES: Final = 2048
MAX_CONNECTIONS: Final = 16

SO_PEERGROUPS: Final = 59  # missing from the socket module
SO_MEMINFO: Final = 55
MEMINFO: Final = struct.Struct("9I")
UCRED: Final = struct.Struct("3i")

log = logging.getLogger(__name__)


class CommandPortError(Exception):
    """A door cannot be opened; the message says which and why."""


@dataclass(frozen=True, slots=True)
class LocalDoor:
    """The local socket.

    Attributes:
        path: where; its directory must exist.
        access: who may do what; None: as the groups say, and root and the daemon's own user
            may operate.
        operate_gids: groups whose members may operate; None: the socket's own group.
        view_gids: groups whose members may view.
    """

    path: Path
    access: LocalAccess | None = None
    operate_gids: frozenset[int] | None = None
    view_gids: frozenset[int] = frozenset()

    @property
    def names_groups(self) -> bool:
        """The file's own group does not decide alone."""
        return self.operate_gids is not None or bool(self.view_gids)


@dataclass(frozen=True, slots=True)
class UdpDoor:
    """The UDP port.

    Attributes:
        host: numeric address; another than loopback only with ``allow_remote``.
        keys: pre-shared keys; without one the door is not opened.
        allow_remote: explicit consent to an address that others can reach.
    """

    host: str = "127.0.0.1"
    port: int = 49160
    keys: tuple[PresharedKey, ...] = ()
    allow_remote: bool = False


@dataclass(slots=True)
class _Connection:
    socket: socket.socket
    server: LocalServer
    who: str
    address: str = field(default="")


class CommandPort:
    """All doors of one daemon, and the one desk behind them.

    Args:
        handle: carries out an order; synchronous and quick.
        telemetry: gives what subscribers are sent.
        local: the local socket, None for none.
        udp: the UDP port, None for none.
        secret: returns 32 random bytes.

    Attributes:
        counters: what came and what became of it, by reason.
    """

    def __init__(
        self,
        handle: Handler,
        telemetry: Snapshot,
        local: LocalDoor | None = None,
        udp: UdpDoor | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        secret: Callable[[], bytes] = lambda: os.urandom(32),
    ) -> None:
        self._handle = handle
        self._telemetry = telemetry
        self._local = local
        self._udp = udp
        self._now_ns = now_ns
        lease = ControlLease()
        self._lease = lease
        self._server = CommandServer(udp.keys if udp else (), secret, lease)
        self.counters: Counter[str] = self._server.counters
        self._listener: socket.socket | None = None
        self._datagrams: socket.socket | None = None
        self._connections: dict[int, _Connection] = {}
        self._access = LocalAccess()
        self._epoll: select.epoll | None = None
        self._until_ns = 0
        self._allowance = 0
        self._invited: asyncio.AbstractEventLoop | None = None

    @property
    def udp_address(self) -> tuple[str, int] | None:
        """The address that the UDP port is bound to."""
        if self._datagrams is None:
            return None
        host, port = self._datagrams.getsockname()[:2]
        return host, port

    def open(self) -> None:
        """Open the doors.

        Raises:
            CommandPortError: one cannot be opened; the others are closed again.
        """
        self._epoll = select.epoll()
        try:
            if self._local is not None:
                self._listener = self._watch(_listen(self._local))
                self._access = self._local.access or _access(self._local)
            if self._udp is not None:
                self._datagrams = self._watch(_bind(self._udp))
        except CommandPortError:
            self.close()
            raise

    def close(self) -> None:
        """Close the doors and forget everybody."""
        self._allowance = 0
        self._serve_guest()
        for connection in list(self._connections.values()):
            self._drop(connection, "closed")
        if self._listener is not None:
            self._listener.close()
            self._listener = None
            if self._local is not None:
                with contextlib.suppress(OSError):
                    self._local.path.unlink()
        if self._datagrams is not None:
            self._datagrams.close()
            self._datagrams = None
        if self._epoll is not None:
            self._epoll.close()
            self._epoll = None

    def replace_keys(self, keys: Iterable[PresharedKey]) -> None:
        """Take a new set of keys (SIGHUP); sessions of keys that are gone end at once."""
        self._server.replace_keys(keys)

    def invite(self, loop: asyncio.AbstractEventLoop, until_ns: int, budget: int) -> None:
        """Let the loop handle what comes between two cycles; nobody waits for the next one.

        It ends by itself: at its time, or with its budget; what is left waits for ``poll``.

        Args:
            until_ns: monotonic time from which on the cycle has the loop for itself [ns].
            budget: messages until then, at most.
        """
        self._until_ns, self._allowance = until_ns, budget
        if self._invited is None and self._epoll is not None and (self._local or self._udp):
            self._invited = loop
            loop.add_reader(self._epoll.fileno(), self._serve_guest)

    def _serve_guest(self) -> None:
        """Handle one message; a turn of the loop is no longer than that."""
        if self._allowance > 0 and self._now_ns() < self._until_ns:
            self._allowance -= max(1, self.poll(1))
        elif self._invited is not None and self._epoll is not None:
            self._invited.remove_reader(self._epoll.fileno())
            self._invited = None

    def poll(self, budget: int = 8) -> int:
        """Handle at most ``budget`` messages, in turn from every socket that has one.

        Returns:
            How many were handled.
        """
        if self._epoll is None:
            return 0
        handled = 0
        ready = [fd for fd, _ in self._epoll.poll(0, MAX_CONNECTIONS + 2)]
        while ready and handled < budget:
            # In turn, so that a flood on one socket leaves the others their share.
            for fd in list(ready):
                if handled >= budget:
                    break
                if self._serve(fd):
                    handled += 1
                else:
                    ready.remove(fd)
        self._send_events()
        return handled

    def status(self) -> dict[str, Any]:
        """Return counts for the status page."""
        return {
            "sessions": self._server.sessions,
            "connections": len(self._connections),
            "control": self._lease.holder,
            "counters": dict(self.counters) | _kernel_drops(self._datagrams),
        }

    def _watch(self, watched: socket.socket) -> socket.socket:
        watched.setblocking(False)
        if self._epoll is not None:
            self._epoll.register(watched.fileno(), select.EPOLLIN)
        return watched

    def _serve(self, fd: int) -> bool:
        """Handle one message of one socket; tell whether there was one."""
        if self._datagrams is not None and fd == self._datagrams.fileno():
            return self._serve_datagram(self._datagrams)
        if self._listener is not None and fd == self._listener.fileno():
            return self._accept(self._listener)
        connection = self._connections.get(fd)
        return connection is not None and self._serve_connection(connection)

    def _serve_datagram(self, door: socket.socket) -> bool:
        try:
            data, address = door.recvfrom(RECEIVE_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            self.counters["receive_errors"] += 1  # ICMP of an earlier answer
            return True
        received = self._server.on_datagram(data, address, self._now_ns())
        for reply in received.replies:
            self._send_datagram(door, reply, address)
        if received.request is not None:
            request = received.request

            def answer(result: Result | None) -> None:
                now_ns = self._now_ns()
                reply = (
                    self._server.fail(request, now_ns)
                    if result is None
                    else self._server.reply(request, result, now_ns)
                )
                if reply is not None and self._datagrams is door:
                    self._send_datagram(door, reply, address)

            self._carry_out(request.order, answer)
        return True

    def _send_datagram(self, door: socket.socket, data: bytes, address: Any) -> None:
        try:
            door.sendto(data, address)
        except OSError:
            self.counters["send_errors"] += 1

    def _accept(self, listener: socket.socket) -> bool:
        try:
            accepted, _ = listener.accept()
        except BlockingIOError:
            return False
        except OSError:
            self.counters["accept_errors"] += 1
            return False
        uid, who, role = self._peer(accepted)
        if role is None or len(self._connections) >= MAX_CONNECTIONS:
            why = "connections_full" if role else "connections_refused"
            self.counters[why] += 1
            log.warning("local connection of uid %d refused: %s", uid, why)
            accepted.close()
            return True
        server = LocalServer(who, role, self._lease, self.counters)
        self._watch(accepted)
        self._connections[accepted.fileno()] = _Connection(accepted, server, who)
        self.counters["connections_made"] += 1
        return True

    def _peer(self, accepted: socket.socket) -> tuple[int, str, Role | None]:
        raw = accepted.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, UCRED.size)
        _, uid, gid = UCRED.unpack(raw)
        gids = {gid, *_peer_groups(accepted)}
        return uid, f"uid:{uid}", self._access.role(uid, frozenset(gids))

    def _serve_connection(self, connection: _Connection) -> bool:
        try:
            data = connection.socket.recv(RECEIVE_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if not data:
            self._drop(connection, "ended")
            return True
        said = connection.server.on_message(data, self._now_ns())
        if not isinstance(said, CommandOrder):
            if said is not None:
                self._send_local(connection, said)
            return True
        order = said

        def answer(result: Result | None) -> None:
            now_ns = self._now_ns()
            server = connection.server
            reply = (
                server.fail(order, now_ns)
                if result is None
                else server.reply(order, result, now_ns)
            )
            if self._connections.get(connection.socket.fileno()) is connection:
                self._send_local(connection, reply)

        self._carry_out(order, answer)
        return True

    def _send_local(self, connection: _Connection, data: bytes) -> None:
        try:
            connection.socket.send(data)
        except OSError:
            # It does not read, or has gone: waiting for it would cost the robot.
            self._drop(connection, "dropped")

    def _drop(self, connection: _Connection, why: str) -> None:
        fd = connection.socket.fileno()
        if self._connections.pop(fd, None) is None:
            return
        self.counters[f"connections_{why}"] += 1
        if self._epoll is not None:
            self._epoll.unregister(fd)
        connection.socket.close()

    def _send_events(self) -> None:
        local = [c for c in self._connections.values() if c.server.subscribed]
        if not local and not self._server.subscribed:
            return
        now_ns = self._now_ns()
        taken: list[Mapping[str, Any]] = []

        def once() -> Mapping[str, Any]:
            if not taken:
                taken.append(self._snapshot())
            return taken[0]

        for connection in local:
            message = connection.server.event(now_ns, once)
            if message is not None:
                self._send_local(connection, message)
        if self._datagrams is not None:
            for datagram, address in self._server.events(now_ns, once):
                self._send_datagram(self._datagrams, datagram, address)

    def _snapshot(self) -> Mapping[str, Any]:
        try:
            return self._telemetry()
        except Exception:
            self.counters["telemetry_errors"] += 1
            if self.counters["telemetry_errors"] == 1:
                log.exception("telemetry failed; said once")
            return {}

    def _carry_out(self, order: CommandOrder, answer: Callable[[Result | None], None]) -> None:
        """Give an order to the handler, and its result to ``answer``: None if that raised."""
        try:
            result = self._handle(order.op, order.params, str(order.role), order.who)
        except Exception as error:  # noqa: BLE001
            # The robot's cycle calls this; a fault in a handler must stay in its request.
            self._failed(order, error)
            answer(None)
            return
        if not isinstance(result, asyncio.Future):
            answer(self._carried_out(order, result))
            return

        def kept(promise: asyncio.Future[Any]) -> None:
            error = asyncio.CancelledError() if promise.cancelled() else promise.exception()
            if error is None:
                answer(self._carried_out(order, promise.result()))
            else:
                self._failed(order, error)
                answer(None)

        result.add_done_callback(kept)

    def _failed(self, order: CommandOrder, error: BaseException) -> None:
        self.counters["handler_errors"] += 1
        log.error("order %s of %s failed", order.op, order.who, exc_info=error)

    @staticmethod
    def _carried_out(order: CommandOrder, result: Result) -> Result:
        if OPERATIONS[order.op].role is Role.OPERATE:
            outcome = f"refused: {result[REFUSED]}" if REFUSED in result else dict(result)
            log.info("%s ordered %s %r: %r", order.who, order.op, order.params, outcome)
        return result


def _peer_groups(accepted: socket.socket) -> tuple[int, ...]:
    try:
        raw = accepted.getsockopt(socket.SOL_SOCKET, SO_PEERGROUPS, 1024)  # Python allows no more
    except OSError:
        return ()
    return struct.unpack(f"{len(raw) // 4}I", raw)


def _access(door: LocalDoor) -> LocalAccess:
    operate = door.operate_gids
    if operate is None:
        operate = frozenset({door.path.stat().st_gid})
    return LocalAccess(frozenset({0, os.geteuid()}), operate, door.view_gids)


def _listen(door: LocalDoor) -> socket.socket:
    path = door.path
    _remove_stale(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    # The mode must be right from the first moment, not after a chmod. A file has one group: where
    # several may connect, anyone may, and is judged by the kernel's word on who they are.
    umask = os.umask(0o111 if door.names_groups else 0o117)
    try:
        listener.bind(str(path))
        listener.listen(MAX_CONNECTIONS)
    except OSError as error:
        listener.close()
        raise CommandPortError(f"{path}: {error}") from error
    finally:
        os.umask(umask)
    return listener


def _remove_stale(path: Path) -> None:
    """Remove a socket that a daemon left behind, never one that somebody listens on."""
    try:
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise CommandPortError(f"{path}: exists and is not a socket")
    except FileNotFoundError:
        return
    except OSError as error:
        raise CommandPortError(f"{path}: {error}") from error
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
            return
        except OSError as error:
            raise CommandPortError(f"{path}: {error}") from error
        raw = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, UCRED.size)
        pid, _, _ = UCRED.unpack(raw)
    raise CommandPortError(f"{path}: another daemon listens there (process {pid})")


def _bind(door: UdpDoor) -> socket.socket:
    try:
        address = ipaddress.ip_address(door.host)
    except ValueError as error:
        raise CommandPortError(f"command port: {error}") from error
    if not door.keys:
        raise CommandPortError("command port: no keys; UDP without a key does not exist")
    if not address.is_loopback and not door.allow_remote:
        raise CommandPortError(f"command port: {address} is not loopback; say allow_remote")
    family = socket.AF_INET6 if address.version == 6 else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_DGRAM)
    try:
        # No SO_REUSEADDR: with it a second daemon could take the port unnoticed.
        bound.bind((str(address), door.port))
    except OSError as error:
        bound.close()
        who = port_holder.told(error, door.port)
        raise CommandPortError(f"command port {address}:{door.port}: {error}{who}") from error
    _filter_in_kernel(bound)
    return bound


def _kernel_drops(bound: socket.socket | None) -> dict[str, int]:
    """What the kernel dropped at the UDP port: junk by the filter, and what found no room."""
    if bound is None:
        return {}
    try:
        raw = bound.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size)
        return {"kernel_drops": MEMINFO.unpack(raw)[-1]}
    except (OSError, struct.error):  # an older kernel
        return {}


def _filter_in_kernel(bound: socket.socket) -> None:
    """Let the kernel drop what is too long or lacks the magic; junk never wakes us.

    Classic BPF sees the UDP header first, 8 bytes. Without the right to attach one
    the same datagrams are dropped one by one, so a refusal is no error.
    """
    udp = 8
    program = [
        (0x80, 0, 0, 0),  # A = length
        (0x25, 3, 0, MAX_FRAME_BYTES + udp),  # if A > longest frame: drop
        (0x28, 0, 0, udp),  # A = first two bytes of the payload
        (0x15, 0, 1, int.from_bytes(MAGIC, "big")),  # if A == magic: keep, else drop
        (0x06, 0, 0, 0xFFFFFFFF),
        (0x06, 0, 0, 0),
    ]
    with contextlib.suppress(OSError):
        attach(bound, program)
