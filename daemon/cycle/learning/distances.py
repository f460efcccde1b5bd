"""Learning over assemblies: how late the distance sensor is dated, and the way that it counts.

A clamped tool moves with its object. Its own position, and how far the force bends its mount, are
where the object is. The reading less that grows with the speed if the sensor is later than stated,
and with the way if its wheel slips:

    reading(t) - place(t) = offset - late v(t) + slip way(t)

What an assembly shows of both adds to what the ones before have shown, by least squares. A line
that does not change its speed in contact shows the slip alone.

Invariants:
- An assembly counts if it was good: screws fixed, then the wheel released, no retreat.
- It counts if the object was firm: one that sways lags its conveyor as a late sensor does.
- A change is made while the robot stands. It goes through the parameter service like an operator's.
- Values that were taken back are learned as at first.
"""

from collections.abc import Sequence

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.observation import mean_distances, mean_wrench, pose_at
from linemate.daemon.core.tracking.settings import DistanceNoise
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.tracker_state import TrackerState
from linemate.daemon.core.wrench_frame import each_at_tcp
from linemate.daemon.cycle.states import MOVING
from linemate.daemon.cycle.step_log import LogEntry

WHO = "distances"
"""Operator that the log names for a learned change."""

LATE, SCALE = "tracking.distance.late", "tracking.distance.scale"
LATE_S, SLIP = 0.01, 0.003  # one sigma of both before an assembly: 5 to 20 ms, 0.1 to 1 %
LARGEST_S, LARGEST_SLIP = 0.03, 0.02  # of an assembly: more shows a fault
LATEST_S, LEAST_SCALE, LARGEST_SCALE = 0.03, 0.97, 1.03  # those of the settings
FADING = 0.9  # of what the assemblies before have shown: a wheel wears
SEATED_S = 1.0  # after which the tool has settled at the object [s]
BLOCK_S = 1.0  # errors of so long are correlated: a block's sum has their variance [s]
LEAST_BLOCKS = 4
MOST_BLOCKS = 120
WORTH_M = 0.00005  # a change that moves the object by less is not made: each is recorded [m]
SPOILS_M = 0.00035  # standard deviation of a touch: a larger change was in the touch [m]
LEAD_S = 1.5  # for which the estimate's offset follows the slip before a touch [s]


