"""A tool that holds the object travels with it until the clamp opens."""

from dataclasses import replace
from typing import Any

import pytest
from cell import TASK

from linemate.daemon.commissioning.plan.held import strained
from linemate.daemon.config.documents import spelled
from linemate.daemon.core.parameters import build
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import PoseFile, TaskFile, WaypointFrame
from linemate.simulators.harness.setup import shipped_control


def complaints_of(number: int, **changes: Any) -> list[str]:
    points = list(TASK.file.waypoints)
    points[number] = replace(points[number], **changes)
    file: TaskFile = replace(TASK.file, waypoints=tuple(points))
    parameters = build(file, TASK.urdf, TrackingSettings(), shipped_control(), 0.012)
    return [f"{spelled(c.path)}: {c.what}" for c in strained(parameters)]


def test_the_shipped_task_travels_with_the_object() -> None:
    assert complaints_of(4) == []


@pytest.mark.parametrize("number", [3, 4, 5, 6, 7])
def test_a_waypoint_that_stands_while_the_object_is_held_is_reported(number: int) -> None:
    lines = complaints_of(number, frame=WaypointFrame.BASE)
    assert lines[0].startswith(f"waypoints[{number}].frame: base: the object travels at 0.106 m/s")


def test_a_pull_at_the_held_object_is_reported_with_its_force() -> None:
    for place in ((0.0, 0.0, -0.02), (0.0, 0.02, 0.001), (-0.02, 0.0, 0.001)):
        (line,) = complaints_of(6, pose=PoseFile(place))
        assert line.startswith("waypoints[6].pose.position: 20 mm from the touch pull with 1000 N")
    for place in ((0.0, 0.0, -0.005), (0.0, 0.005, 0.0), (0.0, 0.0, 0.004)):
        assert complaints_of(6, pose=PoseFile(place)) == []


def test_a_turn_of_the_held_object_is_reported_with_its_angle() -> None:
    (line,) = complaints_of(4, pose=PoseFile((0.0, 0.0, 0.001), (0.995, 0.0, 0.0, 0.0998749)))
    assert line.startswith("waypoints[4].pose.quaternion: turned by 200 mrad from the touch")
    assert "at most 15 mrad (guard.angle_tolerance)" in line


def test_after_the_clamp_has_opened_the_tool_is_free() -> None:
    assert complaints_of(8, pose=PoseFile((0.0, 0.1, -0.3)), frame=WaypointFrame.BASE) == []
