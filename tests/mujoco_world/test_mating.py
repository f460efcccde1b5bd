"""Course of the assembly in the MuJoCo station, without MuJoCo."""

from dataclasses import replace

import pytest

from linemate.simulators.mujoco_world.frame_poses import Vec
from linemate.simulators.mujoco_world.mating import (
    FIX_SCREWS,
    RELEASE_WHEEL,
    SCREWS_FIXED,
    WHEEL_RELEASED,
    BoltMating,
    MatingPoses,
)
from linemate.simulators.mujoco_world.mujoco_cell import Tool

DT = 0.001
FAR = (0.0, 0.0, -0.05)
SEATED = NO_TURN = (0.0, 0.0, 0.0)
AWAY = MatingPoses(
    tool=(*FAR, *NO_TURN), wheel=FAR, tool_in_wheel=SEATED, touch_n=0.0, mount_n=0.0, mount_nm=0.0
)
PRESSED = MatingPoses(
    tool=(*SEATED, *NO_TURN),
    wheel=SEATED,
    tool_in_wheel=SEATED,
    touch_n=50.0,
    mount_n=50.0,
    mount_nm=2.0,
)


def mating() -> BoltMating:
    return BoltMating(Tool(release_s=0.3))


def hold(course: BoltMating, now: MatingPoses, since: float, duration_s: float) -> float:
    """Let a situation last; return the time after it."""
    steps = round(duration_s / DT)
    for step in range(1, steps + 1):
        course.advance(since + step * DT, DT, now)
    return since + steps * DT


def release(course: BoltMating) -> float:
    """Fix the screws, then release the wheel; return the time after it."""
    course.order(FIX_SCREWS)
    t = hold(course, PRESSED, 0.0, 1.4)
    course.order(FIX_SCREWS | RELEASE_WHEEL)
    return hold(course, PRESSED, t, 0.4)


def test_a_wheel_that_touches_is_in_contact() -> None:
    course = mating()
    hold(course, AWAY, 0.0, 0.1)
    assert course.phase == "free"
    hold(course, PRESSED, 0.1, 0.1)
    assert course.phase == "clamped"
    assert course.impact is not None
    assert course.impact.time_s == pytest.approx(0.101)


def test_a_wheel_that_leaves_the_bolts_is_free_again() -> None:
    course = mating()
    t = hold(course, PRESSED, 0.0, 0.1)
    hold(course, AWAY, t, 0.1)
    assert course.phase == "free"


def test_screws_are_fixed_after_their_time_on_a_seated_wheel() -> None:
    course = mating()
    course.order(FIX_SCREWS)
    t = hold(course, PRESSED, 0.0, 1.2)
    assert not course.signals
    hold(course, PRESSED, t, 0.1)
    assert course.signals == SCREWS_FIXED


@pytest.mark.parametrize("wheel", [(0.002, 0, 0), (0, 0, -0.002)])
def test_screws_do_not_hold_a_wheel_that_is_not_seated(wheel: Vec) -> None:
    course = mating()
    course.order(FIX_SCREWS)
    hold(course, replace(PRESSED, wheel=wheel), 0.0, 3.0)
    assert not course.signals


def test_a_wheel_is_released_once_the_gripper_is_open() -> None:
    course = mating()
    course.order(FIX_SCREWS)
    t = hold(course, PRESSED, 0.0, 1.4)
    course.order(FIX_SCREWS | RELEASE_WHEEL)
    t = hold(course, PRESSED, t, 0.25)
    assert course.is_gripped
    hold(course, PRESSED, t, 0.1)
    assert course.signals == SCREWS_FIXED | WHEEL_RELEASED
    assert course.collision is None


def test_a_wheel_without_screws_drops() -> None:
    course = mating()
    course.order(RELEASE_WHEEL)
    hold(course, PRESSED, 0.0, 0.4)
    assert course.collision is not None
    assert "dropped" in course.collision.reason


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mount_n": 401.0}, "mount overloaded: 401 N"),
        ({"touch_n": 2600.0}, "pressed with 2600 N"),
        ({"wheel": (0.0, 0.007, -0.010)}, "missed the bolts: 7.0 mm"),
        ({"mount_nm": 81.0}, "mount overloaded: 81 Nm"),
    ],
)
def test_a_collision_is_what_no_mount_and_no_bolt_survives(
    change: dict[str, object], words: str
) -> None:
    course = mating()
    hold(course, replace(PRESSED, **change), 0.0, 0.01)  # type: ignore[arg-type]
    assert course.collision is not None
    assert words in course.collision.reason
    assert course.collision.time_s == pytest.approx(DT)


def test_an_empty_gripper_that_is_caught_in_the_wheel_is_a_collision() -> None:
    course = mating()
    t = release(course)
    assert course.phase == "released"
    assert course.collision is None
    hold(course, replace(PRESSED, tool_in_wheel=(0.0, 0.021, 0.0)), t, 0.01)
    assert course.collision is not None


def test_an_empty_gripper_that_is_clear_may_go_anywhere() -> None:
    course = mating()
    t = release(course)
    t = hold(course, replace(PRESSED, tool_in_wheel=(0.0, 0.0, -0.02)), t, 0.01)
    hold(course, replace(PRESSED, tool_in_wheel=(0.0, 0.2, 0.0)), t, 0.01)
    assert course.collision is None
