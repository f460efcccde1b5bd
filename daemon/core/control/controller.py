"""From a horizon of desired poses to the joints' setpoints: (16), (11), kinematics, (12), limits.

Invariants:
- Filters are designed at start-up and only applied in a step.
- Feed-forward: no measured pose of the robot enters.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from msgspec import Struct, structs

from linemate.daemon.core import rotations
from linemate.daemon.core.control import (
    command_limiter,
    dead_time,
    friction,
    gravity_bend,
    inverse_filter,
    tcp_limit,
    windup,
)
from linemate.daemon.core.control.axis_limits import Limits
from linemate.daemon.core.control.command_limiter import LimiterState
from linemate.daemon.core.control.dead_time import DriftModel, DriftState
from linemate.daemon.core.control.friction import FrictionState, RubbingDrives
from linemate.daemon.core.control.gravity_bend import BentArm
from linemate.daemon.core.control.kinematics import Arm, UnreachableError
from linemate.daemon.core.control.settings import BrakeSettings, ControlSettings
from linemate.daemon.core.control.smoothing import smoothing_taps
from linemate.daemon.core.control.tcp_limit import TcpLimit
from linemate.daemon.core.control.windup import Windup, WindupState
from linemate.daemon.core.horizon import Array, Horizon
from linemate.protocol.stamped_samples import AXES

LONGEST_STAND_IN = 0.03  # lag of the linear axis that the arm compensates [m]
LARGEST_STAND_IN = 0.1  # change of a joint for it; larger near a singular pose [rad]


@dataclass(frozen=True, slots=True, eq=False)
class Controller:
    """Compiled parameters of control.

    Attributes:
        smoothing: taps (n_imp + 1,) of (16).
        effector: taps (n_l + 1 + n_u, 6) of (11), in the tool's frame.
        damper: (6, n_rob + 1, n_l + n_rob + 1 + n_u) change that (11) adds to x_s, each component's
            taps as rows of a matrix.
        servo: taps (past + 1 + n_rob, axes) of (12).
        servo_past: steps of (12) in the past.
        spreading: (m,) weights of the last commands, newest first; one of them from 4 ms on.
        windup: of the axes, None for an arm whose links are where its motors are.
        bend: of the gears under weight, None for stiff ones.
        friction: of the drives, None if none rubs.
        drift: of the dead times; None if they are fixed.
        limits: of the command limiter.
        gentle: with which a hold comes to rest.
        steps: n, the horizon that control reads.
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
    windup: Windup | None = None
    bend: BentArm | None = None
    friction: RubbingDrives | None = None
    drift: DriftModel | None = None
    spreading: Array = field(default_factory=lambda: np.ones(1))

    @property
    def preview(self) -> int:
        """n_rob: steps of the future that (12) reads."""
        return len(self.servo) - 1 - self.servo_past

    @property
    def effector_future_s(self) -> float:
        """How far (11) reads into the future, in whole cycles [s]."""
        return (len(self.effector) - 1 - self.effector_past) * self.cycle_s

    @property
    def spreading_delay_s(self) -> float:
        """Mean age of the commands that are sent as their mean [s]; 0 from 4 ms on."""
        return 0.5 * (len(self.spreading) - 1) * self.cycle_s


class ControlState(Struct, frozen=True, eq=False):
    """State of control.

    Attributes:
        past_poses: (n_l, 6) the last x_s(0), oldest first.
        past_joints: (servo_past, axes) the last q_d(0), oldest first.
        joints: (n_rob + 1, axes) q_d of the last step, the next guess of the inverse kinematics.
        poses: (n_rob + 1, 6) the x_d of ``joints``.
        windup: of the oldest of ``past_joints``, which are positions of the links.
        commands: (m - 1, axes) the last ones before they were spread, newest first.
        drift: of the dead times; None if they are fixed.
        friction: of the drives; None if none rubs.
    """

    past_poses: Array
    past_joints: Array
    joints: Array
    poses: Array
    limiter: LimiterState
    windup: WindupState | None = None
    commands: Array | None = None
    drift: DriftState | None = None
    friction: FrictionState | None = None


def compile_controller(
    settings: ControlSettings, arm: Arm, cycle_s: float, conveyor_speed: float = 0.0
) -> Controller:
    """Return the controller with its filters designed.

    Args:
        conveyor_speed: added to the limit of the tcp's speed [m/s].

    Raises:
        ValueError: fewer servo models or limits than axes, or a model that cannot be inverted.
    """
    if len(settings.servos) < arm.axes or len(settings.limits) < arm.axes:
        raise ValueError(f"the arm has {arm.axes} axes: as many servos and limits are needed")
    filters = replace(settings.filters, servo_future_s=dead_time.future_reach(settings))
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
        windup=windup.compile_windup(settings.windup, arm.axes),
        bend=gravity_bend.compile_bend(settings.bend, arm),
        friction=friction.compile_friction(settings.friction, settings.servos, arm.axes, cycle_s),
        drift=dead_time.compile_drift(settings, arm.axes, cycle_s),
        spreading=inverse_filter.spreading(cycle_s) if settings.feed_forward else np.ones(1),
    )


