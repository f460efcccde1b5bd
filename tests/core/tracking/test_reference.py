"""The programme: poses along the task's clock, frames, gates, and what cannot be one."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.damping import CONTACT_SHARE, free_table
from linemate.daemon.core.tracking.reference import (
    STANDING_ACCELERATION,
    Reference,
    barrier,
    compile_reference,
    last_step,
    tabulated,
)
from linemate.daemon.core.tracking.task import (
    Gate,
    Phase,
    PoseFile,
    TaskFile,
    Waypoint,
    WaypointFrame,
)

TASK = task_file.load(DAEMON_DATA / "wheel.yaml").file
REFERENCE = compile_reference(TASK)
SPEED = TASK.conveyor.nominal_speed
C = rotations.matrix(TASK.object.nominal.quaternion)
NOMINAL = np.array(TASK.object.nominal.position)
END = TASK.waypoints[-1].time
times = st.floats(0.0, END + 2.0)


def object_in_base(t: float) -> Array:
    """The nominal object (4, 4): it travels along the conveyor's axis from t = 0 on."""
    T = np.eye(4)
    T[:3, :3] = C
    T[:3, 3] = NOMINAL + t * SPEED * np.array(TASK.conveyor.axis)
    return T


def tcp_in_base(pose: Array, reference: Reference = REFERENCE) -> Array:
    """A pose (6,) of c in base (4, 4)."""
    T = np.eye(4)
    T[:3, :3] = reference.nominal @ rotations.exp(pose[3:])
    T[:3, 3] = reference.nominal @ pose[:3]
    return T


def matrix_of(pose: PoseFile) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotations.matrix(pose.quaternion), pose.position
    return T


def turned_task(angle: float) -> TaskFile:
    """The same task, its last object waypoints turned about an axis that is none of the frame's."""
    q = rotations.quaternion(rotations.exp(angle * np.array((0.6, 0.0, 0.8))))
    points = [
        replace(point, pose=PoseFile(point.pose.position, q)) if i >= 4 else point
        for i, point in enumerate(TASK.waypoints)
    ]
    return replace(TASK, waypoints=tuple(points))


