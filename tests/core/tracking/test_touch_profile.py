"""Profile of the last approach: its speed near the object, its ends, its time."""

from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.core.tracking.reference import compile_reference
from linemate.daemon.core.tracking.task import Phase, TaskFile, WaypointFrame
from linemate.daemon.core.tracking.touch import touch_profile
from linemate.simulators.harness.cell.cell_truth import shipped_task

TASK = shipped_task().file
STEP_S = 1e-3
ROUNDING = 1e-6


def stretched(*, far: float = -0.06, near: float = 0.001, lasting: float = 2.0) -> TaskFile:
    """Return the shipped task with another stretch to contact."""
    points = list(TASK.waypoints)
    points[2] = replace(points[2], pose=replace(points[2].pose, position=(0.0, 0.0, far)))
    for i in (3, 4, 5):
        points[i] = replace(points[i], pose=replace(points[i].pose, position=(0.0, 0.0, near)))
    lag = points[2].time + lasting - points[3].time
    points[3:] = [replace(point, time=point.time + lag) for point in points[3:]]
    return replace(TASK, waypoints=tuple(points))


def distances(task: TaskFile) -> tuple[np.ndarray, np.ndarray]:
    """Return distance [m] and speed [m/s] along the tool's axis over the stretch to contact."""
    reference = compile_reference(task)
    begin, end = reference.times[2], reference.times[3]
    times = np.linspace(begin, end, round((end - begin) / STEP_S) + 1)
    z = reference.poses(times)[1][:, 2]
    return z, np.gradient(z, times)


@pytest.mark.parametrize("lasting", [0.3, 1.4, 2.0, 4.0, 20.0])
@pytest.mark.parametrize("far", [-0.25, -0.06, -0.015, -0.011, -0.005])
def test_the_speed_within_the_clearance_is_at_most_the_touch_speed(
    far: float, lasting: float
) -> None:
    z, speed = distances(stretched(far=far, lasting=lasting))
    slow = z >= -TASK.guard.clearance
    assert slow.any()
    assert float(speed[slow].max()) <= TASK.guard.touch_speed * 1.01 + ROUNDING
    assert float(speed.min()) >= -ROUNDING


@pytest.mark.parametrize("lasting", [0.3, 2.0, 20.0])
def test_the_stretch_begins_and_ends_at_its_waypoints_at_rest(lasting: float) -> None:
    z, speed = distances(stretched(lasting=lasting))
    assert (z[0], z[-1]) == pytest.approx((-0.06, 0.001), abs=ROUNDING)
    assert np.abs(speed[[0, -1]]).max() < 1e-4


def test_the_shipped_task_has_the_time_that_its_approach_needs() -> None:
    assert touch_profile.lengthened(TASK) == TASK


def test_a_task_with_too_little_time_is_lengthened_and_its_later_times_move_as_much() -> None:
    task = stretched(lasting=1.4)
    longer = touch_profile.lengthened(task)
    by = longer.waypoints[3].time - task.waypoints[3].time
    assert 0.3 < by < 0.7
    assert longer.waypoints[:3] == task.waypoints[:3]
    for i in range(3, len(task.waypoints)):
        assert longer.waypoints[i].time - task.waypoints[i].time == pytest.approx(by)
    assert longer.tool.fix_screws - task.tool.fix_screws == pytest.approx(by)
    assert longer.tool.release_wheel - task.tool.release_wheel == pytest.approx(by)
    assert touch_profile.touch_profile(longer) == touch_profile.touch_profile(
        touch_profile.lengthened(longer)
    )


def test_a_clearance_of_zero_bounds_no_speed() -> None:
    task = replace(TASK, guard=replace(TASK.guard, clearance=0.0))
    assert touch_profile.touch_profile(task) is None
    assert touch_profile.lengthened(stretched(lasting=0.3)) != stretched(lasting=0.3)
    _, speed = distances(task)
    assert speed.max() == pytest.approx(1.875 * 0.061 / 2.0, rel=1e-3)


def test_a_task_without_contact_has_no_profile() -> None:
    points = tuple(replace(point, phase=Phase.APPROACH) for point in TASK.waypoints)
    assert touch_profile.touch_profile(replace(TASK, waypoints=points)) is None


def test_a_stretch_that_begins_in_the_station_is_left_as_it_is() -> None:
    points = list(TASK.waypoints)
    points[2] = replace(points[2], frame=WaypointFrame.BASE)
    assert touch_profile.contact_stretch(replace(TASK, waypoints=tuple(points))) is None