def _damper(taps: Array, past: int, count: int) -> Array:
    """Return the change that a filter adds, for ``count`` steps: its rows minus the identity."""
    length, components = taps.shape
    rows = np.zeros((components, count, count + length - 1))
    for i in range(count):
        rows[:, i, i : i + length] = taps.T
        rows[:, i, i + past] -= 1.0
    return rows


def _gentle(brake: BrakeSettings, bounds: Limits) -> Limits:
    """Return the limits of a stop: at most those of the command limiter."""
    axes = len(bounds.names)
    acceleration = np.array((*(brake.acceleration,) * 6, brake.axis_acceleration)[:axes])
    jerk = np.array((*(brake.jerk,) * 6, brake.axis_jerk)[:axes])
    return replace(
        bounds,
        acceleration=np.minimum(acceleration, bounds.acceleration),
        jerk=np.minimum(jerk, bounds.jerk),
    )


def at_rest(
    controller: Controller,
    joints: Array,
    pose: Array,
    wound: WindupState | None = None,
    drift: DriftState | None = None,
) -> ControlState:
    """Return the state of a robot that stands.

    Args:
        joints: (axes,) of the motors.
        pose: (6,) of the tcp.
        drift: of the dead times, as far as it is known; None at first.
    """
    placed = links_of(controller, joints, wound)
    if controller.drift is not None:
        drift = dead_time.begin(controller.drift, joints, 0.0 if drift is None else drift.drift)
    return ControlState(
        past_poses=np.tile(pose, (controller.effector_past, 1)),
        past_joints=np.tile(placed, (controller.servo_past, 1)),
        joints=np.tile(placed, (controller.preview + 1, 1)),
        poses=np.tile(pose, (controller.preview + 1, 1)),
        limiter=command_limiter.at_rest(joints),
        windup=wound,
        commands=np.tile(joints, (len(controller.spreading) - 1, 1)),
        drift=drift,
        friction=friction.begin(controller.friction, joints),
    )


def displaced(state: ControlState, joints: Array, pose: Array) -> ControlState:
    """Return the state of a plan that is displaced as a whole.

    Args:
        joints: (axes,) by which its joints are.
        pose: (6,) by which its tcp is.
    """
    commands = state.commands
    return structs.replace(
        state,
        past_poses=state.past_poses + pose,
        past_joints=state.past_joints + joints,
        joints=state.joints + joints,
        poses=state.poses + pose,
        commands=None if commands is None else commands + joints,
    )


def links_of(controller: Controller, joints: Array, wound: WindupState | None) -> Array:
    """Return the positions (axes,) of the links for those of the motors."""
    placed = joints
    if controller.windup is not None and wound is not None:
        placed = windup.links(controller.windup, wound, joints)
    return placed if controller.bend is None else gravity_bend.links(controller.bend, placed)


def smooth(controller: Controller, poses: Array, count: int) -> Array:
    """Return x_s (count, 6) of x_t (n+1, 6), by (16)."""
    taps = controller.smoothing
    if len(taps) == 1:
        return poses[:count]
    windows = np.lib.stride_tricks.sliding_window_view(poses, len(taps), axis=0)
    smoothed: Array = windows[:count] @ taps
    return smoothed


