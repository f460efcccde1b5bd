"""Actors of a fault plan: the parameters that they set exist."""

import pytest

from linemate.daemon.config.parameter_list import list_parameters
from linemate.simulators.lab.faults import dst_cells
from linemate.simulators.lab.faults.dst_actors import HARMLESS

LISTED = {each["name"]: each for each in list_parameters(dst_cells.station("").config)}


PAIRS = [(name, value) for each in HARMLESS for name, value in each.items()]


@pytest.mark.parametrize(("name", "value"), PAIRS)
def test_each_parameter_that_is_set_in_motion_exists_and_takes_such_a_value(
    name: str, value: object
) -> None:
    assert isinstance(value, type(LISTED[name]["default"]))


def test_one_of_them_changes_the_cell_while_the_robot_moves() -> None:
    assert any(LISTED[name]["live"] and LISTED[name]["value"] != value for name, value in PAIRS)
