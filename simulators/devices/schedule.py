"""Timer for absolute instants of the monotonic clock in an asyncio loop.

Invariants:
    Lateness does not add up: each instant is absolute.
    A timerfd wakes the loop within 0.1 ms; asyncio's own timers round to 1 ms.
"""

import asyncio
import ctypes
import heapq
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from typing import Any

_TFD_NONBLOCK_CLOEXEC = 0o4000 | 0o2000000
_TFD_TIMER_ABSTIME = 1
_NS = 1_000_000_000
_NEVER = 0
"""Disarms a timer."""

Entry = list[Any]
"""When [ns], a number that keeps the order, and what; None if it was cancelled."""


class _TimeSpec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _TimerSpec(ctypes.Structure):
    _fields_ = (("interval", _TimeSpec), ("value", _TimeSpec))


_libc = ctypes.CDLL(None, use_errno=True)


def _timerfd() -> int:
    descriptor = int(_libc.timerfd_create(time.CLOCK_MONOTONIC, _TFD_NONBLOCK_CLOEXEC))
    if descriptor < 0:
        raise OSError(ctypes.get_errno(), "timerfd_create")
    return descriptor


class _Timer:
    """A timerfd of the monotonic clock."""

    __slots__ = ("_set", "_value", "descriptor")

    def __init__(self) -> None:
        self.descriptor = _timerfd()
        spec = _TimerSpec(_TimeSpec(0, 0), _TimeSpec(0, 0))
        self._value = spec.value
        call = _libc.timerfd_settime
        # What does not change is made once: this is called several times a cycle.
        self._set = partial(
            call, ctypes.c_int(self.descriptor), _TFD_TIMER_ABSTIME, ctypes.byref(spec), None
        )

    def arm(self, at_ns: int) -> None:
        """Expire at an instant [ns]; zero is never."""
        self._value.seconds, self._value.nanoseconds = divmod(at_ns, _NS)
        if self._set() < 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")


@dataclass(slots=True)
class DeviceSchedule:
    """Runs actions in the order of their instants.

    Attributes:
        worst_ns: how late the latest action ran [ns].
        on_error: gets what an action raises; without it the loop's handler does.
    """

    worst_ns: int = 0
    on_error: Callable[[Exception], None] | None = None
    _timer: _Timer | None = None
    _armed_ns: int = -1
    _is_running: bool = False
    _queue: list[Entry] = field(default_factory=list)
    _order: "count[int]" = field(default_factory=count)

    def open(self) -> None:
        """Start on the running loop.

        Raises:
            OSError: if the kernel gives no timer.
        """
        self._timer = _Timer()
        asyncio.get_running_loop().add_reader(self._timer.descriptor, self._expired)

    def close(self) -> None:
        """Forget what is still to be done."""
        if self._timer is not None:
            asyncio.get_running_loop().remove_reader(self._timer.descriptor)
            os.close(self._timer.descriptor)
            self._timer = None
        self._queue.clear()

    def at(self, at_ns: int, action: Callable[[], None]) -> Entry:
        """Do something at an instant; at once if it has passed.

        Args:
            action: what to do; it must not block.

        Returns:
            What ``cancel`` takes.
        """
        entry: Entry = [at_ns, next(self._order), action]
        heapq.heappush(self._queue, entry)
        self._rearm()
        return entry

    def cancel(self, entry: Entry) -> None:
        """Do not do it after all; nothing if it is done."""
        entry[2] = None

    def __len__(self) -> int:
        return sum(entry[2] is not None for entry in self._queue)

    def _rearm(self) -> None:
        """Set the timer to the next instant; while actions run, that is done after them."""
        queue = self._queue
        while queue and queue[0][2] is None:
            heapq.heappop(queue)
        if self._is_running or self._timer is None:
            return
        # Setting it also clears it, so no read is needed.
        next_ns = max(queue[0][0], 1) if queue else _NEVER
        if next_ns != self._armed_ns:
            self._armed_ns = next_ns
            self._timer.arm(next_ns)

    def together(self, action: Callable[[], object]) -> None:
        """Do something now that puts several things on the schedule; the timer is set once."""
        was_running, self._is_running = self._is_running, True
        try:
            action()
        finally:
            self._is_running = was_running
            self._rearm()

    def _expired(self) -> None:
        self._armed_ns = -1
        self.together(self._run_due)

    def _run_due(self) -> None:
        now_ns = time.monotonic_ns()
        while self._queue and self._queue[0][0] <= now_ns:
            at_ns, _, action = heapq.heappop(self._queue)
            if action is not None:
                self.worst_ns = max(self.worst_ns, now_ns - at_ns)
                self._run(action)

    def _run(self, action: Callable[[], None]) -> None:
        try:
            action()
        except Exception as error:
            if self.on_error is None:
                raise
            self.on_error(error)
