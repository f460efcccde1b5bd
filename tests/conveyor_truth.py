"""A conveyor and its poor distance sensor, on a fine grid, for tests of classifiers."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linemate.daemon.core.tracking.conveyor import (
    Classifier,
    ConveyorEstimate,
    Motion,
    PositionMeasurement,
    Source,
)

Array = NDArray[np.floating[Any]]

T0 = 0.012
NOMINAL, STOP, START = 0.106, 0.104, 0.013
GRID = 0.001
DELAY = 0.001
DEVIATION = 0.00038
GATE = 4.0
LEAD = 2.0  # of steady motion before t = 0 [s]


@dataclass(frozen=True)
class Truth:
    """Positions on the grid from -LEAD on.

    ``events`` are (time, acceleration): the conveyor keeps it until it stands or is at nominal.
    """

    seconds: float
    events: Sequence[tuple[float, float]] = ()
    ripple: float = 0.0003
    seed: int = 0
    speed: float = NOMINAL
    times: Array = field(init=False)
    positions: Array = field(init=False)
    speeds: Array = field(init=False)

    def __post_init__(self) -> None:
        times = np.arange(-LEAD, self.seconds + 0.1, GRID)
        speeds = np.empty(len(times))
        speed, acceleration = self.speed, 0.0
        due = sorted(self.events)
        for i, t in enumerate(times):
            while due and t >= due[0][0]:
                acceleration = due.pop(0)[1]
            speed = min(max(speed + acceleration * GRID, 0.0), NOMINAL)
            speeds[i] = speed
        rng = np.random.default_rng(self.seed)
        decay = np.exp(-GRID)  # of a ripple that forgets within a second
        noise = rng.normal(size=len(times)) * np.sqrt(1.0 - decay**2)
        ripple_state = 0.0
        for i, kick in enumerate(noise):
            ripple_state = decay * ripple_state + kick
            speeds[i] += self.ripple * ripple_state * speeds[i] / NOMINAL
        positions = np.cumsum(speeds) * GRID
        for name, value in (("times", times), ("positions", positions), ("speeds", speeds)):
            object.__setattr__(self, name, value)

    def at(self, t: Array | float) -> Array:
        """Position at a time [m]."""
        return np.interp(t, self.times, self.positions)


@dataclass(frozen=True)
class Sensor:
    """Quantised to ``step``, with noise and outliers; one reading a step."""

    step: float = 0.001
    deviation: float = 0.00025
    outliers: float = 0.0
    seed: int = 0

    def read(self, truth: Truth, times: Array) -> Array:
        """What is read at ``times``, the delay taken into account."""
        rng = np.random.default_rng(1000 + self.seed)
        clean = truth.at(times - DELAY) + rng.normal(0.0, self.deviation, len(times))
        wrong = rng.random(len(times)) < self.outliers
        clean += np.where(wrong, rng.choice((-0.1, 0.1), len(times)), 0.0)
        return np.round(clean / self.step) * self.step if self.step else clean


IDEAL = Sensor(step=0.0, deviation=0.0)


def row(
    value: float, *, delay: float = DELAY, source: Source = Source.DISTANCE
) -> PositionMeasurement:
    return PositionMeasurement(source, value, delay, DEVIATION**2, GATE)


@dataclass(frozen=True)
class Story:
    """Events of a classifier over a run."""

    times: Array
    views: list[ConveyorEstimate]
    states: list[Any]
    events: list[tuple[float, str, str]]

    def first(self, kind: str, what: str, after: float) -> float:
        """When an event came first after a time, infinity if never."""
        return min(
            (t for t, k, w in self.events if (k, w) == (kind, what) and t >= after),
            default=float("inf"),
        )

    def count(self, what: str) -> int:
        return sum(w == what for _, _, w in self.events)

    def motion(self, t: float) -> Motion:
        return self.views[int(np.searchsorted(self.times, t))].motion

    def position_errors(self, truth: Truth, after: float) -> Array:
        found = np.array([view.position + view.offset for view in self.views])
        return np.asarray((found - truth.at(self.times))[self.times >= after])


def tell(
    classifier: Classifier,
    truth: Truth,
    sensor: Sensor | None = None,
    *,
    readings: Array | None = None,
) -> Story:
    """Run a classifier along a truth, one reading a step from -LEAD + 0.5 s on."""
    times = np.arange(-LEAD + 0.5, truth.seconds, T0)
    if readings is None:
        readings = (sensor or Sensor(seed=truth.seed)).read(truth, times)
    state = classifier.initial(float(readings[0]))
    views, states, events = [], [], []
    for t, value in zip(times[1:], readings[1:], strict=True):
        state = classifier.advance(state, [] if np.isnan(value) else [row(float(value))], T0)
        view = classifier.estimate(state)
        views.append(view)
        states.append(state)
        events += [(float(t), kind, what) for kind, what in view.events]
    return Story(times[1:], views, states, events)