@pytest.mark.parametrize("point", TASK.waypoints, ids=lambda point: f"{point.time:g} s")
def test_each_waypoint_is_reached_at_its_time_in_its_frame(point: Waypoint) -> None:
    poses, _ = REFERENCE.poses(np.array((point.time,)))
    known = matrix_of(point.pose)
    if point.frame is WaypointFrame.OBJECT:
        known = object_in_base(point.time) @ known
    assert np.allclose(tcp_in_base(poses[0]), known, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(times)
def test_the_relative_pose_is_the_nominal_objects_inverse_times_the_tcp(t: float) -> None:
    for reference in (REFERENCE, compile_reference(turned_task(0.2))):
        poses, relative = reference.poses(np.array((t,)))
        tcp = tcp_in_base(poses[0], reference)
        known = np.linalg.inv(object_in_base(t)) @ tcp
        found = np.eye(4)
        found[:3, :3], found[:3, 3] = rotations.exp(relative[0, 3:]), relative[0, :3]
        assert np.allclose(found, known, atol=1e-9)


def test_the_motion_has_no_corner_anywhere() -> None:
    fine = np.arange(0.0, END + 1.0, 0.001)
    poses, relative = REFERENCE.poses(fine)
    for rows in (relative,):
        speed = np.diff(rows, axis=0) / 0.001
        acceleration = np.diff(speed, axis=0) / 0.001
        assert np.abs(np.diff(rows, axis=0)).max() < 0.001
        assert np.abs(np.diff(speed, axis=0)).max() < 0.002
        # A quintic's acceleration is continuous: its own jerk bounds each millisecond's change.
        assert np.abs(np.diff(acceleration, axis=0)).max() < 0.02
    travelling = fine > TASK.waypoints[1].time
    along = np.diff(poses[:, 1])[travelling[1:]] / 0.001
    assert np.allclose(along, SPEED, atol=1e-6)


def test_a_released_object_is_left_at_once() -> None:
    begin, end = (TASK.waypoints[i].time for i in (-3, -2))
    assert TASK.waypoints[-3].gate is Gate.WHEEL_RELEASED
    _, relative = REFERENCE.poses(begin + np.array((0.0, 0.2, 0.22)))
    assert relative[0, 2] == 0.0
    assert relative[2, 2] < -0.01
    # A stretch that would need more speed than a retraction always has is a quintic.
    points = [
        replace(point, time=begin + 0.8 + point.time - end) if point.time >= end else point
        for point in TASK.waypoints
    ]
    quick = compile_reference(replace(TASK, waypoints=tuple(points)))
    _, relative = quick.poses(begin + np.array((0.08,)))
    assert relative[0, 2] == pytest.approx(-0.3 * 0.00856)


def test_a_tool_whose_clock_stands_comes_to_rest_without_a_corner() -> None:
    fine, at = np.arange(-0.02, 1.0, 0.001), 2.796
    poses, _ = REFERENCE.poses(at + np.minimum(fine, 0.0))
    speed = np.diff(poses[:, 1] + REFERENCE.way_on(at, np.maximum(fine, 0.0))[:, 1]) / 0.001
    assert speed[0] == pytest.approx(SPEED, rel=0.01)
    assert speed[-1] == pytest.approx(0.0)
    assert np.abs(np.diff(speed)).max() < 0.001 * 1.001 * STANDING_ACCELERATION


@pytest.mark.parametrize("at", [0.3, 0.996, 1.4, 1.8, 2.2, 2.6])
def test_a_tool_on_its_way_to_a_waypoint_comes_to_rest_before_it_without_a_corner(
    at: float,
) -> None:
    fine = np.arange(-0.02, 1.5, 0.001)
    poses = REFERENCE.poses(at + np.minimum(fine, 0.0))[0] + REFERENCE.way_on(at, fine.clip(0.0))
    speeds = np.diff(poses[:, :3], axis=0) / 0.001
    assert (
        np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() < 0.001 * 2.0 * STANDING_ACCELERATION
    )
    assert np.linalg.norm(speeds[-1]) < 1e-9
    end = REFERENCE.poses(np.array([min(t for t in REFERENCE.times if t > at)]))[0][0]
    # Towards the object, along z, it stays on its own side of the waypoint.
    assert poses[:, 2].max() < end[2] + 0.0005


def test_a_tool_that_does_not_travel_yet_stands_at_once() -> None:
    assert np.abs(REFERENCE.way_on(0.0, np.array((0.0, 0.5, 9.0)))).max() < 1e-7


def test_before_and_after_its_ends_the_programme_stays_with_them() -> None:
    early, _ = REFERENCE.poses(np.array((-1.0,)))
    first, _ = REFERENCE.poses(np.zeros(1))
    assert np.allclose(early, first)
    assert np.allclose(first[0], REFERENCE.rest)
    _, late = REFERENCE.poses(np.array((END, END + 3.0)))
    # The object goes on, and the tcp with it.
    assert np.allclose(late[0], late[1])


@settings(max_examples=30, deadline=None)
@given(st.lists(times, min_size=1, max_size=20))
def test_many_times_are_what_they_are_one_by_one(some: list[float]) -> None:
    rising = sorted(some)
    together, relative = REFERENCE.poses(np.array(rising))
    singly = [REFERENCE.poses(np.array((t,))) for t in rising]
    assert np.allclose(together, np.concatenate([pose for pose, _ in singly]))
    assert np.allclose(relative, np.concatenate([pose for _, pose in singly]))


@pytest.mark.parametrize(
    ("time", "phase"),
    [
        (0.0, Phase.APPROACH),
        (4.6, Phase.APPROACH),
        (5.999, Phase.APPROACH),
        (6.0, Phase.CONTACT),
        (8.5, Phase.SCREWS),
        (14.5, Phase.CONTACT),
        (15.0, Phase.RETREAT),
        (17.5, Phase.DONE),
        (99.0, Phase.DONE),
    ],
)
def test_a_phase_is_that_of_the_stretch_behind_its_waypoint(time: float, phase: Phase) -> None:
    assert REFERENCE.phase(time) is phase


def test_phases_begin_where_the_task_says() -> None:
    assert REFERENCE.time_of(Phase.CONTACT) == 6.0
    assert REFERENCE.time_of(Phase.RETREAT) == 15.0
    assert REFERENCE.time_of(Phase.SCREWS, Phase.DONE) == 8.5
    assert REFERENCE.time_of(Phase.WAIT) == float("inf")


def test_contact_is_where_the_programmed_distance_crosses_zero() -> None:
    t = REFERENCE.contact_time
    assert 5.7 < t < 5.9
    _, relative = REFERENCE.poses(np.array((t - 1e-3, t + 1e-3)))
    assert relative[0, 2] < 0.0 < relative[1, 2]


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
@pytest.mark.parametrize("limit", [math.inf, 2.796])
def test_a_slice_of_the_table_is_the_reference_at_those_times(cycle_s: float, limit: float) -> None:
    table = tabulated(REFERENCE, cycle_s, 42)
    for time in (0.0, 2.748, 5.904, 14.4, END + 0.3):
        first = round(time / cycle_s) * cycle_s
        times = np.minimum(first + np.arange(43) * cycle_s, limit)
        for found, known in zip(table.ahead(first, limit, 42), REFERENCE.poses(times), strict=True):
            assert np.allclose(found, known, atol=1e-9)


def test_the_clock_stands_at_the_last_whole_step_before_a_gate() -> None:
    assert last_step(2.8, 0.012) == pytest.approx(2.796)
    assert last_step(2.8, 0.004) == pytest.approx(2.8)
    assert last_step(math.inf, 0.012) == math.inf


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, END), st.sets(st.sampled_from(list(Gate))))
def test_no_gate_is_passed_that_is_not_open(time: float, opened: set[Gate]) -> None:
    limit = barrier(REFERENCE, time, frozenset(opened))
    closed = [
        point.time
        for point in TASK.waypoints
        if point.gate is not Gate.NONE and point.gate not in opened and point.time >= time - 1e-9
    ]
    assert limit == min(closed, default=float("inf"))


