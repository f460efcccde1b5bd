"""Limits of the axes, and the range of accelerations that they allow in one step.

Invariants:
- An acceleration of the range keeps a later stop within all limits possible.

Plain floats, axis by axis: arrays cost four times as much for seven axes.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linemate.daemon.core.horizon import Array


@dataclass(frozen=True, slots=True)
class AxisBounds:
    """Limits of one axis and what follows from them and the cycle time, SI.

    Attributes:
        lower, upper: ends of the position [rad or m].
        change: largest change of the acceleration in one step.
        margin: tolerance for rounding, a millionth of the acceleration.
        braking_way: way beyond which full speed is allowed; it saves two square roots.
        free_speed: speed up to which, that far from the ends, acceleration and jerk alone limit the
            range; it saves the other two.
    """

    lower: float
    upper: float
    speed: float
    acceleration: float
    jerk: float
    period: float
    change: float
    margin: float
    braking_way: float
    free_speed: float


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of all axes as arrays (m,), SI, for commands that are a period apart.

    Attributes:
        lower, upper: ends of the position [rad or m].
        names: of the axes, for reasons.
    """

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    jerk: Array
    names: tuple[str, ...]
    period: float

    @cached_property
    def free(self) -> tuple[Array, Array]:
        """Where no axis is limited, and how far it may be from there (5 m,): all axes at once.

        For an axis' acceleration, the next one, its change, the speed and the position. Within
        these bounds ``acceleration_range`` allows the acceleration.
        """
        none = np.zeros(len(self.names))
        rows = [(axis.acceleration, axis.acceleration, axis.change, axis.free_speed,
                 0.5 * (axis.upper - axis.lower) - axis.braking_way - axis.speed * axis.period)
                for axis in self.axes]  # fmt: skip
        middle = np.concatenate((none, none, none, none, 0.5 * (self.lower + self.upper)))
        return middle, np.array(rows).T.reshape(-1)

    @cached_property
    def axes(self) -> tuple[AxisBounds, ...]:
        """The same limits axis by axis."""
        columns = (self.lower, self.upper, self.speed, self.acceleration, self.jerk)
        T0 = self.period
        return tuple(
            AxisBounds(
                low,
                high,
                speed,
                acceleration,
                jerk,
                T0,
                jerk * T0,
                1e-6 * acceleration,
                speed * (2.0 * acceleration / jerk + 3.0 * T0 + 0.5 * speed / acceleration),
                speed - 1.001 * acceleration * (1.5 * T0 + 0.5 * acceleration / jerk),
            )
            for low, high, speed, acceleration, jerk in zip(
                *(column.tolist() for column in columns), strict=True
            )
        )


def acceleration_range(p: float, v: float, a: float, bounds: AxisBounds) -> tuple[float, float]:
    """Return the least and the largest acceleration that are allowed now.

    Args:
        p: position of the last command.
    """
    period, speed, way = bounds.period, bounds.speed, bounds.braking_way
    hard_low = max(a - bounds.change, -bounds.acceleration)
    hard_high = min(a + bounds.change, bounds.acceleration)
    above = bounds.upper - p - max(v, 0.0) * period
    below = p - bounds.lower + min(v, 0.0) * period
    is_free = above > way and below > way and abs(v) < bounds.free_speed
    if is_free and hard_low <= hard_high:
        return hard_low, hard_high
    up = speed if above > way else min(speed, _stoppable_speed(above, bounds))
    down = speed if below > way else min(speed, _stoppable_speed(below, bounds))
    high = clip(_largest_acceleration(v, up, bounds.jerk, period), hard_low, hard_high)
    low = clip(-_largest_acceleration(-v, down, bounds.jerk, period), hard_low, hard_high)
    return min(low, high), max(low, high)


def _largest_acceleration(speed: float, cap: float, jerk: float, period: float) -> float:
    """Return the largest acceleration after which the speed can still be kept at ``cap``.

    From an acceleration a the speed rises by a^2/2j + aT/2 before jerk can end it, and by aT in
    this step.
    """
    margin = cap - speed
    if margin < 0.0:
        return margin / period
    b = 1.5 * period
    return jerk * (math.sqrt(b * b + 2.0 * margin / jerk) - b)


def _stoppable_speed(way: float, bounds: AxisBounds) -> float:
    """Return the speed from which a stop within ``way`` is possible with limited jerk.

    ``way = c u + u^2 / 2A`` with c the time that jerk needs to build the deceleration up and to
    end it, and three steps of margin.
    """
    A = bounds.acceleration
    c = 2.0 * A / bounds.jerk + 3.0 * bounds.period
    return A * (math.sqrt(c * c + 2.0 * max(way, 0.0) / A) - c)


def clip(value: float, low: float, high: float) -> float:
    """Return a value within bounds; numpy's clip costs twenty times as much."""
    return low if value < low else min(value, high)
