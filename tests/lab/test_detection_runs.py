"""Detection runs: true to the plants, judged correctly, and reproducible."""

import math
from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.core.tracking.conveyor import Source
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.simulators.harness import setup
from linemate.simulators.judge.rows import DaemonEvent
from linemate.simulators.lab import detection_runs
from linemate.simulators.lab.detection_runs import DetectionRun, Kind, Push, Tally
from linemate.simulators.plants.conveyor_plan import (
    AppliedEvent,
    Conveyor,
    ConveyorEvent,
    applied_events,
)
from linemate.simulators.plants.conveyor_plant import ConveyorPlant
from linemate.simulators.plants.scenario import DistanceSensor, ForceTorque, Scenario
from linemate.simulators.plants.scenario_draw import sample

EVENTS = (ConveyorEvent("stop", 10.0, 0.104), ConveyorEvent("start", 20.0, 0.013))


def applied() -> tuple[AppliedEvent, ...]:
    return applied_events(Conveyor(events=EVENTS))


def spec_of(kind: Kind, duration_s: float, *overrides: str) -> DetectionRun:
    return DetectionRun(kind, setup.make("wheel", overrides), 1, duration_s)


def tallied(*reported: tuple[float, str, str], pushes: tuple[Push, ...] = ()) -> Tally:
    events = [DaemonEvent(*one) for one in reported]
    return detection_runs._tally(events, () if pushes else applied(), list(pushes), 40.0)


def test_rows_say_where_the_unit_was_as_long_ago_as_they_say() -> None:
    scenario = replace(
        sample(3, Scenario()),
        distance=DistanceSensor(sigma=0.0, quantisation=0.0, outlier_rate=0.0),
        force_torque=ForceTorque(sigma_translation=0.0),
    )
    push = Push(1.0, lambda t: 0.002 * (t - 1.0))
    station = detection_runs._DetectionStation(scenario, TrackingSettings(), [push], touched=True)
    truth = ConveyorPlant(scenario.conveyor, 3, -detection_runs.LEAD_IN_S)
    sources = []
    for k in range(1, 600):
        now_s = -detection_runs.LEAD_IN_S + k * scenario.cycle_s
        for row in station.rows(now_s):
            at = now_s - row.delay
            sources.append(row.source)
            if row.source is Source.DISTANCE:
                assert row.value == pytest.approx(truth.at(at)[0], abs=1e-9)
            else:
                # The force's stamp is its arrival, a millisecond after it was measured.
                felt = truth.at(at - 0.001)[0] + max(0.0, 0.002 * (at - 1.001))
                assert row.value == pytest.approx(felt, abs=1e-9)
    assert sources.count(Source.DISTANCE) == pytest.approx(599, abs=1)
    assert sources.count(Source.TACTILE) == pytest.approx(599, abs=1)


def test_latencies_and_alarms_are_kept_apart() -> None:
    tally = tallied(
        (2.0, "stop", "tentative"),
        (2.1, "stop", "cancelled"),
        (10.15, "stop", "tentative"),
        (10.2, "stop", "confirmed"),
        (15.0, "start", "tentative"),
        (15.1, "start", "confirmed"),
        (16.0, "stop", "confirmed"),
    )
    assert tally.perceived == {"stop": [0.15], "start": [math.inf]}
    assert tally.confirmed == {"stop": [0.2], "start": [math.inf]}
    assert tally.seconds == {"running": 30.0, "standing": 10.0}
    assert tally.false == {
        ("stop", "tentative"): 1, ("start", "tentative"): 1, ("start", "confirmed"): 1
    }  # fmt: skip
    # The stop that takes the false start back is no alarm of its own.
    assert tally.corrections == 1


def test_what_a_classifier_tells_before_it_has_settled_does_not_count() -> None:
    assert tallied((-1.0, "stop", "confirmed")).false == {}


def test_a_push_is_taken_for_a_stop_only_by_a_confirmed_stop_soon_after() -> None:
    pushes = tuple(Push(t, lambda _: 0.0) for t in (5.0, 15.0, 25.0))
    tally = tallied(
        (5.1, "stop", "tentative"),
        (5.3, "stop", "cancelled"),
        (15.2, "stop", "confirmed"),
        (25.0 + detection_runs.TAKEN_S, "stop", "confirmed"),
        pushes=pushes,
    )
    assert tally.pushed == {"made": 3, "suspected": 2, "taken": 1}


def test_a_run_finds_its_stop_and_its_start_and_is_reproducible() -> None:
    first, second = (detection_runs.run(spec_of("free", 70.0)) for _ in range(2))
    assert first == second
    assert len(first.confirmed["stop"]) == len(first.confirmed["start"]) == 1
    assert 0.0 < first.perceived["stop"][0] <= first.confirmed["stop"][0] < 1.0
    assert 0.0 < first.perceived["start"][0] <= first.confirmed["start"][0] < 3.0


def test_a_restart_comes_while_the_conveyor_brakes() -> None:
    spec = spec_of("restart", 600.0)
    orders = tuple(detection_runs._orders(spec, spec.setup.scenario))
    events = applied_events(Conveyor(events=orders))
    assert len(events) > 20
    stops = events[0::2]
    starts = events[1::2]
    for stop, start in zip(stops, starts, strict=True):
        assert stop.onset_s + 0.2 <= start.onset_s < stop.settled_s
        assert 0.0 < start.speed < 0.106


def test_orders_take_the_scenarios_accelerations() -> None:
    spec = spec_of("free", 300.0, "scenario.conveyor.events.0.acceleration=0.083")
    orders = list(detection_runs._orders(spec, spec.setup.scenario))
    rates = {event.kind: event.acceleration for event in orders}
    assert rates == {"stop": 0.083, "start": 0.013}


@pytest.mark.parametrize("kind", ["jerk", "push"])
def test_pushes_reach_half_a_millimetre_to_three_and_end(kind: Kind) -> None:
    spec = spec_of(kind, 900.0)
    pushes = list(detection_runs._pushes(spec))
    assert len(pushes) > 60
    peaks = []
    for push in pushes:
        ways = [push.way(push.onset_s + t) for t in np.linspace(0.0, 8.0, 801)]
        peaks.append(max(ways, key=abs))
        assert push.way(push.onset_s) == 0.0
        assert abs(ways[-1]) < 0.05 * abs(peaks[-1])
    sizes = np.abs(peaks)
    # A damped sine stays somewhat below its undamped amplitude.
    assert 0.7 * 0.5e-3 <= sizes.min() < 0.8e-3
    assert 2.2e-3 < sizes.max() <= 3.0e-3
    assert 0.3 < np.mean(np.array(peaks) > 0.0) < 0.7


def test_tallies_add_up() -> None:
    tally = tallied((2.0, "stop", "tentative"))
    tally.add(tallied((10.2, "stop", "confirmed")))
    assert tally.confirmed["stop"] == [math.inf, 0.2]
    assert tally.seconds == {"running": 60.0, "standing": 20.0}
    assert tally.false == {("stop", "tentative"): 1}
