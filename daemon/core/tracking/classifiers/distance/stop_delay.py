"""Time in which a distance sensor shows a stop of the conveyor, by its noise alone.

A stop of deceleration a has moved the conveyor by a t^2 / 2 after the time t. Against readings of
one sigma s, one every T, the expected log odds of the stop are the sum of (a t^2 / 2)^2 / (2 s^2):

    m(t) = a^2 t^5 / (40 T s^2),

and their variance is 2 m. No estimator that has these readings alone is quicker.
"""

import math

QUANTILE = 1.645  # sigmas of the log odds: 19 of 20 stops are seen by then


def seen_after(deceleration: float, deviation: float, period: float, odds: float) -> float:
    """Return the time after which 19 of 20 stops are seen [s].

    Args:
        deceleration: of the stop [m/s^2].
        deviation: one sigma of a reading [m].
        period: between two readings [s].
        odds: log odds at which a change counts as seen.
    """
    # m - QUANTILE sqrt(2 m) = odds, solved for sqrt(m).
    half = QUANTILE / math.sqrt(2.0)
    mean = (half + math.sqrt(half * half + max(odds, 0.0))) ** 2
    return float((40.0 * period * mean * (deviation / deceleration) ** 2) ** 0.2)
