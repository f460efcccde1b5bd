"""Sampling timer: a timerfd that the event loop watches, armed by the phase lock.

asyncio's own timers round to a millisecond; a timerfd wakes within 0.1 ms. Times are absolute, so
a late wake does not delay the next one.
"""

import asyncio
import ctypes
import os
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

from linemate.daemon.cycle.clock.phase_lock import Due, DueKind, PhaseLock

CLOCK_MONOTONIC: Final = 1
TFD_FLAGS: Final = os.O_NONBLOCK | os.O_CLOEXEC
TFD_TIMER_ABSTIME: Final = 1
ITIMERSPEC: Final = struct.Struct("@llll")  # interval, value: seconds and nanoseconds each
EXPIRATIONS: Final = struct.Struct("@Q")
NS: Final = 1_000_000_000

Argument = TypeVar("Argument")


class TimerFd:
    """One timerfd on the monotonic clock; os.timerfd_create where Python has it."""

    def __init__(self) -> None:
        """Create the timer, disarmed.

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
        """Expire once at a monotonic time; at once if that has passed."""
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
        late: wakes later than a quarter of a cycle.
    """

    wakes: int = 0
    last_ns: int = 0
    worst_ns: int = 0
    late: int = 0

    def add(self, late_ns: int, limit_ns: int) -> None:
        """Count one wake."""
        self.wakes += 1
        self.last_ns = late_ns
        self.worst_ns = max(self.worst_ns, late_ns)
        self.late += late_ns > limit_ns


@dataclass(slots=True)
class CycleTimer:
    """Wakes the loop when the phase lock says so, and calls what is due.

    Attributes:
        on_error: gets what ``on_due`` or ``attend`` raised. The timer goes on.
        poll: reads telegrams that wait, so that none of them is called missing.
        attend: waits for a telegram whose reply is ready and that is expected then [ns].
    """

    on_due: Callable[[Due], None]
    on_error: Callable[[Exception], None]
    poll: Callable[[], None]
    lock: PhaseLock
    lateness: Lateness = field(default_factory=Lateness)
    attend: Callable[[int], None] = lambda _: None
    _timer: TimerFd | None = None
    _loop: asyncio.AbstractEventLoop | None = None
    _armed_ns: int = 0
    _is_armed: bool = False

    def open(self) -> None:
        """Run on the running loop."""
        self._loop = asyncio.get_running_loop()
        self._timer = TimerFd()
        self._loop.add_reader(self._timer.fileno(), self._wake)
        self.arm()

    def close(self) -> None:
        """Stop."""
        if self._timer is not None and self._loop is not None:
            self._loop.remove_reader(self._timer.fileno())
            self._timer.close()
            self._timer, self._is_armed = None, False

    def arm(self) -> None:
        """Wake when the phase lock says so; to be called when a telegram has moved it."""
        wake_ns = self.lock.wake_ns
        if self._is_armed and wake_ns == self._armed_ns:
            return
        self._armed_ns = wake_ns
        if self._timer is not None:
            self._timer.arm(wake_ns)
            self._is_armed = True

    def _wake(self) -> None:
        now_ns, armed_ns, lock = time.monotonic_ns(), self._armed_ns, self.lock
        if self._timer is None:
            return
        # Arming resets the descriptor, so an expired one is not read: 8 us of a wake. A telegram in
        # the same turn of the loop may have moved the wake into the future.
        if now_ns >= armed_ns:
            self.lateness.add(now_ns - armed_ns, lock.period_ns // 4)
        elif self._timer.read() == 0:
            return
        self._is_armed = False
        if lock.may_pass_over(now_ns):
            self.poll()
        for due in lock.take_due(now_ns):
            self._call(self.on_due, due)
            if due.kind is DueKind.PREPARE:
                lock.add_cost(time.monotonic_ns() - (due.stamp_ns - lock.lead_ns))
        # Only now: until shortly before its telegram there is time for everything else.
        expected_ns = lock.attend(time.monotonic_ns())
        if expected_ns is not None:
            self._call(self.attend, expected_ns)
        self.arm()

    def _call(self, action: Callable[[Argument], None], argument: Argument) -> None:
        try:
            action(argument)
        except Exception as error:  # noqa: BLE001 - the timer must outlive a fault
            self.on_error(error)
