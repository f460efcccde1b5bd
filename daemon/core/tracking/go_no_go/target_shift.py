"""Shift of the target along the conveyor, which bounds how fast a jump of the estimate moves it.

The estimate may jump at once, by 28 mm as it takes a slow sway over. A target that jumped with it
made the tool ring with 500 N in free air. Its speed jumps too: by 90 mm/s where the distance sensor
was lost as a stop began. A tool that has let go need not stay with the object: the shift goes on
with the speed that its target has, by a polynomial of fifth order that ends with the estimate's.
"""

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array

LEAST_JUMP = 0.004  # of the estimate in a step; the merge takes smaller ones smoothly [m]
ACCELERATION = 0.3  # largest of the target on its way to the estimate [m/s^2]
PEAK = 10.0 / math.sqrt(3.0)  # largest second derivative of the quintic from 0 to 1 in unit time
LEAST_CHANGE = 0.01  # of the speed in a step, while a jump is eased [m/s]
LARGEST_CHANGE = 0.05  # of it otherwise; a stop of 0.3 m/s^2 that is confirmed has less [m/s]
RATE_PEAK = 3.95  # largest second derivative of the quintic that begins with slope 1, in unit time
RATE_S = 1e-4  # over which the shift's own speed is taken [s]
LONGEST_STEP_S = 0.05  # between two steps that are compared


class TargetShift(Struct, frozen=True):
    """How far the target is from the estimate, and how it goes there.

    Attributes:
        begun, rate: the shift as its way began [m], and its speed then [m/s].
        age: time since then [s].
        stamp_ns: of the last step [ns]; None before the first.
        position: of the estimated object along the conveyor in that step [m].
        slope: speed of the target along the conveyor in that step [m/s]; NaN: a jump of it is not
            eased.
    """

    begun: float = 0.0
    age: float = math.inf
    stamp_ns: int | None = None
    position: float = 0.0
    slope: float = math.nan
    rate: float = 0.0


NO_SHIFT = TargetShift()


def advanced(
    shift: TargetShift,
    stamp_ns: int,
    position: float,
    speed: float,
    *,
    eases: bool,
    slope: float = math.nan,
) -> TargetShift:
    """Return the shift one step later.

    Args:
        position: of the estimated object along the conveyor [m].
        speed: of the conveyor [m/s].
        eases: a jump is to be eased; in contact the compliance takes it.
        slope: speed of the target along the conveyor, if a jump of it is to be eased [m/s].
    """
    dt = math.inf if shift.stamp_ns is None else (stamp_ns - shift.stamp_ns) * 1e-9
    if not dt <= LONGEST_STEP_S:
        return TargetShift(stamp_ns=stamp_ns, position=position, slope=slope)
    later = TargetShift(shift.begun, shift.age + dt, stamp_ns, position, slope, shift.rate)
    jump, change = position - shift.position - speed * dt, slope - shift.slope
    change = change if math.isfinite(change) else 0.0
    jump = jump if abs(jump) > LEAST_JUMP else 0.0
    is_eased = later.age < duration(later)
    limit = LEAST_CHANGE if is_eased else LARGEST_CHANGE
    if eases and (jump or abs(change) > limit):
        now, soon = remaining(later, np.array((0.0, RATE_S))).tolist()
        return replace(later, begun=now - jump, rate=(soon - now) / RATE_S - change, age=0.0)
    return later if is_eased else replace(later, begun=0.0, rate=0.0, age=math.inf)


def left_behind(shift: TargetShift, way: float, delay: float) -> TargetShift:
    """Return the shift of a target that stayed behind its object by one more way [m].

    Args:
        delay: after which it begins to go back [s]: behind what is committed.
    """
    now, soon = remaining(shift, np.array((0.0, RATE_S))).tolist()
    return replace(shift, begun=now - way, rate=(soon - now) / RATE_S, age=-delay)


def duration(shift: TargetShift) -> float:
    """Return how long the target needs for a shift [s]."""
    way = math.sqrt(PEAK * abs(shift.begun) / ACCELERATION)
    return math.hypot(way, RATE_PEAK * shift.rate / ACCELERATION)


def remaining(shift: TargetShift, times: Array) -> Array:
    """Return the shift (m,) [m] at times from now [s]."""
    if not (shift.begun or shift.rate):
        return np.zeros(len(times))
    lasting = duration(shift)
    s = np.minimum(np.maximum((shift.age + times) / lasting, 0.0), 1.0)
    left: Array = shift.begun * (1.0 - s**3 * (10.0 + s * (6.0 * s - 15.0)))
    if shift.rate:
        left += shift.rate * lasting * (s - s**3 * (6.0 + s * (3.0 * s - 8.0)))
    return left
