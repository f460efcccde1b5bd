"""The sampling clock: a timerfd that the loop watches, driven by the pace.

Law of this file: the timer and nothing else; which step is due is ``pace``'s. asyncio's own
timers round to a millisecond, a timerfd wakes within 0.1 ms. Stamps are absolute, so a late wake
does not delay the next one. Source: reference/real-time.md, sections 1 and 5.
"""

import asyncio
import ctypes
import os
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

from linemate.daemon.cycle.clock.pace import Pace
from linemate.daemon.cycle.clock.schedule import Due, Kind, Schedule

CLOCK_MONOTONIC: Final = 1
TFD_FLAGS: Final = os.O_NONBLOCK | os.O_CLOEXEC
TFD_TIMER_ABSTIME: Final = 1
ITIMERSPEC: Final = struct.Struct("@llll")  # interval, value: seconds and nanoseconds each
EXPIRATIONS: Final = struct.Struct("@Q")
NS: Final = 1_000_000_000

What = TypeVar("What")


class Timer:
    """One timerfd on the monotonic clock; os.timerfd_create where Python has it."""

    def __init__(self) -> None:
        """Create it, disarmed.

        Raises:
            OSError: no descriptor is left.
        """
        self._own: Any = getattr(os, "timerfd_settime_ns", None)
        if self._own is not None:
            self._fd: int = getattr(os, "timerfd_create")(CLOCK_MONOTONIC, flags=TFD_FLAGS)  # noqa: B009
            return
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._fd = _checked(self._libc.timerfd_create(CLOCK_MONOTONIC, TFD_FLAGS))

    def fileno(self) -> int:
        """The descriptor to watch."""
        return self._fd

    def arm(self, at_ns: int) -> None:
        """Expire once at a monotonic time; at once if that has passed.

        Args:
            at_ns: [ns].
        """
        at_ns = max(1, at_ns)  # zero would disarm
        if self._own is not None:
            self._own(self._fd, flags=TFD_TIMER_ABSTIME, initial=at_ns, interval=0)
            return
        spec = ITIMERSPEC.pack(0, 0, at_ns // NS, at_ns % NS)
        _checked(self._libc.timerfd_settime(self._fd, TFD_TIMER_ABSTIME, spec, None))

    def read(self) -> int:
        """How often it has expired since the last read."""
        try:
            (expirations,) = EXPIRATIONS.unpack(os.read(self._fd, EXPIRATIONS.size))
        except BlockingIOError:
            return 0
        return int(expirations)

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self._fd)


def _checked(result: int) -> int:
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return result


@dataclass(slots=True)
class Lateness:
    """How late the loop woke.

    Attributes:
        last_ns, worst_ns: [ns].
        late: wakes later than a quarter of a cycle.
    """

    wakes: int = 0
    last_ns: int = 0
    worst_ns: int = 0
    late: int = 0

    def note(self, late_ns: int, bearable_ns: int) -> None:
        """Count one wake."""
        self.wakes += 1
        self.last_ns = late_ns
        self.worst_ns = max(self.worst_ns, late_ns)
        self.late += late_ns > bearable_ns


@dataclass(slots=True)
class Clock:
    """Calls what is due, in the loop.

    Attributes:
        on_due: does it; what it or ``attend`` raises is counted by the caller and never stops the
            clock.
        on_error: told of what the others raised.
        look: takes telegrams that wait, so that none is called missing that is there already.
        pace: which step is due when.
        attend: waits for a telegram whose reply is ready, told when it is expected [ns].
    """

    on_due: Callable[[Due], None]
    on_error: Callable[[Exception], None]
    look: Callable[[], None]
    pace: Pace
    lateness: Lateness = field(default_factory=Lateness)
    attend: Callable[[int], None] = lambda _: None
    _timer: Timer | None = None
    _loop: asyncio.AbstractEventLoop | None = None
    _armed_ns: int = 0

    @property
    def schedule(self) -> Schedule:
        """Where the schedule stands."""
        return self.pace.schedule

    def open(self) -> None:
        """Run on the running loop."""
        self._loop = asyncio.get_running_loop()
        self._timer = Timer()
        self._loop.add_reader(self._timer.fileno(), self._wake)
        self._arm()

    def close(self) -> None:
        """Stop."""
        if self._timer is not None and self._loop is not None:
            self._loop.remove_reader(self._timer.fileno())
            self._timer.close()
            self._timer = None

    def telegram(self, stamp_ns: int, cycles: int = 1, *, anew: bool = False) -> None:
        """A telegram was answered: follow it.

        Args:
            stamp_ns: its arrival [ns].
            cycles: of the controller since the telegram before.
            anew: it begins a session.
        """
        self.pace.telegram(stamp_ns, cycles, anew=anew)
        self._arm()

    def run_free(self) -> None:
        """The robot is gone; keep the period alone."""
        self.pace.run_free()

    def _arm(self) -> None:
        self._armed_ns = self.pace.wake_ns
        if self._timer is not None:
            self._timer.arm(self._armed_ns)

    def _wake(self) -> None:
        now_ns = time.monotonic_ns()
        if self._timer is None or self._timer.read() == 0:
            return
        armed_ns = self._armed_ns
        # A telegram in the same turn of the loop may have moved the wake into the future.
        if now_ns >= armed_ns:
            self.lateness.note(now_ns - armed_ns, self.schedule.period_ns // 4)
        self.look()
        for one in self.pace.wake(now_ns):
            self._do(self.on_due, one)
            if one.kind is Kind.PREPARE:
                began_ns = one.stamp_ns - self.schedule.lead_ns
                self.pace.prepared(time.monotonic_ns() - began_ns)
        # Only now: until shortly before its telegram there is time for everything else.
        expected_ns = self.pace.attend(time.monotonic_ns())
        if expected_ns is not None:
            self._do(self.attend, expected_ns)
        self._arm()

    def _do(self, action: Callable[[What], None], what: What) -> None:
        try:
            action(what)
        except Exception as error:  # noqa: BLE001 - the clock must outlive a fault
            self.on_error(error)
