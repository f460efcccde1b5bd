"""Command limiter: the last check of a command, whatever is desired.

Invariants:
- Commands are finite; position, speed, acceleration and jerk of their finite differences are
  within the limits. After each command a stop within all limits remains possible.
- A desired command within the limits passes bit for bit.
- The limiter imports nothing of control or tracking.
"""

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from linemate.daemon.core.control.axis_limits import AxisBounds, Limits, acceleration_range, clip
from linemate.daemon.core.horizon import Array

MEAN_S = 0.03  # time constant of the mean speed, which the limit of the tcp's speed reads [s]
_FINITE = 1e100  # beyond this a difference of two setpoints overflows to infinity, and then to NaN


class LimiterState(Struct, frozen=True, eq=False):
    """The last command and the last desired setpoint, with their differences.

    Attributes:
        position, speed, acceleration: of the commands (m,).
        desired: last desired setpoint (m,).
        mean_speed: of the commands over some ``MEAN_S`` (m,); None: the same as ``speed``.
    """

    position: Array
    speed: Array
    acceleration: Array
    desired: Array
    desired_speed: Array
    mean_speed: Array | None = None

    @property
    def mean(self) -> Array:
        """Mean speed of the commands (m,)."""
        return self.speed if self.mean_speed is None else self.mean_speed


def at_rest(position: Array) -> LimiterState:
    """Return the state of a robot that stands at ``position`` (m,)."""
    zero = np.zeros(len(position))
    return LimiterState(position, zero, zero, position, zero, zero)


def held(state: LimiterState, position: Array) -> LimiterState:
    """Return the state of a robot that stands at ``position`` (m,) while more was desired of it.

    The desired setpoint stays. With the held position in its place, the way to the next desired
    setpoint would count as its speed, and the robot would stop again in the second cycle.
    """
    zero = np.zeros(len(position))
    return LimiterState(position, zero, zero, state.desired, state.desired_speed, zero)


def moving(position: Array, speed: Array, acceleration: Array) -> LimiterState:
    """Return the state of a robot whose last setpoints (m,) had these differences."""
    return LimiterState(position, speed, acceleration, position, speed, speed)


def is_standing(state: LimiterState) -> bool:
    """Return whether the commands stand still: below 1e-4 rad/s or m/s, and no acceleration."""
    return bool((np.abs(state.speed) < 1e-4).all() and (np.abs(state.acceleration) < 1e-2).all())


def next_mean_speed(state: LimiterState, speed: Array, period: float) -> Array:
    """Return the mean speed (m,) one step later."""
    mean = state.mean
    return mean + (period / (MEAN_S + period)) * (speed - mean)


class _Axis(NamedTuple):
    """One axis: position, speed and acceleration of the command; last and new desired setpoint."""

    p: float
    v: float
    a: float
    last: float
    last_speed: float
    desired: float


def _catch_up(axis: _Axis, bounds: AxisBounds) -> float:
    """Return the acceleration that leads back to the desired setpoint without overshoot.

    To be on the desired setpoint in one step from some way off is a bang-bang that never ends.
    The rest of the way is closed at the speed from which 0.8 of the acceleration still stop in
    time. That speed is approached as fast as jerk lets it settle. A robot that held for a cycle
    excites its tool by what it is behind, summed over the catch-up. The sum is half of that with
    0.5 of the acceleration and a gain of 0.25.
    """
    period = bounds.period
    speed = (axis.desired - axis.last) / period
    change = (speed - axis.last_speed) / period
    gain = min(0.7 / period, 0.7 * bounds.jerk / bounds.acceleration)
    largest = 0.8 * bounds.acceleration
    error = axis.desired - (axis.p + axis.v * period)
    c = 1.0 / gain + bounds.acceleration / bounds.jerk
    closing = math.copysign(largest * (math.sqrt(c * c + 2.0 * abs(error) / largest) - c), error)
    return change + gain * (speed + closing - axis.v)


def _can_stay(axis: _Axis, wanted: float, bounds: AxisBounds) -> bool:
    """Return whether the axis could stay on the desired setpoint once it is there.

    One that comes back from some way off may arrive so fast that the next step leaves the setpoint
    again, in a limit cycle.
    """
    period = bounds.period
    speed = (axis.desired - axis.last) / period
    arriving = axis.v + wanted * period
    following = (2.0 * speed - axis.last_speed - arriving) / period
    return (
        abs(following) <= bounds.acceleration + bounds.margin
        and abs(following - wanted) <= bounds.change + bounds.margin
    )


def _admit_axis(axis: _Axis, bounds: AxisBounds) -> tuple[float, bool]:
    """Return one axis' acceleration, and whether its command is the one desired."""
    p, v, a, last, _, desired = axis
    wanted = ((desired - p) / bounds.period - v) / bounds.period
    low, high = acceleration_range(p, v, a, bounds)
    is_allowed = low - bounds.margin <= wanted <= high + bounds.margin
    # An axis that has followed so far can always stay.
    if is_allowed and (p == last or _can_stay(axis, wanted, bounds)):
        return wanted, True
    return clip(_catch_up(axis, bounds), low, high), False


