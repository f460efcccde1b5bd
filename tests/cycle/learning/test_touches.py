"""The camera is corrected by where the object is felt, by nothing but a wheel's own steps."""

from functools import cache

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.core import parameters, rotations
from linemate.daemon.core.tracking.settings import CameraNoise
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.tracker_state import TrackerState
from linemate.daemon.cycle.learning.touches import (
    FELT,
    FELT_DEPTH,
    FELT_TURN,
    LARGEST_M,
    LARGEST_RAD,
    LEAST_GAIN,
    REACH_M,
    FeltError,
    TouchLearner,
)
from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.harness import lockstep, setup

MOUNT = (0.8e-3, -0.5e-3)  # of the camera, off the stated place across the tool's axis [m]
TILT = (1.5e-3, -2.0e-3)  # of it, off the stated turn about the tool's x and y [rad]


@cache
def wheel(error: str = "offset", off: tuple[float, float] = MOUNT) -> tuple[LogEntry, ...]:
    """Return the steps of a wheel whose camera is not where it is stated to be."""
    x, y = off
    made = setup.make("wheel", [f"scenario.camera.effects.mount_{error}=[{x}, {y}, 0.0]"])
    entries: list[LogEntry] = []
    lockstep.run(made, 0, on_step=entries.append)
    return tuple(entries)


def touch_of(entries: tuple[LogEntry, ...]) -> FeltError | None:
    learner = TouchLearner()
    for entry in entries:
        learner.record_touch([entry])
    return learner.touch


def test_a_wheel_shows_where_the_camera_is() -> None:
    touch = touch_of(wheel())
    assert touch is not None
    assert touch.across == pytest.approx(MOUNT, abs=0.1e-3)
    assert touch.turn == pytest.approx((0.0, 0.0), abs=0.3e-3)


@cache
def deeper(mass: float | None = None) -> tuple[LogEntry, ...]:
    """Return the steps of a wheel whose camera shows the object 1 mm too near to the tool."""
    changes = ["scenario.camera.effects.mount_offset=[0.0, 0.0, 0.001]"]
    if mass is not None:
        way = '"frequency_hz": 1.0, "damping": 0.02, "drive": 0.0'
        across = f'{{{way}, "mass": {mass}, "direction": [0.0, 0.0, 1.0]}}'
        changes.append(f"scenario.body.carrier=[{across}]")
    entries: list[LogEntry] = []
    lockstep.run(setup.make("wheel", changes), 0, on_step=entries.append)
    return tuple(entries)


@pytest.mark.parametrize(("mass", "depth"), [(None, 1e-3), (500.0, 0.0)])
def test_a_wheel_shows_how_deep_the_object_is_unless_the_press_moves_it(
    mass: float | None, depth: float
) -> None:
    touch = touch_of(deeper(mass))
    assert touch is not None
    assert touch.depth == pytest.approx(depth, abs=0.15e-3)


def test_the_depth_is_learned_as_the_rest_and_a_far_one_is_not() -> None:
    learner, present = TouchLearner(), CameraNoise()
    for depth in (1e-3, 1.1 * LARGEST_M):
        learner.touch = FeltError((1e-3, 0.0), (0.0, 0.0), depth)
        changed = learner.keep(present)
        assert (FELT_DEPTH in changed) == (depth < LARGEST_M)
        assert changed[FELT][0] > 0.3e-3
    learner.touch = FeltError((0.0, 0.0), (0.0, 0.0), 1e-3)
    assert learner.keep(CameraNoise(felt_depth=REACH_M - 1e-5))[FELT_DEPTH] == REACH_M


def test_what_bolts_in_their_holes_have_shown_before_the_touch_is_a_part_of_it() -> None:
    shown = (0.2e-3, 0.0)

    def held(state: TrackerState) -> TrackerState:
        return structs.replace(state, held=shown) if state.distance > -0.02 else state

    def drawn(entry: LogEntry) -> LogEntry:
        before, after = entry.before, entry.after
        if before is None or after is None:
            return entry
        before = structs.replace(before, tracker=held(before.tracker))
        return structs.replace(
            entry, before=before, after=structs.replace(after, tracker=held(after.tracker))
        )

    whole, plain = touch_of(tuple(map(drawn, wheel()))), touch_of(wheel())
    assert whole is not None
    assert plain is not None
    assert whole.across[0] - plain.across[0] == pytest.approx(shown[0], abs=0.03e-3)
    assert whole.across[1] - plain.across[1] == pytest.approx(0.0, abs=0.1e-3)


