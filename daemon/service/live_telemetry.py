"""Live telemetry for views: joints, predicted path, sample ages and events.

Invariants:
- No clock and no I/O. Its size is fixed; with the other telemetry it fits into one datagram.
- ``record`` costs a few microseconds. ``snapshot`` runs on request, at most 50 times a second.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.cycle.clock.timing import CycleTimes
from linemate.daemon.cycle.step_log import LogEntry
from linemate.protocol.stamped_samples import RobotSample

HORIZON_POINTS: Final = 8  # positions of the horizon, the first and the last among them
EVENTS: Final = 2  # in one telemetry; their numbers show which were missed
LONGEST_EVENT: Final = 64  # characters
RECENT_CYCLES: Final = 20  # cycles whose slowest reply is shown
_DIGITS: Final = 5


@dataclass(slots=True)
class LiveTelemetry:
    """Newest steps and events.

    Attributes:
        event_count: number of events so far.
    """

    cycle_ms: float
    event_count: int = 0
    _events: deque[tuple[int, int, str]] = field(default_factory=lambda: deque(maxlen=EVENTS))
    _turnarounds: deque[int] = field(default_factory=lambda: deque(maxlen=RECENT_CYCLES))
    _entry: LogEntry | None = None
    _robot: RobotSample | None = None
    _newest: dict[str, Any] = field(default_factory=dict)

    def record(self, entries: Iterable[LogEntry], times: Iterable[CycleTimes] = ()) -> None:
        """Record steps and the times of their cycles, oldest first."""
        for entry in entries:
            self._entry = entry
            inputs, newest = entry.inputs, self._newest
            if inputs.robot is not None:
                self._robot = inputs.robot
            if inputs.distance:
                newest["distance"] = inputs.distance[-1]
            if inputs.camera:
                newest["camera"] = inputs.camera[-1]
            if inputs.wrench:
                newest["wrench"] = inputs.wrench[-1]
            for what, how in entry.outputs.events:
                self.add_event(inputs.stamp_ns, f"conveyor: {what} {how}")
        for cycle in times:
            if cycle.turnaround_ns is not None:
                self._turnarounds.append(cycle.turnaround_ns)

    def add_event(self, stamp_ns: int, text: str) -> None:
        """Add an event at a monotonic time [ns]."""
        self.event_count += 1
        self._events.append((self.event_count, stamp_ns, text[:LONGEST_EVENT]))

    def snapshot(self, nominal: Array) -> dict[str, Any]:
        """Return plain values for a view.

        Args:
            nominal: (3, 3) axes of c in base, the frame of the horizon.
        """
        shown: dict[str, Any] = {"happened": [list(event) for event in self._events]}
        shown["cycle_ms"] = self.cycle_ms
        if self._turnarounds:
            shown["turnaround_us"] = max(self._turnarounds) // 1000
        entry = self._entry
        if entry is None:
            return shown
        now_ns = entry.inputs.stamp_ns
        robot = self._robot
        if robot is not None:
            joints = (*robot.joints, *robot.external)
            shown["measured"] = joints[: len(entry.outputs.command)]
            shown["measured_ns"] = robot.stamp_ns
        shown["ages_ms"] = {
            name: round(max(0, now_ns - sample.stamp_ns) / 1e6, 1)
            for name, sample in self._newest.items()
        }
        horizon = entry.outputs.horizon
        if horizon is not None:
            last = len(horizon) - 1
            shown["foreseen"] = points_in_base(horizon, nominal)
            shown["foreseen_ms"] = round(last * self.cycle_ms)
        return shown

    def sensors(self) -> dict[str, Any]:
        """Return the newest sample of each sensor as plain values, in SI units.

        A stamp is on the daemon's monotonic clock [ns]; that of the camera is the exposure.
        """
        shown: dict[str, Any] = {}
        wrench, distance = self._newest.get("wrench"), self._newest.get("distance")
        camera = self._newest.get("camera")
        if wrench is not None:
            shown["wrench"] = (*wrench.force, *wrench.torque)
            shown["wrench_ns"] = wrench.stamp_ns
        if distance is not None:
            shown["distance"] = distance.position
            shown["distance_ns"] = distance.stamp_ns
        if camera is not None:
            shown["camera"] = (*camera.position, *camera.quaternion)
            shown["camera_ns"], shown["camera_frame"] = camera.exposure_ns, camera.frame
        return shown


def points_in_base(horizon: Array, nominal: Array) -> list[list[float]]:
    """Return evenly spread positions of a horizon in base [m], with the first and the last.

    Args:
        horizon: (n+1, 6) poses in c.
        nominal: (3, 3) axes of c in base.
    """
    count = min(HORIZON_POINTS, len(horizon))
    chosen = np.linspace(0, len(horizon) - 1, count).round().astype(int)
    points: list[list[float]] = (horizon[chosen, :3] @ nominal.T).round(_DIGITS).tolist()
    return points
