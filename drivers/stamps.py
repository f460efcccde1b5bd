"""When a datum arrived, on the monotonic clock.

Law of this file: the kernel stamps with the wall clock, which may be stepped at any moment;
so a kernel stamp is only ever used as an *age*, and an age is believed only if the datum
could have waited that long: since the socket was last seen empty, plus a margin. Everything
else falls back to the time of reading, and is counted.
Source: reference/reliability.md, 2.0; socket(7), SO_TIMESTAMPNS.
"""

import socket
import struct
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

SO_TIMESTAMPNS = 35  # not named by Python's socket module; asm-generic/socket.h
SO_RXQ_OVFL = 40
MARGIN_NS = 10_000_000
PAIR_TOLERANCE_NS = 50_000

_TIMESPEC = struct.Struct("@ll")
_DROPS = struct.Struct("@I")

ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_DROPS.size)

Ancillary = Iterable[tuple[int, int, bytes]]


def request_kernel_stamps(endpoint: socket.socket) -> None:
    """Ask the kernel to stamp arrivals and to tell of drops, where it can."""
    for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL):
        try:
            endpoint.setsockopt(socket.SOL_SOCKET, option, 1)
        except OSError:
            continue


def read_ancillary(ancillary: Ancillary) -> tuple[int | None, int | None]:
    """Find the arrival stamp and the drop count among control messages.

    Args:
        ancillary: what ``recvmsg`` returned beside the data.

    Returns:
        Wall clock stamp [ns] and number of datagrams the kernel dropped so far; each may be None.
    """
    wall_ns: int | None = None
    drops: int | None = None
    for level, kind, data in ancillary:
        if level != socket.SOL_SOCKET:
            continue
        if kind == SO_TIMESTAMPNS and len(data) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(data)
            wall_ns = seconds * 1_000_000_000 + nanoseconds
        elif kind == SO_RXQ_OVFL and len(data) == _DROPS.size:
            (drops,) = _DROPS.unpack(data)
    return wall_ns, drops


def paired_clocks() -> tuple[int, int]:
    """Read both clocks at one instant, as nearly as a preemptible program can.

    Returns:
        Monotonic and wall clock [ns].
    """
    for _ in range(3):
        before_ns = time.monotonic_ns()
        wall_ns = time.time_ns()
        after_ns = time.monotonic_ns()
        if after_ns - before_ns < PAIR_TOLERANCE_NS:
            break
    return after_ns, wall_ns


@dataclass(slots=True)
class ArrivalClock:
    """Turns kernel stamps into monotonic arrivals.

    Attributes:
        margin_ns: how much older than the last empty read a datum may be [ns].
        refused: kernel stamps that could not be believed.
        missing: data that carried no kernel stamp.
    """

    margin_ns: int = MARGIN_NS
    refused: int = 0
    missing: int = 0
    _empty_ns: int = field(default_factory=time.monotonic_ns)

    def drained(self, now_ns: int) -> None:
        """Note that nothing was left to read.

        Args:
            now_ns: monotonic time of the read that found nothing [ns].
        """
        self._empty_ns = now_ns

    def date(self, ancillary: Ancillary) -> tuple[int, int | None]:
        """Return when a datum arrived that is read now [ns], and the kernel's drops if it says.

        Args:
            ancillary: control messages of the datum.
        """
        now_ns, wall_ns = paired_clocks()
        stamp_wall_ns, drops = read_ancillary(ancillary)
        return self.arrival(stamp_wall_ns, now_ns, wall_ns), drops

    def arrival(self, stamp_wall_ns: int | None, now_ns: int, wall_ns: int) -> int:
        """When a datum arrived.

        Args:
            stamp_wall_ns: the kernel's stamp on the wall clock [ns], or None.
            now_ns: monotonic time of reading [ns].
            wall_ns: wall clock at the same instant [ns].

        Returns:
            Monotonic arrival, never after ``now_ns`` [ns].
        """
        if stamp_wall_ns is None:
            self.missing += 1
            return now_ns
        age_ns = wall_ns - stamp_wall_ns
        if 0 <= age_ns <= now_ns - self._empty_ns + self.margin_ns:
            return now_ns - age_ns
        if -PAIR_TOLERANCE_NS < age_ns < 0:
            return now_ns
        self.refused += 1
        return now_ns
