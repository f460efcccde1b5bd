"""Task clock: its ramps before contact, and the wait for a calm contact before the release."""

import dataclasses as dc
from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from linemate.daemon.core import parameters
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking import merge, task_clock
from linemate.daemon.core.tracking.go_no_go import clock_ramp, evidence
from linemate.daemon.core.tracking.go_no_go.decision import GoOrder, GoState, Zone
from linemate.daemon.core.tracking.goal.programmed_poses import programmed_poses
from linemate.daemon.core.tracking.goal.rest_state import at_rest, rest
from linemate.daemon.core.tracking.reference import barrier, last_step
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch import contact, release
from linemate.daemon.core.tracking.tracker_state import StepSamples, Tracker, TrackerState
from linemate.simulators.harness import setup

SAMPLES = StepSamples(0, None, 0, (), (), (), 0)
CALM, SWINGS = 10.0, 80.0
FIXED = frozenset({Gate.OBJECT_CLOSE, Gate.OBJECT_SEEN, Gate.SCREWS_FIXED})


@cache
def compiled() -> Tracker:
    cell = setup.make("wheel")
    return parameters.build(cell.task, cell.urdf, cell.tracking, cell.control, 0.012).tracker


def on_the_object(before_s: float) -> TrackerState:
    """The state of a clamped tool whose wheel is released after some time."""
    tracker = compiled()
    steps = round((tracker.task.tool.release_wheel - before_s) / tracker.cycle_s)
    state = at_rest(tracker, np.zeros(6), 0.0)
    return replace(
        state, contact=True, started=True, passed=FIXED, blended=10.0, time=steps * tracker.cycle_s
    )


def later(
    state: TrackerState, seconds: float, rms: float, pull: float = 0.0, *, retreat: bool = False
) -> TrackerState:
    tracker = compiled()
    for _ in range(round(seconds / tracker.cycle_s)):
        complied = replace(state.compliance, power=rms**2)
        state = replace(state, compliance=complied, pull=(0.0, pull, -50.0))
        earlier = state.time
        state = task_clock.advance_clock(tracker, state, None, SAMPLES, retreat)
        assert state.time >= earlier
    return state


def test_a_calm_contact_is_released_on_time() -> None:
    state = later(on_the_object(0.3), 0.6, CALM)
    assert state.releasing is not None
    assert state.oscillated is None


@pytest.mark.parametrize(("rms", "pull"), [(SWINGS, 0.0), (CALM, 60.0)])
def test_a_wheel_is_not_released_while_the_object_swings_or_is_pulled_across(
    rms: float, pull: float
) -> None:
    state = later(on_the_object(0.3), 5.0, rms, pull)
    assert state.releasing is None
    assert state.oscillated is not None
    assert state.time < compiled().task.tool.release_wheel
    assert later(state, 0.1, CALM).releasing is not None


def test_an_open_clamp_waits_for_no_programmed_time() -> None:
    leaves = next(at for at, gate in compiled().reference.gated if gate is Gate.WHEEL_RELEASED)
    closed = on_the_object(-0.1)
    free = replace(closed, contact=False, passed=FIXED | {Gate.WHEEL_RELEASED})
    assert later(closed, 0.012, CALM).time < leaves - 0.3
    assert later(free, 0.012, CALM).time == pytest.approx(leaves, abs=0.012)
    # A retreat that opened the clamp before the programme's release leaves by its own way.
    early = replace(free, time=on_the_object(0.5).time)
    assert later(early, 0.012, CALM).time == pytest.approx(early.time, abs=0.013)


@pytest.mark.parametrize("retreat", [True, False])
def test_the_programmes_own_retreat_does_not_begin_in_a_retraction(*, retreat: bool) -> None:
    tracker = compiled()
    leaves = next(at for at, gate in tracker.reference.gated if gate is Gate.WHEEL_RELEASED)
    state = replace(on_the_object(0.3), contact=False, passed=FIXED | {Gate.WHEEL_RELEASED})
    state = later(state, leaves - state.time + 0.5, CALM, retreat=retreat)
    assert (state.time > leaves) is not retreat


