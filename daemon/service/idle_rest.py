"""When the daemon makes no steps for a robot that stands idle, and at which rate its clock wakes.

Invariants:
- Anyone who is connected keeps the full rate. An order ends the rest before it is judged.
- The clock and the cycle rest together.
"""

import time
from collections.abc import Callable

from linemate.daemon.cycle.clock.timer import CycleTimer
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.resting import LOOK_S
from linemate.daemon.cycle.states import State

LOOK_NS = round(1e9 * LOOK_S)


class IdleRest:
    """Begins and ends the rests of a cycle and its clock."""

    def __init__(
        self, cycle: Cycle, timer: CycleTimer, is_used: Callable[[], bool], after_s: float
    ) -> None:
        """Begin at full rate.

        Args:
            is_used: whether anyone is connected, or the daemon orders by itself.
            after_s: time of IDLE without anyone until a rest [s].
        """
        self._cycle, self._timer, self._is_used = cycle, timer, is_used
        self._after_ns = round(1e9 * after_s)
        self._busy_ns = time.monotonic_ns()
        self._updated_ns = 0

    def is_between_looks(self, stamp_ns: int) -> bool:
        """Return whether a telegram of a rest [ns] needs nothing but its reply and the clock."""
        return self._cycle.is_resting and stamp_ns - self._updated_ns < LOOK_NS

    def update(self, now_ns: int) -> None:
        """Begin or end a rest as the state and the operators ask for, after a cycle [ns]."""
        self._updated_ns = now_ns
        if self._cycle.machine.state is not State.IDLE or self._is_used():
            self._busy_ns = now_ns
            self._cycle.end_rest()
        elif not self._cycle.is_resting and now_ns - self._busy_ns > self._after_ns:
            lock = self._timer.lock
            # An unmeasured period forbids to arm. It is measured at full rate.
            if lock.is_locked and lock.estimate.arm_refusal is None:
                self._cycle.begin_rest()
        self.set_rate()

    def wake_up(self) -> None:
        """Go back to full rate for an operator."""
        self._busy_ns = time.monotonic_ns()
        self._cycle.end_rest()
        self.set_rate()

    def set_rate(self) -> None:
        """Let the clock wake as often as the cycle needs it."""
        lock, rests = self._timer.lock, self._cycle.is_resting
        if lock.is_slow != rests:
            lock.set_slow(LOOK_S if rests else 0.0)
            self._timer.arm()
