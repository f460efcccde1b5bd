"""The cyclic heart: a telegram in, a reply out, with the real codec and in virtual time."""

import dataclasses
import json
import re
from collections.abc import Iterator
from copy import deepcopy

import numpy as np
import pytest
from cycle_station import CODEC, PERIOD, SPEED, START, XML, Station
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from linemate.daemon.config.task_file import Task
from linemate.daemon.core import step as stepping
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.settings import PayloadSettings
from linemate.daemon.core.tracking.task import Gate, Phase
from linemate.daemon.core.tracking.touch.compliance import Compliance
from linemate.daemon.core.tracking.touch.tare import GRAVITY
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.operating import SETTLING
from linemate.daemon.cycle.setpoint_reference import CONFIRMATIONS, Proof
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.steps import CATCH_UP_S, LONGEST_LOG
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, SensorTelegram, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample


@pytest.fixture
def station(parameters: Parameters, task: Task) -> Station:
    return Station(parameters, task)


@pytest.fixture(scope="module")
def tracked(parameters: Parameters, task: Task) -> Station:
    """A station whose robot moves at the conveyor's speed; without its log it is copied quickly."""
    station = Station(parameters, task).track(163)
    station.cycle.take_log()
    return station


@pytest.fixture
def moving(tracked: Station) -> Station:
    return deepcopy(tracked, {id(tracked.parameters): tracked.parameters})


def bare(station: Station) -> bool:
    """One cycle; whether its reply has no corrections."""
    reply = station.cycle.on_telegram(station.telegram(), station.stamp_ns)
    is_bare = reply == b'<Sen Type="ImFree"><IPOC>%d</IPOC></Sen>' % station.ipoc
    station.next()
    return is_bare


def zero(fields: SensorTelegram) -> bool:
    assert fields.joints is not None
    assert fields.external is not None
    return not any((*fields.joints, *fields.external)) and fields.channels["DiO"] == 0


# One telegram, one reply.


@pytest.mark.parametrize("step", [1, 4, 12])
@pytest.mark.parametrize("first", [b"0", b"0000000000", b"4208111000", b"0004294967295"])
def test_every_telegram_gets_one_reply_with_its_ipoc_to_the_digit(
    station: Station, first: bytes, step: int
) -> None:
    for k in range(8):
        station.feed()
        digits = str(int(first) + k * step).zfill(len(first)).encode()
        data = station.telegram(ipoc=int(digits), ipoc_text=digits)
        reply = station.cycle.on_telegram(data, station.stamp_ns)
        assert reply is not None
        assert re.findall(rb"<IPOC>(.*?)</IPOC>", reply) == [digits]
        station.next()
    assert station.cycle.steps == 8
    assert [entry.counter for entry in station.cycle.take_log()] == [
        int(first) + k * step for k in range(8)
    ]


def test_the_first_reply_is_zero_wherever_the_robot_stands(station: Station) -> None:
    station.start = station.axes = (0.3, -1.2, 1.4, 0.2, 0.9, -0.7, 2.5)
    assert zero(station.exchange())


def test_a_robot_that_was_not_started_stays_for_ever(station: Station) -> None:
    assert all(zero(station.exchange()) for _ in range(200))
    assert station.cycle.machine.state is State.IDLE


def test_what_was_answered_once_is_not_answered_again(station: Station) -> None:
    station.run(5)
    station.feed()
    data = station.telegram()
    assert station.cycle.on_telegram(data, station.stamp_ns) is not None
    steps = station.cycle.steps
    assert station.cycle.on_telegram(data, station.stamp_ns + 100_000) is None
    older = station.telegram(ipoc=station.ipoc - 3 * station.step)
    assert station.cycle.on_telegram(older, station.stamp_ns + 200_000) is None
    assert station.cycle.steps == steps
    counters = station.cycle.status()["telegrams"]
    assert (counters["duplicate"], counters["backward"]) == (1, 1)


