"""The last gate before the wire: whatever is desired, the command stays within the limits.

Law of this file: finite, position, speed, acceleration and jerk of the *commands'* finite
differences; it imports nothing of control or tracking and trusts neither. It looks ahead: a
command is allowed only while a stop within all limits remains possible after it.

Axis by axis in plain floats: for seven axes that is a quarter of what arrays cost.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array


@dataclass(frozen=True, slots=True)
class AxisBounds:
    """Limits of one axis, SI, for commands that are a period apart.

    Attributes:
        lower, upper, speed, acceleration, jerk: the limits.
        period: T0 [s].
        change: of the acceleration in one step.
        margin: a rounding of the differences is no violation: a millionth of the acceleration.
        clear_lower, clear_upper: between these full speed still stops before the ends.
    """

    lower: float
    upper: float
    speed: float
    acceleration: float
    jerk: float
    period: float
    change: float
    margin: float
    clear_lower: float
    clear_upper: float


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of all axes as arrays (m,), SI."""

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    jerk: Array
    names: tuple[str, ...]


@lru_cache(maxsize=16)
def _by_axis(limits: Limits, period: float) -> tuple[AxisBounds, ...]:
    """Return limits axis by axis, with all that depends on nothing but them and the period."""
    rows = zip(
        limits.lower.tolist(),
        limits.upper.tolist(),
        limits.speed.tolist(),
        limits.acceleration.tolist(),
        limits.jerk.tolist(),
        strict=True,
    )
    return tuple(_axis_bounds(*row, period) for row in rows)


def _stopping_way(speed: float, acceleration: float, jerk: float, period: float) -> float:
    """Return the room from which ``_speed_before`` allows full speed."""
    c = 2.0 * acceleration / jerk + 3.0 * period
    return speed * (c + 0.5 * speed / acceleration)


def _axis_bounds(
    lower: float, upper: float, speed: float, acceleration: float, jerk: float, period: float
) -> AxisBounds:
    room = _stopping_way(speed, acceleration, jerk, period)
    return AxisBounds(
        lower=lower,
        upper=upper,
        speed=speed,
        acceleration=acceleration,
        jerk=jerk,
        period=period,
        change=jerk * period,
        margin=1e-6 * acceleration,
        clear_lower=lower + room,
        clear_upper=upper - room,
    )


class GateState(Struct, frozen=True, eq=False):
    """The last command and its differences, and what had been desired.

    Attributes:
        position, speed, acceleration: of the commands (m,).
        desired: the last desired setpoint (m,).
        desired_speed: and its difference (m,).
        mean_speed: of the commands over some ``MEAN_S`` (m,); None: the same as ``speed``.
    """

    position: Array
    speed: Array
    acceleration: Array
    desired: Array
    desired_speed: Array
    mean_speed: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TcpLimit:
    """Limit of the tcp's speed.

    Attributes:
        speed: of the tcp in base [m/s].
        levers: (m,) upper bound of the tcp's speed for a unit of each axis' speed [m/rad], [1].
    """

    speed: float
    levers: Array

    @property
    def commanded(self) -> float:
        """Limit of the commands' mean speed over some ``MEAN_S`` [m/s]."""
        return COMMANDED * self.speed


MEAN_S = 0.03
"""Time constant of the mean speed [s]. The inverse of a slow servo asks for twice the tcp's speed
in single cycles; the arm itself moves as the mean does."""

PEAK = 2.0
"""Speed of a single cycle's commands over the limit of the mean."""

COMMANDED = 0.75
"""Share of the tcp's limit for its commands: servos overshoot a sudden speed by up to a third."""

FREE = 0.75
"""Share of the commands' limit up to which the mean speed may rise at once."""

RISE = 1.5
"""Acceleration of the tcp above that [m/s^2]."""

_HALVINGS = 6


def at_rest(position: Array) -> GateState:
    """Return the gate of a robot that stands at ``position`` (m,)."""
    zero = np.zeros(len(position))
    return GateState(position, zero, zero, position, zero, zero)


def held(state: GateState, position: Array) -> GateState:
    """Return the gate of a robot that stands at ``position`` (m,) while more was desired of it.

    What was desired stays. Taken as the held position, the way to the next desired setpoint would
    count as its speed, and the robot would stop again in the second cycle.
    """
    zero = np.zeros(len(position))
    return GateState(position, zero, zero, state.desired, state.desired_speed, zero)


def under_way(position: Array, speed: Array, acceleration: Array) -> GateState:
    """Return the gate of a robot whose last setpoints (m,) had these differences."""
    return GateState(position, speed, acceleration, position, speed, speed)