def _admit_free(state: LimiterState, desired: Array, limits: Limits) -> LimiterState | None:
    """Return the state after a desired command that nothing limits, None if something may.

    All axes at once: it takes a third of the time of ``admit`` axis by axis.
    """
    # A difference of huge setpoints overflows. The maximum of a NaN may pass: it is not free below.
    if state.position is not state.desired or not max(map(abs, desired.tolist())) < _FINITE:
        return None
    period = limits.period
    desired_speed = (desired - state.position) / period
    acceleration = (desired_speed - state.speed) / period
    change = acceleration - state.acceleration
    middle, reach = limits.free
    values = (state.acceleration, acceleration, change, state.speed, state.position)
    # Written so that a NaN is not free.
    if not np.logical_and.reduce(np.abs(np.concatenate(values) - middle) < reach):
        return None
    speed = state.speed + acceleration * period
    mean_speed = next_mean_speed(state, speed, period)
    return LimiterState(desired, speed, acceleration, desired, desired_speed, mean_speed)


def admit(state: LimiterState, desired: Array, limits: Limits) -> tuple[LimiterState, str | None]:
    """Return the state after the command that is nearest to ``desired`` within the limits.

    Args:
        state: of the commands so far.

    Returns:
        The new state, whose ``position`` is the command, and None or what was limited and why.
    """
    free = _admit_free(state, desired, limits)
    if free is not None:
        return free, None
    period = limits.period
    positions, accelerations, desired_speeds = [], [], []
    speeds: list[float] = []
    limited: list[str] = []
    for name, bounds, p, v, a, last, last_speed, wanted_position in zip(
        limits.names,
        limits.axes,
        state.position.tolist(),
        state.speed.tolist(),
        state.acceleration.tolist(),
        state.desired.tolist(),
        state.desired_speed.tolist(),
        desired.tolist(),
        strict=True,
    ):
        if not abs(wanted_position) < _FINITE:
            return brake(state, limits), "the command was not finite"
        axis = _Axis(p, v, a, last, last_speed, wanted_position)
        acceleration, is_reached = _admit_axis(axis, bounds)
        speed = v + acceleration * period
        positions.append(wanted_position if is_reached else p + speed * period)
        speeds.append(speed)
        accelerations.append(acceleration)
        desired_speeds.append((wanted_position - last) / period)
        if not is_reached:
            limited.append(name)
    speeds_now = np.array(speeds)
    after = LimiterState(
        position=np.array(positions) if limited else desired,
        speed=speeds_now,
        acceleration=np.array(accelerations),
        desired=desired,
        desired_speed=np.array(desired_speeds),
        mean_speed=next_mean_speed(state, speeds_now, period),
    )
    return after, f"limited: {', '.join(limited)}" if limited else None


def brake(state: LimiterState, limits: Limits, gentle: Limits | None = None) -> LimiterState:
    """Return the state after one step of a stop.

    The deceleration aimed at is the one whose own decay, at full jerk, ends the remaining speed:
    |v| = a^2/2j + aT/2 in discrete time. Speed in excess of the desired one, from catching up
    with a lost command, is ended at ``limits`` first.

    Args:
        state: of the commands so far.
        gentle: acceleration and jerk to stop with; None: those of ``limits``, the quickest stop.
    """
    period = limits.period
    rows = []
    for bounds, soft, p, v, a, planned in zip(
        limits.axes,
        (gentle or limits).axes,
        state.position.tolist(),
        state.speed.tolist(),
        state.acceleration.tolist(),
        state.desired_speed.tolist(),
        strict=True,
    ):
        # An acceleration of the motion beyond the gentle one ends at the jerk of the limits.
        change = bounds.change if abs(a) > soft.acceleration else soft.change
        wanted = clip(-math.copysign(_deceleration(abs(v), soft), v), a - change, a + change)
        excess = v - _planned_part(v, planned)
        if abs(excess) > abs(wanted) * period:
            # A gentle stop from the speed of a catch-up took the tool 60 mm on instead of 20.
            wanted = -math.copysign(_deceleration(abs(excess), bounds), excess)
        acceleration = clip(wanted, *acceleration_range(p, v, a, bounds))
        speed = v + acceleration * period
        # A speed that still rises while its acceleration ends is part of the planned motion.
        own_speed = speed if excess == 0.0 else _planned_part(speed, planned)
        rows.append((p + speed * period, speed, acceleration, own_speed))
    position, speeds, accelerations, own_speeds = np.array(rows).T
    mean = next_mean_speed(state, speeds, period)
    return LimiterState(position, speeds, accelerations, position, own_speeds, mean)


def _deceleration(speed: float, bounds: AxisBounds) -> float:
    """Return the deceleration whose own decay, at full jerk, ends a speed."""
    step = bounds.change
    aim = math.sqrt(0.25 * step * step + 2.0 * bounds.jerk * speed) - 0.5 * step
    return min(aim, speed / bounds.period, bounds.acceleration)


def _planned_part(speed: float, planned: float) -> float:
    """Return the part of a command's speed that is not catching up with a lost command."""
    return clip(speed, min(planned, 0.0), max(planned, 0.0))
