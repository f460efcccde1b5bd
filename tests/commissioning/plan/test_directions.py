"""The tool points at the object, and the linear axis moves along the conveyor."""

from dataclasses import replace

import pytest
from cell import TASK

from linemate.daemon.commissioning.plan.directions import misdirected
from linemate.daemon.commissioning.rehearsal import rehearse
from linemate.daemon.config.documents import spelled
from linemate.daemon.core import rotations
from linemate.daemon.core.parameters import Parameters, build
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import PoseFile, TaskFile
from linemate.protocol.stamped_samples import Quaternion
from linemate.simulators.harness.setup import shipped_control

RAIL = '<axis xyz="0 1 0"/>'


def built(file: TaskFile, urdf: str = TASK.urdf) -> Parameters:
    return build(file, urdf, TrackingSettings(), shipped_control(), 0.012)


def lines(parameters: Parameters) -> list[str]:
    return [f"{spelled(c.path)}: {c.what}" for c in misdirected(parameters)]


def with_tool_turned(turn: Quaternion) -> TaskFile:
    """Return the shipped task for a tcp with other axes, the tool itself as it was."""

    def turned(pose: PoseFile) -> PoseFile:
        return replace(pose, quaternion=rotations.multiply(pose.quaternion, turn))

    file = TASK.file
    points = tuple(replace(point, pose=turned(point.pose)) for point in file.waypoints)
    arm = replace(file.arm, tcp_in_flange=turned(file.arm.tcp_in_flange))
    return replace(file, arm=arm, waypoints=points)


@pytest.mark.parametrize("turn", [(0.0, 1.0, 0.0, 0.0), (0.5**0.5, 0.5**0.5, 0.0, 0.0)])
def test_a_tool_whose_z_does_not_point_at_the_object_is_refused(turn: Quaternion) -> None:
    file = with_tool_turned(turn)
    degrees = 180 if turn[0] == 0.0 else 90
    (complaint,) = rehearse(built(file)).complaints
    (line,) = lines(built(file))
    assert complaint.what in line
    assert line.startswith("waypoints[3].pose.quaternion: the tool's z points ")
    assert f" {degrees} degrees away" in line


def test_a_tool_may_be_turned_about_its_axis() -> None:
    assert lines(built(with_tool_turned((0.5**0.5, 0.0, 0.0, 0.5**0.5)))) == []


def test_a_linear_axis_across_the_conveyor_is_refused_unless_it_rests() -> None:
    across = TASK.urdf.replace(RAIL, '<axis xyz="1 0 0"/>', 1)
    (line,) = lines(built(TASK.file, across))
    assert line.startswith("linear_axis.travel: E1 of the URDF would move by 0 m along the")
    resting = replace(TASK.file, linear_axis=replace(TASK.file.linear_axis, travel=0.0))
    assert lines(built(resting, across)) == []
    assert lines(built(TASK.file, TASK.urdf.replace(RAIL, '<axis xyz="0.6 -0.8 0"/>', 1))) == []
