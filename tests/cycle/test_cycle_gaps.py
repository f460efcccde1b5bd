"""Telegrams that do not come or come late: which steps are made, and from where."""

from types import SimpleNamespace

import numpy as np
import pytest
from cycle_station import PERIOD, START, Station

from linemate.daemon.config.task_file import Task
from linemate.daemon.core import step as stepping
from linemate.daemon.core.control.command_limiter import LimiterState
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.task import Phase
from linemate.daemon.cycle.steps import CATCH_UP_S, Stepper
from linemate.protocol.fanuc.fanuc_link import FanucLink


@pytest.mark.parametrize("missing", [1, 3, 10])
def test_a_gap_makes_the_steps_that_were_missed(station: Station, missing: int) -> None:
    station.run(20)
    station.cycle.take_log()
    station.next(missing)
    station.exchange()
    log = station.cycle.take_log()
    assert [entry.counter is None for entry in log] == [True] * missing + [False]
    assert [entry.inputs.k for entry in log] == list(range(20, 21 + missing))
    stamps = [entry.inputs.stamp_ns for entry in log]
    assert np.diff(stamps).tolist() == [PERIOD] * missing
    assert station.cycle.status()["telegrams"]["missed"] == missing


@pytest.mark.parametrize("ahead", [1, 3])
def test_a_counter_that_jumps_makes_no_step_for_which_no_time_has_passed(
    station: Station, ahead: int
) -> None:
    station.run(20)
    station.cycle.take_log()
    station.ipoc += ahead * station.step
    station.run(3)
    log = station.cycle.take_log()
    assert [entry.counter is None for entry in log] == [False] * 3
    assert [entry.inputs.k for entry in log] == [20, 21, 22]
    assert np.diff([entry.inputs.stamp_ns for entry in log]).tolist() == [PERIOD] * 2


@pytest.mark.parametrize("ahead", [1, 3])
def test_a_flipped_counter_leaves_as_many_steps_as_cycles_have_passed(
    station: Station, ahead: int
) -> None:
    station.run(20)
    station.cycle.take_log()
    flipped = station.telegram(ipoc=station.ipoc + ahead * station.step)
    assert station.cycle.on_telegram(flipped, station.stamp_ns) is not None
    for _ in range(ahead):
        station.next()
        station.delay += 1
        if station.cycle.on_telegram(station.telegram(), station.stamp_ns) is None:
            station.cycle.on_missing(station.stamp_ns)
    station.next()
    station.delay += 1
    station.exchange()
    assert [entry.inputs.k for entry in station.cycle.take_log()] == [*range(20, 22 + ahead)]


def test_cycles_in_which_the_clock_stood_are_stepped_through_without_samples(
    station: Station,
) -> None:
    station.run(20)
    station.cycle.take_log()
    stood, refused = 6, 2
    station.ipoc += stood * station.step
    for _ in range(refused):
        assert station.cycle.on_telegram(station.telegram(), station.stamp_ns) is None
        station.feed()
        station.cycle.on_missing(station.stamp_ns)
        station.next()
    station.delay += stood + refused
    station.exchange()
    log = station.cycle.take_log()
    assert [entry.inputs.k for entry in log] == list(range(20, 21 + refused + stood))
    assert [bool(entry.inputs.distance) for entry in log] == [
        *[True] * refused,
        *[False] * stood,
        True,
    ]


def test_a_long_gap_is_caught_up_with_in_bounded_time(station: Station) -> None:
    station.run(20)
    station.cycle.take_log()
    station.next(80)
    station.exchange()
    assert len(station.cycle.take_log()) == round(CATCH_UP_S / 0.012)


@pytest.mark.parametrize("missing", [1, 4])
def test_steps_that_the_clock_made_are_not_made_again(station: Station, missing: int) -> None:
    station.run(20)
    for _ in range(missing):
        station.feed()
        station.cycle.on_missing(station.stamp_ns)
        station.next()
    station.exchange()
    assert station.cycle.steps == 21 + missing
    ks = [entry.inputs.k for entry in station.cycle.take_log()]
    assert ks == list(range(21 + missing))


def test_without_a_session_the_clock_makes_no_steps(station: Station) -> None:
    station.cycle.on_missing(START)
    assert station.cycle.steps == 0
    assert not station.cycle.prepare(START)


def test_a_gap_in_motion_is_taken_up_from_where_the_robot_holds(station: Station) -> None:
    station.track(60)
    assert station.cycle.last is not None
    assert station.cycle.last.outputs.phase is Phase.APPROACH
    held = np.array(station.axes)
    station.next(2)
    station.exchange()
    # At rest before it: no more than a first step's jerk away.
    first = np.abs(np.array(station.axes) - held)
    limits = station.parameters.controller.limits
    assert (first <= limits.jerk * 0.012**3 * 1.001 + 1e-9).all()
    assert first.max() > 0.0


