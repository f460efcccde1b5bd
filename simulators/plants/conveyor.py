"""The conveyor unit: ramps of constant acceleration between standing and nominal speed, ripple.

Law of this file: the motion is a function of time alone, known in advance and evaluated anywhere;
only the Ornstein-Uhlenbeck ripple is drawn, on a fixed grid, ahead of use and never twice.
The ripple's speed is linear between grid points, so its position is exact everywhere.
"""

import math
from bisect import bisect_right

from linemate.simulators.plants.scenario import Conveyor, applied_events
from linemate.simulators.plants.streams import Draws

RIPPLE_STEP_S = 0.004
"""Grid of the random ripple [s]; the same for every cycle, so that cycles see one conveyor."""


class ConveyorPlant:
    """Position and speed of the unit at any time from `start_s` on."""

    def __init__(self, conveyor: Conveyor, seed: int, start_s: float) -> None:
        self._nominal = conveyor.nominal_speed
        self._ripple = conveyor.ripple
        self._start = start_s
        self._starts, self._segments = _segments(conveyor)
        self._decay = math.exp(-RIPPLE_STEP_S / self._ripple.correlation_s)
        self._spread = self._ripple.speed_sigma * math.sqrt(1.0 - self._decay**2)
        self._draws = Draws.normal(seed, "conveyor.ripple")
        self._omega = math.tau * self._ripple.frequency_hz
        self._phase = self._ripple.phase or 0.0
        self._free = self._ripple.speed_sigma * self._draws.one()
        self._speeds = [self._free * self._share(start_s)]
        self._positions = [0.0]

    def nominal(self, t: float) -> tuple[float, float]:
        """Position [m] and speed [m/s] without ripple."""
        onset, position, speed, acceleration = self._segments[bisect_right(self._starts, t) - 1]
        age = t - onset
        return position + (speed + 0.5 * acceleration * age) * age, speed + acceleration * age

    def at(self, t: float) -> tuple[float, float]:
        """Position [m] and speed [m/s] at scenario time t.

        Raises:
            ValueError: before the start of the run.
        """
        position, speed = self.nominal(t)
        drift, drift_speed = self._random(t)
        share = speed / self._nominal
        wave = self._omega * t + self._phase
        amplitude = share * self._ripple.amplitude
        return (
            position + drift + amplitude * math.sin(wave),
            speed + drift_speed + amplitude * self._omega * math.cos(wave),
        )

    def _share(self, t: float) -> float:
        return self.nominal(t)[1] / self._nominal

    def _random(self, t: float) -> tuple[float, float]:
        cells = (t - self._start) / RIPPLE_STEP_S
        if cells < -1e-9:
            raise ValueError(f"t={t} is before the start of the run at {self._start}")
        cell = max(int(cells), 0)
        while cell + 1 >= len(self._speeds):
            self._extend()
        rest = (cells - cell) * RIPPLE_STEP_S
        speed, after = self._speeds[cell], self._speeds[cell + 1]
        slope = (after - speed) / RIPPLE_STEP_S
        return (
            self._positions[cell] + (speed + 0.5 * slope * rest) * rest,
            speed + slope * rest,
        )

    def _extend(self) -> None:
        # A standing unit has no ripple: the free process goes on, its share fades with the speed.
        self._free = self._decay * self._free + self._spread * self._draws.one()
        t = self._start + len(self._speeds) * RIPPLE_STEP_S
        speed = self._free * self._share(t)
        half = 0.5 * RIPPLE_STEP_S * (self._speeds[-1] + speed)
        self._positions.append(self._positions[-1] + half)
        self._speeds.append(speed)


Segment = tuple[float, float, float, float]
"""Onset [s], position [m], speed [m/s], acceleration [m/s^2]."""


def _segments(conveyor: Conveyor) -> tuple[list[float], list[Segment]]:
    """Cut the motion into pieces of constant acceleration.

    Args:
        conveyor: nominal speed and orders.

    Returns:
        Onsets for bisection (the first minus infinity) and the segments.
    """
    segments: list[Segment] = [(0.0, 0.0, conveyor.nominal_speed, 0.0)]
    starts = [-math.inf]
    events = applied_events(conveyor)
    for i, event in enumerate(events):
        _append(starts, segments, event.onset_s, event.acceleration)
        following = events[i + 1].onset_s if i + 1 < len(events) else math.inf
        if event.settled_s < following:
            _append(starts, segments, event.settled_s, 0.0)
            goal = conveyor.nominal_speed if event.kind == "start" else 0.0
            onset, position, _, _ = segments[-1]
            segments[-1] = (onset, position, goal, 0.0)
    return starts, segments


def _append(starts: list[float], segments: list[Segment], t: float, acceleration: float) -> None:
    onset, position, speed, before = segments[-1]
    age = t - onset
    starts.append(t)
    segments.append(
        (t, position + (speed + 0.5 * before * age) * age, speed + before * age, acceleration)
    )
