"""Check of a change of class against the readings of the distance sensor alone.

Camera and force-torque sensor see the body, which also swings and is pushed. The distance sensor
sees the conveyor alone. The null filter cannot say what the distance sensor finds: it has followed
the body by then, and every hypothesis agrees with where the object is. So the last readings are
fitted by themselves: a steady motion or a ramp, and the change as its hypotheses say.

A sensor whose readings are late no more shows it: one of them comes too early after the one before.
All readings before it are then too short by an unknown way, which is fitted as well.
"""

from collections.abc import Sequence
from statistics import median

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source

SPAN_S = 1.0  # of the readings that are kept
LATEST_S = 0.15  # age of the newest reading with which the sensor still has a say [s]
LEAST_READINGS = 8
LEVEL_DEVIATION = 1.0  # of the position of the steady motion [m]: unknown
OUTLIER_SIGMAS, MOST_OUTLIERS = 5.0, 3  # residual of an outlier; how many are left out
EARLY = 0.6  # share of the usual time between readings, below which the sensor was late before
MOST_EARLY = 3  # so many times in ``SPAN_S``: a sensor that is uneven more often shows nothing
LATE_DEVIATION = 0.005  # way by which late readings are too short [m]
LEAST_WAY = 1e-5  # way of the change since its onset below which nothing can be decided [m]

RAMP_DEVIATION = 0.15  # of a ramp's acceleration, as a share
RAMP_SPEED_DEVIATION = 1.0  # of the speed before a ramp [m/s]: unknown

NO_READINGS = np.zeros((2, 0))


class Ramp(Struct, frozen=True):
    """The ramp on which the conveyor is without the change.

    Attributes:
        age: time since its onset [s].
        acceleration: of the conveyor, less than 0 as it brakes [m/s^2].
        deviation: one sigma of that, as a share.
    """

    age: float
    acceleration: float
    deviation: float = RAMP_DEVIATION


def keep(readings: Array, measurements: Sequence[PositionMeasurement], dt: float) -> Array:
    """Return the readings (2, m), ages [s] and positions [m], one step later with the new ones."""
    new = [(each.delay, each.value) for each in measurements if each.source is Source.DISTANCE]
    count = readings.shape[1]
    aged = np.empty((2, count + len(new)))
    np.add(readings[0], dt, out=aged[0, :count])
    aged[1, :count] = readings[1]
    for i, reading in enumerate(new, count):
        aged[0, i], aged[1, i] = reading
    first = 0
    while first < count and aged[0, first] > SPAN_S:  # one or two a step
        first += 1
    return aged[:, first:] if first else aged


def since(readings: Array, age: float) -> Array:
    """Return the readings of the last ``age`` s."""
    first = int(np.count_nonzero(readings[0] > age))
    kept: Array = readings[:, first:] if first else readings
    return kept


def log_odds(
    readings: Array,
    onset: float,
    change: float,
    speed_deviation: float,
    deviation: float,
    ramp: Ramp | None = None,
    speed: float = 0.0,
) -> float | None:
    """Return the log odds of a change against none, or None if the sensor has no say.

    Args:
        readings: (2, m) as ``keep`` returns them, newest last.
        onset: time since the change began [s].
        change: the acceleration that it adds [m/s^2].
        speed_deviation: one sigma of the steady speed before any reading [m/s].
        deviation: one sigma of a reading [m].
        ramp: on which the conveyor was; None if its motion was steady.
        speed: steady one before any reading [m/s].
    """
    ages, values = readings
    if not has_say(readings):
        return None
    times = onset - ages
    way = values - values[-1] - speed * times
    begun = np.maximum(times, 0.0)
    changed = 0.5 * change * begun * begun
    if abs(float(changed[-1])) < LEAST_WAY:
        return 0.0
    # A vague share of the change keeps the matrix regular.
    rows, information = [np.ones(len(times)), times, changed], [1e-4]
    if ramp is not None:
        ramped = _ramp_way(ages, ramp)
        way = way - ramped
        rows.append(ramped)
        information.append(ramp.deviation**-2)
        speed_deviation = RAMP_SPEED_DEVIATION
    late = _late(ages)
    if late is not None:
        rows.append(late)
        information.append(LATE_DEVIATION**-2)
    known = (LEVEL_DEVIATION**-2, speed_deviation**-2, *information)
    fit, covariance = _fit(np.array(rows), way, _diagonal(known, deviation), deviation)
    return (float(fit[2]) - 0.5) / (deviation**2 * float(covariance[2, 2]))


def speed_now(readings: Array, ramp: Ramp, deviation: float) -> float | None:
    """Return the speed of a conveyor on a ramp [m/s], or None if the sensor has no say."""
    if not has_say(readings):
        return None
    ages, values = readings
    ramped = _ramp_way(ages, ramp)
    basis = np.stack((np.ones_like(ages), -ages, ramped))
    known = (LEVEL_DEVIATION**-2, RAMP_SPEED_DEVIATION**-2, RAMP_DEVIATION**-2)
    way = values - values[-1] - ramped
    fit, _ = _fit(basis, way, _diagonal(known, deviation), deviation)
    return float(fit[1] + (1.0 + fit[2]) * ramp.acceleration * ramp.age)


def mean_speed(readings: Array, deviation: float) -> tuple[float, float]:
    """Return the mean speed over some readings (2, m), and one sigma of it [m/s]."""
    ages, values = readings
    basis = np.stack((np.ones_like(ages), -ages))
    known = (LEVEL_DEVIATION**-2, RAMP_SPEED_DEVIATION**-2)
    fit, covariance = _fit(basis, values - values[-1], _diagonal(known, deviation), deviation)
    return float(fit[1]), deviation * float(covariance[1, 1]) ** 0.5


def has_say(readings: Array) -> bool:
    """Return whether there are enough readings, the newest of them young enough."""
    ages = readings[0]
    return len(ages) >= LEAST_READINGS and bool(ages[-1] <= LATEST_S)


def _late(ages: Array) -> Array | None:
    """Return which of the readings (m,) were late before the sensor was in time again, or None."""
    gaps = ages[:-1] - ages[1:]
    # numpy's median costs eight times as much.
    early = np.flatnonzero(gaps < EARLY * median(gaps.tolist()))
    if not 0 < len(early) <= MOST_EARLY:
        return None
    return np.asarray(np.arange(len(ages)) <= early[-1], dtype=float)


def _ramp_way(ages: Array, ramp: Ramp) -> Array:
    """Return the way (m,) that a ramp had made at some ages."""
    acted = np.maximum(ramp.age - ages, 0.0)
    way: Array = 0.5 * ramp.acceleration * acted * acted
    return way


def _diagonal(information: Sequence[float], deviation: float) -> Array:
    """Return the prior's information as a matrix, times ``deviation`` squared."""
    count = len(information)
    matrix = np.zeros((count, count))
    # numpy's diag costs six times as much.
    matrix.reshape(-1)[:: count + 1] = [each * deviation**2 for each in information]
    return matrix


def _fit(basis: Array, way: Array, prior: Array, deviation: float) -> tuple[Array, Array]:
    """Return the shares of the basis and their covariance over ``deviation`` squared.

    The worst outliers are left out.
    """
    for left in range(MOST_OUTLIERS, -1, -1):
        covariance = np.linalg.inv(basis @ basis.T + prior)
        fit: Array = covariance @ (basis @ way)
        off = np.abs(way - fit @ basis)
        worst = int(off.argmax())
        if not left or off[worst] < OUTLIER_SIGMAS * deviation:
            break
        basis, way = np.delete(basis, worst, axis=1), np.delete(way, worst)
    return fit, covariance
