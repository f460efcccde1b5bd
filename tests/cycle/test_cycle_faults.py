"""What holds a robot that tracks, makes it retreat, or latches a fault."""

import dataclasses

import pytest
from cycle_station import CODEC, PERIOD, Station
from msgspec.structs import replace

from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.settings import PayloadSettings
from linemate.daemon.core.tracking.task import Gate
from linemate.daemon.core.tracking.touch.compliance import Compliance
from linemate.daemon.core.tracking.touch.tare import GRAVITY
from linemate.daemon.cycle.states import State
from linemate.protocol.stamped_samples import WrenchSample


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
    for _ in range(3):
        station.exchange()
        station.axes = braked
    assert station.cycle.machine.state is State.FAULT


@pytest.mark.parametrize("axis", [0, 6])
@pytest.mark.parametrize("cycles", [1, 2])
def test_an_axis_that_jumps_is_no_reading_and_the_motion_goes_on_after_it(
    moving: Station, axis: int, cycles: int
) -> None:
    """Followed, A1 off by 33 degrees in contact pulled at the mount with 992 N."""
    session, error = moving.cycle.openings, moving.cycle.following.error
    for _ in range(cycles):
        moving.feed()
        axes = [q + 0.576 * (n == axis) for n, q in enumerate(moving.axes)]
        forged = moving.telegram(joints=tuple(axes[:6]), external=(axes[6], *(0.0,) * 5))
        reply = moving.cycle.on_telegram(forged, moving.stamp_ns)
        assert reply is not None
        assert CODEC.parse_sensor(reply).joints is None
        moving.next()
    assert moving.cycle.refused == cycles
    assert "jumps from" in (moving.cycle.last_refusal or "")
    moving.run(20)
    assert moving.cycle.refused == cycles
    assert moving.cycle.machine.state is State.TRACK
    assert (moving.cycle.openings, moving.cycle.following.error) == (session, error)


@pytest.mark.parametrize("pause_s", [0.4, 2.1])
def test_a_robot_that_was_moved_in_a_pause_begins_a_new_session(
    moving: Station, pause_s: float
) -> None:
    moving.next(round(pause_s * 1e9 / PERIOD))
    moving.ipoc, moving.delay = 77, 0
    moving.axes = moving.start = (moving.axes[0] + 0.576, *moving.axes[1:])
    openings = moving.cycle.openings
    for _ in range(30):
        moving.feed()
        moving.cycle.on_telegram(moving.telegram(), moving.stamp_ns)
        moving.next()
    assert moving.cycle.openings > openings
    assert moving.cycle.session.reference[0] == pytest.approx(moving.axes[0], abs=1e-5)
    assert moving.cycle.refused == 0


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
