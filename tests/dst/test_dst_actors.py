"""Actors of a fault plan: the parameters that they set exist."""

import numpy as np
import pytest

from linemate.daemon.config.parameter_list import list_parameters
from linemate.simulators.lab.faults import dst_cells, dst_plan, dst_run
from linemate.simulators.lab.faults.dst_actors import HARMLESS, HOMING_S, drawn_out, homing_time
from linemate.simulators.plants import rotation
from linemate.simulators.plants.arm import ArmPlant
from linemate.simulators.plants.scenario import Scenario

LISTED = {each["name"]: each for each in list_parameters(dst_cells.station("").config)}


PAIRS = [(name, value) for each in HARMLESS for name, value in each.items()]


@pytest.mark.parametrize(("name", "value"), PAIRS)
def test_each_parameter_that_is_set_in_motion_exists_and_takes_such_a_value(
    name: str, value: object
) -> None:
    assert isinstance(value, type(LISTED[name]["default"]))


def test_one_of_them_changes_the_cell_while_the_robot_moves() -> None:
    assert any(LISTED[name]["live"] and LISTED[name]["value"] != value for name, value in PAIRS)


def test_the_way_home_asks_no_servo_for_more_than_it_can_accelerate() -> None:
    axes = Scenario().robot.axes
    ways = [0.0] * 6 + [0.54]
    took_s = homing_time(ways, axes)
    u = np.linspace(0.0, 1.0, 1001)
    way = 0.54 * u**3 * (10.0 + u * (6.0 * u - 15.0))
    acceleration = np.abs(np.diff(way, 2)).max() / (took_s * 1e-3) ** 2
    assert acceleration < 0.71 * axes[6].acceleration_limit
    assert homing_time([0.0] * 7, axes) == HOMING_S


def test_a_tool_is_drawn_straight_back() -> None:
    robot = Scenario().robot
    tcp, joints = ArmPlant(robot).tcp, (0.1, -1.5, 1.9, 0.05, 1.2, -0.1, 1.3)
    place, turn = tcp(joints)
    for way in (0.02, 0.08):
        moved, turned = tcp(drawn_out(robot, joints, way))
        off = [a - b for a, b in zip(moved, place, strict=True)]
        x, y, z = rotation.unapply(turn, (off[0], off[1], off[2]))
        assert (x, y, z) == pytest.approx((0.0, 0.0, -way), abs=1e-6)
        assert rotation.angle(rotation.between(turn, turned)) < 1e-6


def test_the_way_home_leads_no_tool_sideways_along_the_hub() -> None:
    # The daemon ends in contact; its clamp is open when the programme drives the robot home.
    outcome = dst_run.run(dst_plan.draw(50175, cycle_ms=12, cell=""))
    assert not outcome.violations
