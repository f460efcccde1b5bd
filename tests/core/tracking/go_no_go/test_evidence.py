"""Evidence of go or no-go: what the camera has seen since a change of the conveyor's class."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from linemate.daemon.core import parameters
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate, Motion
from linemate.daemon.core.tracking.estimation.prediction_error import (
    DISTANCE_S,
    LeadMonitor,
    PredictionMonitor,
)
from linemate.daemon.core.tracking.estimation.step_measurements import distance_rows
from linemate.daemon.core.tracking.go_no_go import evidence
from linemate.daemon.core.tracking.go_no_go.decision import (
    DEVIATIONS,
    LOOK_S,
    GoEvidence,
    GoOrder,
    GoState,
    Reason,
    Zone,
)
from linemate.daemon.core.tracking.go_no_go.target_shift import TargetShift
from linemate.daemon.core.tracking.goal.rest_state import at_rest
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.touch.contact import ContactState
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState
from linemate.protocol.stamped_samples import DistanceSample
from linemate.simulators.harness.setup import Setup
from linemate.simulators.plants.scenario import Scenario

T0_NS = 12_000_000
IMAGE_NS = 36_000_000
UNKNOWN = 0.4  # of a sway that was not identified [s^2]
RUNS = ConveyorEstimate(0.0, 0.1, 0.0, 1e-4, 1e-3, Motion.RUNNING, unknown_sway=UNKNOWN)
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


def test_a_look_is_due_only_if_the_unknown_sway_can_be_larger_than_tolerated(
    tracker: Tracker,
) -> None:
    state = stepped(tracker, seen_running(tracker), STOPS, 0.1, sees=False)
    limit = tracker.task.guard.tolerance / DEVIATIONS / tracker.task.conveyor.deceleration
    assert evidence.is_look_due(tracker, state, replace(STOPS, unknown_sway=1.01 * limit))
    assert not evidence.is_look_due(tracker, state, replace(STOPS, unknown_sway=0.99 * limit))
    # A start is gentler.
    state = stepped(tracker, seen_running(tracker), STARTS, 0.1, sees=False)
    assert not evidence.is_look_due(tracker, state, replace(STARTS, unknown_sway=1.01 * limit))


@pytest.mark.parametrize(
    ("motion", "counts"),
    [
        (Motion.RUNNING, True),
        (Motion.STANDING, False),  # a start moves the object by 1.6 mm in the time
        (Motion.STOPPING, True),
        (Motion.STARTING, True),
    ],
)
def test_a_tentative_change_counts_if_it_moves_the_object_beyond_the_tolerance(
    tracker: Tracker, motion: Motion, counts: bool
) -> None:
    pose = PoseMeasurement(np.array((2.2, 0.0, 1.1)), np.eye(3), 0.0, np.full(6, 1e-8))
    young = tracker.transverse.initial([pose])
    state = replace(at_rest(tracker, np.zeros(6), 0.0), transverse=young)
    view = replace(RUNS, motion=motion, tentative=True)
    assert evidence.gather(tracker, state, view, 0).tentative is counts


def test_a_target_that_is_not_yet_at_the_estimate_counts_as_off(tracker: Tracker) -> None:
    pose = PoseMeasurement(np.array((2.2, 0.0, 1.1)), np.eye(3), 0.0, np.full(6, 1e-8))
    young = tracker.transverse.initial([pose])
    state = replace(at_rest(tracker, np.zeros(6), 0.0), transverse=young)
    shifted = replace(state, shift=TargetShift(-0.02, 0.0))
    assert evidence.gather(tracker, shifted, RUNS, 0).following == pytest.approx(0.02)
    assert evidence.gather(tracker, state, RUNS, 0).following == 0.0


def test_what_is_seen_of_a_robot_that_does_not_track_counts(tracker: Tracker) -> None:
    state = at_rest(tracker, np.zeros(6), 0.0)
    for k in range(1, 100):
        now_ns = k * T0_NS
        state = evidence.note(tracker, replace(state, pose_ns=now_ns), STOPS)
    assert state.steady_s > 1.0
    assert not evidence.is_look_due(tracker, state, STOPS)


@pytest.mark.parametrize("period_ns", [1_000_000, 4_000_000, 12_000_000, 24_000_000])
def test_the_mean_error_of_the_distance_has_the_same_time_constant_at_any_rate(
    tracker: Tracker, period_ns: int
) -> None:
    stamps = tuple(range(-(10**9), 2 * 10**9, 36_000_000))
    lead = LeadMonitor(stamps, (np.zeros(6),) * len(stamps), (0.0,) * len(stamps))
    state = replace(at_rest(tracker, np.zeros(6), 0.0), monitor=PredictionMonitor((lead, lead)))
    off = tracker.task.conveyor.start_position - tracker.reference.origin[1] + 0.001
    for now_ns in range(T0_NS, round(1e9 * DISTANCE_S) + T0_NS, T0_NS):
        first = (now_ns - T0_NS) // period_ns + 1
        due = range(first * period_ns, now_ns + 1, period_ns)
        readings = tuple(DistanceSample(ns, off, 1.0) for ns in due)
        samples = StepSamples(now_ns, None, now_ns, readings, (), (), 0)
        _, noise = distance_rows(tracker, state, samples)
        state = replace(state, distance_noise=noise)
        state = evidence._compare_distances(tracker, state, samples)
    share = 1.0 - math.exp(-1.0)
    assert state.monitor.distance == pytest.approx(0.001 * share, rel=0.15)


def changed(tracker: Tracker, view: ConveyorEstimate, what: str) -> TrackerState:
    """Return the state of the step in which a start was decided so."""
    started = evidence.note(tracker, seen_running(tracker), STARTS)
    return evidence.note(tracker, started, replace(view, events=(("start", what),)))


@pytest.mark.parametrize("view", [RUNS, STOPS])
def test_a_change_that_is_taken_back_counts_for_longer(
    tracker: Tracker, view: ConveyorEstimate
) -> None:
    state = changed(tracker, view, "cancelled")
    assert state.steady_s == -evidence.TAKEN_BACK_S
    assert stepped(tracker, state, view, 0.6, sees=True).steady_s < 0.0
    assert changed(tracker, STOPS, "confirmed").steady_s == 0.0


def test_a_tentative_change_that_is_taken_back_is_none(tracker: Tracker) -> None:
    state = seen_running(tracker)
    later = evidence.note(tracker, state, replace(RUNS, events=(("stop", "cancelled"),)))
    assert later.steady_s > state.steady_s


def test_the_end_of_a_start_is_no_change(tracker: Tracker) -> None:
    started = evidence.note(tracker, seen_running(tracker), STARTS)
    assert evidence.note(tracker, started, RUNS).steady_s > started.steady_s


def test_a_prediction_is_certain_if_neither_covariance_nor_a_change_speaks_against_it(
    tracker: Tracker,
) -> None:
    pose = PoseMeasurement(np.array((2.2, 0.0, 1.1)), np.eye(3), 0.0, np.full(6, 1e-8))
    young = tracker.transverse.initial([pose])
    state = replace(at_rest(tracker, np.zeros(6), 0.0), transverse=young)
    assert not evidence.is_certain(tracker, state, RUNS, 1.5)
    sure = replace(state, transverse=replace(young, P=1e-4 * young.P))
    assert evidence.is_certain(tracker, sure, RUNS, 1.5)
    assert not evidence.is_certain(tracker, sure, replace(RUNS, deviation=0.0011), 1.5)
    assert not evidence.is_certain(tracker, sure, replace(RUNS, speed_deviation=0.005), 1.5)
    assert not evidence.is_certain(tracker, sure, replace(RUNS, confidence=3.1), 1.5)
    assert evidence.is_certain(tracker, sure, replace(RUNS, confidence=2.9), 1.5)


@pytest.mark.parametrize(
    ("distance", "felt", "may_back"),
    [
        (-0.02, ContactState(), True),
        (-0.004, ContactState((0.0, 1.0)), True),
        (-0.004, ContactState((0.0, 30.0), touches=1), False),
        (-0.004, ContactState(), False),
        (-0.012, ContactState((0.0, 30.0), doubtful=True), False),
    ],
)
def test_a_tool_near_the_object_backs_off_if_it_feels_that_nothing_touches(
    tracker: Tracker, distance: float, felt: ContactState, may_back: bool
) -> None:
    state = replace(at_rest(tracker, np.zeros(6), 0.0), distance=distance, contact_state=felt)
    assert evidence._may_back(state) is may_back


def test_the_newer_of_distance_and_camera_is_the_age_of_the_position(tracker: Tracker) -> None:
    pose = PoseMeasurement(np.array((2.2, 0.0, 1.1)), np.eye(3), 0.0, np.full(6, 1e-8))
    state = replace(
        at_rest(tracker, np.zeros(6), 0.0), transverse=tracker.transverse.initial([pose])
    )
    now_ns = 2_000_000_000
    for pose_ns, blind_s, age_s in ((None, 0.3, 0.3), (now_ns - 100_000_000, 0.3, 0.1)):
        state = replace(state, pose_ns=pose_ns, blind_s=blind_s)
        found = evidence.gather(tracker, state, RUNS, now_ns)
        assert found.position_s == pytest.approx(age_s)


def test_a_reason_that_has_ended_keeps_its_words_while_it_is_waited_out(
    tracker: Tracker, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = GoEvidence(0.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0, 0.0, True, 0.1)
    monkeypatch.setattr(evidence, "gather", lambda *_: changes)
    pose = PoseMeasurement(np.array((2.2, 0.0, 1.1)), np.eye(3), 0.0, np.full(6, 1e-8))
    text = "object seen for 0.3 s since the conveyor's motion changed, 0.6 s needed"
    state = replace(
        at_rest(tracker, np.zeros(6), 0.0),
        transverse=tracker.transverse.initial([pose]),
        started=True,
        time=0.5 * (tracker.sight_time + tracker.near_time),
        go=GoState(GoOrder.STAND, (Reason.UNSEEN,), text),
    )
    assert evidence.zone(tracker, state) is Zone.MIDDLE  # where a change of class is no reason
    state = evidence.decide(tracker, state, RUNS, StepSamples(T0_NS, None, T0_NS, (), (), (), 0))
    assert state.go.reasons == (Reason.UNSEEN,)
    assert state.go.text == text
