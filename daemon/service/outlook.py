"""What a live view is shown beside the step's own words: the robot, the foresight, the happenings.

Law of this file: values in, plain values out; no clock, no I/O, and of fixed size. Taking a step in
costs a few microseconds; the rest is made when somebody asks, which is at most 50 times a second
and for all of them at once. Together with the telemetry it fits into one datagram.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.cycle.clock.timing import CycleTimes
from linemate.daemon.cycle.step_log import LogEntry

FORESEEN: Final = 8
"""Poses of the horizon that are shown, the first and the last among them."""

TOLD: Final = 2
"""Happenings in one telemetry; whoever missed some sees it from their numbers."""

LONGEST: Final = 64  # characters of a happening
RECENT: Final = 20  # cycles whose slowest reply is shown
_DIGITS: Final = 5


@dataclass(slots=True)
class Outlook:
    """Takes steps in, and tells what there is to see.

    Attributes:
        cycle_ms: T0 [ms].
        happened: so far, in all.
    """

    cycle_ms: float
    happened: int = 0
    _told: deque[tuple[int, int, str]] = field(default_factory=lambda: deque(maxlen=TOLD))
    _turnarounds: deque[int] = field(default_factory=lambda: deque(maxlen=RECENT))
    _entry: LogEntry | None = None
    _joints: tuple[float, ...] | None = None
    _joints_ns: int = 0
    _newest_ns: dict[str, int] = field(default_factory=dict)

    def take(self, entries: Iterable[LogEntry], times: Iterable[CycleTimes] = ()) -> None:
        """Take in steps, after their replies.

        Args:
            times: what their cycles took.
        """
        for entry in entries:
            self._entry = entry
            inputs = entry.inputs
            if inputs.robot is not None:
                self._joints = (*inputs.robot.joints, *inputs.robot.external)
                self._joints_ns = inputs.robot.stamp_ns
            for name, samples in (
                ("distance", inputs.distance),
                ("camera", inputs.camera),
                ("wrench", inputs.wrench),
            ):
                if samples:
                    self._newest_ns[name] = samples[-1].stamp_ns
            for what, how in entry.outputs.events:
                self.say(inputs.stamp_ns, f"conveyor: {what} {how}")
        for one in times:
            if one.turnaround_ns is not None:
                self._turnarounds.append(one.turnaround_ns)

    def say(self, stamp_ns: int, text: str) -> None:
        """Take in something that happened.

        Args:
            stamp_ns: when [ns].
        """
        self.happened += 1
        self._told.append((self.happened, stamp_ns, text[:LONGEST]))

    def shown(self, nominal: Array) -> dict[str, Any]:
        """Return what there is to see, plain values.

        Args:
            nominal: (3, 3) the axes of c in base, in which the horizon stands.
        """
        told: dict[str, Any] = {"happened": [list(one) for one in self._told]}
        told["cycle_ms"] = self.cycle_ms
        if self._turnarounds:
            told["turnaround_us"] = max(self._turnarounds) // 1000
        entry = self._entry
        if entry is None:
            return told
        now_ns = entry.inputs.stamp_ns
        if self._joints is not None:
            told["measured"] = self._joints[: len(entry.outputs.command)]
            told["measured_ns"] = self._joints_ns
        told["ages_ms"] = {
            name: round(max(0, now_ns - stamp_ns) / 1e6, 1)
            for name, stamp_ns in self._newest_ns.items()
        }
        horizon = entry.outputs.horizon
        if horizon is not None:
            last = len(horizon) - 1
            told["foreseen"] = points_in_base(horizon, nominal)
            told["foreseen_ms"] = round(last * self.cycle_ms)
        return told


def points_in_base(horizon: Array, nominal: Array) -> list[list[float]]:
    """Return some positions of a horizon in base [m], evenly spread, the first and last included.

    Args:
        horizon: (n+1, 6) poses in c.
        nominal: (3, 3) the axes of c in base.
    """
    count = min(FORESEEN, len(horizon))
    chosen = np.linspace(0, len(horizon) - 1, count).round().astype(int)
    points: list[list[float]] = (horizon[chosen, :3] @ nominal.T).round(_DIGITS).tolist()
    return points