def test_the_step_sees_the_robot_of_the_telegram_before(station: Station) -> None:
    """So that the reply can be ready before its telegram comes."""
    station.run(4)
    for entry in station.cycle.take_log()[1:]:
        assert entry.inputs.robot is not None
        assert entry.counter is not None
        assert entry.inputs.robot.counter == entry.counter - station.step
        assert entry.inputs.robot.stamp_ns == entry.inputs.stamp_ns - PERIOD


# Telegrams that do not come.


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


# Sessions.


def moved(station: Station) -> Station:
    """Mid-motion, and then silence for longer than a session lives."""
    station.track(80)
    assert np.abs(np.array(station.axes) - station.start).max() > 0.005
    station.next(200)
    return station


def test_a_new_session_begins_with_zero_where_the_robot_is_and_needs_arming(
    station: Station,
) -> None:
    moved(station)
    # The program was started again: another counter, corrections count from here on.
    station.ipoc, station.delay = 77, 0
    station.start = station.axes
    for _ in range(CONFIRMATIONS - 1):
        assert bare(station)
    assert zero(station.exchange())
    assert station.cycle.machine.state not in {State.TRACK, State.ARMED}
    for _ in range(120):
        assert zero(station.exchange())
    assert station.cycle.order("start") is not None
    assert station.cycle.status()["telegrams"]["sessions"] == 2


def test_a_program_that_ran_before_the_daemon_gets_bare_replies_until_it_is_restarted(
    station: Station,
) -> None:
    moved = list(station.axes)
    moved[0] += 0.2
    station.axes, station.delay = tuple(moved), 40
    station.cycle.listen(station.stamp_ns - PERIOD)
    assert all(bare(station) for _ in range(120))
    status = station.cycle.status()
    assert status["state"] == "init"
    assert "Restart the controller's program" in status["correction"]["unproven"]
    assert "Restart the controller's program" in str(station.cycle.order("arm"))
    # Started again: its corrections count from where it stands now.
    station.next(20)
    station.ipoc, station.delay, station.start = 5_000, 0, station.axes
    for _ in range(CONFIRMATIONS - 1):
        # Its counter is not believed yet.
        assert station.cycle.on_telegram(station.telegram(), station.stamp_ns) is None
        station.next()
        station.delay += 1
    assert zero(station.exchange())
    assert station.cycle.status()["correction"] == {"proof": "started", "unproven": None}


def test_a_robot_that_comes_to_rest_after_its_session_began_counts_from_where_it_rests(
    station: Station,
) -> None:
    true = station.start
    for k in range(40):
        station.axes = (true[0] - 0.02 * 0.8**k, *true[1:])
        station.feed()
        reply = station.cycle.on_telegram(station.telegram(), station.stamp_ns)
        assert reply is not None
        assert zero(CODEC.parse_sensor(reply))
        station.next()
    station.axes = true
    station.track(60)
    assert station.cycle.last is not None
    assert station.cycle.last.outputs.command == pytest.approx(station.axes, abs=2e-4)
    assert station.cycle.status()["astray"] is None


def test_a_robot_that_has_not_come_to_rest_since_its_programme_began_cannot_be_armed(
    station: Station,
) -> None:
    true = station.start
    refusals = []
    for k in range(120):
        station.axes = (true[0] - 0.01 * 0.985**k, *true[1:])
        station.feed()
        assert station.cycle.on_telegram(station.telegram(), station.stamp_ns) is not None
        if station.cycle.machine.state is State.IDLE:
            refusals.append(station.cycle.order("arm"))
        station.next()
    assert len(refusals) > 10
    assert set(refusals) == {SETTLING}
    station.axes = true
    station.run(100)
    assert station.cycle.order("arm") is None


def test_a_robot_that_trembles_a_little_where_it_stands_can_be_armed(station: Station) -> None:
    true = station.start
    for k in range(120):
        station.axes = (true[0] + 2e-4 * (-1) ** k, *true[1:])
        station.feed()
        assert station.cycle.on_telegram(station.telegram(), station.stamp_ns) is not None
        station.next()
    assert station.cycle.order("arm") is None