def damp(
    controller: Controller, smoothed: Array, free: Array, first: int = 0
) -> tuple[Array, Array | None]:
    """Return x_d (n_rob + 1 - first, 6) of x_s, by (11), damped where the tool hangs free.

    And ``rotations.in_own_axes`` of the first of them, None if no pose is damped.

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
        return here, None
    into, back = rotations.in_own_axes_and_back(here[0, 3:])
    tool = np.dot(smoothed[first:], into)
    change = controller.damper[:, first:, first:] @ tool.T[:, :, None]
    if min(shares) < 1.0:
        change *= share[:, None]
    desired: Array = here + np.dot(change[:, :, 0].T, back)
    return desired, into


class DesiredCommand(Struct, frozen=True, eq=False):
    """Desired command of one step; it does not depend on the delivery of the last one.

    Attributes:
        state: one step later; its ``limiter`` is still the last step's.
        command: (axes,), None if the arm does not reach its pose.
        reason: why it does not.
    """

    state: ControlState
    command: Array | None
    reason: str | None = None


def desire_command(controller: Controller, state: ControlState, horizon: Horizon) -> DesiredCommand:
    """Return the desired command of this step, by (16), (11), kinematics and (12).

    Joints whose poses were committed before, with all that (16) and (11) read of them, are the
    last step's and are not solved again.
    """
    count, past = controller.preview + 1, controller.effector_past
    ahead = len(controller.effector) - 1 - past
    reach = ahead + len(controller.smoothing) - 1
    kept = min(max(horizon.committed - reach + 1, 0), count - 1)
    smoothed = np.concatenate((state.past_poses, smooth(controller, horizon.poses, count + ahead)))
    fresh, into = damp(controller, smoothed, horizon.free, kept)
    before = np.concatenate((state.poses[kept + 1 :], state.poses[-1:]))
    last = state.joints
    guesses = np.concatenate((last[kept + 1 :], (2.0 * last[-1] - last[-2])[None]))
    if controller.arm.linear_axis:
        guesses[:, 6] = horizon.axis[kept:count]
    try:
        solved = controller.arm.follow(guesses, fresh, horizon.nominal, before, into)
    except UnreachableError as error:
        return DesiredCommand(state, None, str(error))
    window = motors = np.concatenate((state.past_joints, last[1 : kept + 1], solved))
    if controller.bend is not None:
        motors = gravity_bend.motors(controller.bend, window)
    wound = state.windup
    if controller.windup is not None and wound is not None:
        motors, wound = windup.motors(controller.windup, wound, motors)
    taps = controller.servo
    if controller.drift is not None and state.drift is not None:
        taps = dead_time.servo_taps(controller.drift, state.drift)
    command, rubbed = np.add.reduce(taps * motors), state.friction
    if controller.friction is not None and rubbed is not None:
        drift_s = 0.0 if state.drift is None else state.drift.drift
        planned = motors[controller.servo_past :]
        command, rubbed = friction.overcome(controller.friction, rubbed, planned, command, drift_s)
    commands = state.commands
    if commands is not None and len(commands):
        recent = np.concatenate((command[None], commands))
        command, commands = controller.spreading @ recent, recent[:-1]
    later = ControlState(
        past_poses=smoothed[1 : past + 1],
        past_joints=window[1 : controller.servo_past + 1],
        joints=window[controller.servo_past :],
        poses=np.concatenate((state.poses[1 : kept + 1], fresh)),
        limiter=state.limiter,
        windup=wound,
        commands=commands,
        drift=state.drift,
        friction=rubbed,
    )
    return DesiredCommand(later, command)


def limit_command(
    controller: Controller, desired: DesiredCommand, limiter: LimiterState, *, clamped: bool = False
) -> tuple[ControlState, str | None]:
    """Return the state after the command limiter; its limiter's position is the command.

    Args:
        limiter: of the commands that the robot has; without a desired command it brakes.
        clamped: the tool is clamped to the object: the arm compensates the linear axis' lag.

    Returns:
        The new state, and None or the reason why the command is not the one desired.
    """
    if desired.command is None:
        return stop(controller, structs.replace(desired.state, limiter=limiter)), desired.reason
    bounds = controller.limits
    after, held = command_limiter.admit(limiter, desired.command, bounds)
    if clamped and held is not None and controller.arm.linear_axis:
        command = _add_stand_in(controller, desired.command, float(after.position[6]))
        after, held = command_limiter.admit(limiter, command, bounds)
    if not tcp_limit.is_slow(after, controller.tcp_limit):
        jacobian = controller.arm.tcp_jacobian(limiter.position)
        cap = controller.tcp_limit.commanded
        slower = tcp_limit.slow_down(limiter, after, jacobian, bounds, cap)
        if slower is not after:
            after, held = slower, "limited: tcp" if held is None else f"{held}, tcp"
    return structs.replace(desired.state, limiter=after), held


def _add_stand_in(controller: Controller, command: Array, rail: float) -> Array:
    """Return a command (axes,) whose arm compensates the lag of the linear axis.

    The linear axis catches up at 12 m/s^2, the arm within two cycles. Without this a clamped tool
    was pulled with 326 N instead of 200 N after a hold of 84 ms at 106 mm/s.

    Args:
        rail: limited position of the linear axis [m].
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
    extended = command.copy()
    extended[:6] += change
    return extended


def follow_drift(
    controller: Controller, state: ControlState, setpoint: Array, reported: Array | None
) -> ControlState:
    """Return the state with the drift of the dead times one cycle later.

    Args:
        setpoint: (axes,) in force since the last telegram.
        reported: (axes,) positions in it, None without one.
    """
    if controller.drift is None or state.drift is None:
        return state
    after = dead_time.follow(controller.drift, state.drift, setpoint, reported)
    return structs.replace(state, drift=after)


def stop(controller: Controller, state: ControlState) -> ControlState:
    """Return the state after one step of a gentle stop within the limits."""
    limiter = command_limiter.brake(state.limiter, controller.limits, controller.gentle)
    return structs.replace(state, limiter=limiter)