def test_the_wait_for_a_calm_contact_ends() -> None:
    state = later(on_the_object(0.3), release.LONGEST_WAIT_S + 1.0, SWINGS)
    assert state.releasing is not None


def test_a_retreat_does_not_wait_for_a_calm_contact() -> None:
    state = later(on_the_object(0.3), 1.0, SWINGS)
    assert later(state, 0.024, SWINGS, retreat=True).releasing is not None


def test_a_retreat_after_the_release_does_not_change_how_the_press_goes() -> None:
    # A merge amplifies a change of what is committed: the tool went 1.8 mm deeper.
    released = later(on_the_object(0.02), 0.048, CALM)
    assert released.releasing is not None
    assert later(released, 0.024, CALM, retreat=True).unloading_s == release.UNLOADING_S
    retreats = later(on_the_object(0.3), 0.024, CALM, retreat=True)
    assert retreats.unloading_s == release.RETREAT_S


@pytest.mark.parametrize("released_after", [None, 0.1])
def test_a_retreat_from_free_space_keeps_the_clamp_closed(released_after: float | None) -> None:
    tracker = compiled()
    tool = dc.replace(tracker.task.tool, released_after=released_after)
    tracker = dc.replace(tracker, task=dc.replace(tracker.task, tool=tool))
    free = replace(on_the_object(0.3), contact=False, passed=SIGHT, time=0.0)
    for state, keeps in (
        (free, True),
        (replace(free, contact=True), False),
        (replace(free, releasing=0.0), False),
        (replace(free, contact_state=contact.ContactState(doubtful=True)), False),
    ):
        after = state
        for _ in range(50):
            after = task_clock.advance_clock(tracker, after, None, SAMPLES, True)
        assert after.keeps is keeps
        is_open = Gate.WHEEL_RELEASED in after.passed
        assert is_open is (released_after is not None and not keeps)
        # What stays closed after a retreat is opened once the tool is on an object.
        assert not rest(tracker, after, np.zeros(6), 0.0).keeps


def test_a_clamp_that_was_kept_closed_gets_its_time_to_open_from_a_late_touch_on() -> None:
    tracker = compiled()
    tool = dc.replace(tracker.task.tool, released_after=0.1)
    tracker = dc.replace(tracker, task=dc.replace(tracker.task, tool=tool))
    state = replace(on_the_object(0.3), contact=False, passed=SIGHT, time=0.0)
    for _ in range(50):
        state = task_clock.advance_clock(tracker, state, None, SAMPLES, True)
    state = replace(state, contact=True, touching=0.0)
    opened = []
    for _ in range(20):
        state = task_clock.advance_clock(tracker, state, None, SAMPLES, True)
        assert not state.keeps
        opened.append(Gate.WHEEL_RELEASED in state.passed)
    assert not any(opened[:8])
    assert opened[-1]


@pytest.mark.parametrize(
    ("clamps", "fixing", "is_fixed", "keeps"),
    [
        (False, None, False, True),
        (False, 0.1, False, False),
        (False, None, True, False),
        (True, None, False, False),
    ],
)
def test_a_part_that_the_tool_alone_carries_is_taken_off_the_object_again(
    fixing: float | None, *, clamps: bool, is_fixed: bool, keeps: bool
) -> None:
    tracker = compiled()
    tactile = dc.replace(tracker.settings.tactile, clamps=clamps)
    tracker = dc.replace(tracker, settings=dc.replace(tracker.settings, tactile=tactile))
    state = replace(on_the_object(0.3), passed=FIXED if is_fixed else SIGHT, fixing=fixing)
    for stood in (0.1, 0.0):
        # A robot that gets no commands withdraws later, and what it carries stays with it.
        state = replace(state, stood=stood)
        state = task_clock.advance_clock(tracker, state, None, SAMPLES, True)
        assert state.keeps is keeps
    assert (state.withdrawn is not None) is keeps


