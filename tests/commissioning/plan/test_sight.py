"""What the camera shows where a task needs it: from its mount, and outside its blind zone."""

import math
from dataclasses import replace

import pytest
from cell import TASK

from linemate.daemon.commissioning.plan.sight import unseen
from linemate.daemon.config.documents import spelled
from linemate.daemon.core.parameters import build
from linemate.daemon.core.tracking.settings import CameraNoise, TrackingSettings
from linemate.daemon.core.tracking.task import Gate, Phase, PoseFile, TaskFile
from linemate.protocol.stamped_samples import Quaternion, Vector3
from linemate.simulators.harness.setup import shipped_control

HALF = math.sqrt(0.5)


def complaints_of(file: TaskFile, tracking: TrackingSettings | None = None) -> list[str]:
    tracking = tracking or TrackingSettings()
    parameters = build(file, TASK.urdf, tracking, shipped_control(), 0.012)
    return [f"{spelled(complaint.path)}: {complaint.what}" for complaint in unseen(parameters)]


def mounted(position: Vector3, quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)) -> TaskFile:
    arm = replace(TASK.file.arm, camera_in_tcp=PoseFile(position, quaternion))
    return replace(TASK.file, arm=arm)


def blind_below(distance: float) -> list[str]:
    tracking = TrackingSettings(camera=CameraNoise(blind_below=distance))
    return complaints_of(TASK.file, tracking)


def test_the_shipped_camera_sees_the_object_at_the_gate_and_before_the_touch() -> None:
    assert complaints_of(TASK.file) == []


@pytest.mark.parametrize("quaternion", [(0.0, 1.0, 0.0, 0.0), (HALF, HALF, 0.0, 0.0)])
def test_any_axis_of_a_cameras_frame_may_be_its_line_of_sight(quaternion: Quaternion) -> None:
    assert complaints_of(mounted(TASK.file.arm.camera_in_tcp.position, quaternion)) == []


def test_a_camera_that_is_10_m_away_is_reported_with_its_place() -> None:
    (line,) = complaints_of(mounted((-0.10, 0.0, -10.0)))
    assert line.startswith("arm.camera_in_tcp.position: the camera would be 10.00 m from the tcp")


def test_a_gate_on_the_camera_in_its_blind_zone_is_reported() -> None:
    lines = blind_below(0.5)
    assert lines[0].startswith("waypoints[1]: the gate object_seen is 250 mm from the object")
    assert "tracking.camera.blind_below is 500 mm" in lines[0]


def test_a_last_waypoint_that_cannot_be_moved_out_of_the_blind_zone_is_reported() -> None:
    (line,) = blind_below(0.24)  # 20 mm before it is behind the waypoint with the gate
    assert line.startswith("waypoints[2]: the last waypoint before contact is 60 mm from the")
    assert blind_below(0.22) == []


def test_a_task_without_contact_and_gate_needs_no_camera() -> None:
    points = tuple(
        replace(point, gate=Gate.NONE, phase=Phase.APPROACH) for point in TASK.file.waypoints
    )
    tracking = TrackingSettings(camera=CameraNoise(blind_below=0.5))
    assert complaints_of(replace(TASK.file, waypoints=points), tracking) == []
