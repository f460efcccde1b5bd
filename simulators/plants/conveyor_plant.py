"""Conveyor: ramps of constant acceleration between rest and nominal speed, and ripple.

Invariants:
    The motion is a function of time alone.
    Only the Ornstein-Uhlenbeck ripple is drawn, on a fixed grid, each point once.
    The ripple's speed is linear between grid points, so positions are exact.
"""

import math
from bisect import bisect_right
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from linemate.simulators.plants.conveyor_plan import Conveyor, applied_events, shaped_ramps
from linemate.simulators.plants.effects.conveyor_effects import ChainErrors, off_line
from linemate.simulators.plants.streams import stream

RIPPLE_STEP_S = 0.004
"""Grid of the random ripple [s]; the same for every cycle, so that cycles see one conveyor."""

FALSE_SIGNAL_S = 0.5
"""How long a stop that is none is announced [s]."""

_BLOCK = 512

Array = NDArray[np.float64]


class ConveyorPlant:
    """Position and speed of the unit at any time from `start_s` on."""

    def __init__(self, conveyor: Conveyor, seed: int, start_s: float) -> None:
        self._nominal = conveyor.nominal_speed
        self._ripple = conveyor.ripple
        self._start = start_s
        self._segments = _segments(conveyor)
        self._onsets = [segment[0] for segment in self._segments[1:]]
        self._table = np.array(self._segments)
        self._changes = np.array(self._onsets)
        self._effects = effects = conveyor.effects
        self._signal = conveyor.stop_signal
        self._announced = _announced(conveyor)
        self._shaped = shaped_ramps(conveyor)[0] if effects.shapes_ramps else None
        self._chain = self._chain_errors(conveyor, seed)
        self._decay = math.exp(-RIPPLE_STEP_S / self._ripple.correlation_s)
        self._generator = stream(seed, "conveyor.ripple")
        self._free = self._ripple.speed_sigma * float(self._generator.standard_normal())
        self._omega = math.tau * self._ripple.frequency_hz
        self._phase = self._ripple.phase or 0.0
        self._speeds = [self._free * self.nominal(start_s)[1] / self._nominal]
        self._positions = [0.0]

    def nominal(self, t: float) -> tuple[float, float]:
        """Position [m] and speed [m/s] without ripple."""
        if self._shaped is not None:
            return self._shaped.at(t)[:2]
        onset, position, speed, acceleration = self._segments[bisect_right(self._onsets, t)]
        age = t - onset
        return position + (speed + 0.5 * acceleration * age) * age, speed + acceleration * age

    def at(self, t: float) -> tuple[float, float]:
        """Position [m] and speed [m/s] at scenario time t.

        Raises:
            ValueError: before the start of the run.
        """
        if self._chain is not None:
            positions, speeds = self.motion(np.array([t]))
            return float(positions[0]), float(speeds[0])
        position, speed = self.nominal(t)
        cell, rest = self._cell(t)
        drift, after = self._speeds[cell], self._speeds[cell + 1]
        slope = (after - drift) / RIPPLE_STEP_S
        amplitude = self._ripple.amplitude * speed / self._nominal
        phase = self._omega * t + self._phase
        return (
            position
            + self._positions[cell]
            + (drift + 0.5 * slope * rest) * rest
            + amplitude * math.sin(phase),
            speed + drift + slope * rest + amplitude * self._omega * math.cos(phase),
        )

    def drive(self, times: Array) -> tuple[Array, Array, Array]:
        """Motion of the drive without ripple, chain and stick-slip, at ascending times.

        Returns:
            Positions [m], speeds [m/s] and accelerations [m/s^2], shape (n,) each.
        """
        if self._shaped is not None:
            return self._shaped.motion(times)
        index = self._changes.searchsorted(times, side="right")
        onset, position, speed, acceleration = self._table[index].T
        age = times - onset
        return (
            position + (speed + 0.5 * acceleration * age) * age,
            speed + acceleration * age,
            acceleration,
        )

    def signals(self, t: float) -> int:
        """What the line's controller sends at scenario time t: the bit of an announced stop."""
        signal = self._signal
        if signal.bit is None:
            return 0
        is_set = signal.stuck or any(begin <= t < end for begin, end in self._announced)
        return int(is_set) << signal.bit

    @property
    def leaves_line(self) -> bool:
        """Whether the unit leaves the straight line of the nominal conveyor."""
        return self._effects.leaves_line

    def off_line(self, positions: Array) -> Array:
        """How far the unit is off the nominal line at positions, in base, (n, 3) [m]."""
        return off_line(self._effects, positions)

    def positions(self, times: Array) -> Array:
        """Positions at many times at once; the same law as `at`.

        Args:
            times: scenario times, ascending, shape (n,) [s].

        Returns:
            Positions, shape (n,) [m].
        """
        return self.motion(times)[0]

    def motion(self, times: Array) -> tuple[Array, Array]:
        """Positions and speeds at many times at once; the same law as `at`.

        Args:
            times: scenario times, ascending, shape (n,) [s].

        Returns:
            Positions [m] and speeds [m/s], shape (n,) each.
        """
        position, drive_speed, acceleration = self.drive(times)
        speed = drive_speed
        if self._chain is not None:
            deviation, rate = self._chain.deviation(times, position, drive_speed, acceleration)
            position, speed = position + deviation, speed + rate
        self._cell(float(times[-1]))
        cells = np.maximum((times - self._start) / RIPPLE_STEP_S, 0.0)
        index = cells.astype(int)
        rest = (cells - index) * RIPPLE_STEP_S
        first, last = int(index[0]), int(index[-1]) + 2
        drifts = np.array(self._speeds[first:last])
        bases = np.array(self._positions[first:last])
        drift = drifts[index - first]
        slope = (drifts[index - first + 1] - drift) / RIPPLE_STEP_S
        amplitude = self._ripple.amplitude * drive_speed / self._nominal
        phase = self._omega * times + self._phase
        return (
            position
            + bases[index - first]
            + (drift + 0.5 * slope * rest) * rest
            + amplitude * np.sin(phase),
            speed + drift + slope * rest + amplitude * self._omega * np.cos(phase),
        )

    def _chain_errors(self, conveyor: Conveyor, seed: int) -> ChainErrors | None:
        effects = conveyor.effects
        if not (effects.teeth or effects.stick_slip):
            return None
        starts = [event.onset_s for event in applied_events(conveyor) if event.kind == "start"]
        phase = float(stream(seed, "conveyor.sprocket").uniform())
        return ChainErrors(effects, [(t, self.nominal(t)[0]) for t in starts], phase)

    def _cell(self, t: float) -> tuple[int, float]:
        cells = (t - self._start) / RIPPLE_STEP_S
        if cells < -1e-6:
            raise ValueError(f"t={t} is before the start of the run at {self._start}")
        cell = max(int(cells), 0)
        while cell + 1 >= len(self._speeds):
            self._extend()
        return cell, (cells - cell) * RIPPLE_STEP_S

    def _extend(self) -> None:
        # A standing unit has no ripple: the free process goes on, its share fades with the speed.
        spread = self._ripple.speed_sigma * math.sqrt(1.0 - self._decay**2)
        draws: list[float] = (spread * self._generator.standard_normal(_BLOCK)).tolist()
        decay = self._decay
        _, *free = accumulate(draws, lambda u, draw: decay * u + draw, initial=self._free)
        self._free = free[-1]
        count = len(self._speeds)
        times = self._start + RIPPLE_STEP_S * np.arange(count, count + _BLOCK, dtype=np.float64)
        speeds = np.array(free) * self.drive(times)[1] / self._nominal
        before = np.concatenate(([self._speeds[-1]], speeds[:-1]))
        steps = 0.5 * RIPPLE_STEP_S * (before + speeds)
        self._positions += (self._positions[-1] + np.cumsum(steps)).tolist()
        self._speeds += speeds.tolist()


