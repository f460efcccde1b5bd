"""Command server: Unix socket and authenticated UDP endpoint.

Invariants:
- Only sockets are handled here. ``protocol.command`` decodes, authenticates and answers.
- Nothing waits. ``poll`` handles a bounded number of messages after a reply to the robot, the
  window those that come between two cycles.
- A handler that raises costs its request, never the daemon.
"""

import asyncio
import contextlib
import logging
import os
import select
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from linemate.daemon.service import endpoints
from linemate.daemon.service.endpoints import (
    MAX_CONNECTIONS,
    CommandPortError,
    LocalEndpoint,
    UdpEndpoint,
)
from linemate.protocol.command.authenticated import CommandServer
from linemate.protocol.command.conversation import REFUSED, CommandOrder, ControlLease
from linemate.protocol.command.frame_codec import Role
from linemate.protocol.command.local_server import LocalAccess, LocalServer
from linemate.protocol.command.preshared_keys import PresharedKey
from linemate.protocol.command.requests import OPERATIONS

Result = Mapping[str, Any]
# handle(op, params, role, who) returns a result, ``{"refused": reason}``, or a future of one.
Handler = Callable[[str, dict[str, Any], str, str], Result | asyncio.Future[Any]]
Snapshot = Callable[[], Mapping[str, Any]]

RECEIVE_BYTES: Final = 2048

log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Connection:
    socket: socket.socket
    server: LocalServer


