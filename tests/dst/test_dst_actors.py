"""Actors of a fault plan: the parameters that they set exist."""

import numpy as np
import pytest

from linemate.daemon.config.parameter_list import list_parameters
from linemate.simulators.lab.faults import dst_cells
from linemate.simulators.lab.faults.dst_actors import HARMLESS, HOMING_S, homing_time
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
