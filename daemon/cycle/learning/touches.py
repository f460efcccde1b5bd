"""Learning over assemblies: where the object is felt beyond where the camera shows it.

A hand-eye calibration has an error that no sensor sees before the touch. A clamped tool measures
the object, and the camera's place of it is known from just before. Their difference across the
tool's axis is what the next assembly is corrected by (``tracking.camera.felt``).

Invariants:
- A touch counts if its assembly was good: screws fixed, then the wheel released, no retreat.
- A change is made while the robot stands. It goes through the parameter service like an operator's.
- A touch farther off than ``LARGEST_M`` shows a fault, not a bias.
"""

import math
from collections.abc import Sequence

from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.classifiers.bank_model import OFFSET, BankState
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.tracker_state import TrackerState
from linemate.daemon.cycle.states import MOVING
from linemate.daemon.cycle.step_log import LogEntry

WHO = "touches"
"""Operator that the log names for a learned change."""

FELT = "tracking.camera.felt"
LARGEST_M = 0.002  # of a touch from where the object was expected [m]
KNOWN = 4  # touches that a value counts for which was learned before the start
LEAST_GAIN = 0.1  # share of a touch that is taken: a mount may move
REACH_M = 0.003  # largest correction [m], that of the setting
WORTH_M = 1e-5  # a smaller change is not made: each is recorded [m]

Touch = tuple[float, float]


class TouchLearner:
    """Keeps the touch of an assembly until it is known to be good.

    Attributes:
        touch: of the last good assembly, across the tool's axis [m]; None before the next one.
    """

    def __init__(self) -> None:
        self.touch: Touch | None = None
        self._felt: Touch | None = None
        self._is_over = False
        self._count = 0

    def record_touch(self, entries: Sequence[LogEntry]) -> None:
        """Look at the steps of a motion."""
        for entry in entries:
            if entry.before is None or entry.after is None or entry.state not in MOVING:
                self._felt, self._is_over = None, False
                continue
            before, after = entry.before.tracker, entry.after.tracker
            if after.compliance.press is not None and before.compliance.press is None:
                self._felt, self._is_over = felt_touch(before, after), False
            if self._is_over or Gate.WHEEL_RELEASED not in after.passed:
                continue
            self._is_over = True
            if Gate.SCREWS_FIXED in after.passed and after.withdrawn is None:
                self.touch = self._felt

    def keep(self, present: Touch) -> dict[str, list[float]]:
        """Return the parameters that the last touch changes, by name.

        Args:
            present: correction in force in that assembly [m].
        """
        touch, self.touch = self.touch, None
        if touch is None or math.hypot(*touch) > LARGEST_M:
            return {}
        if not self._count and any(present):
            self._count = KNOWN
        self._count += 1
        gain = max(1.0 / (self._count + 1.0), LEAST_GAIN)
        later = [
            min(max(p + gain * t, -REACH_M), REACH_M) for p, t in zip(present, touch, strict=True)
        ]
        if math.dist(later, present) < WORTH_M:
            return {}
        return {FELT: [round(value, 6) for value in later]}


def felt_touch(before: TrackerState, after: TrackerState) -> Touch | None:
    """Return how far the object is felt from where it was estimated, across the tool's axis [m].

    Args:
        before: state of the last step without a force that measures the object.
        after: of the first one with it: its estimate has taken a part of the way already.
    """
    history, earlier, later = after.history, before.transverse, after.transverse
    if history is None or earlier is None or later is None:
        return None
    x, y, z = after.compliance.offset
    x += float(later.x[0] - earlier.x[0])
    z += float(later.x[1] - earlier.x[1])
    if isinstance(before.conveyor, BankState) and isinstance(after.conveyor, BankState):
        # The offset of the distance sensor falls by what the object has moved on its conveyor.
        y -= float(after.conveyor.x[OFFSET] - before.conveyor.x[OFFSET])
    R = rotations.exp(history.poses[-1][3:])
    across = R.T.dot((x, y, z))
    return float(across[0]), float(across[1])
