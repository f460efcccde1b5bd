"""The last gate before the wire: whatever is desired, the command stays within the limits.

Law of this file: finite, position, speed, acceleration and jerk of the *commands'* finite
differences; it imports nothing of control or tracking and trusts neither. It looks ahead: a
command is allowed only while a stop within all limits remains possible after it.
"""

from dataclasses import dataclass, replace

import numpy as np

from linemate.daemon.horizon import Array


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Limits of all axes as arrays (m,), SI."""

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    jerk: Array
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class GateState:
    """The last command and its differences, and what had been desired.

    Attributes:
        position, speed, acceleration: of the commands (m,).
        desired: the last desired setpoint (m,).
        desired_speed: and its difference (m,).
    """

    position: Array
    speed: Array
    acceleration: Array
    desired: Array
    desired_speed: Array


def at_rest(position: Array) -> GateState:
    """Return the gate of a robot that stands at ``position`` (m,)."""
    zero = np.zeros(len(position))
    return GateState(position, zero, zero, position, zero)


def _ceiling(state_speed: Array, cap: Array, jerk: Array, period: float) -> Array:
    """Return the largest acceleration after which the speed can still be kept at ``cap``.

    From an acceleration a the speed rises by a^2/2j + aT/2 before jerk can end it, and by aT in
    this step.
    """
    room = cap - state_speed
    b = 1.5 * period
    rising = jerk * (np.sqrt(b * b + 2.0 * np.maximum(room, 0.0) / jerk) - b)
    return np.where(room >= 0.0, rising, room / period)


def _speed_before(room: Array, limits: Limits, period: float) -> Array:
    """Return the speed from which a stop within ``room`` (m,) is possible with jerk limited.

    ``room = c u + u^2 / 2A`` with c the time that jerk needs to build the deceleration up and to
    let it go, and three steps of margin.
    """
    c = 2.0 * limits.acceleration / limits.jerk + 3.0 * period
    A = limits.acceleration
    return A * (np.sqrt(c * c + 2.0 * np.maximum(room, 0.0) / A) - c)


def _bounds(state: GateState, limits: Limits, period: float) -> tuple[Array, Array]:
    """Return the least and the largest acceleration (m,) that are allowed now."""
    p, v, a = state.position, state.speed, state.acceleration
    step = limits.jerk * period
    hard_low = np.maximum(a - step, -limits.acceleration)
    hard_high = np.minimum(a + step, limits.acceleration)
    up = np.minimum(
        limits.speed, _speed_before(limits.upper - p - np.maximum(v, 0.0) * period, limits, period)
    )
    down = np.minimum(
        limits.speed, _speed_before(p - limits.lower + np.minimum(v, 0.0) * period, limits, period)
    )
    high = np.clip(_ceiling(v, up, limits.jerk, period), hard_low, hard_high)
    low = np.clip(-_ceiling(-v, down, limits.jerk, period), hard_low, hard_high)
    return np.minimum(low, high), np.maximum(low, high)


def _advance(state: GateState, acceleration: Array, period: float, desired: Array) -> GateState:
    """Return the gate after one command with the given acceleration."""
    speed = state.speed + acceleration * period
    return GateState(
        state.position + speed * period,
        speed,
        acceleration,
        desired,
        (desired - state.desired) / period,
    )


def _catch_up(state: GateState, desired: Array, limits: Limits, period: float) -> Array:
    """Return the acceleration that leads back to what is desired without overshoot.

    Taken where the direct way is closed: to be on the desired setpoint in one step from some way
    off is a bang-bang that never ends. The way left is closed at the speed from which half the
    acceleration still stops in time, the speed reached as quickly as jerk lets it settle.
    """
    speed = (desired - state.desired) / period
    change = (speed - state.desired_speed) / period
    gain = np.minimum(0.25 / period, 0.25 * limits.jerk / limits.acceleration)
    half = 0.5 * limits.acceleration
    off = desired - (state.position + state.speed * period)
    c = 1.0 / gain + limits.acceleration / limits.jerk
    closing = np.sign(off) * half * (np.sqrt(c * c + 2.0 * np.abs(off) / half) - c)
    caught: Array = change + gain * (speed + closing - state.speed)
    return caught


def _stays(
    state: GateState, wanted: Array, desired: Array, limits: Limits, period: float
) -> Array:
    """Tell for each axis whether it could stay on what is desired once it is there.

    An axis that has followed so far always can. One that comes back from some way off may arrive
    so fast that the next step throws it off again, for ever.
    """
    speed = (desired - state.desired) / period
    arriving = state.speed + wanted * period
    following = (2.0 * speed - state.desired_speed - arriving) / period
    margin = 1e-6 * limits.acceleration
    calm = np.abs(following) <= limits.acceleration + margin
    smooth = np.abs(following - wanted) <= limits.jerk * period + margin
    on_track = state.position == state.desired
    stays: Array = on_track | (calm & smooth)
    return stays


def admit(
    state: GateState, desired: Array, limits: Limits, period: float
) -> tuple[GateState, str | None]:
    """Return the gate after the command that is nearest to ``desired`` within the limits.

    Args:
        state: of the commands so far.
        desired: setpoints (m,), SI.
        limits: of each axis.
        period: T0 [s].

    Returns:
        The new gate, whose ``position`` is the command, and None or what was held back and why.
    """
    if not bool(np.isfinite(desired).all()):
        return brake(state, limits, period), "the command was not finite"
    # All that is far beyond the limits is alike, and its differences must not overflow.
    desired = np.minimum(np.maximum(desired, limits.lower - 1.0), limits.upper + 1.0)
    wanted = ((desired - state.position) / period - state.speed) / period
    low, high = _bounds(state, limits, period)
    # A rounding of the differences is no violation: a millionth of the acceleration limit.
    margin = 1e-6 * limits.acceleration
    short = (wanted < low - margin) | (wanted > high + margin)
    short |= ~_stays(state, wanted, desired, limits, period)
    if short.any():
        wanted = np.where(short, _catch_up(state, desired, limits, period), wanted)
        taken = np.minimum(np.maximum(wanted, low), high)
        axes = ", ".join(name for name, held in zip(limits.names, short, strict=True) if held)
        return _advance(state, taken, period, desired), f"limited: {axes}"
    reached = _advance(state, wanted, period, desired)
    return replace(reached, position=desired), None


def brake(state: GateState, limits: Limits, period: float) -> GateState:
    """Return the gate after one step of the quickest stop that jerk and acceleration allow.

    Deceleration is let go in time: the acceleration aimed at is the one whose own decay, at
    full jerk, ends the remaining speed.
    """
    v, a = state.speed, state.acceleration
    half = 0.5 * limits.jerk * period
    # The acceleration with which jerk at its limit brings the speed to rest exactly:
    # |v| = a^2/2j + aT/2 in discrete time, one step of margin.
    aim = np.sqrt(half * half + 2.0 * limits.jerk * np.abs(v)) - half
    aim = np.minimum(aim, np.abs(v) / period)
    target = -np.sign(v) * np.minimum(aim, limits.acceleration)
    step = limits.jerk * period
    low, high = _bounds(state, limits, period)
    taken = np.clip(np.clip(target, a - step, a + step), low, high)
    after = _advance(state, taken, period, state.position)
    return replace(after, desired=after.position, desired_speed=after.speed)


def stands(state: GateState) -> bool:
    """Tell whether the commands stand still: below 1e-4 rad/s or m/s, and no acceleration."""
    return bool((np.abs(state.speed) < 1e-4).all() and (np.abs(state.acceleration) < 1e-2).all())
