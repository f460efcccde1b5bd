"""The nominal task through the kinematics: what it asks, and where it cannot be asked."""

import math
from dataclasses import replace

import pytest
from cell import TASK

from linemate.daemon.commissioning.rehearsal import MOST_STEPS, rehearse
from linemate.daemon.config import task_file
from linemate.daemon.config.documents import spelled
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters, build
from linemate.daemon.core.tracking.settings import (
    CameraNoise,
    DistanceNoise,
    PayloadSettings,
    TrackingSettings,
)
from linemate.daemon.core.tracking.task import PoseFile, StopInput, TaskFile
from linemate.simulators.harness.setup import shipped_control


def made(
    file: TaskFile = TASK.file, task: Task = TASK, tracking: TrackingSettings | None = None
) -> Parameters:
    return build(file, task.urdf, tracking or TrackingSettings(), shipped_control(), 0.012)


def complaints_of(file: TaskFile) -> list[str]:
    found = rehearse(made(file)).complaints
    return [f"{spelled(complaint.path)}: {complaint.what}" for complaint in found]


def with_position(number: int, *position: float) -> TaskFile:
    points = list(TASK.file.waypoints)
    there = PoseFile(position, points[number].pose.quaternion)  # type: ignore[arg-type]
    points[number] = replace(points[number], pose=there)
    return replace(TASK.file, waypoints=tuple(points))


def test_the_shipped_task_is_good_and_its_last_approach_is_what_is_fastest() -> None:
    rehearsal = rehearse(made())
    assert rehearsal.complaints == ()
    tcp, *axes = rehearsal.peaks
    # A quintic over 0.17 m in 1.2 s, across a conveyor of 0.106 m/s. It ends 80 mm off the object,
    # where the camera still sees it. The retreat has 0.3 m in 2 s at a constant speed.
    assert tcp.speed == pytest.approx(math.hypot(1.875 * 0.17 / 1.2, 0.106), abs=0.002)
    assert tcp.at_s == pytest.approx(3.4, abs=0.1)
    assert [peak.name for peak in axes] == ["A1", "A2", "A3", "A4", "A5", "A6", "E1"]
    assert all(peak.speed < peak.limit and peak.margin > 0.5 for peak in axes)


def test_a_linear_axis_that_counts_against_the_conveyor_follows_it_as_well() -> None:
    limits = '<limit lower="-1.5" upper="6.0"', '<limit lower="-6.0" upper="1.5"'
    against = TASK.urdf.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', 1).replace(*limits)
    control = replace(shipped_control(), limits=())
    mirrored = build(TASK.file, against, TrackingSettings(), control, 0.012)
    assert mirrored.tracker.axis_travel == -made().tracker.axis_travel
    usual, there = rehearse(made()), rehearse(mirrored)
    assert there.complaints == ()
    for peak, other in zip(there.peaks, usual.peaks, strict=True):
        assert peak.speed == pytest.approx(other.speed, abs=1e-6)
        assert peak.margin == pytest.approx(other.margin, abs=1e-6)


def test_an_exercise_is_not_carried_off_by_a_conveyor_that_will_stop() -> None:
    exercise = task_file.load(DAEMON_DATA / "exercise.yaml")
    rehearsal = rehearse(made(exercise.file, exercise))
    assert rehearsal.complaints == ()
    assert rehearsal.peaks[7].speed == 0.0


def test_a_pose_out_of_reach_is_reported_with_its_waypoint_and_place() -> None:
    (what,) = complaints_of(with_position(8, -2.5, 0.0, -0.3))
    assert what.startswith("waypoints[8]: the arm does not reach the pose at 16.")
    assert "m in base" in what


def test_a_rest_pose_that_is_not_at_the_first_waypoint_is_reported_with_both_distances() -> None:
    rest = (0.5, *TASK.file.arm.rest_joints[1:])
    file = replace(TASK.file, arm=replace(TASK.file.arm, rest_joints=rest))  # type: ignore[arg-type]
    (what,) = complaints_of(file)
    assert what.startswith("arm.rest_joints: with these joints the tcp is ")
    assert "500 mrad away from waypoints[0], at most 20 mm and 50 mrad" in what


def test_a_programme_that_is_too_fast_is_reported_with_the_axis_and_the_time() -> None:
    points = tuple(replace(point, time=point.time / 5.0) for point in TASK.file.waypoints)
    lines = complaints_of(replace(TASK.file, waypoints=points))
    assert any("tcp would move at 1." in line and "limit 0.455 m/s" in line for line in lines)


