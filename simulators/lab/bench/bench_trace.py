"""Trace of a station during an assembly, to be played at any cycle time.

Invariants:
    Plain values on one time axis; no bytes, no clock.
    Between two telegrams the robot's axes are on a straight line.
"""

from __future__ import annotations

import itertools
import json
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from linemate.daemon.cycle.step_log import LogEntry

DISTANCE_NS = 4_000_000
"""A distance sensor speaks no faster than this, however short the cycle is [ns]."""

Row = Sequence[Any]


@dataclass(frozen=True, slots=True)
class StationTrace:
    """One run's readings; each row begins with its arrival after the run's begin [ns].

    Attributes:
        robot: joints A1..A6 [rad], E1 [m], the tool's signals.
        camera: exposure [ns], position [m], quaternion, covariance or None.
        wrench: force [N], torque [Nm].
    """

    robot: Sequence[Row]
    distance: Sequence[Row]
    camera: Sequence[Row]
    wrench: Sequence[Row]

    @property
    def length_ns(self) -> int:
        """From its begin to its last telegram [ns]."""
        return int(self.robot[-1][0])

    def axes(self, at_ns: int) -> tuple[tuple[float, ...], int]:
        """Where the robot is.

        Args:
            at_ns: after the begin [ns].

        Returns:
            A1..A6 [rad] and E1 [m], and the tool's signals.
        """
        after = bisect_right(self.robot, at_ns, key=lambda row: row[0])
        old = self.robot[max(0, after - 1)]
        new = self.robot[min(after, len(self.robot) - 1)]
        span = new[0] - old[0]
        share = (at_ns - old[0]) / span if span else 0.0
        joints = tuple(a + share * (b - a) for a, b in zip(old[1:8], new[1:8], strict=True))
        return joints, int(old[8])

    def thinned(self, cycle_ns: int) -> list[Row]:
        """The distance sensor's readings: one a cycle, but no faster than the sensor is."""
        period, rows = max(cycle_ns, DISTANCE_NS), self.distance
        thinned_rows: list[Row] = []
        for old, new in itertools.pairwise(rows):
            at = -(-old[0] // period) * period
            while at < new[0]:
                share = (at - old[0]) / (new[0] - old[0])
                thinned_rows.append((at, old[1] + share * (new[1] - old[1])))
                at += period
        return thinned_rows

    def write(self, path: Path) -> None:
        """Keep it in a file."""
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> StationTrace:
        """Take it from a file."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))


def from_entries(entries: Iterable[LogEntry]) -> StationTrace:
    """Take the readings out of a run's steps.

    Args:
        entries: from its first step on.

    Raises:
        ValueError: there is no telegram among them.
    """
    inputs = [entry.inputs for entry in entries]
    robots = [step_inputs.robot for step_inputs in inputs if step_inputs.robot is not None]
    if not robots:
        raise ValueError("a run without telegrams cannot be played")
    begin = robots[0].stamp_ns
    return StationTrace(
        robot=[
            (r.stamp_ns - begin, *r.joints, r.external[0] if r.external else 0.0, r.digital_in)
            for r in robots
        ],
        distance=[
            (d.stamp_ns - begin, d.position) for step_inputs in inputs for d in step_inputs.distance
        ],
        camera=[
            (c.stamp_ns - begin, c.exposure_ns - begin, c.position, c.quaternion, c.covariance)
            for step_inputs in inputs
            for c in step_inputs.camera
        ],
        wrench=[
            (w.stamp_ns - begin, w.force, w.torque)
            for step_inputs in inputs
            for w in step_inputs.wrench
        ],
    )