def test_a_programme_that_goes_on_after_a_long_silence_keeps_its_start(station: Station) -> None:
    moved(station)
    held = station.axes
    station.delay = 200  # every cycle of the silence was counted
    fields = station.exchange()
    assert fields.joints is not None
    assert station.axes == pytest.approx(held, abs=1e-9)
    assert not zero(fields)
    assert station.cycle.machine.state not in {State.TRACK, State.ARMED}


@pytest.mark.parametrize("lost", [False, True])
def test_after_another_controller_the_first_one_is_known_again(
    station: Station, *, lost: bool
) -> None:
    station.track(80)
    held = station.axes
    station.feed()
    reply = station.cycle.on_telegram(station.telegram(), station.stamp_ns)
    assert reply is not None
    station.next()
    if not lost:
        station.take(CODEC.parse_sensor(reply))
        held = station.axes
    for k in range(30):
        station.offset_ns = 5_000_000
        alien = station.telegram(ipoc=9 + 12 * k, delay=0)
        station.cycle.on_telegram(alien, station.stamp_ns, "another")
        station.next()
    station.next(20)
    station.offset_ns = 0
    station.delay = 50 + lost
    station.exchange()
    assert station.axes == pytest.approx(held, abs=1e-9)


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


def test_a_robot_that_does_not_go_where_it_is_sent_is_held_with_the_axis_named(
    station: Station,
) -> None:
    station.track(60)
    braked = station.axes
    for _ in range(60):
        station.exchange()
        station.axes = braked
        if station.cycle.machine.state is not State.TRACK:
            break
    assert station.cycle.machine.state in {State.HOLD, State.FAULT}
    assert station.cycle.machine.latched
    assert "it was sent to" in station.cycle.status()["astray"]
    station.run(3)
    assert station.cycle.machine.state is State.FAULT


@pytest.mark.parametrize(("forces", "retreats"), [((900.0,), False), ((900.0, 900.0), True)])
def test_one_sample_of_overload_is_ignored_and_the_second_is_not(
    station: Station, forces: tuple[float, ...], *, retreats: bool
) -> None:
    station.track(30)
    for i, force in enumerate((0.0, *forces, 0.0)):
        stamp_ns = station.stamp_ns - 8_000_000 + 2_000_000 * i
        station.cycle.samples.wrench.push(WrenchSample(stamp_ns, (0.0, force, 0.0), (0.0,) * 3))
    station.exchange()
    assert (station.cycle.machine.state is State.RETREAT) == retreats


@pytest.mark.parametrize("zeroed", [False, True])
def test_a_payload_that_weighs_more_than_the_overload_is_tracked_wherever_the_sensor_was_zeroed(
    parameters: Parameters, task: Task, *, zeroed: bool
) -> None:
    tracker = parameters.tracker
    settings = dataclasses.replace(tracker.settings, payload=PayloadSettings(mass=40.0))
    heavy_tracker = dataclasses.replace(tracker, settings=settings)
    heavy = dataclasses.replace(parameters, tracker=heavy_tracker)
    station = Station(heavy, task)
    # The tcp's x points down.
    station.free_force = (0.0 if zeroed else 40.0 * GRAVITY, 0.0, 0.1)
    station.track(10)
    assert station.cycle.machine.state is State.TRACK


@pytest.mark.parametrize(("rms", "fixed"), [(90.0, True), (180.0, False)])
def test_an_oscillation_that_goes_on_though_the_contact_is_softened_ends_in_a_retreat(
    station: Station, rms: float, fixed: bool
) -> None:
    station.track(30)
    cycle = station.cycle
    assert cycle._state is not None
    swings = Compliance(power=rms**2, soft=True, softened=1.5, past=(rms**2,) * 30)
    touching = replace(cycle._state.tracker, contact=True, touching=2.0, compliance=swings)
    if fixed:
        touching = replace(touching, passed=touching.passed | {Gate.SCREWS_FIXED})
    cycle._state = replace(cycle._state, tracker=touching)
    for _ in range(5):
        station.exchange()
    assert cycle.machine.state is State.RETREAT
    assert f"an oscillation of {rms:.0f} N rms does not fall" in (cycle.operating.cause or "")


