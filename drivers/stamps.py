"""Arrival time of a datagram on the monotonic clock, from the kernel's stamp.

Invariants:
    The kernel stamps with CLOCK_REALTIME, which can be stepped. Only the age of a stamp is used.
    An age is accepted up to the time since the socket was last empty, plus a margin.
    Any other datagram is dated by its reading, and counted.

Reference: socket(7), SO_TIMESTAMPNS.
"""

import socket
import struct
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

SO_TIMESTAMPNS = 35  # not named by Python's socket module; asm-generic/socket.h
SO_RXQ_OVFL = 40
MARGIN_NS = 10_000_000  # an accepted age may exceed the time since the socket was empty [ns]
PAIR_TOLERANCE_NS = 50_000  # between two readings of the monotonic clock around the other [ns]

_TIMESPEC = struct.Struct("@ll")
_DROPS = struct.Struct("@I")

ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_DROPS.size)

Ancillary = Iterable[tuple[int, int, bytes]]


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
            return now_ns - age_ns
        if -PAIR_TOLERANCE_NS < age_ns < 0:
            return now_ns
        self.refused += 1
        return now_ns
