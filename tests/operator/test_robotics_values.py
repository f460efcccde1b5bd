"""Values of OPC 40010-1 from a daemon's status."""

from typing import Any

import pytest

from linemate.daemon.operator.plc.robotics_values import (
    CONTINUOUS,
    CYCLE,
    RoboticsValues,
    robotics_values,
)

STATUS = {"state": "idle", "latched": False, "astray": None, "link": "healthy", "task": "wheel"}


def test_a_daemon_that_does_not_answer_is_not_on_its_path() -> None:
    assert robotics_values(None) == RoboticsValues()
    assert not RoboticsValues().on_path


@pytest.mark.parametrize(
    "changes", [{"state": "fault"}, {"latched": True}, {"astray": "A1"}, {"link": "lost"}]
)
def test_a_fault_an_axis_astray_and_a_lost_link_are_off_the_path(changes: dict[str, Any]) -> None:
    assert robotics_values(STATUS).on_path
    assert not robotics_values(STATUS | changes).on_path


def test_the_program_is_the_variant_of_the_part_else_the_task() -> None:
    assert robotics_values(STATUS)[2:] == ("wheel", True, CYCLE)
    running = {"production": {"part": {"part": "P1", "variant": "sedan"}}}
    assert robotics_values(STATUS | running)[2:] == ("sedan", True, CONTINUOUS)
    assert robotics_values(STATUS | {"production": {"part": None}}).program == "wheel"


def test_positions_are_those_measured() -> None:
    assert robotics_values(STATUS | {"measured": [0.1] * 7}).positions == (0.1,) * 7
    assert robotics_values(STATUS | {"measured": None}).positions == ()
