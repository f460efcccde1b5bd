"""The last gate before the wire: whatever is desired, the command stays within the limits.

Law of this file: finite, position, speed, acceleration and jerk of the *commands'* finite
differences; it imports nothing of control or tracking and trusts neither. It looks ahead: a
command is allowed only while a stop within all limits remains possible after it.

Axis by axis in plain floats: for seven axes that is a quarter of what arrays cost.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from linemate.daemon.horizon import Array
from linemate.protocol.frozen import frozen


@dataclass(frozen=True, slots=True)
class AxisBounds:
    """Limits of one axis, SI, with the period its commands are apart."""

    lower: float
    upper: float
    speed: float
    acceleration: float
    jerk: float


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of all axes as arrays (m,), SI."""

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    jerk: Array
    names: tuple[str, ...]

    @cached_property
    def axes(self) -> tuple[AxisBounds, ...]:
        """The same axis by axis."""
        rows = zip(
            self.lower.tolist(),
            self.upper.tolist(),
            self.speed.tolist(),
            self.acceleration.tolist(),
            self.jerk.tolist(),
            strict=True,
        )
        return tuple(AxisBounds(*row) for row in rows)


@frozen(eq=False)
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


def under_way(position: Array, speed: Array, acceleration: Array) -> GateState:
    """Return the gate of a robot whose last setpoints (m,) had these differences."""
    return GateState(position, speed, acceleration, position, speed)


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


def _speed_before(room: float, bounds: AxisBounds, period: float) -> float:
    """Return the speed from which a stop within ``room`` is possible with jerk limited.

    ``room = c u + u^2 / 2A`` with c the time that jerk needs to build the deceleration up and to
    let it go, and three steps of margin.
    """
    A = bounds.acceleration
    c = 2.0 * A / bounds.jerk + 3.0 * period
    return A * (math.sqrt(c * c + 2.0 * max(room, 0.0) / A) - c)


def _clip(value: float, low: float, high: float) -> float:
    return low if value < low else min(value, high)


def _range(p: float, v: float, a: float, bounds: AxisBounds, period: float) -> tuple[float, float]:
    """Return the least and the largest acceleration that are allowed now."""
    step = bounds.jerk * period
    hard_low = max(a - step, -bounds.acceleration)
    hard_high = min(a + step, bounds.acceleration)
    up = min(bounds.speed, _speed_before(bounds.upper - p - max(v, 0.0) * period, bounds, period))
    down = min(bounds.speed, _speed_before(p - bounds.lower + min(v, 0.0) * period, bounds, period))
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


def _catch_up(axis: _Axis, bounds: AxisBounds, period: float) -> float:
    """Return the acceleration that leads back to what is desired without overshoot.

    Taken where the direct way is closed: to be on the desired setpoint in one step from some way
    off is a bang-bang that never ends. The way left is closed at the speed from which four fifths
    of the acceleration still stop in time, the speed reached as quickly as jerk lets it settle.
    What a robot that held for a cycle is behind, summed over the time until it is back, is what
    sets its tool ringing: half of what it was with a half of the acceleration and a gain of a
    quarter.
    """
    speed = (axis.desired - axis.last) / period
    change = (speed - axis.last_speed) / period
    gain = min(0.7 / period, 0.7 * bounds.jerk / bounds.acceleration)
    most = 0.8 * bounds.acceleration
    off = axis.desired - (axis.p + axis.v * period)
    c = 1.0 / gain + bounds.acceleration / bounds.jerk
    closing = math.copysign(most * (math.sqrt(c * c + 2.0 * abs(off) / most) - c), off)
    return change + gain * (speed + closing - axis.v)


def _stays(axis: _Axis, wanted: float, bounds: AxisBounds, period: float) -> bool:
    """Tell whether the axis could stay on what is desired once it is there.

    One that has followed so far always can. One that comes back from some way off may arrive so
    fast that the next step throws it off again, for ever.
    """
    if axis.p == axis.last:
        return True
    speed = (axis.desired - axis.last) / period
    arriving = axis.v + wanted * period
    following = (2.0 * speed - axis.last_speed - arriving) / period
    margin = 1e-6 * bounds.acceleration
    return (
        abs(following) <= bounds.acceleration + margin
        and abs(following - wanted) <= bounds.jerk * period + margin
    )


