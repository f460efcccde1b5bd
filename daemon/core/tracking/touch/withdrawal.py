"""Way of an emergency retraction along the tool's axis: a ramp up, a constant speed, a ramp down.

It goes on behind ``WAY`` for what is left of a second, towards where the task's own retreat ends.
An object that goes on passes the tool with all its width, and its plane may be oblique to the line:
0.5 m of a line that is 19 degrees off bring it 0.18 m nearer.

Invariants:
    * The speed is one that the limit of the tcp's speed lets pass, or ``SLOWEST``. A plan beyond it
      is slowed axis by axis: the arm left it by 24 mm, and the free tool swung with 470 N.
"""

import math
from dataclasses import dataclass

import numpy as np

from linemate.daemon.core.horizon import Array

WAY = 0.15  # of the retraction, whatever it lasts [m]
ENDS_S = 0.97  # in which a longer one ends [s]
RAMP_S = 0.24  # time in which its speed rises or falls [s]; 10 mm are left in 0.14 s
LEAVING_S = 0.26  # the same of the task's own retreat [s]; its jerk is 20 m/s^3 at 0.18 m/s
FASTEST = 0.4  # speed of the retraction [m/s]
SLOWEST = 0.2  # it must end within 1 s, whatever slows it [m/s]
MARGIN = 0.95  # of the speed: the inverse of the servos commands some more


@dataclass(frozen=True, slots=True)
class Withdrawal:
    """An emergency retraction.

    Attributes:
        speed: between its ramps [m/s].
        reach: distance from the object at which the task's own retreat leaves the tool [m].
    """

    speed: float
    reach: float = 0.0

    @property
    def duration(self) -> float:
        """Time from its begin to the end of ``WAY`` [s]."""
        return WAY / self.speed + RAMP_S

    def further(self, gap: float) -> float:
        """Return the way behind ``WAY``, at most to where the task's own retreat ends [m].

        Args:
            gap: from the tool to the object as the retraction begins [m].
        """
        in_time = (ENDS_S - self.duration) * self.speed
        return max(min(self.reach - WAY - max(gap, 0.0), in_time), 0.0)

    def lasting(self, further: float) -> float:
        """Return the time from its begin to its end [s].

        Args:
            further: its way behind ``WAY`` [m].
        """
        return self.duration + further / self.speed

    def share(self, leaving: float) -> float:
        """Return the share of its way that a programme leaves it, for both to be no faster.

        Args:
            leaving: speed at which the programme itself moves the tool off the object [m/s].
        """
        return min(max(1.0 - leaving / self.speed, 0.0), 1.0)

    def way(self, times: Array, gone: float = 0.0, further: float = 0.0) -> Array:
        """Return the way (m,) at times from its begin (m,) [m].

        Args:
            gone: what it has done before it began again [m].
            further: its way behind ``WAY`` [m].
        """
        left = max(WAY + further - gone, 0.0)
        way: Array = self.speed * (_ramp(times) - _ramp(times - left / self.speed))
        return way


def compile_withdrawal(free_speed: float, conveyor_speed: float, reach: float) -> Withdrawal:
    """Return the retraction from an object that moves on across the tool's axis.

    Args:
        free_speed: of the tcp in base up to which nothing slows it [m/s].
        reach: distance from the object at which the task's own retreat leaves the tool [m].
    """
    along = math.sqrt(max((MARGIN * free_speed) ** 2 - conveyor_speed**2, 0.0))
    return Withdrawal(min(max(along, SLOWEST), FASTEST), reach)


def leaving_share(times: Array, duration: float, way: float) -> Array | None:
    """Return the share (m,) of a stretch that leaves an object, None if that were too quick.

    A released object moves off the tool at once, a body on a soft hanger by 10 mm in 0.2 s. Over
    0.3 m in 2 s a step of fifth order is 10 mm off after 0.31 s, a ramp of the speed after 0.2 s.

    Args:
        times: from the begin of the stretch [s].
        duration: of the stretch [s].
        way: of the tool along it [m].
    """
    lasting = duration - LEAVING_S
    if lasting < LEAVING_S or way > SLOWEST * lasting:
        return None
    share: Array = (_ramp(times, LEAVING_S) - _ramp(times - lasting, LEAVING_S)) / lasting
    return share


def lag(times: Array) -> Array:
    """Return the way (m,) that a speed of 1 lacks as it rises from 0 at time 0 [m]."""
    missing: Array = np.maximum(times, 0.0) - _ramp(times)
    return missing


def _ramp(times: Array, ramp_s: float = RAMP_S) -> Array:
    """Return the way (m,) of a speed that rises from 0 to 1 by the step of seventh order [m]."""
    u = np.minimum(np.maximum(times / ramp_s, 0.0), 1.0)
    rising = u**5 * (7.0 + u * (-14.0 + u * (10.0 - 2.5 * u)))
    way: Array = ramp_s * rising + np.maximum(times - ramp_s, 0.0)
    return way