class DistanceLearner:
    """Keeps an assembly in contact until it is known to be good.

    Attributes:
        shown: of the last good assembly: information (2, 2) of what the sensor is late [s] and
            slips beyond its settings, and its product with both (2,); None before the next one.
        moved: how far what the last assembly has shown moves an object before the touch [m].
    """

    def __init__(self) -> None:
        self.shown: tuple[Array, Array] | None = None
        self.moved = 0.0
        self._blocks: list[Array] = []
        self._first: tuple[int, float, float] | None = None
        self._is_firm = self._is_over = False
        self._speed = 0.0
        self._known: Array = _before()
        self._rest: Array = np.zeros(2)
        self._kept: tuple[float, float] | None = None

    @property
    def spoils_touch(self) -> bool:
        """Whether that is more than a touch errs by itself."""
        return self.moved > SPOILS_M

    def record_motion(self, entries: Sequence[LogEntry]) -> None:
        """Look at the steps of a motion."""
        for entry in entries:
            if entry.after is None or entry.parameters is None or entry.state not in MOVING:
                self._blocks, self._first, self._is_firm, self._is_over = [], None, False, False
                continue
            state = entry.after.tracker
            if state.contact and state.releasing is None and state.touching > SEATED_S:
                self._add(entry, state, entry.parameters)
            if self._is_over or Gate.WHEEL_RELEASED not in state.passed:
                continue
            self._is_over = True
            if self._is_firm and Gate.SCREWS_FIXED in state.passed and state.withdrawn is None:
                self.shown = shown_by(self._blocks)

    def _add(self, entry: LogEntry, state: TrackerState, parameters: Parameters) -> None:
        """Add one step's readings to the sums of its block."""
        self._is_firm = self._is_firm or state.compliance.is_firm
        self._speed = parameters.tracker.task.conveyor.nominal_speed
        settings = parameters.tracker.settings
        wrench = mean_wrench(each_at_tcp(parameters.wrench_frame, entry.inputs.wrench))
        if wrench is None or state.history is None or not settings.tactile.holds:
            return
        tcp = pose_at(state.history, wrench.stamp_ns, 2.5 * parameters.cycle_s)
        if tcp is None:
            return
        bent = rotations.exp(tcp[3:])[1] @ (wrench.force / np.array(settings.tactile.stiffness))
        for sample, count in mean_distances(entry.inputs.distance):
            since_s = (sample.stamp_ns - wrench.stamp_ns) * 1e-9
            since_s -= settings.distance.delay + settings.distance.late
            reading, place = settings.distance.scale * sample.position, float(tcp[1] + bent)
            place += state.speed * since_s
            self._first = self._first or (sample.stamp_ns, reading, place)
            begin_ns, first, start = self._first
            block = int((sample.stamp_ns - begin_ns) * 1e-9 / BLOCK_S)
            if block >= MOST_BLOCKS:
                return
            while len(self._blocks) <= block:
                self._blocks.append(np.zeros((4, 4)))
            way = reading - first
            row = np.array((1.0, -state.speed, way, way - place + start))
            self._blocks[block] += count * np.outer(row, row)

    def keep(self, present: DistanceNoise) -> dict[str, float]:
        """Return the parameters that the last assembly changes, by name.

        Args:
            present: with the values in force in that assembly.
        """
        shown, self.shown, self.moved = self.shown, None, 0.0
        if shown is None:
            return {}
        if (present.late, present.scale) != self._kept:
            self._known, self._rest = _before(), np.zeros(2)
            self._kept = present.late, present.scale
        known = FADING * self._known + shown[0]
        off = np.linalg.solve(known, FADING * (self._known @ self._rest) + shown[1])
        late, slip = off.tolist()
        self.moved = self._speed * abs(late - LEAD_S * slip)
        if abs(late) > LARGEST_S or abs(slip) > LARGEST_SLIP:
            return {}
        self._known, self._rest = known, off
        if self._speed * max(abs(late), LEAD_S * abs(slip)) < WORTH_M:
            return {}
        whole = round(min(max(present.late + late, -present.delay), LATEST_S), 6)
        scale = round(min(max(present.scale * (1.0 - slip), LEAST_SCALE), LARGEST_SCALE), 6)
        self._rest, self._kept = np.zeros(2), (whole, scale)
        return {LATE: whole, SCALE: scale}


def _before() -> Array:
    """Return the information (2, 2) before any assembly."""
    return np.diag((LATE_S**-2.0, SLIP**-2.0))


def shown_by(blocks: Sequence[Array]) -> tuple[Array, Array] | None:
    """Return what sums of rows show: information (2, 2), and its product with both (2,).

    None where they are too few. What errs for long, such as a swing, counts by the sums of blocks.

    Args:
        blocks: sums of the products (4, 4) of 1, minus the speed, the way, and what is explained.
    """
    if len(blocks) < LEAST_BLOCKS:
        return None
    total: Array = np.sum(blocks, axis=0)
    normal, right, count = total[:3, :3], total[:3, 3], float(total[0, 0])
    fit = np.linalg.lstsq(normal, right, rcond=None)[0]
    squares = max(float(total[3, 3] - right @ fit), 1e-12)
    sums = [float(block[0, 3] - block[0, :3] @ fit) for block in blocks]
    variance = max(sum(each * each for each in sums), squares) / count
    across = normal[0, 1:] / count
    information: Array = (normal[1:, 1:] - count * np.outer(across, across)) / variance
    return information, (right[1:] - right[0] * across) / variance
