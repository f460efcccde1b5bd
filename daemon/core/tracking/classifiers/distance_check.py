"""Check of a change of class against the readings of the distance sensor alone.

Camera and force-torque sensor see the body, which also swings and is pushed. The distance sensor
sees the conveyor alone. The null filter cannot say what the distance sensor finds: it has followed
the body by then, and every hypothesis agrees with where the object is. So the last readings are
fitted by themselves: a steady motion, and the change as its hypotheses say.
"""

import math
from collections.abc import Sequence

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source

SPAN_S = 1.0  # of the readings that are kept
LATEST_S = 0.15  # age of the newest reading with which the sensor still has a say [s]
LEAST_READINGS = 8
LEVEL_DEVIATION = 1.0  # of the position of the steady motion [m]: unknown
OUTLIER_SIGMAS, MOST_OUTLIERS = 5.0, 3  # residual of an outlier; how many are left out
LEAST_WAY = 1e-5  # way of the change since its onset below which nothing can be decided [m]

NO_READINGS = np.zeros((2, 0))


def keep(readings: Array, measurements: Sequence[PositionMeasurement], dt: float) -> Array:
    """Return the readings (2, m), ages [s] and positions [m], one step later with the new ones."""
    new = [(each.delay, each.value) for each in measurements if each.source is Source.DISTANCE]
    aged = readings + np.array(((dt,), (0.0,)))
    if new:
        aged = np.concatenate((aged, np.array(new).T), axis=1)
    first = int(np.count_nonzero(aged[0] > SPAN_S))
    kept: Array = aged[:, first:] if first else aged
    return kept


def log_odds(
    readings: Array, onset: float, change: float, speed_deviation: float, deviation: float
) -> float | None:
    """Return the log odds of a change against none, or None if the sensor has no say.

    Args:
        readings: (2, m) as ``keep`` returns them, newest last.
        onset: time since the change began [s].
        change: the acceleration that it adds [m/s^2].
        speed_deviation: one sigma of the steady speed before any reading [m/s].
        deviation: one sigma of a reading [m].
    """
    ages, values = readings
    if len(ages) < LEAST_READINGS or ages[-1] > LATEST_S:
        return None
    times, way = onset - ages, values - values[-1]
    begun = np.maximum(times, 0.0)
    basis = np.stack((np.ones_like(times), times, 0.5 * change * begun * begun))
    if abs(float(basis[2, -1])) < LEAST_WAY:
        return 0.0
    # A vague share of the change keeps the matrix regular.
    prior = np.diag((LEVEL_DEVIATION**-2, speed_deviation**-2, 1e-4)) * deviation**2
    share, sigma = _fit(basis, way, prior, deviation)
    return (share - 0.5) / (sigma * sigma)


def _fit(basis: Array, way: Array, prior: Array, deviation: float) -> tuple[float, float]:
    """Return the change as a share of its hypothesis, and one sigma, without the worst outliers."""
    for left in range(MOST_OUTLIERS, -1, -1):
        covariance = np.linalg.inv(basis @ basis.T + prior)
        fit = covariance @ (basis @ way)
        off = np.abs(way - fit @ basis)
        worst = int(off.argmax())
        if not left or off[worst] < OUTLIER_SIGMAS * deviation:
            break
        basis, way = np.delete(basis, worst, axis=1), np.delete(way, worst)
    return float(fit[2]), deviation * math.sqrt(float(covariance[2, 2]))
