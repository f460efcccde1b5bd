"""The camera is corrected by where the object is felt, by nothing but a wheel's own steps."""

from functools import cache

import pytest
from msgspec import structs

from linemate.daemon.core import parameters
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.cycle.learning.touches import (
    FELT,
    LARGEST_M,
    LEAST_GAIN,
    REACH_M,
    TouchLearner,
)
from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.harness import lockstep, setup

MOUNT = (0.8e-3, -0.5e-3)  # of the camera, off the stated place across the tool's axis [m]


@cache
def wheel() -> tuple[LogEntry, ...]:
    """Return the steps of a wheel whose camera is not where it is stated to be."""
    x, y = MOUNT
    made = setup.make("wheel", [f"scenario.camera.effects.mount_offset=[{x}, {y}, 0.0]"])
    entries: list[LogEntry] = []
    lockstep.run(made, 0, on_step=entries.append)
    return tuple(entries)


def touch_of(entries: tuple[LogEntry, ...]) -> tuple[float, float] | None:
    learner = TouchLearner()
    for entry in entries:
        learner.record_touch([entry])
    return learner.touch


def test_a_wheel_shows_where_the_camera_is() -> None:
    touch = touch_of(wheel())
    assert touch is not None
    assert touch == pytest.approx(MOUNT, abs=0.3e-3)


def test_a_wheel_that_was_not_finished_shows_nothing() -> None:
    released = next(
        i
        for i, entry in enumerate(wheel())
        if entry.after is not None and Gate.WHEEL_RELEASED in entry.after.tracker.passed
    )
    assert touch_of(wheel()[: released - 1]) is None
    assert touch_of(wheel()[:released] + wheel()[-1:]) is None


def test_a_wheel_without_its_screws_shows_nothing() -> None:
    def unscrewed(entry: LogEntry) -> LogEntry:
        if entry.after is None:
            return entry
        tracker = entry.after.tracker
        tracker = structs.replace(tracker, passed=tracker.passed - {Gate.SCREWS_FIXED})
        return structs.replace(entry, after=structs.replace(entry.after, tracker=tracker))

    assert touch_of(tuple(map(unscrewed, wheel()))) is None


def kept(learner: TouchLearner, touch: tuple[float, float], present: tuple[float, float]) -> float:
    learner.touch = touch
    return learner.keep(present).get(FELT, present)[0]


def test_the_mean_of_the_touches_is_reached_and_held() -> None:
    learner, bias, value = TouchLearner(), 0.6e-3, 0.0
    for noise in (0.2e-3, -0.2e-3) * 10:
        value = kept(learner, (bias - value + noise, 0.0), (value, 0.0))
    assert value == pytest.approx(bias, abs=0.05e-3)


def test_a_value_learned_before_the_start_is_no_guess() -> None:
    assert kept(TouchLearner(), (1e-3, 0.0), (0.0, 0.0)) == pytest.approx(0.5e-3)
    assert kept(TouchLearner(), (1e-3, 0.0), (0.2e-3, 0.0)) < 0.4e-3


def test_a_far_touch_and_a_large_correction_are_refused() -> None:
    learner = TouchLearner()
    assert kept(learner, (1.1 * LARGEST_M, 0.0), (0.0, 0.0)) == 0.0
    for _ in range(round(10.0 * REACH_M / LARGEST_M / LEAST_GAIN)):
        value = kept(learner, (LARGEST_M, 0.0), (REACH_M - 1e-4, 0.0))
    assert value == REACH_M
    assert learner.keep((0.0, 0.0)) == {}


def test_the_correction_moves_the_object_that_the_camera_shows() -> None:
    plain = setup.make("wheel")
    corrected = setup.make("wheel", [f"{FELT}=[0.001, -0.002]"])
    built = lockstep.parameters_of(plain, 0.012)
    again = parameters.retuned(built, corrected.tracking)
    for made in (lockstep.parameters_of(corrected, 0.012), again):
        moved = made.tracker.camera[0] - built.tracker.camera[0]
        assert moved == pytest.approx((0.001, -0.002, 0.0))