def test_a_waypoint_deep_in_the_object_is_reported_with_the_force() -> None:
    assert complaints_of(with_position(4, 0.0, 0.0, 0.005)) == []
    (what,) = complaints_of(with_position(4, 0.0, 0.0, 0.01))
    assert what.startswith("waypoints[4].pose.position: 10 mm beyond the object's surface press")
    assert "500 N at 50000 N/m, overload is 350 N" in what


def test_a_contact_that_the_search_does_not_reach_is_reported_with_both_ways() -> None:
    (what,) = complaints_of(with_position(3, 0.0, 0.0, -0.03))
    assert what.startswith("waypoints[3].pose.position: 30 mm before the object's surface")
    assert "the search goes on for 12 mm (guard.overrun)" in what
    assert complaints_of(with_position(3, 0.0, 0.0, -0.01)) == []


def test_a_waypoint_nearer_than_the_begin_of_the_last_approach_is_reported() -> None:
    for depth, gap in ((0.0, "0 mm"), (-0.03, "30 mm")):
        blind, what = complaints_of(with_position(1, 0.0, 0.0, depth))
        assert blind.startswith("waypoints[1]: the gate object_seen is")
        assert what.startswith(f"waypoints[1].pose.position: {gap} before the object's surface")
        assert "nearer than waypoints[2] (60 mm), where the last approach begins" in what


def test_bolts_that_reach_the_object_before_the_last_approach_are_reported() -> None:
    def lines(bolts: float) -> list[str]:
        tracking = TrackingSettings(payload=PayloadSettings(bolts=bolts))
        return [complaint.what for complaint in rehearse(made(tracking=tracking)).complaints]

    (what,) = lines(0.3)
    assert "begins 60 mm before the object's surface, where bolts of 300 mm" in what
    assert "out to 310 mm" in what
    assert lines(0.2) == []  # the last waypoint is moved out by itself


def test_a_task_that_ends_at_the_object_is_reported() -> None:
    points = TASK.file.waypoints
    (what,) = complaints_of(replace(TASK.file, waypoints=points[:8]))
    assert what.startswith("waypoints[7].pose.position: the task ends 0 mm before the object's")
    assert "80 mm are needed to go home (home.clearance)" in what


def test_a_search_that_presses_with_less_than_a_touch_is_reported() -> None:
    (what,) = complaints_of(with_position(3, 0.0, 0.0, -0.0118))
    assert "the tool presses with 10 N, a touch is felt from 15 N on" in what


def test_an_axis_beyond_its_position_limit_is_reported() -> None:
    rows = list(shipped_control().limits)
    rows[0] = replace(rows[0], upper=0.01)
    narrow = replace(shipped_control(), limits=tuple(rows))
    parameters = build(TASK.file, TASK.urdf, TrackingSettings(), narrow, 0.012)
    lines = [complaint.what for complaint in rehearse(parameters).complaints]
    assert any(line.startswith("A1 would be at 0.0") and ".. 0.010 rad" in line for line in lines)


def test_a_long_task_is_rehearsed_in_as_many_steps_at_most() -> None:
    points = list(TASK.file.waypoints)
    points[-1] = replace(points[-1], time=80.0)
    parameters = made(replace(TASK.file, waypoints=tuple(points)))
    assert MOST_STEPS < 80.0 / 0.02
    rehearse(parameters)


COARSE = TrackingSettings(distance=DistanceNoise(deviation=0.004))


def test_a_stop_that_spoils_the_touch_before_the_sensor_shows_it_is_refused() -> None:
    (complaint,) = rehearse(made(tracking=COARSE)).complaints
    assert complaint.path == ("conveyor", "stop_input")
    assert "is seen after 0.40 s by a distance sensor of 4 mm" in complaint.what
    assert "8.5 mm off then, limit 3.0 mm (guard.tolerance)" in complaint.what


def test_a_coarse_sensor_is_enough_where_something_else_shows_a_stop() -> None:
    conveyor = replace(TASK.file.conveyor, stop_input=StopInput(bit=4))
    assert rehearse(made(replace(TASK.file, conveyor=conveyor), tracking=COARSE)).complaints == ()
    seeing = replace(COARSE, camera=CameraNoise(blind_below=0.0))
    assert rehearse(made(tracking=seeing)).complaints == ()
    guard = replace(TASK.file.guard, tolerance=0.009)
    assert rehearse(made(replace(TASK.file, guard=guard), tracking=COARSE)).complaints == ()
    exercise = task_file.load(DAEMON_DATA / "exercise.yaml")
    assert rehearse(made(exercise.file, exercise, COARSE)).complaints == ()
