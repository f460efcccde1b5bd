"""The cyclic heart: a telegram in, a reply out, with the real codec and in virtual time."""

import json
import re
from collections.abc import Iterator

import numpy as np
import pytest
from cycle_station import CODEC, PERIOD, SPEED, START, XML, Station, bare, zero
from hypothesis import example, given, settings
from hypothesis import strategies as st

from linemate.daemon.config.task_file import Task
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.setpoint_reference import Proof
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.steps import LONGEST_LOG
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample

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
