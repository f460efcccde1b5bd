"""Search for the angle of bolts that do not enter."""

import numpy as np
import pytest

from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.touch import bolt_search
from linemate.daemon.core.tracking.touch.bolt_search import (
    LASTING_S,
    NO_BOLT_SEARCH,
    TURN_S,
    TURNS,
    BoltSearch,
)

LENGTH, OVERLOAD, SPREAD, DT = 0.025, 350.0, 0.02, 0.012


@pytest.mark.parametrize(
    ("force", "distance", "jams"),
    [
        ((5.0, -20.0, -90.0), -0.022, True),
        ((60.0, -30.0, -80.0), -0.022, False),  # a chamfer draws the bolts in
        ((60.0, -30.0, -110.0), -0.022, True),  # too much for one
        ((0.0, 0.0, -40.0), -0.022, False),
        ((0.0, 0.0, 90.0), -0.022, False),
        ((0.0, 0.0, -90.0), -0.002, False),  # the face
        ((0.0, 0.0, -90.0), -0.050, False),  # nothing is there to touch
    ],
)
def test_a_force_along_the_axis_alone_at_the_tips_is_a_jam(
    force: tuple[float, float, float], distance: float, jams: bool
) -> None:
    assert bolt_search.is_jammed(force, LENGTH, distance, OVERLOAD) is jams
    assert not bolt_search.is_jammed(force, 0.0, distance, OVERLOAD)


@pytest.mark.parametrize(("distance", "clear"), [(-0.029, False), (-0.031, True)])
def test_the_tips_are_clear_of_the_object_beyond_their_length(distance: float, clear: bool) -> None:
    assert bolt_search.is_clear(LENGTH, distance) is clear


@pytest.mark.parametrize(
    ("force", "distance", "presses"),
    [
        ((30.0, 0.0, -30.0), -0.022, True),
        ((60.0, 0.0, -20.0), -0.022, False),  # bolts that rub in their holes
        ((0.0, 0.0, -14.0), -0.022, False),
        ((0.0, 0.0, 90.0), -0.022, False),
        ((0.0, 0.0, -30.0), -0.002, False),  # the face
    ],
)
def test_tips_press_by_more_than_bolts_rub_in_their_holes(
    force: tuple[float, float, float], distance: float, presses: bool
) -> None:
    assert bolt_search.is_pressed(force, LENGTH, distance, 15.0) is presses


def pressed(seconds: float) -> BoltSearch:
    search = NO_BOLT_SEARCH
    for _ in range(round(seconds / DT)):
        search = bolt_search.pressing(search, DT, presses=True)
        search = bolt_search.advanced(search, SPREAD, DT, jams=False, is_clear=False)
    return search


def test_a_force_at_the_tips_that_lasts_is_a_jam_however_small() -> None:
    assert not pressed(0.8 * LASTING_S).is_jammed
    assert pressed(1.2 * LASTING_S).is_jammed


def test_tips_that_slip_in_have_not_pressed_after_as_long() -> None:
    search = pressed(0.8 * LASTING_S)
    for _ in range(round(LASTING_S / DT)):
        search = bolt_search.pressing(search, DT, presses=False)
    assert search == NO_BOLT_SEARCH


def stepped(search: BoltSearch, seconds: float, *, is_clear: bool = True) -> BoltSearch:
    for _ in range(round(seconds / DT)):
        search = bolt_search.advanced(search, SPREAD, DT, jams=False, is_clear=is_clear)
    return search


def jammed(search: BoltSearch, spread: float = SPREAD) -> BoltSearch:
    return bolt_search.advanced(search, spread, DT, jams=True, is_clear=False)


def test_each_angle_is_tried_once_and_then_the_search_is_over() -> None:
    search, tried = NO_BOLT_SEARCH, [0.0]
    for _ in TURNS[1:]:
        search = jammed(search)
        assert search.is_jammed
        assert not search.is_over
        search = stepped(search, TURN_S + 2.0 * DT)
        assert not search.is_jammed
        tried.append(search.angle)
    assert tried == pytest.approx([turn * SPREAD for turn in TURNS])
    search = stepped(jammed(search), 2.0 * TURN_S)
    assert search.is_over


def test_the_tool_does_not_turn_while_its_tips_may_touch() -> None:
    search = stepped(jammed(NO_BOLT_SEARCH), 3.0, is_clear=False)
    assert search.is_jammed
    assert search.angle == 0.0


def test_bolts_whose_angle_is_known_are_tried_once() -> None:
    assert jammed(NO_BOLT_SEARCH, spread=0.0).is_over


def test_the_target_turns_about_the_tools_axis_without_a_jump() -> None:
    target = np.tile((1.0, -0.5, 2.0, 0.3, -0.2, 0.4), (4, 1))
    assert bolt_search.turned(target, NO_BOLT_SEARCH, np.zeros(4)) is target
    search = BoltSearch(tried=2, before=0.01, angle=-0.02, turning=0.0)
    span = np.array((0.0, 0.25, 0.5, 1.0)) * TURN_S
    turned = bolt_search.turned(target, search, span)
    assert (turned[:, :3] == target[:, :3]).all()
    own = rotations.exp_many(target[:, 3:]).transpose(0, 2, 1) @ rotations.exp_many(turned[:, 3:])
    assert rotations.log_many(own)[:, 2] == pytest.approx([0.01, 0.0079, -0.005, -0.02], abs=2e-4)
    assert rotations.log_many(own)[:, :2] == pytest.approx(np.zeros((4, 2)), abs=1e-9)


def test_an_object_felt_by_a_turned_tool_keeps_its_orientation() -> None:
    rotation = rotations.exp(np.array((0.3, -0.2, 0.4)))
    search = BoltSearch(tried=1, angle=0.01)
    pose = np.array([[0.0, 0.0, 0.0, 0.3, -0.2, 0.4]])
    tool = bolt_search.turned(pose, search, np.zeros(1))[0]
    felt = bolt_search.unturned(rotations.exp(tool[3:]), search)
    assert felt == pytest.approx(rotation, abs=1e-12)
