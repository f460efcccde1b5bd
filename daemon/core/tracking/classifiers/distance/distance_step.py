"""Step of the distance sensor's readings, which is no change of the conveyor's motion.

A sensor that is late at once, or slips, reads too little from one reading to the next. A bank of
stops takes that for a stop that began a fifth of a second ago. A stop has no step: at 0.1 m/s^2 it
makes 2 mm in 0.2 s. So the last readings are fitted by themselves, with a step and with the change.
The amplitudes are integrated out, as those of the banks are. A sensor that becomes late shows
no reading for as long as it becomes late: a step of that size is likelier there.
"""

import math
from statistics import median

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers.distance.distance_check import (
    LEAST_READINGS,
    LEVEL_DEVIATION,
    OUTLIER_SIGMAS,
    since,
)
from linemate.daemon.core.tracking.classifiers.onset_bank import AmplitudePrior

SPAN_S = 0.5  # of the readings that are fitted
LATEST_S = 0.16  # age of the oldest step that is looked for [s]
LEAST_AFTER = 2  # readings after a step, so that one outlier is none
STEP_DEVIATION = 0.005  # of a step before any reading [m]
LEAST_SIZE = 0.0015  # of a step: a smaller one costs less than a stop that is taken for it [m]
ONSETS = np.linspace(0.04, 0.48, 23)  # time since a change began [s]
LIKELY = 2.0  # log likelihood ratio of a step from which it is one that may be
CERTAIN = 4.0  # log odds of a step against a change from which it is one; a fast stop had 2.1
MISSING = 1.5  # times the usual time between readings, from which one is missing
LATE = 4.0  # log odds more of a step by as much as the object moved while readings were missing
NONE = -30.0  # log likelihood ratio of a step the other way, which is taken for no change


class DistanceStep(Struct, frozen=True):
    """A step of the readings.

    Attributes:
        odds: log odds of the step against the change.
        age: of the newest reading before it [s].
        size: readings after it minus those before it [m].
        deviation: one sigma of the size [m].
    """

    odds: float
    age: float
    size: float
    deviation: float

    @property
    def is_certain(self) -> bool:
        """Whether the readings show no change; else the next readings decide."""
        return self.odds > CERTAIN


def find(
    readings: Array,
    change: AmplitudePrior,
    speed: float,
    speed_deviation: float,
    deviation: float,
    faster: AmplitudePrior | None = None,
) -> DistanceStep | None:
    """Return the likeliest step; None if a change is likelier, or neither is likely.

    Args:
        readings: (2, m), ages [s] and positions [m], newest last.
        change: prior of the acceleration that a change adds [m/s^2].
        speed: steady one before either [m/s].
        speed_deviation: one sigma of it [m/s].
        deviation: one sigma of a reading [m].
        faster: prior of a change that is faster than configured, None without one.
    """
    heard = since(readings, SPAN_S)
    fits = _has_a_neighbour(heard, speed, deviation)
    ages, values = heard[:, fits]
    if len(ages) < LEAST_READINGS + LEAST_AFTER:
        return None
    places = np.flatnonzero(ages <= LATEST_S)
    places = places[(places > 0) & (places <= len(ages) - LEAST_AFTER)]
    if not len(places):
        return None
    way = values - values[-1] + speed * ages
    steady = np.stack((np.ones_like(ages), -ages))
    prior = np.diag((LEVEL_DEVIATION**-2, speed_deviation**-2)) * deviation**2
    fitted = np.linalg.solve(steady @ steady.T + prior, steady)
    stepped = (np.arange(len(ages)) >= places[:, None]).astype(float)
    begun = np.maximum(ONSETS[:, None] - ages, 0.0)
    # Without the level and the speed that explain most of both.
    rows = np.concatenate((stepped, 0.5 * begun * begun))
    left = rows - (rows @ fitted.T) @ steady
    power = np.einsum("ij,ij->i", left, rows) / deviation**2
    shown = (left @ way) / deviation**2
    count = len(places)
    steps, sizes = _ratios(power[:count], shown[:count], AmplitudePrior(0.0, STEP_DEVIATION**2))
    changes, _ = _ratios(power[count:], shown[count:], change)
    if faster is not None:
        # A sensor that misses no reading steps as seldom as a conveyor changes faster than stated.
        steps = steps + faster.odds
        fast, accelerations = _ratios(power[count:], shown[count:], faster)
        is_fast = accelerations / faster.mean > faster.least
        changes = np.maximum(changes, np.where(is_fast, fast + faster.odds, NONE))
    # An outlier is no silence.
    gaps = -np.diff(heard[0], prepend=heard[0, :1])[fits]
    usual = median(gaps.tolist())
    missing = gaps[places] - usual
    late = AmplitudePrior(-speed * missing, (speed * usual) ** 2)
    # Readings that a stalled host reads at once have one stamp: no gap says that one is missing.
    if late.variance > 0.0:
        lates, late_sizes = _ratios(power[:count], shown[:count], late)
        lates = np.where(missing > (MISSING - 1.0) * usual, lates + LATE, NONE)
        sizes = np.where(lates > steps, late_sizes, sizes)
        steps = np.maximum(lates, steps)
    is_step = sizes * math.copysign(1.0, change.mean) > LEAST_SIZE
    steps = np.where(is_step, steps, NONE)
    odds = _total(steps) - _total(changes)
    best = int(steps.argmax())
    if odds < 0.0 or float(steps[best]) < LIKELY:
        return None
    age = float(ages[places[best] - 1])
    return DistanceStep(odds, age, float(sizes[best]), float(power[best]) ** -0.5)


def _has_a_neighbour(readings: Array, speed: float, deviation: float) -> Array:
    """Return which of the readings (2, m) do not stand alone, away from both neighbours.

    An outlier next to a stop looks like a step back and forth. A step has a neighbour on its side.
    """
    ages, values = readings
    if len(ages) < LEAST_READINGS:
        return np.ones(len(ages), dtype=bool)
    way = values + speed * ages
    # Not np.median: its first call imports numpy.ma, 10 ms within a cycle.
    near = np.sort(np.stack((way[:-2], way[1:-1], way[2:])), axis=0)[1]
    off = way - np.concatenate((near[:1], near, near[-1:]))
    return np.asarray(np.abs(off) < OUTLIER_SIGMAS * deviation)


def levelled(readings: Array, step: DistanceStep) -> Array:
    """Return the readings (2, m) with the step in those before it too."""
    ages, values = readings
    return np.stack((ages, np.where(ages >= step.age, values + step.size, values)))


def _ratios(power: Array, shown: Array, prior: AmplitudePrior) -> tuple[Array, Array]:
    """Return log likelihood ratios (m,) against neither, and the amplitudes' means (m,)."""
    precision = power + 1.0 / prior.variance
    weighted = shown + prior.mean / prior.variance
    mean: Array = weighted / precision
    ratio: Array = weighted * mean - np.log(precision * prior.variance)
    ratio -= prior.mean**2 / prior.variance
    return 0.5 * ratio, mean


def _total(ratios: Array) -> float:
    """Return the log of the mean likelihood ratio."""
    top = float(ratios.max())
    return top + math.log(float(np.exp(ratios - top).mean()))