def test_a_reply_that_the_controller_did_not_take_is_noticed_by_its_delay(station: Station) -> None:
    station.track(60)
    held = np.array(station.axes)
    station.exchange(lost=True)
    station.exchange()
    limits = station.parameters.controller.limits
    first = np.abs(np.array(station.axes) - held)
    assert (first <= limits.jerk * 0.012**3 * 1.001 + 1e-9).all()
    assert station.cycle.session.replies_lost == 1


def test_a_telegram_that_comes_after_its_step_gets_that_step(station: Station) -> None:
    station.track(60)
    station.feed()
    steps = station.cycle.steps
    station.cycle.on_missing(station.stamp_ns)
    made = station.cycle.last
    station.offset_ns = 7_000_000
    station.exchange(feed=False)
    station.offset_ns = 0
    assert station.cycle.steps == steps + 1
    assert made is not None
    assert station.axes == pytest.approx(made.outputs.command, abs=1e-9)
    station.exchange()
    assert station.cycle.steps == steps + 2


@pytest.mark.parametrize("is_missed_again", [True, False])
def test_a_step_stands_on_what_the_telegram_before_it_was_given_however_late(
    parameters: Parameters, task: Task, is_missed_again: bool
) -> None:
    late, prompt = Station(parameters, task), Station(parameters, task)
    late.track(160)
    prompt.track(163)
    late.feed()
    assert late.cycle.prepare(late.stamp_ns)
    late.cycle.on_missing(late.stamp_ns)
    # The next step is made before its time, and assumes that the last one was never sent.
    assert late.cycle.prepare(late.stamp_ns + PERIOD)
    late.exchange(feed=False)
    if is_missed_again:
        late.cycle.on_missing(late.stamp_ns)
    late.exchange(feed=False)
    late.exchange()
    moves, expected = np.array(late.commands[-5:]), np.array(prompt.commands[-5:])
    assert np.abs(np.diff(expected, axis=0)).max() > 1e-3
    assert moves == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("is_prepared", [True, False])
@pytest.mark.parametrize("steps_missing", [0, 1, 2])
@pytest.mark.parametrize("slipped", [0, 1, 3])
@pytest.mark.parametrize("unanswered", [1, 2])
def test_after_a_cycle_without_a_reply_a_step_begins_where_the_robot_holds(
    moving: Station, slipped: int, unanswered: int, steps_missing: int, is_prepared: bool
) -> None:
    # A controller that was delayed counts no cycles: the clock's steps are ahead of its IPOC.
    for _ in range(slipped):
        moving.cycle.on_missing(moving.stamp_ns)
        moving.k += 1
    moving.exchange()
    # Of telegrams that wait together only the newest is answered; the clock may have seen to both.
    for count in range(unanswered):
        if count < steps_missing:
            moving.cycle.on_missing(moving.stamp_ns)
        moving.next()
        moving.delay += 1
    if is_prepared:
        moving.feed()
        moving.cycle.prepare(moving.stamp_ns)
    held = np.array(moving.axes)
    moving.exchange(feed=not is_prepared)
    assert moving.cycle.last is not None
    assert moving.cycle.last.inputs.applied == pytest.approx(held, abs=1e-9)
    before = moving.cycle.last.outputs.command
    moving.exchange()
    assert moving.cycle.last.inputs.sent
    assert moving.axes == pytest.approx(moving.cycle.last.outputs.command, abs=1e-9)
    assert np.abs(np.array(before) - held).max() > 0.0


@pytest.mark.parametrize("is_prepared", [True, False])
@pytest.mark.parametrize("steps_ahead", [2, 3, 5])
def test_a_robot_that_moves_gets_no_step_that_took_it_for_one_that_holds(
    parameters: Parameters, moving: Station, steps_ahead: int, *, is_prepared: bool
) -> None:
    # The controller is delayed and counts no cycles; the clock goes on without it.
    for _ in range(steps_ahead):
        moving.cycle.on_missing(moving.stamp_ns)
        moving.k += 1
    if is_prepared:
        moving.feed()
        moving.cycle.prepare(moving.stamp_ns)
    before = len(moving.commands)
    pace = (np.array(moving.axes) - np.array(moving.commands[-2])) / parameters.cycle_s
    moving.exchange(feed=not is_prepared)
    assert moving.cycle.last is not None
    entered = moving.cycle.last.inputs
    assert not entered.sent
    assert entered.pace is not None
    assert entered.pace[0] == pytest.approx(pace, abs=1e-6)
    for _ in range(3):
        moving.exchange()
    assert len(moving.commands) == before + 4
    commands, bounds = np.array(moving.commands[before - 4 :]), parameters.controller.limits
    speeds = np.diff(commands, axis=0) / parameters.cycle_s
    assert np.abs(speeds).max() > 0.1
    for limit in (bounds.acceleration, bounds.jerk):
        speeds = np.diff(speeds, axis=0) / parameters.cycle_s
        assert (np.abs(speeds) <= limit * (1.0 + 1e-6) + 1e-3).all()


