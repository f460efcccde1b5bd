"""Sockets of the command server: a Unix socket and an authenticated UDP port.

Invariants:
- A socket of a running daemon is never taken over. A stale one is removed.
- The Unix socket has its mode from the first moment. UDP needs at least one key.
"""

import contextlib
import ipaddress
import os
import socket
import stat
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from linemate.drivers.udp import port_holder
from linemate.drivers.udp.sole_sender import attach
from linemate.protocol.command.frame_codec import MAGIC, MAX_FRAME_BYTES
from linemate.protocol.command.local_server import LocalAccess
from linemate.protocol.command.preshared_keys import PresharedKey

MAX_CONNECTIONS: Final = 16
SO_PEERGROUPS: Final = 59  # missing from the socket module
SO_MEMINFO: Final = 55
MEMINFO: Final = struct.Struct("9I")
UCRED: Final = struct.Struct("3i")  # pid, uid, gid


class CommandPortError(Exception):
    """An endpoint cannot be opened; the message says which and why."""


@dataclass(frozen=True, slots=True)
class LocalEndpoint:
    """Unix socket.

    Attributes:
        path: path of the socket. Its directory must exist.
        access: roles by user and group. None: as the groups below say; root and the daemon's own
            user may operate.
        operate_gids: groups whose members may operate. None: the socket file's own group.
        view_gids: groups whose members may view.
    """

    path: Path
    access: LocalAccess | None = None
    operate_gids: frozenset[int] | None = None
    view_gids: frozenset[int] = frozenset()

    @property
    def names_groups(self) -> bool:
        """Other groups than the file's own may connect."""
        return self.operate_gids is not None or bool(self.view_gids)


@dataclass(frozen=True, slots=True)
class UdpEndpoint:
    """UDP port.

    Attributes:
        host: numeric address. Another than loopback needs ``allow_remote``.
        port: 0 takes any free port.
        keys: pre-shared keys. Without one the port is refused.
    """

    host: str = "127.0.0.1"
    port: int = 49160
    keys: tuple[PresharedKey, ...] = ()
    allow_remote: bool = False


def peer_of(connection: socket.socket) -> tuple[int, frozenset[int]]:
    """Return user id and group ids of the other end, as the kernel knows them."""
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, UCRED.size)
    _, uid, gid = UCRED.unpack(raw)
    try:
        # Python reads at most 1024 bytes of an option.
        raw = connection.getsockopt(socket.SOL_SOCKET, SO_PEERGROUPS, 1024)
    except OSError:
        raw = b""
    return uid, frozenset({gid, *struct.unpack(f"{len(raw) // 4}I", raw)})


def access_of(endpoint: LocalEndpoint) -> LocalAccess:
    """Return the roles by user and group; the socket must exist."""
    if endpoint.access is not None:
        return endpoint.access
    operate = endpoint.operate_gids
    if operate is None:
        operate = frozenset({endpoint.path.stat().st_gid})
    return LocalAccess(frozenset({0, os.geteuid()}), operate, endpoint.view_gids)


def listen(endpoint: LocalEndpoint) -> socket.socket:
    """Return the listening Unix socket.

    Raises:
        CommandPortError: another daemon listens there, or the path cannot be used.
    """
    path = endpoint.path
    _remove_stale(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    # A file has one group. Where several may connect, all may, and SO_PEERCRED decides.
    umask = os.umask(0o111 if endpoint.names_groups else 0o117)
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
    """Remove a socket that no process listens on."""
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
        pid, _, _ = UCRED.unpack(
            probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, UCRED.size)
        )
    raise CommandPortError(f"{path}: another daemon listens there (process {pid})")


def bind(endpoint: UdpEndpoint) -> socket.socket:
    """Return the bound UDP socket, with its filter.

    Raises:
        CommandPortError: no keys, a remote address without consent, or the port is taken.
    """
    try:
        address = ipaddress.ip_address(endpoint.host)
    except ValueError as error:
        raise CommandPortError(f"command port: {error}") from error
    if not endpoint.keys:
        raise CommandPortError("command port: no keys. Name a key file in command.udp.keys.")
    if not address.is_loopback and not endpoint.allow_remote:
        raise CommandPortError(
            f"command port: {address} is not loopback. Set allow_remote: true to serve other hosts."
        )
    family = socket.AF_INET6 if address.version == 6 else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_DGRAM)
    try:
        # No SO_REUSEADDR: with it a second daemon could take the port unnoticed.
        bound.bind((str(address), endpoint.port))
    except OSError as error:
        bound.close()
        holder = port_holder.describe_holder(error, endpoint.port)
        raise CommandPortError(
            f"command port {address}:{endpoint.port}: {error}{holder}"
        ) from error
    _filter_in_kernel(bound)
    return bound


def kernel_drops(bound: socket.socket | None) -> dict[str, int]:
    """Return the datagrams that the kernel dropped: by the filter, or for want of memory."""
    if bound is None:
        return {}
    try:
        raw = bound.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size)
        return {"kernel_drops": MEMINFO.unpack(raw)[-1]}
    except (OSError, struct.error):  # an older kernel
        return {}


def _filter_in_kernel(bound: socket.socket) -> None:
    """Let the kernel drop datagrams that are too long or lack the magic.

    Classic BPF sees the UDP header first, 8 bytes. Without the right to attach a filter, the
    protocol drops the same datagrams one by one.
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
