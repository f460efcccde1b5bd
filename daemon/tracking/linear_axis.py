"""The linear axis follows the programme and stops when the conveyor stops.

Law of this file: a list over the horizon to which each step appends one sample; what is in it
never changes, so the arm's inverse kinematics can rely on it.
"""

import math

import numpy as np

from linemate.daemon.horizon import Array
from linemate.protocol.frozen import frozen


@frozen(eq=False)
class AxisPlan:
    """What the axis will do.

    Attributes:
        positions: planned (n+1,) [m].
        stages: of the smoothed speed [m/s].
        target: the speed it heads for [m/s].
    """

    positions: Array
    stages: tuple[float, float, float] = (0.0, 0.0, 0.0)
    target: float = 0.0


def advance(plan: AxisPlan, target: float, ramp: float, dt: float) -> AxisPlan:
    """Return the plan one step later, its end heading for ``target`` [m/s].

    Three equal lags make speed, acceleration and jerk continuous; six of their time constants
    are a ramp.
    """
    gain = 1.0 - math.exp(-6.0 * dt / ramp)
    first, second, third = plan.stages
    first += gain * (target - first)
    second += gain * (first - second)
    third += gain * (second - third)
    positions = np.empty_like(plan.positions)
    positions[:-1] = plan.positions[1:]
    positions[-1] = plan.positions[-1] + third * dt
    return AxisPlan(positions, (first, second, third), target)


def at_rest(position: float, steps: int) -> AxisPlan:
    """Return the plan of an axis that stands, ``steps`` ahead."""
    return AxisPlan(np.full(steps + 1, position))
