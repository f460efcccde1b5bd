"""Way of an emergency retraction along the tool's axis: a ramp up, a constant speed, a ramp down.

Invariants:
    * The speed is one that the limit of the tcp's speed lets pass, or ``SLOWEST``. A plan beyond it
      is slowed axis by axis: the arm left it by 24 mm, and the free tool swung with 470 N.
"""

import math
from dataclasses import dataclass

import numpy as np

from linemate.daemon.core.horizon import Array

WAY = 0.15  # of the retraction [m]
RAMP_S = 0.24  # time in which its speed rises or falls [s]; 10 mm are left in 0.14 s
FASTEST = 0.4  # speed of the retraction [m/s]
SLOWEST = 0.2  # it must end within 1 s, whatever slows it [m/s]
MARGIN = 0.95  # of the speed: the inverse of the servos commands some more


@dataclass(frozen=True, slots=True)
class Withdrawal:
    """An emergency retraction.

    Attributes:
        speed: between its ramps [m/s].
    """

    speed: float

    @property
    def duration(self) -> float:
        """Time from its begin to its end [s]."""
        return WAY / self.speed + RAMP_S

    def way(self, times: Array, gone: float = 0.0) -> Array:
        """Return the way (m,) at times from its begin (m,) [m].

        Args:
            gone: what it has done before it began again [m].
        """
        left = max(WAY - gone, 0.0)
        way: Array = self.speed * (_ramp(times) - _ramp(times - left / self.speed))
        return way


def compile_withdrawal(free_speed: float, conveyor_speed: float) -> Withdrawal:
    """Return the retraction from an object that moves on across the tool's axis.

    Args:
        free_speed: of the tcp in base up to which nothing slows it [m/s].
    """
    along = math.sqrt(max((MARGIN * free_speed) ** 2 - conveyor_speed**2, 0.0))
    return Withdrawal(min(max(along, SLOWEST), FASTEST))


def lag(times: Array) -> Array:
    """Return the way (m,) that a speed of 1 lacks as it rises from 0 at time 0 [m]."""
    missing: Array = np.maximum(times, 0.0) - _ramp(times)
    return missing


def _ramp(times: Array) -> Array:
    """Return the way (m,) of a speed that rises from 0 to 1 by the step of seventh order [m]."""
    u = np.minimum(np.maximum(times / RAMP_S, 0.0), 1.0)
    rising = u**5 * (7.0 + u * (-14.0 + u * (10.0 - 2.5 * u)))
    way: Array = RAMP_S * rising + np.maximum(times - RAMP_S, 0.0)
    return way
