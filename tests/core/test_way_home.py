"""The way home: straight away from the objects' plane, then along it, within every limit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cell import TASK, World, parameters
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from linemate.daemon.commissioning.rehearsal import rehearse
from linemate.daemon.core import way_home
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.parameters import build
from linemate.daemon.core.step import REST_DISTANCE, home_refusal
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import WayHome

P = parameters()
T0 = P.cycle_s
SETTINGS = WayHome()
REST = P.tracker.reference.rest
PLANE = float(P.tracker.reference.origin[2])


def retreated() -> World:
    """A robot that was ordered to retreat before contact, and stands where that ended."""
    world = World(P)
    world.run(1.2)
    world.step(MotionOrder.TRACK, start=True)
    for _ in range(300):
        world.step(MotionOrder.TRACK)
    for _ in range(80):
        world.step(MotionOrder.RETREAT)
    world.run(1.0)
    return world


@pytest.fixture(scope="module")
def stood() -> World:
    return retreated()


def blocked(world: World) -> str | None:
    assert world.outputs is not None
    return home_refusal(world.state, world.outputs, P)


def go_home(world: World, most_s: float = 30.0) -> list[Any]:
    outputs = []
    for _ in range(round(most_s / T0)):
        outputs.append(world.step(MotionOrder.HOME))
        if outputs[-1].finished:
            return outputs
    raise AssertionError("the way home has no end")


def places(outputs: list[Any]) -> np.ndarray:
    """Commanded tcp (m, 6) in c."""
    arm, nominal = P.controller.arm, P.tracker.reference.nominal
    return np.array([arm.tcp_in(nominal, np.array(each.command)) for each in outputs])


def test_a_robot_that_has_retreated_comes_home_and_may_be_armed_again(stood: World) -> None:
    world = stood.fork()
    before = world.run(0.1)
    assert before.ready is not None
    assert "Order home" in before.ready
    assert blocked(world) is None
    go_home(world)
    after = world.run(0.5)
    assert after.ready is None
    assert np.allclose(after.command, P.home, atol=1e-6)
    assert not world.state.moving


def test_the_way_home_keeps_its_speed_and_every_limit_of_the_axes(stood: World) -> None:
    outputs = go_home(stood.fork())
    assert all(each.held is None for each in outputs)
    commands = np.array([each.command for each in outputs])
    for order, limit in enumerate((P.controller.limits.speed, P.controller.limits.acceleration), 1):
        changes = np.diff(commands, order, axis=0) / T0**order
        assert (np.abs(changes) <= limit).all()
    speeds = np.linalg.norm(np.diff(places(outputs)[:, :3], axis=0), axis=1) / T0
    # The inverse of the servos asks for more than the tcp does.
    assert speeds.max() <= 1.05 * SETTINGS.speed


def test_the_way_home_never_comes_nearer_to_the_objects_than_its_begin(stood: World) -> None:
    tcp = places(go_home(stood.fork()))
    assert (tcp[:, 2] <= max(tcp[0, 2], REST[2]) + 1e-4).all()
    # It leaves the object before it travels along the line.
    travelling = np.abs(tcp[:, 1] - tcp[0, 1]) > 0.002
    assert (tcp[travelling, 2] <= max(REST[2], min(tcp[0, 2], REST[2])) + 2e-3).all()


def test_a_tool_before_the_object_is_refused_the_way_home() -> None:
    world = World(P)
    world.run(1.2)
    world.step(MotionOrder.TRACK, start=True)
    while (world.outputs is None) or (world.outputs.task_time or 0.0) < 4.6:
        world.step(MotionOrder.TRACK)
    world.run(1.0)
    assert "before the object's plane" in str(blocked(world))


def test_a_robot_in_motion_or_on_the_object_is_refused_the_way_home() -> None:
    world = World(P)
    world.run(1.2)
    world.step(MotionOrder.TRACK, start=True)
    for _ in range(150):
        world.step(MotionOrder.TRACK)
    assert blocked(world) == "the robot still moves"


def test_an_object_that_is_nearer_than_the_nominal_one_counts() -> None:
    tcp = np.zeros(6)
    assert way_home.refusal(tcp, (0.1, 0.1), SETTINGS) is None
    assert way_home.refusal(tcp, (0.1, 0.07), SETTINGS) is not None
    assert way_home.refusal(tcp, (0.07, 0.1), SETTINGS) is not None


def test_a_stop_on_the_way_brakes_and_a_second_way_begins_from_there(stood: World) -> None:
    world = stood.fork()
    for _ in range(150):
        world.step(MotionOrder.HOME)
    stopped = world.run(1.5)
    assert blocked(world) is None
    assert stopped.ready is not None
    assert not world.state.moving
    go_home(world)
    assert world.run(0.5).ready is None


def test_a_task_after_the_way_home_runs_as_the_first_one(stood: World) -> None:
    world = stood.fork()
    go_home(world)
    world.run(0.5)
    outputs = world.step(MotionOrder.TRACK, start=True)
    assert outputs.task_time is not None
    assert world.state.path is None


def poses(low: float, high: float) -> st.SearchStrategy[np.ndarray]:
    numbers = st.floats(low, high, allow_nan=False)
    rounded = st.tuples(*[numbers] * 3, *[st.floats(-0.5, 0.5)] * 3).map(np.array)
    return rounded.map(lambda pose: np.round(pose, 9))


@settings(max_examples=60, deadline=None)
@given(begin=poses(-1.5, 1.5), end=poses(-1.5, 1.5), rail=st.floats(-2.0, 2.0))
def test_any_path_is_continuous_bounded_and_ends_where_it_should(
    begin: np.ndarray, end: np.ndarray, rail: float
) -> None:
    path = way_home.plan_path(begin, end, (0.0, rail), SETTINGS, 9)
    count = round(sum(path.times) / T0) + 60
    way = way_home.poses_ahead(path, T0, count)
    axis = way_home.rail_ahead(path, T0, count)
    assert (way[:9] == begin).all()  # what is committed stands
    assert np.allclose(way[-1], end)
    assert axis[-1] == pytest.approx(rail)
    speed = np.linalg.norm(np.diff(way[:, :3], axis=0), axis=1) / T0
    bend = np.linalg.norm(np.diff(way[:, :3], 2, axis=0), axis=1) / T0**2
    assert speed.max() <= SETTINGS.speed + 1e-9
    assert bend.max() <= SETTINGS.acceleration + 1e-6
    assert np.abs(np.diff(axis)).max() <= SETTINGS.speed * T0 + 1e-9
    assert way[:, 2].max() <= max(begin[2], end[2]) + 1e-12
    later = way_home.poses_ahead(_advanced(path, 5), T0, count)
    assert (later[:-5] == way[5:]).all()


def _advanced(path: way_home.HomePath, steps: int) -> way_home.HomePath:
    return structs.replace(path, steps=path.steps + steps)


def test_the_first_pose_must_keep_its_distance_to_the_objects() -> None:
    near = replace(TASK.file, home=WayHome(clearance=0.5))
    compiled = build(near, TASK.urdf, TrackingSettings(), ControlSettings(), T0)
    complaint, end = rehearse(compiled).complaints
    assert "the task ends 300 mm before the object's plane, at least 500 mm" in end.what
    assert complaint.path == ("waypoints", 0)
    assert "400 mm" in complaint.what
    assert abs(PLANE - REST[2]) == pytest.approx(0.4, abs=REST_DISTANCE)