def _announced(conveyor: Conveyor) -> tuple[tuple[float, float], ...]:
    """From when to when a stop is announced, true or false [s]."""
    signal = conveyor.stop_signal
    spans = [(at, at + FALSE_SIGNAL_S) for at in signal.false_s]
    if not signal.silent:
        events = applied_events(conveyor)
        for i, event in enumerate(events):
            if event.kind == "stop":
                until = events[i + 1].onset_s if i + 1 < len(events) else math.inf
                spans.append((event.onset_s - signal.lead_s, until))
    return tuple(spans)


Segment = tuple[float, float, float, float]
"""Onset [s], position [m], speed [m/s], acceleration [m/s^2]."""


def _segments(conveyor: Conveyor) -> list[Segment]:
    """Cut the motion into pieces of constant acceleration.

    Args:
        conveyor: nominal speed and orders.

    Returns:
        The segments in order of time; the first runs at nominal speed from ever.
    """
    segments: list[Segment] = [(0.0, 0.0, conveyor.nominal_speed, 0.0)]
    events = applied_events(conveyor)
    for i, event in enumerate(events):
        position = _position(segments[-1], event.onset_s)
        segments.append((event.onset_s, position, event.speed, event.acceleration))
        following = events[i + 1].onset_s if i + 1 < len(events) else math.inf
        if event.settled_s < following:
            goal = conveyor.nominal_speed if event.kind == "start" else 0.0
            position = _position(segments[-1], event.settled_s)
            segments.append((event.settled_s, position, goal, 0.0))
    return segments


def _position(segment: Segment, t: float) -> float:
    onset, position, speed, acceleration = segment
    age = t - onset
    return position + (speed + 0.5 * acceleration * age) * age
