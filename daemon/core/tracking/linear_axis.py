"""Plan of the linear axis: it follows the object's estimated position along the conveyor.

Invariants:
    - Each step appends one sample to the plan and changes none: the inverse kinematics relies
      on it.
    - Position, speed and acceleration of the plan are continuous, whatever the estimate does.
"""

import math

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array

LAGS = 3  # equal lags in a row make position, speed and acceleration continuous
RATE = 6.0  # of one lag, as a multiple of 1 / ramp: three of them settle within the ramp


class AxisPlan(Struct, frozen=True, eq=False):
    """What the axis will do.

    Attributes:
        positions: planned (m+1,), one a cycle from now on [m].
        stages: outputs of the lags; the last one is the end of the plan [m].
        goal: input of the lags [m].
    """

    positions: Array
    stages: tuple[float, float, float]
    goal: float


def advance(plan: AxisPlan, goal: float, ramp: float, dt: float) -> AxisPlan:
    """Return the plan one step later, its end lagging behind ``goal`` by ``delay``.

    Args:
        plan: of the step before.
        goal: where the axis is to be ``delay`` after the end of the plan [m].
        ramp: time in which the axis takes up or loses its speed [s].
    """
    gain = _gain(ramp, dt)
    first, second, third = plan.stages
    first += gain * (goal - first)
    second += gain * (first - second)
    third += gain * (second - third)
    positions = np.empty_like(plan.positions)
    positions[:-1] = plan.positions[1:]
    positions[-1] = third
    return AxisPlan(positions, (first, second, third), goal)


def displaced(plan: AxisPlan, way: float) -> AxisPlan:
    """Return the plan displaced as a whole by a way [m]; it goes back to its goal."""
    first, second, third = plan.stages
    return AxisPlan(plan.positions + way, (first + way, second + way, third + way), plan.goal)


def delay(ramp: float, dt: float) -> float:
    """Return by how much the plan lags behind a goal of constant speed [s]."""
    gain = _gain(ramp, dt)
    return LAGS * dt * (1.0 - gain) / gain


def _gain(ramp: float, dt: float) -> float:
    """Return the share of its way to the input that a lag covers in one step."""
    return 1.0 - math.exp(-RATE * dt / ramp)


def at_rest(position: float, steps: int) -> AxisPlan:
    """Return the plan of an axis that stands, ``steps`` ahead."""
    return AxisPlan(np.full(steps + 1, position), (position, position, position), position)