def _mean_of(state: GateState) -> Array:
    return state.speed if state.mean_speed is None else state.mean_speed


def _mean_speed(state: GateState, speed: Array, period: float) -> Array:
    """Return the mean speed (m,) one step later."""
    mean = _mean_of(state)
    return mean + (period / (MEAN_S + period)) * (speed - mean)


def _ceiling(speed: float, cap: float, jerk: float, period: float) -> float:
    """Return the largest acceleration after which the speed can still be kept at ``cap``.

    From an acceleration a the speed rises by a^2/2j + aT/2 before jerk can end it, and by aT in
    this step.
    """
    room = cap - speed
    if room < 0.0:
        return room / period
    b = 1.5 * period
    return jerk * (math.sqrt(b * b + 2.0 * room / jerk) - b)


def _speed_before(room: float, bounds: AxisBounds) -> float:
    """Return the speed from which a stop within ``room`` is possible with jerk limited.

    ``room = c u + u^2 / 2A`` with c the time that jerk needs to build the deceleration up and to
    let it go, and three steps of margin.
    """
    A = bounds.acceleration
    c = 2.0 * A / bounds.jerk + 3.0 * bounds.period
    return A * (math.sqrt(c * c + 2.0 * max(room, 0.0) / A) - c)


def _clip(value: float, low: float, high: float) -> float:
    return low if value < low else min(value, high)


def _range(p: float, v: float, a: float, bounds: AxisBounds) -> tuple[float, float]:
    """Return the least and the largest acceleration that are allowed now."""
    period = bounds.period
    hard_low = max(a - bounds.change, -bounds.acceleration)
    hard_high = min(a + bounds.change, bounds.acceleration)
    up = min(bounds.speed, _speed_before(bounds.upper - p - max(v, 0.0) * period, bounds))
    down = min(bounds.speed, _speed_before(p - bounds.lower + min(v, 0.0) * period, bounds))
    high = _clip(_ceiling(v, up, bounds.jerk, period), hard_low, hard_high)
    low = _clip(-_ceiling(-v, down, bounds.jerk, period), hard_low, hard_high)
    return min(low, high), max(low, high)


class _Axis(NamedTuple):
    """One axis of a gate and what is desired of it now."""

    p: float
    v: float
    a: float
    last: float
    last_speed: float
    desired: float


def _catch_up(axis: _Axis, bounds: AxisBounds) -> float:
    """Return the acceleration that leads back to what is desired without overshoot.

    Taken where the direct way is closed: to be on the desired setpoint in one step from some way
    off is a bang-bang that never ends. The way left is closed at the speed from which four fifths
    of the acceleration still stop in time, the speed reached as quickly as jerk lets it settle.
    What a robot that held for a cycle is behind, summed over the time until it is back, is what
    sets its tool ringing: half of what it was with a half of the acceleration and a gain of a
    quarter.
    """
    period = bounds.period
    speed = (axis.desired - axis.last) / period
    change = (speed - axis.last_speed) / period
    gain = min(0.7 / period, 0.7 * bounds.jerk / bounds.acceleration)
    most = 0.8 * bounds.acceleration
    off = axis.desired - (axis.p + axis.v * period)
    c = 1.0 / gain + bounds.acceleration / bounds.jerk
    closing = math.copysign(most * (math.sqrt(c * c + 2.0 * abs(off) / most) - c), off)
    return change + gain * (speed + closing - axis.v)


def _stays(axis: _Axis, wanted: float, bounds: AxisBounds) -> bool:
    """Tell whether the axis could stay on what is desired once it is there.

    One that has followed so far always can. One that comes back from some way off may arrive so
    fast that the next step throws it off again, for ever.
    """
    if axis.p == axis.last:
        return True
    period = bounds.period
    speed = (axis.desired - axis.last) / period
    arriving = axis.v + wanted * period
    following = (2.0 * speed - axis.last_speed - arriving) / period
    return (
        abs(following) <= bounds.acceleration + bounds.margin
        and abs(following - wanted) <= bounds.change + bounds.margin
    )


def _is_clear(p: float, v: float, a: float, wanted: float, bounds: AxisBounds) -> bool:
    """Tell at once what ``_range`` would say of most steps: nothing is near a limit.

    The same conditions without a square root: far enough from both ends for a stop from full
    speed, and the speed's own limit not reached as jerk ends the acceleration.
    """
    size = abs(wanted)
    if not (size <= bounds.acceleration and abs(wanted - a) <= bounds.change):
        return False
    way = abs(v) * bounds.period
    if p + way > bounds.clear_upper or p - way < bounds.clear_lower:
        return False
    left = bounds.speed - v if wanted > 0.0 else bounds.speed + v
    return left >= size * (0.5 * size / bounds.jerk + 1.5 * bounds.period)


