"""Shift of the target along the conveyor, which bounds how fast a jump of the estimate moves it.

The estimate may jump at once, by 28 mm as it takes a slow sway over. A target that jumped with it
made the tool ring with 500 N in free air.
"""

import math

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array

LEAST_JUMP = 0.004  # of the estimate in a step; the merge takes smaller ones smoothly [m]
ACCELERATION = 0.3  # largest of the target on its way to the estimate [m/s^2]
PEAK = 10.0 / math.sqrt(3.0)  # largest second derivative of the quintic from 0 to 1 in unit time
LONGEST_STEP_S = 0.05  # between two steps that are compared


class TargetShift(Struct, frozen=True):
    """How far the target is from the estimate, and how it goes there.

    Attributes:
        begun: the shift as its way began [m].
        age: time since then [s].
        stamp_ns: of the last step [ns]; None before the first.
        position: of the estimated object along the conveyor in that step [m].
    """

    begun: float = 0.0
    age: float = math.inf
    stamp_ns: int | None = None
    position: float = 0.0


NO_SHIFT = TargetShift()


def advanced(
    shift: TargetShift, stamp_ns: int, position: float, speed: float, *, eases: bool
) -> TargetShift:
    """Return the shift one step later.

    Args:
        position: of the estimated object along the conveyor [m].
        speed: of the conveyor [m/s].
        eases: a jump is to be eased; in contact the compliance takes it.
    """
    dt = math.inf if shift.stamp_ns is None else (stamp_ns - shift.stamp_ns) * 1e-9
    if not dt <= LONGEST_STEP_S:
        return TargetShift(stamp_ns=stamp_ns, position=position)
    begun, age = shift.begun, shift.age + dt
    jump = position - shift.position - speed * dt
    if eases and abs(jump) > LEAST_JUMP:
        now = TargetShift(begun, age)
        begun, age = float(remaining(now, np.zeros(1))[0]) - jump, 0.0
    elif age >= duration(begun):
        begun, age = 0.0, math.inf
    return TargetShift(begun, age, stamp_ns, position)


def duration(begun: float) -> float:
    """Return how long the target needs for a shift [s]."""
    return math.sqrt(PEAK * abs(begun) / ACCELERATION)


def remaining(shift: TargetShift, times: Array) -> Array:
    """Return the shift (m,) [m] at times from now [s]."""
    if not shift.begun:
        return np.zeros(len(times))
    s = np.minimum(np.maximum((shift.age + times) / duration(shift.begun), 0.0), 1.0)
    left: Array = shift.begun * (1.0 - s**3 * (10.0 + s * (6.0 * s - 15.0)))
    return left