def test_two_samples_of_overload_in_two_cycles_are_two_in_a_row(station: Station) -> None:
    station.track(30)
    for _ in range(2):
        station.exchange()
        station.cycle.samples.wrench.push(
            WrenchSample(station.stamp_ns, (0.0, 0.0, 500.0), (0.0,) * 3)
        )
        station.exchange(feed=False)
    assert station.cycle.machine.state is State.TRACK
    for _ in range(2):
        station.cycle.samples.wrench.push(
            WrenchSample(station.stamp_ns, (0.0, 0.0, 500.0), (0.0,) * 3)
        )
        station.exchange(feed=False)
    assert station.cycle.machine.state is State.RETREAT


def test_a_link_that_was_lost_in_motion_latches_a_fault(station: Station) -> None:
    station.track(30)
    for _ in range(12):
        station.feed()
        station.cycle.on_missing(station.stamp_ns)
        station.next()
        station.delay += 1
    station.run(100)
    assert station.cycle.machine.state is State.FAULT
    assert station.cycle.order("arm") is not None
    assert station.cycle.order("ack") is None
    station.run(2)
    assert station.cycle.machine.state is State.IDLE


# Orders.


def test_orders_are_refused_with_a_reason_until_they_mean_something(station: Station) -> None:
    assert station.cycle.order("arm") is not None
    station.exchange()
    assert station.cycle.order("arm") is not None
    assert station.cycle.order("start") is not None
    assert station.cycle.order("dance") == "no such order: dance"
    station.run(90)
    assert station.cycle.order("start") is not None
    assert station.cycle.order("arm") is None
    station.exchange()
    assert station.cycle.machine.state is State.ARMED


def test_a_start_is_one_edge_for_the_step(station: Station) -> None:
    station.track(20)
    starts = [entry.inputs.start for entry in station.cycle.take_log()]
    assert starts.count(True) == 1
    orders = [entry.inputs.order for entry in station.cycle.take_log()]
    assert set(orders) <= {MotionOrder.TRACK}


def test_a_stop_in_motion_comes_to_rest_within_the_limits(station: Station) -> None:
    station.track(80)
    assert station.cycle.order("stop") is None
    station.run(60)
    assert station.cycle.machine.state is State.HOLD
    assert station.commands[-1] == pytest.approx(station.commands[-10], abs=1e-9)
    bounds = station.parameters.controller.limits
    rows = np.array(station.commands)
    # Eight decimals of a degree or a millimetre on the wire.
    grain = np.radians(1e-8)
    for order, limit in enumerate((bounds.speed, bounds.acceleration, bounds.jerk), 1):
        rates = np.abs(np.diff(rows, n=order, axis=0)) / 0.012**order
        assert (rates <= limit * 1.0001 + 2**order * grain / 0.012**order).all()


def test_a_sensor_that_falls_silent_holds_the_robot(station: Station) -> None:
    station.track(30)
    for step in range(40):
        force = (0.01 * step, 0.0, 0.0)  # Wrenches alike in motion are no measurement.
        station.cycle.samples.wrench.push(WrenchSample(station.stamp_ns, force, (0, 0, 0)))
        station.exchange(feed=False)
    assert station.cycle.machine.state is State.HOLD
    assert "position" in station.cycle.machine.because


# Prepared replies.


def camera_samples(stamp_ns: int, k: int) -> Iterator[CameraSample]:
    if k % 2 == 0:
        yield CameraSample(
            stamp_ns - 1_000_000,
            stamp_ns - 100_000_000,
            "cam1",
            "camera",
            "hub",
            k,
            (0.09, 0.01, 0.51),
            (0.99, 0.1, 0.0, 0.1),
        )


