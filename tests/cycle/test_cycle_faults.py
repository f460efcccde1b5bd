"""What holds a robot that tracks, makes it retreat, or latches a fault."""

import dataclasses

import pytest
from cycle_station import Station
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
