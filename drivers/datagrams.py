"""Non-blocking datagram socket, and the arrival of a datagram from the kernel's stamp.

asyncio's datagram transport is not used: it allocates 256 KiB for each datagram and reads without
a limit.

Invariants:
    A read allocates at most 2 KiB. A longer datagram is marked as oversize by the kernel's flag.
    The kernel stamps with CLOCK_REALTIME, which can be stepped. Only the age of a stamp is used.
    An age is accepted up to the time since the socket was last empty, plus a margin.
    Any other datagram is dated by its reading, and counted.

Reference: socket(7), SO_TIMESTAMPNS.
"""

import select
import socket
import struct
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

from msgspec import Struct

SO_TIMESTAMPNS = 35  # not named by Python's socket module; asm-generic/socket.h
SO_RXQ_OVFL = 40
TRUNCATED = int(socket.MSG_TRUNC)  # an enumeration's & takes 4 us
BUFFER_BYTES = 2048
MAX_SELECTABLE = 1024  # select waits for descriptors below, with a resolution of microseconds
MARGIN_NS = 10_000_000  # an accepted age may exceed the time since the socket was empty [ns]
PAIR_TOLERANCE_NS = 50_000  # between two readings of the monotonic clock around the other [ns]

_TIMESPEC = struct.Struct("@ll")
_DROPS = struct.Struct("@I")

ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_DROPS.size)

Address = tuple[str, int]
Ancillary = Iterable[tuple[int, int, bytes]]
# Bytes, control messages, flags and source, as the kernel returns them.
RawDatagram = tuple[bytes, list[tuple[int, int, bytes]], int, Address]


def request_kernel_stamps(endpoint: socket.socket) -> None:
    """Ask the kernel to stamp arrivals and to count drops, where it can."""
    for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL):
        try:
            endpoint.setsockopt(socket.SOL_SOCKET, option, 1)
        except OSError:
            continue


def read_ancillary(ancillary: Ancillary) -> tuple[int | None, int | None]:
    """Return the stamp on CLOCK_REALTIME [ns] and the number of datagrams dropped so far.

    Each is None if the control messages of ``recvmsg`` do not have it.
    """
    realtime_ns: int | None = None
    drops: int | None = None
    for level, kind, data in ancillary:
        if level != socket.SOL_SOCKET:
            continue
        if kind == SO_TIMESTAMPNS and len(data) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(data)
            realtime_ns = seconds * 1_000_000_000 + nanoseconds
        elif kind == SO_RXQ_OVFL and len(data) == _DROPS.size:
            (drops,) = _DROPS.unpack(data)
    return realtime_ns, drops


def paired_clocks() -> tuple[int, int]:
    """Return the monotonic clock and CLOCK_REALTIME at one instant [ns].

    Three tries: the scheduler may run another program between the two readings.
    """
    for _ in range(3):
        before_ns = time.monotonic_ns()
        realtime_ns = time.time_ns()
        after_ns = time.monotonic_ns()
        if after_ns - before_ns < PAIR_TOLERANCE_NS:
            break
    return after_ns, realtime_ns


@dataclass(slots=True)
class ArrivalClock:
    """Turns kernel stamps into monotonic arrivals.

    Attributes:
        margin_ns: how much older than the last empty read a datagram may be [ns].
        refused: kernel stamps with an age that is not accepted.
        missing: datagrams without a kernel stamp.
    """

    margin_ns: int = MARGIN_NS
    refused: int = 0
    missing: int = 0
    _empty_ns: int = field(default_factory=time.monotonic_ns)

    def drained(self, now_ns: int) -> None:
        """Note that a read found nothing at a monotonic time [ns]."""
        self._empty_ns = now_ns

    def date(self, ancillary: Ancillary) -> tuple[int, int | None]:
        """Return the arrival of a datagram that is read now [ns], and the kernel's drop count."""
        now_ns, realtime_ns = paired_clocks()
        stamp_realtime_ns, drops = read_ancillary(ancillary)
        return self.arrival(stamp_realtime_ns, now_ns, realtime_ns), drops

    def arrival(self, stamp_realtime_ns: int | None, now_ns: int, realtime_ns: int) -> int:
        """Return the monotonic arrival of a datagram [ns], never after ``now_ns``.

        Args:
            stamp_realtime_ns: the kernel's stamp on CLOCK_REALTIME [ns], or None.
            now_ns: monotonic time of reading [ns].
            realtime_ns: CLOCK_REALTIME at the same instant [ns].
        """
        if stamp_realtime_ns is None:
            self.missing += 1
            return now_ns
        age_ns = realtime_ns - stamp_realtime_ns
        if 0 <= age_ns <= now_ns - self._empty_ns + self.margin_ns:
            # What is read later has come later.
            self._empty_ns = max(self._empty_ns, now_ns - age_ns)
            return now_ns - age_ns
        if -PAIR_TOLERANCE_NS < age_ns < 0:
            return now_ns
        self.refused += 1
        return now_ns


