"""From a horizon of desired poses to the joints' setpoints: (16), (11), kinematics, (12), gate.

Law of this file: a straight line through the paper's Sect. IV; the filters were made at start-up
and are only applied here. No measured pose of the robot enters: the chain is feed-forward.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from msgspec import Struct, structs

from linemate.daemon.core import rotations
from linemate.daemon.core.control import command_limiter, inverse_filter, tcp_limit
from linemate.daemon.core.control.axis_limits import Limits
from linemate.daemon.core.control.command_limiter import LimiterState
from linemate.daemon.core.control.kinematics import Arm, UnreachableError
from linemate.daemon.core.control.settings import BrakeSettings, ControlSettings
from linemate.daemon.core.control.smoothing import smoothing_taps
from linemate.daemon.core.control.tcp_limit import TcpLimit
from linemate.daemon.core.horizon import Array, Horizon

AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
LONGEST_STAND_IN = 0.03  # of the linear axis' way that the arm makes up for [m]
LARGEST_STAND_IN = 0.1  # change of a joint for it, which near a singular pose would be larger [rad]


@dataclass(frozen=True, slots=True, eq=False)
class Controller:
    """What control needs, compiled.

    Attributes:
        smoothing: taps (n_imp + 1,) of (16).
        effector: taps (n_l + 1 + n_u, 6) of (11), in the tool's frame.
        damper: (6, n_rob + 1, n_l + n_rob + 1 + n_u) the change that (11) makes of x_s, each
            component's taps as rows of a matrix.
        servo: taps (past + 1 + n_rob, axes) of (12).
        servo_past: steps of (12) in the past.
        limits: of the last gate.
        gentle: with which a hold comes to rest.
        steps: n, the horizon that control reads.
        contact_steps: over how many steps (11) is blended out before contact.
    """

    arm: Arm
    cycle_s: float
    smoothing: Array
    effector: Array
    effector_past: int
    damper: Array
    servo: Array
    servo_past: int
    limits: Limits
    tcp_limit: TcpLimit
    gentle: Limits
    steps: int
    contact_steps: int

    @property
    def preview(self) -> int:
        """n_rob: steps of the future that (12) reads."""
        return len(self.servo) - 1 - self.servo_past


class ControlState(Struct, frozen=True, eq=False):
    """What control remembers.

    Attributes:
        smooth: (n_l, 6) the last x_s(0), oldest first.
        passed: (servo_past, axes) the last q_d(0), oldest first.
        desired: (n_rob + 1, axes) q_d of the last step, the next guess.
        wanted: (n_rob + 1, 6) the x_d that they are for.
    """

    smooth: Array
    passed: Array
    desired: Array
    wanted: Array
    gate: LimiterState


def compile_controller(
    settings: ControlSettings, arm: Arm, cycle_s: float, conveyor_speed: float = 0.0
) -> Controller:
    """Return the controller with its filters designed.

    Args:
        conveyor_speed: which the tcp may have beside its own [m/s].

    Raises:
        ValueError: fewer servo models or limits than axes, or a model that cannot be inverted.
    """
    if len(settings.servos) < arm.axes or len(settings.limits) < arm.axes:
        raise ValueError(f"the arm has {arm.axes} axes: as many servos and limits are needed")
    filters = settings.filters
    taps = inverse_filter.tap_steps(filters.servo_past_s, filters.servo_future_s, cycle_s)
    servo = np.stack(
        [
            inverse_filter.servo_inverse(model, filters, cycle_s)
            if settings.feed_forward
            else (taps == 0).astype(float)
            for model in settings.servos[: arm.axes]
        ],
        axis=1,
    )
    reach = inverse_filter.tap_steps(filters.effector_past_s, filters.effector_future_s, cycle_s)
    effector = np.stack(
        [
            inverse_filter.effector_inverse(mode, filters, cycle_s)
            if settings.damping
            else (reach == 0).astype(float)
            for mode in settings.effector
        ],
        axis=1,
    )
    smoothing = smoothing_taps(settings.smoothing, cycle_s)
    needed = int(taps[-1]) + int(reach[-1]) + len(smoothing) - 1
    rows = settings.limits[: arm.axes]
    bounds = Limits(
        np.maximum([row.lower for row in rows], arm.lower),
        np.minimum([row.upper for row in rows], arm.upper),
        np.array([row.speed for row in rows]),
        np.array([row.acceleration for row in rows]),
        np.array([row.jerk for row in rows]),
        AXES[: arm.axes],
        cycle_s,
    )
    return Controller(
        arm=arm,
        cycle_s=cycle_s,
        smoothing=smoothing,
        effector=effector,
        effector_past=-int(reach[0]),
        damper=_damper(effector, -int(reach[0]), int(taps[-1]) + 1),
        servo=servo,
        servo_past=-int(taps[0]),
        limits=bounds,
        tcp_limit=TcpLimit(settings.tcp_speed + conveyor_speed, arm.levers),
        gentle=_gentle(settings.brake, bounds),
        steps=max(needed, math.ceil(settings.horizon_s / cycle_s)),
        contact_steps=max(round(filters.contact_blend / cycle_s), 1),
    )


def _damper(taps: Array, past: int, count: int) -> Array:
    """Return the change that a filter makes, for ``count`` steps: its rows less what goes in."""
    length, components = taps.shape
    rows = np.zeros((components, count, count + length - 1))
    for i in range(count):
        rows[:, i, i : i + length] = taps.T
        rows[:, i, i + past] -= 1.0
    return rows


def _gentle(brake: BrakeSettings, bounds: Limits) -> Limits:
    """Return the limits of a stop: never more than those of the gate."""
    axes = len(bounds.names)
    acceleration = np.array((*(brake.acceleration,) * 6, brake.axis_acceleration)[:axes])
    jerk = np.array((*(brake.jerk,) * 6, brake.axis_jerk)[:axes])
    return replace(
        bounds,
        acceleration=np.minimum(acceleration, bounds.acceleration),
        jerk=np.minimum(jerk, bounds.jerk),
    )


def at_rest(controller: Controller, joints: Array, pose: Array) -> ControlState:
    """Return the state of a robot that stands at ``joints`` (axes,), its tcp at ``pose`` (6,)."""
    return ControlState(
        smooth=np.tile(pose, (controller.effector_past, 1)),
        passed=np.tile(joints, (controller.servo_past, 1)),
        desired=np.tile(joints, (controller.preview + 1, 1)),
        wanted=np.tile(pose, (controller.preview + 1, 1)),
        gate=command_limiter.at_rest(joints),
    )


def smooth(controller: Controller, poses: Array, count: int) -> Array:
    """Return x_s (count, 6) of x_t (n+1, 6), by (16)."""
    taps = controller.smoothing
    if len(taps) == 1:
        return poses[:count]
    windows = np.lib.stride_tricks.sliding_window_view(poses, len(taps), axis=0)
    smoothed: Array = windows[:count] @ taps
    return smoothed


def damp(controller: Controller, smoothed: Array, free: Array, first: int = 0) -> Array:
    """Return x_d (n_rob + 1 - first, 6) of x_s, by (11), damped where the tool hangs free.

    Args:
        controller: with the taps, which act along and about the tool's axes.
        smoothed: x_s from n_l steps ago to n_rob + n_u ahead.
        free: (n_rob + 1 or more,) share of (11) at each step.
        first: the first step that is wanted.
    """
    count = controller.preview + 1 - first
    begin = first + controller.effector_past
    here = smoothed[begin : begin + count]
    share = free[first : first + count]
    shares = share.tolist()
    if not any(shares):
        return here
    into, back = rotations.in_own_axes_and_back(here[0, 3:])
    tool = np.dot(smoothed[first:], into)
    change = controller.damper[:, first:, first:] @ tool.T[:, :, None]
    if min(shares) < 1.0:
        change *= share[:, None]
    desired: Array = here + np.dot(change[:, :, 0].T, back)
    return desired


class Aim(Struct, frozen=True, eq=False):
    """Where one step along the horizon leads, whatever the robot made of the last command.

    Attributes:
        state: one step later but for the gate, which is the last step's.
        command: (axes,) that is desired, None if the arm does not reach its pose.
        reason: why it does not.
    """

    state: ControlState
    command: Array | None
    reason: str | None = None


def aim(controller: Controller, state: ControlState, horizon: Horizon) -> Aim:
    """Return the command that is desired in this step, by (16), (11), kinematics and (12).

    Joints whose poses, and all that (16) and (11) read of them, were committed before are the
    last step's and are not solved again.
    """
    count, past = controller.preview + 1, controller.effector_past
    ahead = len(controller.effector) - 1 - past
    reach = ahead + len(controller.smoothing) - 1
    kept = min(max(horizon.committed - reach + 1, 0), count - 1)
    smoothed = np.concatenate((state.smooth, smooth(controller, horizon.poses, count + ahead)))
    fresh = damp(controller, smoothed, horizon.free, kept)
    before = np.concatenate((state.wanted[kept + 1 :], state.wanted[-1:]))
    last = state.desired
    guesses = np.concatenate((last[kept + 1 :], (2.0 * last[-1] - last[-2])[None]))
    if controller.arm.linear_axis:
        guesses[:, 6] = horizon.axis[kept:count]
    try:
        solved = controller.arm.follow(guesses, fresh, horizon.nominal, before)
    except UnreachableError as error:
        return Aim(state, None, str(error))
    window = np.concatenate((state.passed, last[1 : kept + 1], solved))
    later = ControlState(
        smooth=smoothed[1 : past + 1],
        passed=window[1 : controller.servo_past + 1],
        desired=window[controller.servo_past :],
        wanted=np.concatenate((state.wanted[1 : kept + 1], fresh)),
        gate=state.gate,
    )
    return Aim(later, np.add.reduce(controller.servo * window))


def reach(
    controller: Controller, aimed: Aim, gate: LimiterState, *, clamped: bool = False
) -> tuple[ControlState, str | None]:
    """Return the state after the last gate; its gate's position is the command.

    Args:
        aimed: at what is desired.
        gate: of the commands that the robot has; without a pose to aim at it brakes.
        clamped: the tool is clamped to the object: what the linear axis is behind, the arm makes
            up for.

    Returns:
        The new state, and None or the reason why the command is not the one desired.
    """
    if aimed.command is None:
        return stop(controller, structs.replace(aimed.state, gate=gate)), aimed.reason
    bounds = controller.limits
    after, held = command_limiter.admit(gate, aimed.command, bounds)
    if clamped and held is not None and controller.arm.linear_axis:
        command = _made_up(controller, aimed.command, float(after.position[6]))
        after, held = command_limiter.admit(gate, command, bounds)
    if not tcp_limit.is_slow(after, controller.tcp_limit):
        jacobian = controller.arm.tcp_jacobian(gate.position)
        cap = controller.tcp_limit.commanded
        slower = tcp_limit.slow_down(gate, after, jacobian, bounds, cap)
        if slower is not after:
            after, held = slower, "limited: tcp" if held is None else f"{held}, tcp"
    return structs.replace(aimed.state, gate=after), held


def _made_up(controller: Controller, command: Array, rail: float) -> Array:
    """Return a command (axes,) whose arm makes up for a linear axis that is behind.

    The linear axis catches up at 12 m/s^2, the arm in a cycle or two. A clamped tool whose robot
    held for 84 ms beside a car at 106 mm/s was so pulled with 326 N instead of 200 N.

    Args:
        rail: where the linear axis is sent instead [m].
    """
    short = float(command[6]) - rail
    if not 0.0 < abs(short) <= LONGEST_STAND_IN:
        return command
    try:
        change = controller.arm.stand_in(command, short)
    except UnreachableError:
        return command
    if float(np.abs(change).max()) > LARGEST_STAND_IN:
        return command
    made_up = command.copy()
    made_up[:6] += change
    return made_up


def stop(controller: Controller, state: ControlState) -> ControlState:
    """Return the state after one step of a gentle stop within the limits."""
    gate = command_limiter.brake(state.gate, controller.limits, controller.gentle)
    return structs.replace(state, gate=gate)