def test_the_tool_waits_where_the_camera_still_sees_the_object() -> None:
    stretch = touch_profile.contact_stretch(TASK)
    assert stretch is not None
    near = -TASK.waypoints[stretch].pose.position[2]
    assert touch_profile.sighted(TASK, near) == TASK
    moved = touch_profile.sighted(TASK, near + 0.03).waypoints[stretch]
    assert moved.pose.position[2] == -(near + 0.03)
    assert moved.time == TASK.waypoints[stretch].time


def test_a_waypoint_is_not_moved_behind_the_one_before_it() -> None:
    assert touch_profile.sighted(TASK, 0.4) == TASK


TIPS = touch_profile.bolt_tips(0.025, 50e3, 350.0)


@pytest.mark.parametrize("stiffness", [50e3, 58e3, 100e3, 400e3])
def test_the_speed_near_the_bolts_tips_is_at_most_theirs(stiffness: float) -> None:
    """A tool that came to tips that did not enter at 200 mm/s overloaded its mount by 8 mm."""
    tips = touch_profile.bolt_tips(0.025, stiffness, 350.0)
    for lasting in (0.3, 2.0, 20.0):
        task = touch_profile.slowed(stretched(far=-0.11, lasting=lasting), stiffness, 350.0)
        task = touch_profile.lengthened(task, tips)
        reference = compile_reference(task, tips)
        begin, end = reference.times[2], reference.times[3]
        times = np.linspace(begin, end, round((end - begin) / STEP_S) + 1)
        z = reference.poses(times)[1][:, 2]
        speed = np.gradient(z, times)
        assert (z[0], z[-1]) == pytest.approx((-0.11, 0.001), abs=ROUNDING)
        near = z >= -tips.length - touch_profile.TIPS_RESERVE
        assert float(speed[near].max()) <= tips.speed * 1.01 + ROUNDING
        slow = z >= -task.guard.clearance
        assert float(speed[slow].max()) <= task.guard.touch_speed * 1.01 + ROUNDING
        assert float(speed.min()) >= -ROUNDING


def test_the_force_on_tips_that_do_not_enter_stays_below_the_overload() -> None:
    limit = touch_profile.force_limit(TIPS.length, -TIPS.length, 350.0)
    assert limit + TIPS.speed * touch_profile.LED_S * 50e3 < 350.0


def test_bolts_within_the_clearance_change_nothing() -> None:
    task, short = stretched(), touch_profile.bolt_tips(0.006, 50e3, 350.0)
    assert touch_profile.touch_profile(task, short) == touch_profile.touch_profile(task)
    assert touch_profile.lengthened(TASK, short) == TASK


@pytest.mark.parametrize(
    ("length", "distance", "limit"),
    [(0.0, -0.01, 350.0), (0.025, -0.05, 350.0), (0.025, -0.024, 175.0), (0.025, np.inf, 350.0)],
)
def test_less_force_withdraws_a_tool_that_only_tips_can_stop(
    length: float, distance: float, limit: float
) -> None:
    assert touch_profile.force_limit(length, distance, 350.0) == limit


STIFFNESS, OVERLOAD = 50e3, 350.0
DEAD_TIME_S = 0.15  # in which a touch is felt and the tool stops


@pytest.mark.parametrize(
    ("clearance", "speed"), [(0.0, 0.009), (0.0, 0.1), (0.02, 0.1), (0.02, 0.03)]
)
def test_no_task_touches_faster_than_its_mount_bears(clearance: float, speed: float) -> None:
    guard = replace(TASK.guard, clearance=clearance, touch_speed=speed)
    slowed = touch_profile.slowed(replace(TASK, guard=guard), STIFFNESS, OVERLOAD)
    assert slowed.guard.touch_speed * DEAD_TIME_S * STIFFNESS <= 0.5 * OVERLOAD * 1.001
    assert slowed.guard.clearance == (clearance or 0.011)
    z, reached = distances(slowed)
    near = z >= -slowed.guard.clearance
    assert float(reached[near].max()) <= slowed.guard.touch_speed * 1.01 + ROUNDING


def test_a_task_that_touches_gently_is_not_slowed() -> None:
    assert touch_profile.slowed(TASK, STIFFNESS, OVERLOAD) is TASK