def test_the_clock_waits_at_a_gate_to_the_last_step() -> None:
    """A clock a rounding before its gate stands, and one a rounding behind it stands too."""
    for time in (2.8 - 1e-12, 2.8, 2.8 + 1e-12):
        assert barrier(REFERENCE, time, frozenset({Gate.OBJECT_CLOSE})) == 2.8


@pytest.mark.parametrize("times", [(0.0, 0.0), (1.0, 0.5)])
def test_times_that_do_not_rise_are_refused(times: tuple[float, float]) -> None:
    points = tuple(
        replace(point, time=time) for point, time in zip(TASK.waypoints[:2], times, strict=True)
    )
    with pytest.raises(ValueError, match="times must rise"):
        compile_reference(replace(TASK, waypoints=points))


def test_a_nominal_pose_that_does_not_look_along_the_conveyor_is_refused() -> None:
    crooked = replace(TASK.object, nominal=PoseFile(TASK.object.nominal.position))
    compile_reference(replace(TASK, object=crooked))
    turned = replace(
        TASK.object, nominal=PoseFile(TASK.object.nominal.position, (0.7071, 0.0, 0.0, 0.7071))
    )
    with pytest.raises(ValueError, match=r"conveyor\.axis"):
        compile_reference(replace(TASK, object=turned))


def test_a_turned_programme_is_known_to_be_one() -> None:
    assert not REFERENCE.turned
    assert compile_reference(turned_task(0.1)).turned


def test_the_tool_is_damped_until_it_touches_and_again_once_it_has_left() -> None:
    touch, leave, blend = REFERENCE.contact_time, 15.0, 0.06
    instants = np.array(
        (0.0, touch - blend, touch, touch + CONTACT_SHARE * blend, leave, leave + blend)
    )
    shares = free_table(REFERENCE, leave, blend, instants)
    assert shares == pytest.approx((1.0, 1.0, CONTACT_SHARE, 0.0, 0.0, 1.0), abs=1e-9)
    around = free_table(REFERENCE, leave, blend, touch + np.linspace(-0.1, 0.1, 41))
    assert (np.diff(around) <= 0.0).all()
