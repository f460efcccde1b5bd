"""What the line announces of a stop: the odds of onsets near the edge, before any reading.

The line's controller announces a stop before any sensor sees it, but may be wrong. So an edge adds
bounded log odds to the onsets that it allows. They count for the prediction until the readings
have decided. Whether there is a stop is decided as without it.
"""

import math

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.task import ConveyorClasses, StopInput

LATEST_S = 0.3  # after an edge in which it counts at least [s]
BORNE = 0.002  # way by which an edge alone may move the target: 100 N on a mount of 50 N/mm [m]
DECIDED = 5.0  # sigmas of a reading that the object is off as the readings have decided
APART_S = 1.0  # between two edges that both count: a bit that chatters announces once


def edge_age(settings: StopInput, age: float, was: int, bits: int | None) -> float:
    """Return the time since the last edge that counts [s].

    Args:
        age: of the edge before, now [s].
        was: digital inputs of the step before.
        bits: digital inputs now; None without a telegram.
    """
    if settings.bit is None or bits is None:
        return age
    mask = 1 << settings.bit
    rises = bits & mask and not was & mask
    return 0.0 if rises and age > APART_S else age


def counted_for(conveyor: ConveyorClasses, deviation: float) -> float:
    """Return the time after an edge in which it counts [s]: by then the readings have decided.

    Args:
        deviation: one sigma of a reading of the distance sensor [m].
    """
    return max(LATEST_S, math.sqrt(2.0 * DECIDED * deviation / conveyor.deceleration))


def decided_way(conveyor: ConveyorClasses, deviation: float, spacing: float) -> float:
    """Return the way that a stop makes until readings show or deny it [m].

    A deceleration a that is or is not there gives log odds of a^2 u^5 / (40 sigma^2 dt) after u.
    They have decided once these are the weight of the announcement.

    Args:
        deviation: one sigma of a reading of the distance sensor [m].
        spacing: time between two readings [s].
    """
    a, odds = conveyor.deceleration, max(conveyor.stop_input.weight, 0.1)
    decided_s: float = (40.0 * odds * deviation**2 * spacing / a**2) ** 0.2
    return 0.5 * a * decided_s**2


def onset_odds(settings: StopInput, edge: float, ages: Array) -> Array | None:
    """Return the log odds (m,) that the line gives each onset; None if it says nothing of any.

    Args:
        edge: time since the edge [s].
        ages: time since each onset (m,) [s].
    """
    if not math.isfinite(edge) or not len(ages):
        return None
    allowed = np.abs(ages - edge - 0.5 * (settings.before - settings.after)) <= 0.5 * (
        settings.before + settings.after
    )
    count = int(np.count_nonzero(allowed))
    if not count:
        return None
    odds: Array = np.where(allowed, settings.weight - math.log(count), 0.0)
    return odds
