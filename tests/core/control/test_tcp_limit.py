"""The limit of the tcp's speed: kept whatever is desired, within the limits of every axis."""

from dataclasses import replace

import numpy as np
import pytest
from cell import AXIS, parameters
from cell import REST as JOINTS

from linemate.daemon.core.control import command_limiter, tcp_limit
from linemate.daemon.core.control import controller as control
from linemate.daemon.core.control.axis_limits import Limits
from linemate.daemon.core.control.controller import Controller
from linemate.daemon.core.horizon import Array
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.servo_plant import ServoBank

CYCLES = (0.012, 0.004)
ARM = parameters().controller.arm
REST = np.array((*JOINTS, AXIS))
MEAN_SHARE = 1.1
"""The mean speed of the tcp over the limit: the gate takes the mean of the axes instead."""

TRUE_SHARE = 1.7
"""The true speed over the limit, at worst: axes that catch up at the limits of their setpoints
saturate the drives of the plant, each for another time."""


def compiled(cycle_s: float, share: float = 1.0) -> Controller:
    """Return a controller; ``share`` of the shipped accelerations and jerks."""
    controller = parameters(cycle_s).controller
    rows = controller.limits
    bounds = replace(rows, acceleration=share * rows.acceleration, jerk=share * rows.jerk)
    return replace(controller, limits=bounds)


def assert_within(commands: Array, bounds: Limits, period: float) -> None:
    """Check position, speed, acceleration and jerk from the commands alone."""
    assert (commands >= bounds.lower - 1e-12).all()
    assert (commands <= bounds.upper + 1e-12).all()
    derivative = np.vstack((np.tile(commands[:1], (3, 1)), commands))
    for order, bound in enumerate((bounds.speed, bounds.acceleration, bounds.jerk), start=1):
        derivative = np.diff(derivative, axis=0) / period
        assert (np.abs(derivative) <= bound * (1.0 + 1e-5) + 1e-13 / period**order).all()


