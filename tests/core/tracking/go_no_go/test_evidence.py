"""Evidence of go or no-go: what the camera has seen since a change of the conveyor's class."""

import math
from dataclasses import replace as other

import numpy as np
import pytest
from msgspec.structs import replace

from linemate.daemon.core import parameters
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate, Motion
from linemate.daemon.core.tracking.go_no_go import evidence
from linemate.daemon.core.tracking.go_no_go.decision import LOOK_S
from linemate.daemon.core.tracking.touch.contact import ContactState
from linemate.daemon.core.tracking.tracker import at_rest
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState
from linemate.simulators.harness.setup import Setup
from linemate.simulators.plants.scenario import Scenario

T0_NS = 12_000_000
IMAGE_NS = 36_000_000
RUNS = ConveyorEstimate(0.0, 0.1, 0.0, 1e-4, 1e-3, Motion.RUNNING)
STOPS = replace(RUNS, motion=Motion.STOPPING)
STARTS = replace(RUNS, motion=Motion.STARTING)


@pytest.fixture(scope="module")
def tracker() -> Tracker:
    cell = Setup(Scenario())
    return parameters.build(cell.task, cell.urdf, cell.tracking, cell.control, 0.012).tracker


def stepped(
    tracker: Tracker, state: TrackerState, view: ConveyorEstimate, seconds: float, *, sees: bool
) -> TrackerState:
    """Return the state after some time in which the camera sees the object, or does not."""
    for _ in range(round(seconds * 1e9 / T0_NS)):
        now_ns = (state.units[-1][0] if state.units else 0) + T0_NS
        state = replace(state, units=((now_ns, 0.0),))
        if sees and now_ns % IMAGE_NS == 0:
            state = replace(state, pose_ns=now_ns)
        samples = StepSamples(now_ns, None, now_ns, (), (), (), 0)
        state = evidence.decide(tracker, state, view, samples)
    return state


def seen_running(tracker: Tracker) -> TrackerState:
    return stepped(tracker, at_rest(tracker, np.zeros(6), 0.0), RUNS, 1.0, sees=True)


def test_nothing_has_to_be_seen_before_the_first_change(tracker: Tracker) -> None:
    assert seen_running(tracker).looked_s == math.inf


def test_a_stop_that_the_camera_does_not_see_has_to_be_looked_at(tracker: Tracker) -> None:
    state = stepped(tracker, seen_running(tracker), STOPS, 2.0, sees=False)
    assert state.looked_s == 0.0
    assert evidence.is_look_due(tracker, state, STOPS)
    state = stepped(tracker, state, STOPS, 0.5 * LOOK_S, sees=True)
    assert 0.0 < state.looked_s < LOOK_S
    assert evidence.is_look_due(tracker, state, STOPS)
    state = stepped(tracker, state, STOPS, LOOK_S, sees=True)
    assert not evidence.is_look_due(tracker, state, STOPS)


def test_the_time_without_images_does_not_count_as_seen(tracker: Tracker) -> None:
    state = stepped(tracker, seen_running(tracker), STOPS, 2.0, sees=False)
    state = stepped(tracker, state, STOPS, IMAGE_NS * 1e-9, sees=True)
    assert 0.0 < state.looked_s <= evidence.LONGEST_SPACING_S


def test_what_was_seen_of_a_stop_tells_of_a_start_but_not_the_reverse(tracker: Tracker) -> None:
    stopped = stepped(tracker, seen_running(tracker), STOPS, 1.0, sees=True)
    started = stepped(tracker, stopped, STARTS, 0.1, sees=False)
    assert started.looked_s == 0.0
    assert not evidence.is_look_due(tracker, started, STARTS)
    started = stepped(tracker, seen_running(tracker), STARTS, 1.0, sees=True)
    stopped = stepped(tracker, started, STOPS, 0.1, sees=False)
    assert evidence.is_look_due(tracker, stopped, STOPS)


def test_a_known_sway_or_a_stiff_hanger_needs_no_look(tracker: Tracker) -> None:
    state = stepped(tracker, seen_running(tracker), STOPS, 0.1, sees=False)
    assert not evidence.is_look_due(tracker, state, replace(STOPS, sway_known=True))
    sway = other(tracker.settings.sway, look=False)
    stiff = other(tracker, settings=other(tracker.settings, sway=sway))
    assert not evidence.is_look_due(stiff, state, STOPS)


@pytest.mark.parametrize(
    ("distance", "felt", "may_back"),
    [
        (-0.02, ContactState(), True),
        (-0.004, ContactState((0.0, 1.0)), True),
        (-0.004, ContactState((0.0, 30.0), touches=1), False),
        (-0.004, ContactState(), False),
    ],
)
def test_a_tool_near_the_object_backs_off_if_it_feels_that_nothing_touches(
    tracker: Tracker, distance: float, felt: ContactState, may_back: bool
) -> None:
    state = replace(at_rest(tracker, np.zeros(6), 0.0), distance=distance, contact_state=felt)
    assert evidence._may_back(state) is may_back