def test_prepared_and_in_line_replies_are_the_same_bytes_in_motion(
    parameters: Parameters, task: Task
) -> None:
    one, other = Station(parameters, task), Station(parameters, task)
    for k in range(200):
        orders = {90: "arm", 92: "start"}
        replies = []
        for station, ahead in ((one, False), (other, True)):
            if k in orders:
                assert station.cycle.order(orders[k]) is None
            station.feed()
            for sample in camera_samples(station.stamp_ns, k):
                station.cycle.samples.camera.push(sample)
            if ahead and k > 0:
                assert station.cycle.prepare(station.stamp_ns)
            replies.append(station.cycle.on_telegram(station.telegram(), station.stamp_ns))
            answer = replies[-1]
            assert answer is not None
            station.take(CODEC.parse_sensor(answer))
            station.next()
        assert replies[0] == replies[1]
    assert np.abs(np.array(one.axes) - one.start).max() > 0.001
    assert (one.cycle.prepared, one.cycle.inline) == (0, 200)
    assert (other.cycle.prepared, other.cycle.inline) == (199, 1)


def test_a_prepared_step_whose_telegram_does_not_come_is_not_sent(station: Station) -> None:
    station.track(60)
    held = np.array(station.axes)
    station.feed()
    assert station.cycle.prepare(station.stamp_ns)
    station.cycle.on_missing(station.stamp_ns)
    station.next()
    station.exchange()
    limits = station.parameters.controller.limits
    first = np.abs(np.array(station.axes) - held)
    assert (first <= limits.jerk * 0.012**3 * 1.001 + 1e-9).all()


@pytest.mark.parametrize("prepares", [False, True])
def test_a_silence_ends_the_motion_as_soon_with_prepared_steps_as_without(
    station: Station, prepares: bool
) -> None:
    station.track(60)
    cycles = 0
    while station.cycle.machine.state is State.TRACK and cycles < 10:
        station.feed()
        assert not prepares or station.cycle.prepare(station.stamp_ns)
        station.cycle.on_missing(station.stamp_ns)
        station.next()
        cycles += 1
    # A prepared step is decided on before its telegram could be missed.
    assert cycles == (4 if prepares else 3)
    assert station.cycle.machine.state is State.HOLD


# Whatever comes in.


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_after_an_unreadable_telegram_and_its_bare_reply_the_motion_goes_on_from_where_it_is(
    station: Station, lost: int
) -> None:
    station.track(80)
    if lost == 2:
        station.exchange(lost=True)
    held = station.axes
    station.feed()
    data = station.telegram().replace(b'A4="', b'A4="?', 1)
    reply = station.cycle.on_telegram(data, station.stamp_ns)
    assert reply == b'<Sen Type="ImFree"><IPOC>%d</IPOC></Sen>' % station.ipoc
    station.next()
    station.delay += lost > 0
    waited = 0
    while bare(station):  # until the axes rest, if it is unknown which of the replies is lost
        waited += 1
        assert waited < 20
    assert (waited > 0) == (lost == 1)
    station.next(-1)
    moved = np.array(station.cycle.session.held) - held
    limits = station.parameters.controller.limits
    assert (np.abs(moved) <= limits.jerk * 0.012**3 * 1.001 + 1e-9).all()
    assert station.cycle.refused == 1
    # Waiting for the axes to rest takes longer than a link may be silent.
    assert station.cycle.machine.state is (State.FAULT if lost == 1 else State.TRACK)


