"""Learning over assemblies: what the object keeps weighs as much as the tool does less without it.

The mean force of the free tool before contact and that of the empty tool after the release differ
by the weight of the part, wherever the sensor was zeroed. The next assembly lets the object take
that weight over before the clamp opens (``tracking.payload.part_mass``).

Invariants:
- An assembly counts if it was good: screws fixed, then the wheel released, no retreat.
- A difference that is not along gravity, or no larger than a bias, is no weight.
- A change is made while the robot stands. It goes through the parameter service like an operator's.
- One assembly changes a known mass by ``LARGEST_STEP`` of it at most.
"""

import math
from collections.abc import Sequence

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.estimation.tool_weight import gravity
from linemate.daemon.core.tracking.settings import PayloadSettings
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch.tare import GRAVITY, SHARE, SPRUNG_S, WEIGHT_N
from linemate.daemon.cycle.states import MOVING
from linemate.daemon.cycle.step_log import LogEntry

WHO = "weights"
"""Operator that the log names for a learned change."""

PART_MASS = "tracking.payload.part_mass"
KNOWN = 4  # assemblies that a mass counts for which was known before the start
LEAST_GAIN = 0.1  # share of a weight that is taken: another variant may come
LARGEST_STEP = 0.3  # of a known mass by one assembly, as a share
WORTH = 0.05  # a smaller change is not made: each is recorded [kg]


class PartLearner:
    """Keeps the weight of an assembly's part until the assembly is known to be good.

    Attributes:
        mass: of the last good assembly [kg]; None before the next one.
    """

    def __init__(self) -> None:
        self.mass: float | None = None
        self._hung: Array | None = None
        self._count = 0

    def record_weight(self, entries: Sequence[LogEntry]) -> None:
        """Look at the steps of a motion."""
        for entry in entries:
            if entry.after is None or entry.parameters is None or entry.state not in MOVING:
                self._hung = None
                continue
            state = entry.after.tracker
            if state.tare.wrench is not None:
                self._hung = state.tare.wrench[:3]
            empty = state.tare.empty
            if self._hung is None or empty is None or state.tare.emptied < SPRUNG_S:
                continue
            if Gate.SCREWS_FIXED in state.passed and state.withdrawn is None:
                down = gravity(entry.parameters.tracker, state.poses[0])
                self.mass = weighed(self._hung - empty, down)
            self._hung = None

    def keep(self, present: PayloadSettings) -> dict[str, float]:
        """Return the parameter that the last weight changes, by its name.

        Args:
            present: with the mass in force in that assembly.
        """
        mass, self.mass = self.mass, None
        if mass is None:
            return {}
        known = present.part_mass
        self._count = (self._count or KNOWN) + 1 if known > 0.0 else 1
        largest = LARGEST_STEP * known if known > 0.0 else math.inf
        step = min(max(mass - known, -largest), largest)
        step *= max(1.0 / self._count, LEAST_GAIN)
        return {PART_MASS: round(known + step, 2)} if abs(step) >= WORTH else {}


def weighed(force: Array, down: tuple[float, float, float]) -> float | None:
    """Return the mass whose weight a force is [kg]; None if it is none.

    Args:
        force: (3,) by which the tool has become lighter, in the tcp [N].
        down: unit vector of gravity in the tcp.
    """
    x, y, z = force.tolist()
    along = x * down[0] + y * down[1] + z * down[2]
    is_weight = along > WEIGHT_N and along > SHARE * math.hypot(x, y, z)
    return along / GRAVITY if is_weight else None