@pytest.mark.parametrize("is_prepared", [True, False])
@pytest.mark.parametrize("lost", [True, False])
def test_a_telegram_whose_step_the_clock_has_made_makes_no_other_one(
    parameters: Parameters, moving: Station, *, lost: bool, is_prepared: bool
) -> None:
    ahead = moving.cycle.steps - moving.k
    for _ in range(10):
        moving.exchange(lost=lost)
        moving.cycle.on_missing(moving.stamp_ns)
        if is_prepared:
            moving.feed()
            moving.k += 1
            moving.cycle.prepare(moving.stamp_ns)
            moving.k -= 1
        moving.exchange(feed=False)
    assert moving.cycle.steps - moving.k == ahead + is_prepared
    assert moving.cycle.repeated == (10 if lost else 0)
    bounds = parameters.controller.limits
    speeds = np.diff(np.array(moving.commands[-30:]), axis=0) / parameters.cycle_s
    assert (np.abs(speeds) <= bounds.speed * (1.0 + 1e-6)).all()


@pytest.mark.parametrize("is_prepared", [True, False])
def test_a_step_that_is_finished_once_more_replays_from_the_state_that_it_tells(
    parameters: Parameters, moving: Station, *, is_prepared: bool
) -> None:
    moving.cycle.take_log()
    moving.exchange(lost=True)
    moving.cycle.on_missing(moving.stamp_ns)
    if is_prepared:
        moving.cycle.prepare(moving.stamp_ns + PERIOD)
    moving.exchange()
    moving.exchange()
    entries = moving.cycle.take_log()
    assert [e.inputs.k for e in entries].count(entries[1].inputs.k) == 2
    for entry in entries:
        assert entry.before is not None
        after, outputs = stepping.step(entry.before, entry.inputs, parameters)
        assert outputs.command == entry.outputs.command
        assert entry.after is not None
        assert np.array_equal(after.control.limiter.position, entry.after.control.limiter.position)


@pytest.mark.parametrize("ahead", [1, 2])
def test_a_reply_to_a_flipped_counter_moves_no_robot_and_neither_do_the_steps_after_it(
    moving: Station, ahead: int
) -> None:
    held = np.array(moving.axes)
    # One telegram's counter is flipped forward: it is answered as if cycles had been missed.
    # Those that follow seem late or repeated, and the clock sees to them.
    flipped = moving.telegram(ipoc=moving.ipoc + ahead * moving.step)
    assert moving.cycle.on_telegram(flipped, moving.stamp_ns) is not None
    for _ in range(ahead):
        moving.next()
        moving.delay += 1
        assert moving.cycle.on_telegram(moving.telegram(), moving.stamp_ns) is None
        moving.cycle.on_missing(moving.stamp_ns)
    moving.next()
    moving.delay += 1
    moving.exchange()
    assert moving.cycle.last is not None
    entered = moving.cycle.last.inputs
    assert (entered.sent, entered.pace) == (False, None)
    assert entered.applied == pytest.approx(held, abs=1e-9)
    assert moving.cycle.session.replies_lost == 1


@pytest.mark.parametrize(("cycles", "coasted", "speed"), [(-1, 0, 0.5), (15, 15, 0.5), (60, 15, 0)])
def test_a_controller_coasts_until_it_stops_with_its_alarm(
    cycles: int, coasted: int, speed: float
) -> None:
    """Commands went on for as long as the robot was lost, in FAULT."""
    stepper = SimpleNamespace(
        parameters=SimpleNamespace(cycle_s=0.008), _link=SimpleNamespace(rules=FanucLink(3).rules)
    )
    zeros = np.zeros(1)
    gate = LimiterState(np.ones(1), np.full(1, 0.5), zeros, zeros, zeros)
    position, pace = Stepper._coasted(stepper, gate, cycles)  # type: ignore[arg-type]
    assert position == pytest.approx((1.0 + 0.5 * 0.008 * coasted,))
    assert pace == ((speed,), (0.0,))