class Datagram(Struct, frozen=True):
    """One datagram with its monotonic arrival [ns].

    Attributes:
        oversize: the datagram was longer than 2 KiB and ``data`` is incomplete.
    """

    data: bytes
    stamp_ns: int
    source: Address
    oversize: bool


@dataclass(slots=True)
class DatagramSocket:
    """A bound, non-blocking UDP socket.

    Attributes:
        is_selectable: ``wait`` can be called.
        kernel_drops: datagrams that the kernel dropped because the queue was full.
    """

    endpoint: socket.socket
    clock: ArrivalClock = field(default_factory=ArrivalClock)
    kernel_drops: int = 0
    is_selectable: bool = field(init=False)
    _buffer: bytearray = field(default_factory=lambda: bytearray(BUFFER_BYTES))
    _descriptors: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Keep the descriptor for ``wait``."""
        self._descriptors = (self.endpoint.fileno(),)
        self.is_selectable = self._descriptors[0] < MAX_SELECTABLE

    @classmethod
    def bound(cls, host: str, port: int) -> "DatagramSocket":
        """Open and bind a socket; no address is shared with another process.

        Args:
            port: local port, 0 for any.

        Raises:
            OSError: the address cannot be bound.
        """
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        endpoint = socket.socket(family, socket.SOCK_DGRAM)
        try:
            endpoint.setblocking(False)
            request_kernel_stamps(endpoint)
            endpoint.bind((host, port))
        except OSError:
            endpoint.close()
            raise
        return cls(endpoint)

    @property
    def address(self) -> Address:
        """Local address and port."""
        host, port = self.endpoint.getsockname()[:2]
        return str(host), int(port)

    def fileno(self) -> int:
        """Return the descriptor to watch."""
        return self.endpoint.fileno()

    def read(self) -> Datagram | None:
        """Return the oldest waiting datagram, None if there is none.

        Raises:
            OSError: the socket is broken.
        """
        try:
            size, ancillary, flags, source = self.endpoint.recvmsg_into(
                [self._buffer], ANCILLARY_BYTES
            )
        except (BlockingIOError, InterruptedError):
            self.clock.drained(time.monotonic_ns())
            return None
        return self.stamped((bytes(memoryview(self._buffer)[:size]), ancillary, flags, source))

    def wait(self, timeout_ns: int) -> RawDatagram | None:
        """Sleep until a datagram comes, and return it without its arrival.

        Args:
            timeout_ns: the longest time to wait [ns].

        Returns:
            The argument of ``stamped``, to be called after the reply; None after the time-out.

        Raises:
            OSError: the socket is broken.
            ValueError: the descriptor is too great for select.
        """
        # select waits in microseconds, poll in milliseconds, a socket's time-out in kernel ticks.
        if not select.select(self._descriptors, (), (), max(0, timeout_ns) * 1e-9)[0]:
            return None
        try:
            return self.endpoint.recvmsg(BUFFER_BYTES, ANCILLARY_BYTES)
        except (BlockingIOError, InterruptedError):
            return None

    def has_more(self) -> bool:
        """Return whether another datagram waits."""
        return bool(select.select(self._descriptors, (), (), 0.0)[0])

    def stamped(self, raw: RawDatagram) -> Datagram:
        """Return a datagram with its arrival; call it soon, for its age is counted from now."""
        data, ancillary, flags, source = raw
        stamp_ns, drops = self.clock.date(ancillary)
        if drops is not None:
            self.kernel_drops = drops
        return Datagram(data, stamp_ns, source, bool(flags & TRUNCATED))

    def close(self) -> None:
        """Close the socket."""
        self.endpoint.close()
