"""Sessions: what a robot is given at their begin, and when it may be armed."""

import numpy as np
import pytest
from cycle_station import CODEC, PERIOD, Station, bare, zero

from linemate.daemon.cycle.operating import SETTLING
from linemate.daemon.cycle.setpoint_reference import CONFIRMATIONS
from linemate.daemon.cycle.states import State


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