def test_a_wheel_shows_how_the_camera_is_turned() -> None:
    touch = touch_of(wheel("rotation", TILT))
    assert touch is not None
    assert touch.turn == pytest.approx(TILT, abs=0.3e-3)


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


def kept(
    learner: TouchLearner, off: float, present: float, turn: float = 0.0, turned: float = 0.0
) -> tuple[float, float]:
    """Return the first components of both corrections after a touch."""
    learner.touch = FeltError((off, 0.0), (turn, 0.0))
    camera = CameraNoise(felt=(present, 0.0), felt_turn=(turned, 0.0))
    changed = learner.keep(camera)
    return changed.get(FELT, camera.felt)[0], changed.get(FELT_TURN, camera.felt_turn)[0]


def test_the_mean_of_the_touches_is_reached_and_held() -> None:
    learner, bias, tilt, value, turned = TouchLearner(), 0.6e-3, -1.2e-3, 0.0, 0.0
    for noise in (0.2e-3, -0.2e-3) * 10:
        value, turned = kept(learner, bias - value + noise, value, tilt - turned - noise, turned)
    assert value == pytest.approx(bias, abs=0.05e-3)
    assert turned == pytest.approx(tilt, abs=0.05e-3)


def test_three_touches_take_most_of_an_error() -> None:
    learner, value = TouchLearner(), 0.0
    for _ in range(3):
        value, _ = kept(learner, 1e-3 - value, value)
    assert 0.8e-3 < value < 0.95e-3


def test_what_was_taken_back_is_learned_as_at_first() -> None:
    learner = TouchLearner()
    first = kept(learner, 1e-3, 0.0)
    kept(learner, 0.0, first[0])
    assert kept(learner, 1e-3, 0.0) == first


def test_a_value_learned_before_the_start_is_no_guess() -> None:
    assert kept(TouchLearner(), 1e-3, 0.0)[0] > 0.6e-3
    assert kept(TouchLearner(), 1e-3, 0.2e-3)[0] < 0.4e-3
    assert kept(TouchLearner(), 1e-3, 0.0, turned=1e-3)[0] < 0.2e-3


def test_a_far_touch_and_a_large_correction_are_refused() -> None:
    learner = TouchLearner()
    assert kept(learner, 1.1 * LARGEST_M, 0.0, turn=1e-3) == (0.0, 0.0)
    assert kept(learner, 1e-3, 0.0, turn=1.1 * LARGEST_RAD) == (0.0, 0.0)
    value = REACH_M - 1e-4
    for _ in range(round(10.0 * REACH_M / LARGEST_M / LEAST_GAIN)):
        value, _ = kept(learner, LARGEST_M, value)
    assert value == REACH_M
    assert learner.keep(CameraNoise()) == {}


def test_the_correction_moves_the_object_that_the_camera_shows() -> None:
    plain = setup.make("wheel")
    corrected = setup.make("wheel", [f"{FELT}=[0.001, -0.002]", f"{FELT_DEPTH}=0.0005"])
    built = lockstep.parameters_of(plain, 0.012)
    again = parameters.retuned(built, corrected.tracking)
    for made in (lockstep.parameters_of(corrected, 0.012), again):
        moved = made.tracker.camera[0] - built.tracker.camera[0]
        assert moved == pytest.approx((0.001, -0.002, 0.0005))


def test_a_turned_camera_turns_the_object_where_the_tool_touches_it() -> None:
    plain, corrected = (
        lockstep.parameters_of(setup.make("wheel", changes), 0.012).tracker.camera
        for changes in ((), (f"{FELT_TURN}=[0.001, -0.002]",))
    )
    turn = rotations.exp(np.array((0.001, -0.002, 0.0)))
    assert corrected[1] == pytest.approx(turn @ plain[1])
    # An object at the tcp stays there.
    seen = plain[1].T @ -plain[0]
    assert corrected[0] + corrected[1] @ seen == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
