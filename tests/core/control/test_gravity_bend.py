"""Bend of the gears under weight: links from motors, motors for links, and both in control."""

import re
from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.core import rotations
from linemate.daemon.core.control import controller as control
from linemate.daemon.core.control import gravity_bend, kinematics
from linemate.daemon.core.control.settings import AxisLoad, ControlSettings, GravityBend
from linemate.daemon.core.horizon import Array, Horizon
from linemate.simulators.harness.setup import shipped_control

TASK = task_file.load(DAEMON_DATA / "wheel.yaml")
NOMINAL = rotations.matrix(TASK.file.object.nominal.quaternion)
REST = np.array((*TASK.file.arm.rest_joints, 0.5))
LOADS = (
    AxisLoad(2, 250.0, (0.5, 0.0, 0.0)),
    AxisLoad(3, 180.0, (0.6, 0.0, 0.0)),
    AxisLoad(6, 110.0, (0.2, 0.0, 0.1)),
)
BEND = GravityBend((0.25e-6,) * 3 + (2e-6,) * 3, LOADS, balanced=0.6)
NEWTON = 9.81


def arm(loads: tuple[AxisLoad, ...] = LOADS, *, linear_axis: bool = True) -> kinematics.Arm:
    urdf = TASK.urdf
    if not linear_axis:
        urdf = re.sub(r'(<joint name="E1" type=")prismatic', r"\1fixed", urdf)
    tool = TASK.file.arm.tcp_in_flange
    rotation = rotations.matrix(tool.quaternion)
    return kinematics.load(
        urdf, "flange", np.array(tool.position), rotation, linear_axis=linear_axis, loads=loads
    )


def compiled(settings: GravityBend = BEND) -> gravity_bend.BentArm:
    found = gravity_bend.compile_bend(settings, arm(settings.loads))
    assert found is not None
    return found


@pytest.mark.parametrize("settings", [GravityBend(), replace(BEND, loads=()), GravityBend((0.0,))])
def test_stiff_gears_or_an_arm_without_weight_have_no_model(settings: GravityBend) -> None:
    assert gravity_bend.compile_bend(settings, arm(settings.loads)) is None


@pytest.mark.parametrize("linear_axis", [False, True])
def test_a_weight_on_a_level_arm_is_held_by_weight_times_lever(linear_axis: bool) -> None:
    """With A2 and A3 at zero the shipped arm is level; its axes turn it down."""
    loaded = arm((AxisLoad(3, 100.0, (0.7, 0.0, 0.0)),), linear_axis=linear_axis)
    moments = loaded.gravity(np.zeros(loaded.axes))
    expected = np.zeros(loaded.axes)
    expected[1], expected[2] = -100.0 * NEWTON * (1.15 + 0.7), -100.0 * NEWTON * 0.7
    assert moments == pytest.approx(expected, abs=1e-9)


def test_a_weight_bends_the_arm_down_and_the_counterbalance_takes_its_share() -> None:
    without = compiled(replace(BEND, balanced=0.0))
    whole = compiled(replace(BEND, balanced=1.0))
    height = [
        bent.arm.tcp_in_base(gravity_bend.links(bent, REST))[0][2] for bent in (without, whole)
    ]
    level = without.arm.tcp_in_base(REST)[0][2]
    assert height[0] < height[1] - 1e-4 < level - 1e-4
    assert gravity_bend.links(whole, REST)[1] == REST[1]
    assert gravity_bend.links(without, REST)[6] == REST[6]


def test_motors_that_are_led_bring_the_links_where_they_are_wanted() -> None:
    bent = compiled()
    steps = np.linspace(0.0, 0.2, 14)[:, None]
    wanted = REST + steps * np.array((0.15, 0.1, -0.2, 0.2, 0.1, -0.1, 0.1))
    led = gravity_bend.motors(bent, wanted)
    placed = np.array([gravity_bend.links(bent, row) for row in led])
    off = [np.linalg.norm(at(bent, a) - at(bent, b)) for a, b in zip(placed, wanted, strict=True)]
    unled = [np.linalg.norm(at(bent, row) - at(bent, led[i])) for i, row in enumerate(wanted)]
    assert max(off) < 1e-5
    assert min(unled) > 5e-4


def at(bent: gravity_bend.BentArm, joints: Array) -> Array:
    """The tcp's position (3,) in base."""
    return bent.arm.tcp_in_base(joints)[0]


def test_a_robot_at_rest_that_bends_is_commanded_to_stay() -> None:
    settings = ControlSettings(limits=shipped_control().limits, bend=BEND)
    controller = control.compile_controller(settings, arm(), 0.012)
    assert controller.bend is not None
    pose = controller.arm.tcp_in(NOMINAL, control.links_of(controller, REST, None))
    state = control.at_rest(controller, REST, pose)
    count = controller.steps + 1
    horizon = Horizon(np.tile(pose, (count, 1)), np.full(count, REST[6]), np.ones(count), NOMINAL)
    for _ in range(20):
        desired = control.desire_command(controller, state, horizon)
        assert desired.command == pytest.approx(REST, abs=1e-6)
        state, held = control.limit_command(controller, desired, state.limiter)
        assert held is None
