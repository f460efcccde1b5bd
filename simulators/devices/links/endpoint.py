"""UDP socket of an emulated device with kernel stamps.

Invariants:
    It binds loopback unless configured otherwise, never blocks and never queues.
    It shares no code with the daemon's drivers.
"""

import socket
import struct
import time
from dataclasses import dataclass

_SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@ll")
_SPACE = socket.CMSG_SPACE(_TIMESPEC.size)
_LONGEST_WAIT_NS = 1_000_000_000
_READ_BYTES = 65_536

Address = tuple[str, int]


@dataclass(slots=True)
class Endpoint:
    """A non-blocking UDP socket.

    Attributes:
        unsent: datagrams the kernel would not take.
    """

    link: socket.socket
    unsent: int = 0

    @classmethod
    def bound(cls, host: str = "127.0.0.1", port: int = 0) -> "Endpoint":
        """Open and bind.

        Args:
            port: local port, 0 for any.

        Returns:
            The open endpoint.

        Raises:
            OSError: if the address cannot be bound.
        """
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            link.setblocking(False)
            link.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            link.bind((host, port))
        except OSError:
            link.close()
            raise
        except OverflowError as error:  # Python's own word for a port that there is not
            link.close()
            raise OSError(str(error)) from error
        return cls(link)

    @property
    def address(self) -> Address:
        """Where the endpoint is bound."""
        host, port = self.link.getsockname()
        return str(host), int(port)

    def send(self, data: bytes, target: Address) -> bool:
        """Send one datagram now or never.

        Returns:
            Whether the kernel took it.
        """
        try:
            self.link.sendto(data, target)
        except OSError:
            self.unsent += 1
            return False
        return True

    def receive(self) -> tuple[bytes, int, Address] | None:
        """Take one datagram.

        Returns:
            Its bytes, its monotonic arrival [ns] and its source; None if nothing waits.
        """
        try:
            data, ancillary, _, source = self.link.recvmsg(_READ_BYTES, _SPACE)
        except OSError:
            return None
        return data, _arrival(ancillary), source

    def close(self) -> None:
        """Close the socket."""
        self.link.close()


def _arrival(ancillary: list[tuple[int, int, bytes]]) -> int:
    """The kernel's stamp as an age, subtracted from the monotonic clock."""
    now_ns = time.monotonic_ns()
    wall_ns = time.time_ns()
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
            seconds, nanoseconds = _TIMESPEC.unpack(data[: _TIMESPEC.size])
            age_ns = wall_ns - (seconds * 1_000_000_000 + nanoseconds)
            if 0 <= age_ns < _LONGEST_WAIT_NS:
                return int(now_ns - age_ns)
    return now_ns