def _is_clear(axis: _Axis, wanted: float, bounds: AxisBounds, period: float) -> bool:
    """Tell at once what ``_range`` and ``_stays`` would say of most steps: nothing is near a limit.

    The same conditions without a square root: far enough from both ends for a stop from full
    speed, and the speed's own limit not reached as jerk ends the acceleration.
    """
    if axis.p != axis.last or not abs(wanted) <= bounds.acceleration:
        return False
    if not abs(wanted - axis.a) <= bounds.jerk * period:
        return False
    way, room = abs(axis.v) * period, _stopping_way(bounds, period)
    if axis.p + way > bounds.upper - room or axis.p - way < bounds.lower + room:
        return False
    left = bounds.speed - axis.v if wanted > 0.0 else bounds.speed + axis.v
    return left >= abs(wanted) * (0.5 * abs(wanted) / bounds.jerk + 1.5 * period)


def _stopping_way(bounds: AxisBounds, period: float) -> float:
    """Return the room from which ``_speed_before`` allows full speed."""
    c = 2.0 * bounds.acceleration / bounds.jerk + 3.0 * period
    return bounds.speed * (c + 0.5 * bounds.speed / bounds.acceleration)


def _admit_axis(axis: _Axis, bounds: AxisBounds, period: float) -> tuple[float, bool]:
    """Return one axis' acceleration, and whether its command is the one desired."""
    wanted = ((axis.desired - axis.p) / period - axis.v) / period
    if _is_clear(axis, wanted, bounds, period):
        return wanted, True
    low, high = _range(axis.p, axis.v, axis.a, bounds, period)
    # A rounding of the differences is no violation: a millionth of the acceleration limit.
    margin = 1e-6 * bounds.acceleration
    if low - margin <= wanted <= high + margin and _stays(axis, wanted, bounds, period):
        return wanted, True
    return _clip(_catch_up(axis, bounds, period), low, high), False


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
    wishes = desired.tolist()
    # Beyond this a difference of two setpoints overflows to infinity, and then to NaN.
    if not all(abs(wish) < 1e100 for wish in wishes):
        return brake(state, limits, period), "the command was not finite"
    rows, short = [], []
    for n, (p, v, a, last, last_speed, wish) in enumerate(
        zip(
            state.position.tolist(),
            state.speed.tolist(),
            state.acceleration.tolist(),
            state.desired.tolist(),
            state.desired_speed.tolist(),
            wishes,
            strict=True,
        )
    ):
        axis = _Axis(p, v, a, last, last_speed, wish)
        taken, reached = _admit_axis(axis, limits.axes[n], period)
        speed = v + taken * period
        position = wish if reached else p + speed * period
        rows.append((position, speed, taken, wish, (wish - last) / period))
        if not reached:
            short.append(limits.names[n])
    reason = f"limited: {', '.join(short)}" if short else None
    return GateState(*np.array(rows).T), reason


def brake(
    state: GateState, limits: Limits, period: float, gentle: Limits | None = None
) -> GateState:
    """Return the gate after one step of a stop.

    Deceleration is let go in time: the acceleration aimed at is the one whose own decay, at
    full jerk, ends the remaining speed: |v| = a^2/2j + aT/2 in discrete time.

    Args:
        state: of the commands so far.
        limits: never left.
        period: T0 [s].
        gentle: acceleration and jerk to stop with; None: those of ``limits``, the quickest stop.
    """
    rows = []
    for bounds, soft, p, v, a in zip(
        limits.axes,
        (gentle or limits).axes,
        state.position.tolist(),
        state.speed.tolist(),
        state.acceleration.tolist(),
        strict=True,
    ):
        step = soft.jerk * period
        aim = math.sqrt(0.25 * step * step + 2.0 * soft.jerk * abs(v)) - 0.5 * step
        aim = min(aim, abs(v) / period, soft.acceleration)
        # What is left of a motion's own acceleration is let go at once.
        if abs(a) > soft.acceleration:
            step = bounds.jerk * period
        low, high = _range(p, v, a, bounds, period)
        taken = _clip(_clip(-math.copysign(aim, v), a - step, a + step), low, high)
        speed = v + taken * period
        rows.append((p + speed * period, speed, taken))
    position, speeds, accelerations = np.array(rows).T
    return GateState(position, speeds, accelerations, position, speeds)


def stands(state: GateState) -> bool:
    """Tell whether the commands stand still: below 1e-4 rad/s or m/s, and no acceleration."""
    return bool((np.abs(state.speed) < 1e-4).all() and (np.abs(state.acceleration) < 1e-2).all())