def test_a_late_telegram_with_a_bare_reply_keeps_the_prepared_step_for_the_next_cycle(
    moving: Station,
) -> None:
    cycle = moving.cycle
    assert cycle.prepare(moving.stamp_ns)
    before = cycle.steps - 1  # without the step of this cycle
    for made in range(1, 30):
        cycle.on_missing(moving.stamp_ns)
        assert cycle.prepare(moving.stamp_ns + PERIOD)
        late = moving.telegram().replace(b'A4="', b'A4="?', 1)
        assert cycle.on_telegram(late, moving.stamp_ns + PERIOD // 2 + 1_000_000)
        assert cycle.ready_reply is None  # the robot does not get this one's command
        assert cycle.steps == before + made + 1
        assert not cycle.prepare(moving.stamp_ns + PERIOD)
        moving.next()
        moving.delay += 1
    held = moving.axes
    while bare(moving):
        pass
    moved = np.array(cycle.session.held) - held
    limits = moving.parameters.controller.limits
    assert (np.abs(moved) <= limits.jerk * 0.012**3 * 1.001 + 1e-9).all()


def test_telegrams_that_are_unreadable_for_a_second_are_all_answered(station: Station) -> None:
    station.track(80)
    held = station.axes
    for _ in range(83):
        data = station.telegram().replace(b'A4="', b'A4="?', 1)
        assert station.cycle.on_telegram(data, station.stamp_ns) is not None
        station.next()
    assert station.cycle.machine.state in {State.HOLD, State.FAULT}
    station.exchange()
    assert station.axes == pytest.approx(held, abs=1e-6)
    assert station.cycle.session.proof is Proof.CONTINUED


@settings(max_examples=60)
@given(st.lists(st.binary(max_size=300), min_size=1, max_size=5))
@example([b"", b"<Rob>", b"<Rob Type='KUKA'></Rob>", b"\x00" * 3000, b"<!DOCTYPE x>"])
def test_garbage_is_counted_and_costs_nothing(
    parameters: Parameters, task: Task, junk: list[bytes]
) -> None:
    station = Station(parameters, task)
    station.run(2)
    for data in junk:
        assert station.cycle.on_telegram(data, station.stamp_ns) is None
    assert station.cycle.refused == len(junk)
    assert station.cycle.steps == 2
    assert station.cycle.status()["telegrams"]["unreadable"] == len(junk)
    assert station.cycle.last_refusal
    assert zero(station.exchange())


def test_a_good_telegram_cut_anywhere_is_refused_or_complete(station: Station) -> None:
    station.run(2)
    data = station.telegram()
    for end in range(0, len(data), 7):
        reply = station.cycle.on_telegram(data[:end], station.stamp_ns)
        assert reply in {None, b'<Sen Type="ImFree"><IPOC>%d</IPOC></Sen>' % station.ipoc}
        refused = station.cycle.refused
    assert refused == len(range(0, len(data), 7))
    station.next()
    data = station.telegram()
    assert station.cycle.on_telegram(data, station.stamp_ns) is not None


@pytest.mark.parametrize(
    ("cut", "says"), [("AIPos", "no AIPos"), ("EIPos", "no EIPos")], ids=["joints", "axis"]
)
def test_a_configuration_without_what_the_daemon_needs_is_refused_by_name(
    parameters: Parameters, task: Task, cut: str, says: str
) -> None:
    xml = re.sub(rf'<ELEMENT TAG="DEF_{cut}"[^>]*/>'.encode(), b"", XML)
    codec = RsiCodec(parse_config(xml))
    cycle = Cycle(parameters, RsiLink(codec, on_rail=True))
    telegram = RobotTelegram(
        ipoc=1,
        joints=None if cut == "AIPos" else (0.0,) * 6,
        external=None if cut == "EIPos" else (0.0,) * 6,
        tcp=(0.0,) * 6,
        delay=0,
        channels={"DiL": 0},
    )
    reply = cycle.on_telegram(codec.format_robot(telegram), START)
    assert reply == b'<Sen Type="ImFree"><IPOC>1</IPOC></Sen>'
    assert cycle.last_refusal is not None
    assert says in cycle.last_refusal


def test_inboxes_are_bounded_and_what_is_dropped_is_counted_and_oldest(station: Station) -> None:
    station.run(2)
    for i in range(1000):
        stamp_ns = station.stamp_ns - 1_000_000 + i
        station.cycle.samples.distance.push(DistanceSample(stamp_ns, station.where(stamp_ns), 1.0))
        station.cycle.samples.wrench.push(WrenchSample(stamp_ns, (0, 0, 0), (0, 0, 0)))
        for sample in camera_samples(stamp_ns, 0):
            station.cycle.samples.camera.push(sample)
    newest = station.stamp_ns - 1_000_000 + 999
    station.exchange(feed=False)
    entry = station.cycle.take_log()[-1]
    dropped = station.cycle.status()["dropped"]
    for name, samples, most in (
        ("distance", entry.inputs.distance, 128),
        ("camera", entry.inputs.camera, 16),
        ("wrench", entry.inputs.wrench, 64),
    ):
        assert len(samples) + dropped[name] == 1000
        assert len(samples) <= most
    assert entry.inputs.distance[-1].stamp_ns == newest


def test_a_log_that_is_not_read_is_bounded_and_counted(station: Station) -> None:
    station.run(LONGEST_LOG + 30)
    assert station.cycle.log_dropped == 30
    log = station.cycle.take_log()
    assert len(log) == LONGEST_LOG
    assert log[-1].counter == station.ipoc - station.step
    assert station.cycle.take_log() == []


# Status.


def test_the_status_is_plain_at_every_moment(station: Station) -> None:
    json.dumps(station.cycle.status())
    station.exchange()
    json.dumps(station.cycle.status())
    station.track(60)
    fields = json.loads(json.dumps(station.cycle.status(), allow_nan=False))
    assert fields["state"] == "track"
    assert fields["steps"] == station.cycle.steps
    assert fields["speed"] == pytest.approx(SPEED, abs=0.002)
    assert fields["ages_s"]["position"] == pytest.approx(0.003)


def test_increments_add_up_to_the_corrections(parameters: Parameters, task: Task) -> None:
    absolute = Station(parameters, task).track(70)
    relative = Station(parameters, task, absolute=False).track(70)
    assert np.abs(np.array(absolute.axes) - absolute.start).max() > 0.001
    # Each increment is rounded by the wire, and the sum of roundings is not.
    assert np.allclose(absolute.axes, relative.axes, atol=170 * np.radians(0.5e-8))


# Without a robot.


def gone(station: Station, cycles: int, *, may_rest: bool = True) -> None:
    """Cycles without a telegram."""
    for _ in range(cycles):
        station.feed()
        station.cycle.on_missing(station.stamp_ns, may_rest=may_rest)
        station.next()


@pytest.mark.parametrize("restarted", [False, True])
def test_no_steps_are_made_for_a_robot_that_is_gone_and_the_next_session_is_new(
    station: Station, *, restarted: bool
) -> None:
    station.run(90)
    gone(station, 100)
    assert station.cycle.machine.state is State.INIT
    made = station.cycle.steps
    gone(station, 5000)
    assert station.cycle.steps == made
    if restarted:
        station.ipoc = 77
    station.delay = 0 if restarted else 5100
    while bare(station):
        assert station.cycle.steps == made
    station.run(1)
    first = station.cycle.last
    assert first is not None
    assert first.before is not None
    # The estimate of an object that has gone on for a minute would be wrong by metres.
    history = first.before.tracker.history
    assert history is not None
    assert len(history.poses) <= 2
    station.run(120)
    assert station.cycle.last.outputs.speed == pytest.approx(SPEED, abs=0.01)
    assert station.cycle.order("arm") is None


def test_steps_are_made_for_a_robot_that_is_gone_while_someone_looks(station: Station) -> None:
    station.run(90)
    made = station.cycle.steps
    gone(station, 300, may_rest=False)
    assert station.cycle.machine.state is State.INIT
    assert station.cycle.steps == made + 300


def test_steps_are_made_for_a_robot_that_was_lost_in_its_task(station: Station) -> None:
    station.track(80)
    made = station.cycle.steps
    gone(station, 300)
    assert station.cycle.machine.state is not State.INIT
    assert station.cycle.steps == made + 300