SIGHT = frozenset({Gate.OBJECT_CLOSE, Gate.OBJECT_SEEN})


@cache
def of_cycle(cycle_s: float) -> Tracker:
    cell = setup.make("wheel")
    return parameters.build(cell.task, cell.urdf, cell.tracking, cell.control, cycle_s).tracker


def on_the_way(tracker: Tracker, after_s: float) -> TrackerState:
    """The state of a tool that left the far gate some time ago."""
    steps = round((tracker.sight_time + after_s) / tracker.cycle_s)
    state = at_rest(tracker, np.zeros(6), 0.0)
    return replace(
        state, started=True, passed=SIGHT, blended=10.0, time=steps * tracker.cycle_s, distance=-1.0
    )


def ordered(
    tracker: Tracker, state: TrackerState, order: GoOrder, seconds: float
) -> list[TrackerState]:
    """The states of each step with an order."""
    states = [state]
    for _ in range(round(seconds / tracker.cycle_s)):
        state = replace(states[-1], go=GoState(order))
        states.append(task_clock.advance_clock(tracker, state, None, SAMPLES, False))
    return states[1:]


def ways(tracker: Tracker, states: list[TrackerState]) -> Array:
    """The programmed tcp along the object's axis at each step [m]."""
    times = np.array([state.time / tracker.cycle_s for state in states])
    return tracker.table.between(times)[1][:, 2]


@pytest.mark.parametrize("cycle_s", [0.004, 0.012])
@pytest.mark.parametrize("order", [GoOrder.STAND, GoOrder.BACK])
def test_a_no_go_on_the_way_slows_the_tool_down_with_a_bounded_acceleration(
    cycle_s: float, order: GoOrder
) -> None:
    tracker = of_cycle(cycle_s)
    before = ordered(tracker, on_the_way(tracker, 0.2), GoOrder.GO, 0.2)
    after = ordered(tracker, before[-1], order, 2.0)
    way = ways(tracker, before + after)
    acceleration = np.diff(way, 2) / cycle_s**2
    # The programme has an acceleration of its own, at either rate.
    own = np.abs(np.diff(tracker.table.relative[:, 2], 2)).max() / cycle_s**2
    assert np.abs(acceleration).max() <= clock_ramp.ACCELERATION + own
    end = tracker.sight_time if order is GoOrder.BACK else after[-1].time
    assert after[-1].time == pytest.approx(last_step(end, cycle_s))
    assert after[-1].time < before[-1].time + 0.5