def _admit_axis(axis: _Axis, wanted: float, bounds: AxisBounds) -> tuple[float, bool]:
    """Return one axis' acceleration, and whether its command is the one desired."""
    low, high = _range(axis.p, axis.v, axis.a, bounds)
    is_allowed = low - bounds.margin <= wanted <= high + bounds.margin
    if is_allowed and _stays(axis, wanted, bounds):
        return wanted, True
    return _clip(_catch_up(axis, bounds), low, high), False


def admit(
    state: GateState, desired: Array, limits: Limits, period: float
) -> tuple[GateState, str | None]:
    """Return the gate after the command that is nearest to ``desired`` within the limits.

    Args:
        state: of the commands so far.
        period: T0 [s].

    Returns:
        The new gate, whose ``position`` is the command, and None or what was held back and why.
    """
    positions, accelerations, desired_speeds = [], [], []
    speeds: list[float] = []
    short: list[str] = []
    for n, (bounds, p, v, a, last, last_speed, wish) in enumerate(
        zip(
            _by_axis(limits, period),
            state.position.tolist(),
            state.speed.tolist(),
            state.acceleration.tolist(),
            state.desired.tolist(),
            state.desired_speed.tolist(),
            desired.tolist(),
            strict=True,
        )
    ):
        taken, reached = ((wish - p) / period - v) / period, True
        # One that is behind has more to ask, see ``_stays``.
        if p != last or not _is_clear(p, v, a, taken, bounds):
            # Beyond this a difference of two setpoints overflows to infinity, and then to NaN;
            # it is never clear.
            if not abs(wish) < 1e100:
                return brake(state, limits, period), "the command was not finite"
            axis = _Axis(p, v, a, last, last_speed, wish)
            taken, reached = _admit_axis(axis, taken, bounds)
        speed = v + taken * period
        positions.append(wish if reached else p + speed * period)
        speeds.append(speed)
        accelerations.append(taken)
        desired_speeds.append((wish - last) / period)
        if not reached:
            short.append(limits.names[n])
    speeds_now = np.array(speeds)
    gate = GateState(
        position=np.array(positions) if short else desired,
        speed=speeds_now,
        acceleration=np.array(accelerations),
        desired=desired,
        desired_speed=np.array(desired_speeds),
        mean_speed=_mean_speed(state, speeds_now, period),
    )
    return gate, f"limited: {', '.join(short)}" if short else None


def brake(
    state: GateState, limits: Limits, period: float, gentle: Limits | None = None
) -> GateState:
    """Return the gate after one step of a stop.

    Deceleration is let go in time: the acceleration aimed at is the one whose own decay, at
    full jerk, ends the remaining speed: |v| = a^2/2j + aT/2 in discrete time. The speed at which a
    lost command was caught up with is let go at the limits first.

    Args:
        state: of the commands so far.
        period: T0 [s].
        gentle: acceleration and jerk to stop with; None: those of ``limits``, the quickest stop.
    """
    rows = []
    for bounds, soft, p, v, a, planned in zip(
        _by_axis(limits, period),
        _by_axis(gentle or limits, period),
        state.position.tolist(),
        state.speed.tolist(),
        state.acceleration.tolist(),
        state.desired_speed.tolist(),
        strict=True,
    ):
        step = soft.change
        # What is left of a motion's own acceleration is let go at once.
        if abs(a) > soft.acceleration:
            step = bounds.change
        wanted = _clip(-math.copysign(_deceleration(abs(v), soft), v), a - step, a + step)
        excess = v - _own_speed(v, planned)
        if abs(excess) > abs(wanted) * period:
            # A gentle stop from the speed of a catch-up took the tool 60 mm on instead of 20.
            wanted = -math.copysign(_deceleration(abs(excess), bounds), excess)
        taken = _clip(wanted, *_range(p, v, a, bounds))
        speed = v + taken * period
        # A speed that still rises while its acceleration is let go is the motion's own.
        own_speed = speed if excess == 0.0 else _own_speed(speed, planned)
        rows.append((p + speed * period, speed, taken, own_speed))
    position, speeds, accelerations, own_speeds = np.array(rows).T
    mean = _mean_speed(state, speeds, period)
    return GateState(position, speeds, accelerations, position, own_speeds, mean)


def _deceleration(speed: float, bounds: AxisBounds) -> float:
    """Return the deceleration whose own decay, at full jerk, ends a speed."""
    step = bounds.change
    aim = math.sqrt(0.25 * step * step + 2.0 * bounds.jerk * speed) - 0.5 * step
    return min(aim, speed / bounds.period, bounds.acceleration)


