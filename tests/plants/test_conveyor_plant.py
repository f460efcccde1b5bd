"""Laws of the conveyor: ramps, orders that change nothing, ripple that fades with the speed."""

import math

import numpy as np
import pytest

from linemate.simulators.plants.conveyor_plan import (
    Conveyor,
    ConveyorEvent,
    Ripple,
    StopSignal,
    applied_events,
)
from linemate.simulators.plants.conveyor_plant import ConveyorPlant
from linemate.simulators.plants.scenario import Scenario

SMOOTH = Ripple(speed_sigma=0.0, amplitude=0.0, phase=0.0)


def plant(*events: ConveyorEvent, ripple: Ripple = SMOOTH, seed: int = 0) -> ConveyorPlant:
    return ConveyorPlant(Conveyor(events=events, ripple=ripple), seed, -2.0)


def test_the_unit_passes_zero_at_time_zero_with_nominal_speed() -> None:
    unit = plant()
    assert unit.at(0.0) == (0.0, 0.106)
    assert unit.at(-2.0)[0] == pytest.approx(-0.212)


def test_a_stop_takes_the_distance_and_the_time_of_its_deceleration() -> None:
    unit = plant(ConveyorEvent("stop", 5.0, 0.104))
    position, speed = unit.at(8.0)
    assert speed == 0.0
    assert position == pytest.approx(5.0 * 0.106 + 0.106**2 / 2 / 0.104)
    assert unit.at(5.0 + 0.106 / 0.104 - 0.01)[1] == pytest.approx(0.104 * 0.01)


def test_the_default_restart_reaches_the_old_speed_after_eight_seconds() -> None:
    unit = plant(*Conveyor().events)
    assert unit.at(17.1)[1] < 0.106
    assert unit.at(17.16)[1] == 0.106


def test_a_restart_during_deceleration_starts_from_the_speed_left() -> None:
    events = (ConveyorEvent("stop", 5.0, 0.104), ConveyorEvent("start", 5.5, 0.013))
    unit = plant(*events)
    left = 0.106 - 0.052
    assert unit.at(5.5)[1] == pytest.approx(left)
    assert unit.at(6.5)[1] == pytest.approx(left + 0.013)
    stop, start = applied_events(Conveyor(events=events))
    assert start.speed == pytest.approx(left)
    assert start.settled_s == pytest.approx(5.5 + 0.052 / 0.013)
    assert stop.acceleration == -0.104


def test_an_order_for_what_already_goes_on_is_no_event() -> None:
    events = (
        ConveyorEvent("start", 1.0, 0.013),
        ConveyorEvent("stop", 2.0, 0.104),
        ConveyorEvent("stop", 2.5, 0.5),
        ConveyorEvent("start", 4.0, 0.02),
    )
    scenario = Scenario(conveyor=Conveyor(events=events))
    assert [(e.kind, e.onset_s) for e in scenario.events] == [("stop", 2.0), ("start", 4.0)]
    assert plant(*events).at(2.7)[1] == pytest.approx(0.106 - 0.104 * 0.7)


def test_repeated_stops_each_take_place() -> None:
    events = tuple(
        ConveyorEvent(kind, t, 0.1)  # type: ignore[arg-type]
        for kind, t in (("stop", 1.0), ("start", 3.0), ("stop", 6.0), ("start", 9.0))
    )
    assert len(applied_events(Conveyor(events=events))) == 4
    unit = plant(*events)
    assert unit.at(2.5)[1] == 0.0
    assert unit.at(5.5)[1] == 0.106
    assert unit.at(8.0)[1] == 0.0
    assert unit.at(20.0)[1] == 0.106


def test_the_speed_is_the_derivative_of_the_position() -> None:
    unit = ConveyorPlant(Conveyor(ripple=Ripple(phase=1.0, amplitude=0.0)), 3, -2.0)
    for t in np.arange(-1.999, 15.0, 0.377):
        slope = (unit.at(t + 1e-5)[0] - unit.at(t - 1e-5)[0]) / 2e-5
        assert unit.at(t)[1] == pytest.approx(slope, abs=1e-6)


def test_a_standing_unit_has_no_ripple_at_all() -> None:
    unit = plant(ConveyorEvent("stop", 5.0, 0.104), ripple=Ripple(phase=0.3))
    assert {unit.at(t)[0] for t in (6.2, 7.0, 9.99)} == {unit.at(8.0)[0]}
    assert unit.at(8.0)[1] == 0.0


def test_the_ripples_speed_has_its_spread_and_correlation() -> None:
    speeds = []
    for seed in range(150):
        unit = plant(ripple=Ripple(amplitude=0.0, phase=0.0), seed=seed)
        speeds.append([unit.at(t)[1] - 0.106 for t in np.arange(0.0, 20.0, 0.5)])
    values = np.array(speeds)
    assert values.std() == pytest.approx(0.3e-3, rel=0.05)
    lag1s = float((values[:, 2:] * values[:, :-2]).mean() / (values**2).mean())
    assert lag1s == pytest.approx(math.exp(-1.0), abs=0.06)


def test_the_periodic_ripple_has_its_amplitude() -> None:
    unit = plant(ripple=Ripple(speed_sigma=0.0, phase=0.0))
    t = 0.25 / 1.2
    assert unit.at(t)[0] - 0.106 * t == pytest.approx(0.1e-3, abs=1e-12)


def test_a_block_of_positions_is_the_single_ones() -> None:
    unit = plant(*Conveyor().events, ripple=Ripple(phase=2.0), seed=5)
    times = -2.0 + 0.004 * np.arange(5000, dtype=np.float64)
    singles = np.array([unit.at(float(t))[0] for t in times])
    assert np.abs(unit.positions(times) - singles).max() < 1e-12


def test_the_ripple_does_not_depend_on_the_order_of_questions() -> None:
    forward, jumping = (plant(ripple=Ripple(phase=0.0), seed=9) for _ in range(2))
    late = jumping.at(30.0)
    early = jumping.at(1.0)
    assert forward.at(1.0) == early
    assert forward.at(30.0) == late


def test_before_the_run_there_is_no_answer() -> None:
    with pytest.raises(ValueError, match="before the start"):
        plant().at(-2.1)


def test_a_stop_is_announced_with_its_lead_until_the_restart() -> None:
    signal = StopSignal(bit=4, lead_s=0.024, false_s=(2.0,))
    plant = ConveyorPlant(Conveyor(stop_signal=signal), 0, -2.0)
    instants = (1.99, 2.1, 2.51, 4.97, 4.98, 8.99, 9.01)
    assert [plant.signals(t) for t in instants] == [0, 16, 0, 0, 16, 16, 0]


def test_a_stuck_signal_is_always_set_and_a_line_without_one_sends_nothing() -> None:
    stuck = ConveyorPlant(Conveyor(stop_signal=StopSignal(bit=4, stuck=True)), 0, -2.0)
    assert stuck.signals(0.0) == 16
    assert ConveyorPlant(Conveyor(), 0, -2.0).signals(6.0) == 0
