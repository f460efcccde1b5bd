"""Learning over assemblies: where the object is felt beyond where the camera shows it.

A hand-eye calibration has an error that no sensor sees before the touch. A clamped tool measures
the object, and the camera's place of it is known from just before, and from before bolts in their
holes have moved the estimate. Their difference across the tool's axis, and about the axes across
it, is what the next assembly is corrected by (``tracking.camera.felt``,
``tracking.camera.felt_turn``). Along the tool's axis the first force shows it
(``tracking.camera.felt_depth``): later the press moves an object that gives way. Bolts are drawn
into their angle, which shows nothing of the camera's mount.

Invariants:
- A touch counts if its assembly was good: screws fixed, then the wheel released, no retreat.
- Its depth counts if the object was firm: the press moves one that gives way.
- A change is made while the robot stands. It goes through the parameter service like an operator's.
- Corrections that were taken back are learned as quickly as at first.
- A touch farther off than ``LARGEST_M`` or ``LARGEST_RAD`` shows a fault, not a bias. Within what
  the corrections reach it is none: a camera 1.7 mm off, with noise, was refused in two of three.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers.bank_model import OFFSET, BankState
from linemate.daemon.core.tracking.observation import History
from linemate.daemon.core.tracking.settings import CameraNoise
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.tracker_state import TrackerState
from linemate.daemon.cycle.states import MOVING
from linemate.daemon.cycle.step_log import LogEntry

WHO = "touches"
"""Operator that the log names for a learned change."""

FELT, FELT_TURN = "tracking.camera.felt", "tracking.camera.felt_turn"
FELT_DEPTH = "tracking.camera.felt_depth"
LARGEST_M, LARGEST_RAD = 0.003, 0.006  # of a touch from where the object was expected
KNOWN = 4  # touches that a value counts for which was learned before the start
LEAST_GAIN = 0.1  # share of a touch that is taken: a mount may move
NOISE_SHARE = 0.5  # variance of a touch (0.35 mm) over that of a calibrated mount (0.5 mm)
REACH_M, REACH_RAD = 0.003, 0.01  # largest corrections, those of the settings
WORTH = 1e-5  # a smaller change is not made: each is recorded [m, rad]
DEPTH_S = 0.03  # after which a clamp is closed; the press soon moves an object that gives way [s]
PLACE_S = 0.2  # after which a tool that rang has settled, and a heavy object has hardly moved [s]
SEATED_S = 1.0  # after which the estimate has taken the turn of a clamped tool [s]

UNHELD = (0.0, 0.0)

Pair = tuple[float, float]
Place = tuple[float, float, float]


class FeltError(NamedTuple):
    """Where a good assembly felt the object beyond where it was estimated.

    Attributes:
        across: along x and y of the tcp [m].
        turn: about x and y of the tcp [rad].
        depth: along z of the tcp [m].
    """

    across: Pair
    turn: Pair
    depth: float = 0.0


class TouchLearner:
    """Keeps the touch of an assembly until it is known to be good.

    Attributes:
        touch: of the last good assembly; None before the next one.
    """

    def __init__(self) -> None:
        self.touch: FeltError | None = None
        self._depth: float | None = None
        self._across: Pair | None = None
        self._expected: TrackerState | None = None
        self._drawn = 0.0
        self._felt: FeltError | None = None
        self._is_over = self._is_firm = False
        self._count = 0

    def record_touch(self, entries: Sequence[LogEntry]) -> None:
        """Look at the steps of a motion."""
        for entry in entries:
            if entry.before is None or entry.after is None or entry.state not in MOVING:
                self._expected, self._felt, self._is_over = None, None, False
                self._is_firm = False
                continue
            self._measure(entry.before.tracker, entry.after.tracker)
            after = entry.after.tracker
            self._is_firm = self._is_firm or after.compliance.is_firm
            if self._is_over or Gate.WHEEL_RELEASED not in after.passed:
                continue
            self._is_over = True
            if Gate.SCREWS_FIXED in after.passed and after.withdrawn is None:
                self.touch = self._felt
                if self.touch is not None and not self._is_firm:
                    # One that gives way has yielded by 0.4 mm as the force is detected.
                    self.touch = self.touch._replace(depth=0.0)

    def _measure(self, before: TrackerState, after: TrackerState) -> None:
        """Look at one step: of a settled tool for the place, of a seated one for the turn."""
        # Bolts in their holes have shown a part before the face touches.
        if after.held == UNHELD:
            self._drawn = 0.0
        elif after.held != before.held:
            self._drawn += moved_along(before, after)
        if after.compliance.press is not None and before.compliance.press is None:
            self._expected, self._felt, self._is_over = before, None, False
            self._across = self._depth = None
        if self._expected is None or after.touching < DEPTH_S:
            return
        if self._depth is None or self._across is None:
            place = felt_place(self._expected, after, self._drawn)
            if place is None:
                return
            self._depth = place[2] if self._depth is None else self._depth
            self._across = place[:2] if after.touching >= PLACE_S else None
        if after.touching < SEATED_S:
            return
        turn = felt_turn(self._expected, after)
        if self._across is not None and turn is not None:
            self._felt = FeltError(self._across, turn, self._depth or 0.0)
        self._expected = None

    def keep(self, present: CameraNoise) -> dict[str, Any]:
        """Return the parameters that the last touch changes, by name.

        Args:
            present: with the corrections in force in that assembly.
        """
        touch, self.touch = self.touch, None
        if touch is None or is_far(touch):
            return {}
        is_known = any((*present.felt, *present.felt_turn, present.felt_depth))
        self._count = (self._count or KNOWN) + 1 if is_known else 1
        gain = max(1.0 / (self._count + NOISE_SHARE), LEAST_GAIN)
        changed: dict[str, Any] = {}
        for name, known, off, reach in (
            (FELT, present.felt, touch.across, REACH_M),
            (FELT_TURN, present.felt_turn, touch.turn, REACH_RAD),
        ):
            later = [min(max(p + gain * t, -reach), reach) for p, t in zip(known, off, strict=True)]
            if math.dist(later, known) >= WORTH:
                changed[name] = [round(value, 6) for value in later]
        depth = min(max(present.felt_depth + gain * touch.depth, -REACH_M), REACH_M)
        if abs(touch.depth) <= LARGEST_M and abs(depth - present.felt_depth) >= WORTH:
            changed[FELT_DEPTH] = round(depth, 6)
        return changed


def is_far(touch: FeltError) -> bool:
    """Return whether a touch is farther off than a calibrated camera can be."""
    return math.hypot(*touch.across) > LARGEST_M or math.hypot(*touch.turn) > LARGEST_RAD


def moved_along(before: TrackerState, after: TrackerState) -> float:
    """Return how far the object has moved on its conveyor by the estimates [m].

    The offset of the distance sensor falls by as much.
    """
    if isinstance(before.conveyor, BankState) and isinstance(after.conveyor, BankState):
        return -float(after.conveyor.x[OFFSET] - before.conveyor.x[OFFSET])
    return 0.0


def felt_place(before: TrackerState, after: TrackerState, drawn: float = 0.0) -> Place | None:
    """Return how far the object is felt from where it was estimated, along x y z of the tcp [m].

    Args:
        before: state of the last step without a force that measures the object.
        after: of a settled tool. The estimate and the offset of the compliance have taken a part
            of the way already; what is left is in the mean deviation.
        drawn: what bolts in their holes have moved the estimate by before, along [m].
    """
    earlier, later = before.transverse, after.transverse
    if after.history is None or earlier is None or later is None:
        return None
    offset, rest = after.compliance.offset, after.compliance.smooth
    x, y, z = (taken + left for taken, left in zip(offset, rest, strict=True))
    x += float(later.x[0] - earlier.x[0]) + before.held[0]
    y += moved_along(before, after) + drawn
    z += float(later.x[1] - earlier.x[1]) + before.held[1]
    return _in_tool(after.history, np.array((x, y, z)))


def felt_turn(expected: TrackerState, seated: TrackerState) -> Pair | None:
    """Return by how much the object is turned from its estimate, about x and y of the tcp [rad].

    Args:
        expected: state of the last step before the touch.
        seated: of a clamped tool, whose estimate the turn of the mount has corrected.
    """
    if expected.transverse is None or seated.transverse is None or seated.history is None:
        return None
    turned = rotations.log(seated.transverse.rotation @ expected.transverse.rotation.T)
    return _in_tool(seated.history, turned)[:2]


def _in_tool(history: History, vector: Array) -> Place:
    """Return in the tcp a vector (3,) in c."""
    x, y, z = rotations.exp(history.poses[-1][3:]).T.dot(vector).tolist()
    return x, y, z