@pytest.mark.parametrize("cycle_s", [0.004, 0.008, 0.012])
@pytest.mark.parametrize("order", [GoOrder.STAND, GoOrder.BACK])
@pytest.mark.parametrize("seconds", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
def test_a_plan_stays_on_the_programme_as_the_clock_changes_its_rate(
    cycle_s: float, order: GoOrder, seconds: float
) -> None:
    tracker = of_cycle(cycle_s)
    before = ordered(tracker, on_the_way(tracker, 0.4), GoOrder.GO, 0.1)
    states = ordered(tracker, before[-1], order, seconds)
    states += ordered(tracker, states[-1], GoOrder.GO, 0.5)
    plan, off = tracker.merge_free, []
    ahead = np.arange(tracker.steps + 1.0)
    poses = tracker.table.between(before[-1].time / cycle_s + ahead)[1]
    for state in states:
        times = task_clock.programme_times(tracker, state)
        goal = tracker.table.between(state.time / cycle_s + ahead if times is None else times)[1]
        poses, _ = merge.merge(poses, goal, plan)
        off.append(np.abs(poses - goal)[:, 2].max())
    # A ramp that began a step earlier moved the plan by 67 mm at 4 ms.
    assert max(off) < 3e-4


def test_the_ramp_takes_as_long_at_every_cycle() -> None:
    ends = []
    for cycle_s in (0.002, 0.004, 0.012):
        tracker = of_cycle(cycle_s)
        states = ordered(tracker, on_the_way(tracker, 0.4), GoOrder.STAND, 1.0)
        committed = (tracker.commit + 1) * cycle_s
        ends.append(states[-1].time - states[0].time - committed)
    assert max(ends) - min(ends) < 0.03


@pytest.mark.parametrize("order", [GoOrder.STAND, GoOrder.BACK])
def test_what_is_committed_stays_on_the_programme_as_the_clock_changes(order: GoOrder) -> None:
    tracker = compiled()
    before = ordered(tracker, on_the_way(tracker, 0.3), GoOrder.GO, 0.1)[-1]
    state = ordered(tracker, before, order, tracker.cycle_s)[0]
    times = task_clock.programme_times(tracker, state)
    assert times is not None
    steady = round(before.time / tracker.cycle_s) + 1 + np.arange(tracker.commit + 1)
    assert times[: tracker.commit + 1] == pytest.approx(steady)


def test_a_clock_that_stood_goes_on_and_ends_at_the_gate() -> None:
    tracker = compiled()
    stood = ordered(tracker, on_the_way(tracker, 0.3), GoOrder.STAND, 1.0)[-1]
    states = ordered(tracker, stood, GoOrder.GO, 12.0)
    assert states[-1].ramp == clock_ramp.RUNNING
    closed = barrier(tracker.reference, stood.time, stood.passed)
    assert states[-1].time == pytest.approx(last_step(closed, tracker.cycle_s))


def test_a_contact_ends_the_ramp_at_a_whole_step() -> None:
    tracker = compiled()
    ramped = ordered(tracker, on_the_way(tracker, 0.3), GoOrder.BACK, 0.15)[-1]
    assert ramped.ramp.planned
    state = replace(ramped, contact=True)
    state = task_clock.advance_clock(tracker, state, None, SAMPLES, False)
    assert state.ramp == clock_ramp.RUNNING
    assert task_clock.programme_times(tracker, state) is None
    steps = state.time / tracker.cycle_s
    assert steps == pytest.approx(round(steps))
    assert state.time <= ramped.time + tracker.cycle_s


@pytest.mark.row
@pytest.mark.long
@pytest.mark.parametrize("cycle_s", [0.004, 0.008, 0.012])
@pytest.mark.parametrize("order", [GoOrder.GO, GoOrder.STAND, GoOrder.BACK])
def test_a_retreat_from_any_step_of_a_ramp_leaves_the_plan_on_the_programme(
    cycle_s: float, order: GoOrder
) -> None:
    tracker = of_cycle(cycle_s)
    plan, ahead = tracker.merge_free, np.arange(tracker.steps + 1.0)
    first = on_the_way(tracker, 0.4)
    if order is GoOrder.GO:
        first = ordered(tracker, first, GoOrder.STAND, 1.0)[-1]
    poses = tracker.table.between(first.time / cycle_s + first.ramp.rate * ahead)[1]
    off = []
    for state in ordered(tracker, first, order, 0.2):
        times = task_clock.programme_times(tracker, state)
        goal = tracker.table.between(state.time / cycle_s + ahead if times is None else times)[1]
        poses, _ = merge.merge(poses, goal, plan)
        if not state.ramp.planned:
            continue
        retreating, plans = state, poses
        for _ in range(round(0.4 / cycle_s)):
            retreating = task_clock.advance_clock(tracker, retreating, None, SAMPLES, True)
            times = task_clock.programme_times(tracker, retreating)
            assert times is not None
            plans, _ = merge.merge(plans, tracker.table.between(times)[1], plan)
            off.append(np.abs(plans - tracker.table.between(times)[1])[:, 2].max())
        assert retreating.ramp == clock_ramp.STANDING
    # With the ramp cut off the plan swung by 50 mm at 4 ms.
    assert max(off) < 5e-4


@pytest.mark.parametrize("cycle_s", [0.004, 0.008, 0.012])
@pytest.mark.parametrize("after_s", [-0.3, -0.1, 0.3, 0.5, 0.7])
@pytest.mark.parametrize("blend_s", [0.0, 11.0])
def test_a_retreat_from_an_approach_leaves_the_plan_on_the_programme(
    cycle_s: float, after_s: float, blend_s: float
) -> None:
    tracker = of_cycle(cycle_s)
    plan, ahead = tracker.merge_free, np.arange(tracker.steps + 1.0)
    state = replace(on_the_way(tracker, after_s), blend_s=blend_s)
    begun = state.time
    poses, off = tracker.table.between(state.time / cycle_s + ahead)[1], []
    for _ in range(round(0.5 / cycle_s)):
        state = task_clock.advance_clock(tracker, state, None, SAMPLES, True)
        _, goal = programmed_poses(tracker, state, state.time, retreat=True)
        poses, _ = merge.merge(poses, goal, plan)
        off.append(np.abs(poses - goal)[:, 2].max())
    assert state.time == begun
    # If the programme stood at once, the plan came back at 0.18 m/s on top of the retraction.
    assert max(off) < 5e-4
    assert np.ptp(goal[:, 2]) == 0.0


@pytest.mark.parametrize("cycle_s", [0.004, 0.012])
def test_a_clamp_that_a_retreat_opened_before_the_contact_does_not_set_the_clock_going(
    cycle_s: float,
) -> None:
    tracker = of_cycle(cycle_s)
    state = on_the_way(tracker, tracker.search_time - tracker.sight_time - 0.03)
    state = replace(state, contact=True, releasing=0.3, touching=0.2)
    state = task_clock.advance_clock(tracker, state, None, SAMPLES, True)
    stood = state.time
    state = replace(state, contact=False, passed=state.passed | {Gate.WHEEL_RELEASED})
    for _ in range(5):
        state = task_clock.advance_clock(tracker, state, None, SAMPLES, True)
    assert task_clock.is_before_contact(tracker, state)
    assert state.time == stood


def test_a_clock_that_stands_behind_the_last_step_is_still_judged() -> None:
    tracker = compiled()
    state = on_the_way(tracker, 0.3)
    state = replace(state, time=tracker.final_time + 3 * tracker.cycle_s)
    assert evidence.zone(tracker, state) is Zone.FINAL
    stands = replace(state, go=GoState(GoOrder.STAND))
    assert evidence.zone(tracker, stands) is Zone.LAST


def test_a_retreat_begins_with_the_first_command_that_the_robot_gets() -> None:
    tracker = compiled()
    lost = replace(at_rest(tracker, np.zeros(6), 0.0), started=True, time=5.0, stood=0.036)
    for _ in range(5):
        lost = task_clock.advance_clock(tracker, lost, None, SAMPLES, retreat=True)
        assert lost.withdrawn is None
    heard = task_clock.advance_clock(tracker, replace(lost, stood=0.0), None, SAMPLES, retreat=True)
    assert heard.withdrawn == 0.0


def test_a_tool_is_about_to_touch_while_a_goal_is_taken_up_until_its_touch_is_overdue() -> None:
    """Merged for a tool that hangs free until the contact was felt: 253 N, now 181 N."""
    tracker = compiled()
    T0, touch, overdue = tracker.cycle_s, tracker.reference.contact_time, tracker.search_time
    near = at_rest(tracker, np.zeros(6), 0.0)
    near = replace(near, started=True, blended=10.0, blend_s=1.0, time=touch)
    ahead = np.arange(0.0, 0.2, T0)
    about = [
        task_clock.is_about_to_touch(tracker, replace(near, time=touch - each)) for each in ahead
    ]
    assert tracker.merge_clamped.committed_s < T0 * sum(about) < 0.11
    assert about == sorted(about, reverse=True)
    for change in (
        {"time": overdue},
        {"contact": True},
        {"withdrawn": 0.0},
        {"blended": None},
        {"go": GoState(GoOrder.STAND)},
    ):
        assert not task_clock.is_about_to_touch(tracker, replace(near, **change))
