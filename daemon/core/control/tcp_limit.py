"""Limit of the tcp's speed, on top of the limits of the axes.

Invariants:
- The slowed command is within the limits of every axis, if the admitted command is.
- All axes take the same share of the way from a joint stop to the admitted command.
"""

import math
from dataclasses import dataclass

import numpy as np

from linemate.daemon.core.control.axis_limits import Limits, acceleration_range, clip
from linemate.daemon.core.control.command_limiter import MEAN_S, LimiterState, next_mean_speed
from linemate.daemon.core.horizon import Array

# The inverse of a slow servo asks for twice the tcp's speed in single cycles. The arm itself moves
# as the mean over ``MEAN_S`` does.
PEAK = 2.0  # speed of a single cycle's commands over the limit of the mean
COMMANDED = 0.75  # share of the limit for commands: servos overshoot a step by up to a third
FREE = 0.75  # share of the commands' limit up to which the mean speed may rise at once
RISE = 1.5  # acceleration of the tcp above that [m/s^2]

_HALVINGS = 6


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

    @property
    def free(self) -> float:
        """Mean speed up to which it may rise at once [m/s]."""
        return FREE * self.commanded


def is_slow(state: LimiterState, limit: TcpLimit) -> bool:
    """Return whether the axes' speeds alone keep the tcp far below its limit."""
    return bool(
        np.dot(np.abs(state.mean), limit.levers) <= limit.free
        and np.dot(np.abs(state.speed), limit.levers) <= limit.commanded
    )


def slow_down(
    state: LimiterState, admitted: LimiterState, jacobian: Array, limits: Limits, cap: float
) -> LimiterState:
    """Return the admitted command, or the share of it that keeps the tcp's speed.

    Args:
        state: of the commands so far.
        jacobian: (3, m) of the tcp's position.
        cap: of the tcp's mean speed [m/s].

    Returns:
        ``admitted`` itself where it keeps the limit.
    """
    before, period = np.dot(jacobian, state.mean), limits.period

    def keeps(after: LimiterState) -> bool:
        return _keeps_speed(after, jacobian, limits, before, RISE * period, cap)

    if keeps(admitted):
        return admitted
    stop = _joint_stop(state, limits)
    low, high, slower = 0.0, 1.0, _interpolate(state, stop, admitted, 0.0, period)
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        candidate = _interpolate(state, stop, admitted, share, period)
        if keeps(candidate):
            low, slower = share, candidate
        else:
            high = share
    return slower


def _keeps_speed(
    after: LimiterState, jacobian: Array, limits: Limits, before: Array, change: float, cap: float
) -> bool:
    """Return whether the tcp's speed, and what it still comes to, is within its limits.

    A speed v above the cap raises the mean while the axes brake, at d: by (v - cap)^2 / 2d over
    ``MEAN_S``.

    Args:
        jacobian: (3, m) of the tcp's position.
        before: (3,) mean velocity of the tcp one step ago [m/s].
        change: by which the mean may rise in its own direction in this step [m/s].
        cap: limit of the mean [m/s].
    """
    mean = np.dot(jacobian, after.mean)
    size = math.hypot(*mean.tolist())
    if size > FREE * cap and size > float(np.dot(before, mean)) / size + change:
        return False
    now = math.hypot(*np.dot(jacobian, after.speed).tolist())
    if now <= cap:
        return size <= cap
    stop_s = float((np.abs(after.speed) / limits.acceleration).max())
    rise = 0.5 * (now - cap) ** 2 * stop_s / (now * MEAN_S)
    return size + rise <= cap and now <= PEAK * cap


def _joint_stop(state: LimiterState, limits: Limits) -> Array:
    """Return accelerations (m,) that slow all axes in proportion, as far as their limits allow.

    Axes that stop one after another would move the tcp faster where their speeds cancel out.
    """
    stop_s = max(float((np.abs(state.speed) / limits.acceleration).max()), limits.period)
    rows = zip(
        limits.axes,
        state.position.tolist(),
        state.speed.tolist(),
        state.acceleration.tolist(),
        strict=True,
    )
    return np.array(
        [clip(-v / stop_s, *acceleration_range(p, v, a, bounds)) for bounds, p, v, a in rows]
    )


def _interpolate(
    state: LimiterState, stop: Array, admitted: LimiterState, share: float, period: float
) -> LimiterState:
    """Return the state after a share of the way from a stop to the admitted command.

    Args:
        state: of the commands so far.
        stop: accelerations (m,) of the stop.
        share: 0 for the stop, 1 for the admitted command.
    """
    acceleration = stop + share * (admitted.acceleration - stop)
    speed = state.speed + period * acceleration
    return LimiterState(
        position=state.position + period * speed,
        speed=speed,
        acceleration=acceleration,
        desired=admitted.desired,
        desired_speed=admitted.desired_speed,
        mean_speed=next_mean_speed(state, speed, period),
    )