def _own_speed(speed: float, planned: float) -> float:
    """Return the part of a command's speed that is not the catching up with a lost command."""
    return _clip(speed, min(planned, 0.0), max(planned, 0.0))


def is_slow(gate: GateState, limit: TcpLimit) -> bool:
    """Tell by the axes' speeds alone whether the tcp's speed is far within its limit."""
    mean, cap = _mean_of(gate), FREE * limit.commanded
    return bool(
        np.dot(np.abs(mean), limit.levers) <= cap
        and np.dot(np.abs(gate.speed), limit.levers) <= limit.commanded
    )


def slow_down(
    state: GateState,
    admitted: GateState,
    jacobian: Array,
    limits: Limits,
    period: float,
    cap: float,
) -> GateState:
    """Return the admitted command, or the share of it that keeps the tcp's speed.

    All axes take the same share of the way from a joint stop to the admitted command. Both ends
    are within the range of accelerations that each axis' limits allow, so the rest is too.

    Args:
        state: of the commands so far.
        jacobian: (3, m) of the tcp's position.
        period: T0 [s].
        cap: of the tcp's mean speed [m/s].

    Returns:
        ``admitted`` itself where it keeps the limit.
    """
    before = np.dot(jacobian, _mean_of(state))

    def keeps(gate: GateState) -> bool:
        return _keeps_speed(gate, jacobian, limits, before, RISE * period, cap)

    if keeps(admitted):
        return admitted
    stopping = _joint_stop(state, limits, period)
    low, high, slower = 0.0, 1.0, _between(state, stopping, admitted, 0.0, period)
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        tried = _between(state, stopping, admitted, share, period)
        if keeps(tried):
            low, slower = share, tried
        else:
            high = share
    return slower


def _keeps_speed(
    gate: GateState, jacobian: Array, limits: Limits, before: Array, change: float, cap: float
) -> bool:
    """Tell whether the tcp's speed, and what it still comes to, is within its limits.

    A speed v above the cap raises the mean while the axes brake, at d: by (v - cap)^2 / 2d over
    ``MEAN_S``.

    Args:
        jacobian: (3, m) of the tcp's position.
        before: (3,) mean velocity of the tcp one step ago [m/s].
        change: by which the mean may rise in its own direction in this step [m/s].
        cap: limit of the mean [m/s].
    """
    mean = np.dot(jacobian, _mean_of(gate))
    size = math.hypot(*mean.tolist())
    if size > FREE * cap and size > float(np.dot(before, mean)) / size + change:
        return False
    now = math.hypot(*np.dot(jacobian, gate.speed).tolist())
    if now <= cap:
        return size <= cap
    stop_s = float((np.abs(gate.speed) / limits.acceleration).max())
    rise = 0.5 * (now - cap) ** 2 * stop_s / (now * MEAN_S)
    return size + rise <= cap and now <= PEAK * cap


def _joint_stop(state: GateState, limits: Limits, period: float) -> Array:
    """Return accelerations (m,) that slow all axes in proportion, as far as their limits let them.

    Axes that stop one after another would move the tcp faster where their speeds cancel out.
    """
    stop_s = max(float((np.abs(state.speed) / limits.acceleration).max()), period)
    rows = zip(
        _by_axis(limits, period),
        state.position.tolist(),
        state.speed.tolist(),
        state.acceleration.tolist(),
        strict=True,
    )
    return np.array([_clip(-v / stop_s, *_range(p, v, a, bounds)) for bounds, p, v, a in rows])


def _between(
    state: GateState, stopping: Array, admitted: GateState, share: float, period: float
) -> GateState:
    """Return the gate after a share of the way from a stop to the admitted command.

    Args:
        state: of the commands so far.
        stopping: accelerations (m,) of the stop.
        share: 0 for the stop, 1 for the admitted command.
        period: T0 [s].
    """
    acceleration = stopping + share * (admitted.acceleration - stopping)
    speed = state.speed + period * acceleration
    return GateState(
        position=state.position + period * speed,
        speed=speed,
        acceleration=acceleration,
        desired=admitted.desired,
        desired_speed=admitted.desired_speed,
        mean_speed=_mean_speed(state, speed, period),
    )


def stands(state: GateState) -> bool:
    """Tell whether the commands stand still: below 1e-4 rad/s or m/s, and no acceleration."""
    return bool((np.abs(state.speed) < 1e-4).all() and (np.abs(state.acceleration) < 1e-2).all())
