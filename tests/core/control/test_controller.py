"""The straight line from x_t to q_c: each filter on or off does what it should, and no more."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.core import rotations
from linemate.daemon.core.control import command_limiter, inverse_filter, kinematics
from linemate.daemon.core.control import controller as control
from linemate.daemon.core.control.controller import Controller, ControlState
from linemate.daemon.core.control.settings import ControlSettings, SmoothingSettings
from linemate.daemon.core.horizon import Array, Horizon
from linemate.simulators.harness.setup import shipped_control

CYCLES = (0.012, 0.004)
TASK = task_file.load(DAEMON_DATA / "wheel.yaml")
NOMINAL = rotations.matrix(TASK.file.object.nominal.quaternion)
REST = np.array((*TASK.file.arm.rest_joints, 0.5))
PLAIN = ControlSettings(feed_forward=False, damping=False)


def follow(
    controller: control.Controller, state: control.ControlState, horizon: Horizon
) -> tuple[control.ControlState, str | None]:
    """One step whose last command has reached the robot."""
    return control.limit_command(
        controller, control.desire_command(controller, state, horizon), state.limiter
    )


def arm() -> kinematics.Arm:
    tool = TASK.file.arm.tcp_in_flange
    return kinematics.load(
        TASK.urdf,
        "flange",
        np.array(tool.position),
        rotations.matrix(tool.quaternion),
        linear_axis=True,
    )


ARM = arm()


def made(settings: ControlSettings, cycle_s: float = 0.012) -> Controller:
    whole = settings if settings.limits else replace(settings, limits=shipped_control().limits)
    return control.compile_controller(whole, ARM, cycle_s)


def pose_of(joints: Array) -> Array:
    """The tcp (6,) in c."""
    position, rotation = ARM.tcp_in_base(joints)
    return np.concatenate((NOMINAL.T @ position, rotations.log(NOMINAL.T @ rotation)))


def joints_of(pose: Array, axis: float) -> Array:
    guess = np.concatenate((REST[:6], (axis,)))
    rotation = NOMINAL @ rotations.exp(pose[3:])
    return ARM.solve(guess, NOMINAL @ pose[:3], rotation, tolerance=1e-12)


def motion(t: Array) -> Array:
    """A smooth motion (m, 6) in c about the pose at rest that begins from rest at t = 0."""
    fade = np.clip(t / 1.5, 0.0, 1.0)
    fade = fade**4 * (35.0 - 84.0 * fade + 70.0 * fade**2 - 20.0 * fade**3)
    size = np.array((0.004, 0.010, 0.006, 0.003, 0.004, 0.002))
    w = 2.0 * np.pi * np.array((0.62, 0.3, 0.5, 0.62, 0.4, 0.62))
    return np.asarray(pose_of(REST) + fade[:, None] * size * np.sin(np.outer(t, w)))


def drive(
    controller: Controller, seconds: float, free: float = 1.0
) -> tuple[Array, Array, list[str | None]]:
    """Commands (k, 7) along ``motion``, the times of their steps, and what was held back."""
    span = np.arange(controller.steps + 1) * controller.cycle_s
    state = control.at_rest(controller, REST, pose_of(REST))
    commands, held = [], []
    times = np.arange(int(seconds / controller.cycle_s)) * controller.cycle_s
    for now in times:
        horizon = Horizon(
            motion(now + span), np.full(len(span), REST[6]), np.full(len(span), free), NOMINAL
        )
        state, why = follow(controller, state, horizon)
        commands.append(state.limiter.position)
        held.append(why)
    return np.array(commands), times, held


def test_without_any_filter_the_commands_are_the_inverse_kinematics_of_the_list() -> None:
    commands, times, held = drive(made(PLAIN), 1.5)
    known = np.array([joints_of(pose, REST[6]) for pose in motion(times)])
    # The one Jacobian of a whole horizon leaves a share of a micrometre or so.
    assert np.abs(commands - known).max() < 2e-6
    assert set(held) == {None}


def test_feed_forward_off_is_taps_of_one() -> None:
    controller = made(PLAIN)
    assert np.array_equal(controller.servo.sum(axis=0), np.ones(7))
    assert np.array_equal(controller.servo[controller.servo_past], np.ones(7))
    assert np.array_equal(controller.effector[controller.effector_past], np.ones(6))


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_every_filters_taps_sum_to_one(cycle_s: float) -> None:
    controller = made(ControlSettings(smoothing=SmoothingSettings(1e-3, 0.002)), cycle_s)
    assert np.allclose(controller.servo.sum(axis=0), 1.0)
    assert np.allclose(controller.effector.sum(axis=0), 1.0)
    assert controller.smoothing.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_the_horizon_is_what_the_filters_read_and_half_a_second(cycle_s: float) -> None:
    law = SmoothingSettings(mass=1e-3, steps_s=0.24)
    for settings in (PLAIN, ControlSettings(smoothing=law, horizon_s=0.11)):
        controller = made(settings, cycle_s)
        ahead = len(controller.effector) - 1 - controller.effector_past
        needed = controller.preview + ahead + len(controller.smoothing) - 1
        assert controller.steps >= needed
        assert controller.steps * cycle_s >= settings.horizon_s - 1e-9
    assert made(ControlSettings(), cycle_s).steps * cycle_s == pytest.approx(0.49, abs=0.01)


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_a_robot_at_rest_stays_there_to_the_last_bit_or_two(cycle_s: float) -> None:
    controller = made(ControlSettings(), cycle_s)
    pose = pose_of(REST)
    count = controller.steps + 1
    horizon = Horizon(np.tile(pose, (count, 1)), np.full(count, REST[6]), np.ones(count), NOMINAL)
    state = control.at_rest(controller, REST, pose)
    for _ in range(20):
        state, held = follow(controller, state, horizon)
        assert held is None
        assert np.abs(state.limiter.position - REST).max() < 1e-9


def simulated(commands: Array, cycle_s: float) -> Array:
    """What the servos make of commands, by the models that the settings name."""
    answers = np.empty_like(commands)
    for axis, model in enumerate(ControlSettings().servos):
        pulse = inverse_filter.servo_pulse(model, cycle_s)
        way = np.convolve(pulse, commands[:, axis] - REST[axis])[: len(commands)]
        answers[:, axis] = REST[axis] + way
    return answers


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_with_feed_forward_the_servos_are_where_the_list_was(cycle_s: float) -> None:
    commands, times, held = drive(made(ControlSettings(damping=False), cycle_s), 125 * cycle_s)
    reached = simulated(commands, cycle_s)
    known = np.array([joints_of(pose, REST[6]) for pose in motion(times)])
    assert np.abs(reached - known).max() < 3e-5
    assert set(held) == {None}
    lazy, _, _ = drive(made(PLAIN, cycle_s), 125 * cycle_s)
    assert np.abs(simulated(lazy, cycle_s) - known).max() > 3e-4


def test_damping_is_off_where_the_tool_is_clamped() -> None:
    clamped, _, _ = drive(made(ControlSettings(feed_forward=False)), 1.0, free=0.0)
    bare, _, _ = drive(made(PLAIN), 1.0)
    free, _, _ = drive(made(ControlSettings(feed_forward=False)), 1.0, free=1.0)
    half, _, _ = drive(made(ControlSettings(feed_forward=False)), 1.0, free=0.5)
    assert np.abs(clamped - bare).max() < 1e-9
    assert np.abs(free - bare).max() > 1e-5
    assert np.allclose(half, 0.5 * (free + bare), atol=1e-6)


def test_damping_acts_along_and_about_the_tools_axes() -> None:
    controller = made(ControlSettings())
    past, count = controller.effector_past, controller.preview + 1
    length = len(controller.effector) - 1 + count
    rng = np.random.default_rng(1)
    turned = np.array((0.3, -0.2, 0.25))
    R = rotations.exp(turned)
    tool = 0.002 * np.cumsum(rng.normal(size=(length, 6)), axis=0)
    smoothed = np.empty((length, 6))
    smoothed[:, :3] = (R @ tool[:, :3].T).T
    smoothed[:, 3:] = [rotations.log(R @ rotations.exp(small)) for small in 0.01 * tool[:, 3:]]
    desired, _ = control.damp(controller, smoothed, np.ones(count))
    for axis in range(3):
        known = np.correlate(tool[:, axis], controller.effector[:, axis], mode="valid")
        # The tool's axes are taken once, where the list begins: some tenths of a milliradian off.
        assert np.allclose((R.T @ desired[:, :3].T)[axis], known, atol=1e-6)
        body = [rotations.log(R.T @ rotations.exp(row))[axis] for row in desired[:, 3:]]
        plain = 0.01 * tool[:, 3 + axis]
        known = np.correlate(plain, controller.effector[:, 3 + axis], mode="valid")
        change = known - plain[past : past + count]
        found = np.array(body) - plain[past : past + count]
        assert np.allclose(found, change, atol=0.02 * np.abs(change).max())


def test_smoothing_reads_ahead_and_never_behind() -> None:
    controller = made(ControlSettings(smoothing=SmoothingSettings(mass=1e-3)))
    poses = np.random.default_rng(2).normal(size=(controller.steps + 1, 6))
    count = 5
    known = [controller.smoothing @ poses[i : i + len(controller.smoothing)] for i in range(count)]
    assert np.allclose(control.smooth(controller, poses, count), known)
    assert np.array_equal(control.smooth(made(PLAIN), poses, count), poses[:count])


@pytest.mark.parametrize("bad", [np.nan, 30.0])
def test_a_pose_that_cannot_be_reached_brakes_and_says_so(bad: float) -> None:
    controller = made(ControlSettings())
    count = controller.steps + 1
    poses = np.tile(pose_of(REST), (count, 1))
    state = control.at_rest(controller, REST, poses[0])
    poses[3, 1] = bad
    after, held = follow(
        controller, state, Horizon(poses, np.full(count, REST[6]), np.ones(count), NOMINAL)
    )
    assert held is not None
    assert np.array_equal(after.limiter.position, REST)


def test_a_stop_is_the_limiters_gentle_brake_and_leaves_the_plan_alone() -> None:
    controller = made(PLAIN)
    state = control.at_rest(controller, REST, pose_of(REST))
    moving = structs.replace(state, limiter=structs.replace(state.limiter, speed=np.full(7, 0.1)))
    stopped = control.stop(controller, moving)
    known = command_limiter.brake(moving.limiter, controller.limits, controller.gentle)
    assert np.array_equal(stopped.limiter.position, known.position)
    assert stopped.past_joints is moving.past_joints
    assert isinstance(stopped, ControlState)


@pytest.mark.parametrize("what", ["servos", "limits"])
def test_too_few_models_are_refused_with_the_number_needed(what: str) -> None:
    settings = shipped_control()
    fewer = {what: getattr(settings, what)[:6]}
    with pytest.raises(ValueError, match="7 axes"):
        made(replace(settings, **fewer))


def test_the_narrower_of_settings_and_urdf_bounds_the_position() -> None:
    bounds = made(ControlSettings()).limits
    for axis, row in enumerate(shipped_control().limits):
        assert bounds.lower[axis] == max(row.lower, ARM.lower[axis])
        assert bounds.upper[axis] == min(row.upper, ARM.upper[axis])


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_while_clamped_the_arm_makes_up_for_what_the_linear_axis_is_behind(cycle_s: float) -> None:
    controller = made(PLAIN, cycle_s)
    desired = REST + np.array((0.0,) * 6 + (0.009,))
    off = {}
    for clamped in (False, True):
        gate, state = (
            command_limiter.at_rest(REST),
            control.at_rest(controller, REST, pose_of(REST)),
        )
        for _ in range(round(0.036 / cycle_s)):
            aimed = control.DesiredCommand(structs.replace(state, limiter=gate), desired)
            after, _ = control.limit_command(controller, aimed, gate, clamped=clamped)
            gate = after.limiter
        off[clamped] = float(np.abs(pose_of(gate.position) - pose_of(desired))[:3].max())
    assert off[False] > 0.002
    assert off[True] < 0.0012


@pytest.mark.parametrize("short", [0.031, 1.0])
def test_the_arm_makes_up_for_a_short_way_only(short: float) -> None:
    controller = made(PLAIN)
    desired = REST + np.array((0.0,) * 6 + (short + 0.002,))
    aimed = control.DesiredCommand(control.at_rest(controller, REST, pose_of(REST)), desired)
    after, _ = control.limit_command(controller, aimed, command_limiter.at_rest(REST), clamped=True)
    assert np.array_equal(after.limiter.position[:6], REST[:6])