class CommandPort:
    """Endpoints of one daemon.

    Args:
        handle: carries out an order; synchronous and quick.
        telemetry: returns what subscribers are sent.
        local, udp: endpoints, None for none.

    Attributes:
        counters: messages by what became of them.
    """

    def __init__(
        self,
        handle: Handler,
        telemetry: Snapshot,
        local: LocalEndpoint | None = None,
        udp: UdpEndpoint | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._handle = handle
        self._telemetry = telemetry
        self._local = local
        self._udp = udp
        self._now_ns = now_ns
        self._lease = ControlLease()
        self._server = CommandServer(udp.keys if udp else (), lambda: os.urandom(32), self._lease)
        self.counters: Counter[str] = self._server.counters
        self._listener: socket.socket | None = None
        self._datagrams: socket.socket | None = None
        self._connections: dict[int, _Connection] = {}
        self._access = LocalAccess()
        self._epoll: select.epoll | None = None
        self._window_end_ns = 0
        self._window_budget = 0
        self._window_loop: asyncio.AbstractEventLoop | None = None

    @property
    def udp_address(self) -> tuple[str, int] | None:
        """Address of the UDP port, None if it is closed."""
        if self._datagrams is None:
            return None
        host, port = self._datagrams.getsockname()[:2]
        return host, port

    def open(self) -> None:
        """Open the endpoints.

        Raises:
            CommandPortError: one cannot be opened; the others are closed again.
        """
        self._epoll = select.epoll()
        try:
            if self._local is not None:
                self._listener = self._watch(endpoints.listen(self._local))
                self._access = endpoints.access_of(self._local)
            if self._udp is not None:
                self._datagrams = self._watch(endpoints.bind(self._udp))
        except CommandPortError:
            self.close()
            raise

    def close(self) -> None:
        """Close the endpoints and all connections."""
        self._window_budget = 0
        self._serve_window()
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
        """Use a new set of keys (SIGHUP); sessions of removed keys end at once."""
        self._server.replace_keys(keys)

    @property
    def is_watched(self) -> bool:
        """Whether anyone has subscribed to telemetry."""
        if self._server.subscribed:
            return True
        return any(c.server.subscribed for c in self._connections.values())

    @property
    def is_used(self) -> bool:
        """Whether anyone is connected."""
        return bool(self._connections) or self._server.sessions > 0

    @property
    def has_to_poll(self) -> bool:
        """Whether messages or telemetry may wait that the loop does not handle by itself."""
        return self._window_loop is None or self.is_watched

    def open_window(self, loop: asyncio.AbstractEventLoop, until_ns: int, budget: int) -> None:
        """Let the loop handle messages between two cycles.

        The window ends at its time or with its budget. ``poll`` handles the rest.

        Args:
            until_ns: monotonic time at which the cycle needs the loop [ns].
            budget: most messages until then.
        """
        self._window_end_ns, self._window_budget = until_ns, budget
        if self._window_loop is None and self._epoll is not None and (self._local or self._udp):
            self._window_loop = loop
            loop.add_reader(self._epoll.fileno(), self._serve_window)

    def _serve_window(self) -> None:
        """Handle one message, so that a turn of the loop is no longer than that."""
        if self._window_budget > 0 and self._now_ns() < self._window_end_ns:
            self._window_budget -= max(1, self.poll(1))
        elif self._window_loop is not None and self._epoll is not None:
            self._window_loop.remove_reader(self._epoll.fileno())
            self._window_loop = None

    def poll(self, budget: int = 8) -> int:
        """Handle at most ``budget`` messages, then send telemetry that is due.

        Returns:
            Number of messages handled.
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
            "counters": dict(self.counters) | endpoints.kernel_drops(self._datagrams),
        }

    def _watch(self, watched: socket.socket) -> socket.socket:
        watched.setblocking(False)
        if self._epoll is not None:
            self._epoll.register(watched.fileno(), select.EPOLLIN)
        return watched

    def _serve(self, fd: int) -> bool:
        """Handle one message of one socket; return False if there is none."""
        if self._datagrams is not None and fd == self._datagrams.fileno():
            return self._serve_datagram(self._datagrams)
        if self._listener is not None and fd == self._listener.fileno():
            return self._accept(self._listener)
        connection = self._connections.get(fd)
        return connection is not None and self._serve_connection(connection)

    def _serve_datagram(self, bound: socket.socket) -> bool:
        try:
            data, address = bound.recvfrom(RECEIVE_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            self.counters["receive_errors"] += 1  # ICMP of an earlier answer
            return True
        received = self._server.on_datagram(data, address, self._now_ns())
        for reply in received.replies:
            self._send_datagram(bound, reply, address)
        if received.request is not None:
            request = received.request

            def answer(result: Result | None) -> None:
                now_ns = self._now_ns()
                reply = (
                    self._server.fail(request, now_ns)
                    if result is None
                    else self._server.reply(request, result, now_ns)
                )
                if reply is not None and self._datagrams is bound:
                    self._send_datagram(bound, reply, address)

            self._carry_out(request.order, answer)
        return True

    def _send_datagram(self, bound: socket.socket, data: bytes, address: Any) -> None:
        try:
            bound.sendto(data, address)
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
        uid, gids = endpoints.peer_of(accepted)
        role = self._access.role(uid, gids)
        if role is None or len(self._connections) >= MAX_CONNECTIONS:
            why = "connections_full" if role else "connections_refused"
            self.counters[why] += 1
            log.warning("local connection of uid %d refused: %s", uid, why)
            accepted.close()
            return True
        server = LocalServer(f"uid:{uid}", role, self._lease, self.counters)
        self._watch(accepted)
        self._connections[accepted.fileno()] = _Connection(accepted, server)
        self.counters["connections_made"] += 1
        return True

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
        server = connection.server
        request = server.on_message(data, self._now_ns())
        if not isinstance(request, CommandOrder):
            if request is not None:
                self._send_local(connection, request)
            return True

        def answer(result: Result | None) -> None:
            now_ns = self._now_ns()
            reply = (
                server.fail(request, now_ns)
                if result is None
                else server.reply(request, result, now_ns)
            )
            if self._connections.get(connection.socket.fileno()) is connection:
                self._send_local(connection, reply)

        self._carry_out(request, answer)
        return True

    def _send_local(self, connection: _Connection, data: bytes) -> None:
        try:
            connection.socket.send(data)
        except OSError:
            # The client does not read, or has gone. Waiting for it would delay the robot.
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
        snapshots: list[Mapping[str, Any]] = []

        def snapshot_once() -> Mapping[str, Any]:
            if not snapshots:
                snapshots.append(self._snapshot())
            return snapshots[0]

        for connection in local:
            message = connection.server.event(now_ns, snapshot_once)
            if message is not None:
                self._send_local(connection, message)
        if self._datagrams is not None:
            for datagram, address in self._server.events(now_ns, snapshot_once):
                self._send_datagram(self._datagrams, datagram, address)

    def _snapshot(self) -> Mapping[str, Any]:
        try:
            return self._telemetry()
        except Exception:
            self.counters["telemetry_errors"] += 1
            if self.counters["telemetry_errors"] == 1:
                log.exception("telemetry failed. Further failures are counted only.")
            return {}

    def _carry_out(self, order: CommandOrder, answer: Callable[[Result | None], None]) -> None:
        """Give an order to the handler and its result to ``answer``: None if it raised."""
        try:
            result = self._handle(order.op, order.params, str(order.role), order.who)
        except Exception as error:  # noqa: BLE001
            # The robot's cycle calls this: a fault in a handler must stay in its request.
            self._count_failure(order, error)
            answer(None)
            return
        if not isinstance(result, asyncio.Future):
            answer(_logged(order, result))
            return

        def done(future: asyncio.Future[Any]) -> None:
            error = asyncio.CancelledError() if future.cancelled() else future.exception()
            if error is None:
                answer(_logged(order, future.result()))
            else:
                self._count_failure(order, error)
                answer(None)

        result.add_done_callback(done)

    def _count_failure(self, order: CommandOrder, error: BaseException) -> None:
        self.counters["handler_errors"] += 1
        log.error("order %s of %s failed", order.op, order.who, exc_info=error)


def _logged(order: CommandOrder, result: Result) -> Result:
    """Log the order of an operator, and return its result."""
    if OPERATIONS[order.op].role is Role.OPERATE:
        outcome = f"refused: {result[REFUSED]}" if REFUSED in result else dict(result)
        log.info("%s ordered %s %r: %r", order.who, order.op, order.params, outcome)
    return result