def wishes(seed: int, steps: int, bounds: Limits) -> Array:
    """Return desired joints (steps, 7): jumps, ramps that are too fast, trembling."""
    random, rows = np.random.default_rng(seed), []
    here = REST.copy()
    while len(rows) < steps:
        kind, length = random.integers(4), int(random.integers(5, 120))
        way = random.uniform(-1.0, 1.0, 7) * np.array((1.0, 0.6, 0.8, 2.0, 1.0, 2.0, 2.0))
        aim = np.clip(REST + way, bounds.lower, bounds.upper)
        if kind == 0:
            rows += [aim] * length
        elif kind == 1:
            rows += [here + (aim - here) * i / length for i in range(1, length + 1)]
        elif kind == 2:
            rows += [aim + 0.02 * random.standard_normal(7) for _ in range(length)]
        else:
            rows += [aim, here] * (length // 2)
        here = rows[-1]
    return np.array(rows[:steps])


def paths(seed: int, steps: int, cycle_s: float) -> Array:
    """Return desired joints (steps, 7) of a tcp that is sent at 0.7 to 3 m/s on average."""
    random, rows, here = np.random.default_rng(seed), [], np.zeros(3)
    position, rotation = ARM.tcp_in_base(REST)
    joints = REST
    while len(rows) < steps:
        aim = random.uniform(-0.35, 0.35, 3)
        way = float(np.linalg.norm(aim - here))
        length = max(1, round(way / random.uniform(0.7, 3.0) / cycle_s))
        for i in range(1, length + 1):
            s = i / length
            share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
            joints = ARM.solve(joints, position + here + (aim - here) * share, rotation)
            rows.append(joints)
        rows += [joints] * round(0.8 / cycle_s)
        here = aim
    return np.array(rows[:steps])


def journey(controller: Controller, desired: Array) -> tuple[Array, int]:
    """Return the commands (n, 7) and how often the tcp was slowed down."""
    state = control.at_rest(controller, REST, np.zeros(6))
    commands, slowed = [REST], 0
    for wish in desired:
        state, held = control.limit_command(
            controller, control.DesiredCommand(state, wish), state.limiter
        )
        commands.append(state.limiter.position)
        slowed += held is not None and held.endswith("tcp")
    return np.array(commands), slowed


def mean_speed(commands: Array, cycle_s: float) -> float:
    """Return the highest mean speed of the commands' tcp [m/s]."""
    places = np.array([ARM.tcp_in_base(joints)[0] for joints in commands])
    mean, worst = np.zeros(3), 0.0
    for speed in np.diff(places, axis=0) / cycle_s:
        mean += cycle_s / (command_limiter.MEAN_S + cycle_s) * (speed - mean)
        worst = max(worst, float(np.linalg.norm(mean)))
    return worst


def true_speed(commands: Array, cycle_s: float) -> float:
    """Return the highest speed of the tcp that the plant's servos make of commands [m/s]."""
    substeps = max(1, round(cycle_s / 0.004))
    servos = ServoBank(Scenario().robot.axes, tuple(REST), cycle_s, substeps)
    places = []
    for k, command in enumerate(commands):
        servos.begin_cycle(k)
        servos.command(k, 0.0, tuple(command))
        for n in range(substeps):
            servos.advance(k * substeps + n)
            places.append(ARM.tcp_in_base(np.array(servos.positions))[0])
    way = np.linalg.norm(np.diff(np.array(places), axis=0), axis=1)
    return float(way.max()) / (cycle_s / substeps)


@pytest.mark.row
@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("share", [1.0, 0.15])
def test_whatever_is_desired_the_tcp_keeps_its_limit_and_the_axes_theirs(
    cycle_s: float, share: float
) -> None:
    controller = compiled(cycle_s, share)
    assert controller.tcp_limit.speed == pytest.approx(0.606)
    limit = controller.tcp_limit.commanded
    for seed in range(3):
        desired = wishes(seed, round(12.0 / cycle_s), controller.limits)
        commands, slowed = journey(controller, desired)
        assert slowed > 50, "nothing tested the limit"
        assert_within(commands, controller.limits, cycle_s)
        assert mean_speed(commands, cycle_s) <= MEAN_SHARE * limit


@pytest.mark.row
@pytest.mark.long
@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("share", [1.0, 0.15])
def test_wherever_the_tcp_is_sent_its_true_speed_keeps_the_limit(
    cycle_s: float, share: float
) -> None:
    controller = compiled(cycle_s, share)
    for seed in range(3):
        commands, slowed = journey(controller, paths(seed, round(8.0 / cycle_s), cycle_s))
        assert slowed > 50, "nothing tested the limit"
        assert_within(commands, controller.limits, cycle_s)
        assert true_speed(commands, cycle_s) <= TRUE_SHARE * controller.tcp_limit.speed


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_without_the_limit_the_same_wishes_are_several_times_as_fast(cycle_s: float) -> None:
    controller = compiled(cycle_s)
    without = replace(controller, tcp_limit=replace(controller.tcp_limit, speed=100.0))
    commands, slowed = journey(without, paths(0, round(8.0 / cycle_s), cycle_s))
    assert slowed == 0
    assert true_speed(commands, cycle_s) > 3.0 * controller.tcp_limit.speed


def test_a_robot_that_was_slowed_down_arrives_where_it_was_sent() -> None:
    controller = compiled(0.012)
    aim = REST + np.array((0.6, 0.2, -0.2, 0.5, 0.3, 0.5, 0.4))
    commands, slowed = journey(controller, np.tile(aim, (600, 1)))
    assert slowed > 10
    assert np.allclose(commands[-1], aim, atol=1e-9)


def test_no_pose_is_needed_while_the_axes_are_slow() -> None:
    controller = compiled(0.012)
    rest = command_limiter.at_rest(REST)
    assert tcp_limit.is_slow(rest, controller.tcp_limit)
    slow = command_limiter.moving(REST, 0.02 * np.ones(7), np.zeros(7))
    assert (
        float(controller.tcp_limit.levers.sum() * 0.02)
        < tcp_limit.FREE * tcp_limit.COMMANDED * 0.606
    )
    assert tcp_limit.is_slow(slow, controller.tcp_limit)
    quick = command_limiter.moving(REST, np.array((0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0)), np.zeros(7))
    assert not tcp_limit.is_slow(quick, controller.tcp_limit)


def test_the_levers_bound_the_speed_of_the_tcp_in_every_pose() -> None:
    random = np.random.default_rng(3)
    for _ in range(300):
        joints = random.uniform(ARM.lower, ARM.upper)
        columns = np.linalg.norm(ARM.tcp_jacobian(joints), axis=0)
        assert (columns <= ARM.levers * (1.0 + 1e-9)).all()


def test_the_jacobian_is_the_derivative_of_the_position() -> None:
    jacobian = ARM.tcp_jacobian(REST)
    position, rotation = ARM.tcp_in_base(REST)
    for axis in range(7):
        turned = REST.copy()
        turned[axis] += 1e-6
        moved = (ARM.tcp_in_base(turned)[0] - position) / 1e-6
        assert np.allclose(rotation @ jacobian[:, axis], moved, atol=1e-5)
