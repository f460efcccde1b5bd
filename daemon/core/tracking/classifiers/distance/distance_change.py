"""Change of class that the distance sensor alone shows, while the object in contact gives way.

The tool holds such an object, and both swing on the mount. Camera and force-torque sensor then see
the swing, and the bank takes the change of class for it. The distance sensor sees the conveyor: a
start of 13 mm/s^2 is certain after 0.5 s. Each onset of a grid is fitted to its last readings,
with and without the change.
"""

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers.distance.distance_check import (
    LEAST_READINGS,
    LEVEL_DEVIATION,
)

ONSETS = np.linspace(0.12, 0.84, 13)  # time since the change began [s]
LEAST_BEFORE_S = 0.12  # of readings before the onset, which show the motion without the change [s]
SHARES = (0.7, 1.4)  # of the nominal acceleration that a change may have
LARGEST_RESIDUAL = 1.6  # rms residual of all readings and of those since the onset, in sigmas


class DistanceChange(Struct, frozen=True):
    """A change of class, fitted to readings of the distance sensor.

    Attributes:
        odds: log odds of the change against none.
        onset: time since it began [s].
        share: of the nominal acceleration.
        speed: before the change [m/s].
        reading: of the sensor now, by the fit [m].
    """

    odds: float
    onset: float
    share: float
    speed: float
    reading: float


def find(
    readings: Array, change: float, speed: float, speed_deviation: float, deviation: float
) -> DistanceChange | None:
    """Return the likeliest change; None if there is none that fits the readings.

    A step or a frozen value is no change: its residual is too large.

    Args:
        readings: (2, m), ages [s] and positions [m], newest last.
        change: nominal acceleration that the change adds [m/s^2].
        speed: steady one before the change [m/s].
        speed_deviation: one sigma of it [m/s].
        deviation: one sigma of a reading [m].
    """
    ages, values = readings
    if len(ages) < LEAST_READINGS:
        return None
    onsets = ONSETS[ages[0] - LEAST_BEFORE_S >= ONSETS]
    if not len(onsets):
        return None
    way = values - values[-1] + speed * ages
    begun = np.maximum(onsets[:, None] - ages, 0.0)
    changed = 0.5 * change * begun * begun
    steady = np.stack((np.ones_like(ages), -ages))
    prior = np.diag((LEVEL_DEVIATION**-2, speed_deviation**-2)) * deviation**2
    fitted = np.linalg.solve(steady @ steady.T + prior, steady)
    # Without the level and the speed that explain most of both.
    left = changed - (changed @ fitted.T) @ steady
    power = np.einsum("ij,ij->i", left, changed)
    shares = (left @ way) / np.maximum(power, 1e-12)
    odds = (shares - 0.5) * power / deviation**2
    best = int(odds.argmax())
    share = float(shares[best])
    level, more = (fitted @ (way - share * changed[best])).tolist()
    onset = float(onsets[best])
    residual = way - share * changed[best] - level + more * ages
    recent = residual[ages <= onset]
    limit = (LARGEST_RESIDUAL * deviation) ** 2
    fits = all(float(each @ each) < limit * len(each) for each in (residual, recent))
    if not fits or not SHARES[0] <= share <= SHARES[1]:
        return None
    now = float(values[-1]) + level + 0.5 * share * change * onset * onset
    return DistanceChange(float(odds[best]), onset, share, speed + more, now)
