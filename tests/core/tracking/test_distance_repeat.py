"""A distance sensor that freezes, ends or becomes late while the conveyor runs shows no stop."""

import numpy as np
import pytest
from conveyor_bank import FUSION
from conveyor_truth import DEVIATION, NOMINAL, STOP, T0, Truth

from linemate.daemon.core.tracking.classifiers.bank_model import OFFSET, BankState, V, Y
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings
from linemate.daemon.core.tracking.task import ConveyorClasses


def frozen_at_full_speed(seed: int, cycle_s: float, frozen_s: float = 0.15) -> list[BankState]:
    """Return the states of a sensor in steps of 1 mm since it froze."""
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    rng, state, read, states = np.random.default_rng(seed), bank.initial(0.0), 0.0, []
    for t in np.arange(cycle_s, 2.0 + frozen_s, cycle_s):
        if t < 2.0:
            read = 1e-3 * round(1e3 * (NOMINAL * t + rng.normal(0.0, 2.5e-4)))
        row = PositionMeasurement(Source.DISTANCE, read, 0.0, DEVIATION**2, 4.0)
        state = bank.advance(state, [row], cycle_s)
        states += [state] if t >= 2.0 else []
    return states


@pytest.mark.parametrize("seed", range(20))
def test_a_sensor_that_freezes_at_full_speed_stops_no_conveyor(seed: int) -> None:
    """At 4 ms the filter followed it to rest within 0.08 s, and the tool missed the hub."""
    states = frozen_at_full_speed(seed, 0.004)
    assert {state.motion for state in states} == {Motion.RUNNING}
    assert states[-1].x[V] == pytest.approx(NOMINAL, abs=2e-3)


def test_what_a_frozen_sensor_repeated_at_first_supports_no_stop() -> None:
    """In contact lower odds confirm a stop: it was confirmed at the touch, 205 N."""
    seeds = [frozen_at_full_speed(seed, T0) for seed in range(40)]
    before = max(state.change_odds for states in seeds for state in states[:2])
    last = [states[-1] for states in seeds]
    after = max(state.change_odds for state in last)
    assert after < BankSettings().contact_confirmed < before
    assert all(len(set(state.readings[1, -2:])) == 2 for state in last)


@pytest.mark.parametrize("seed", range(6))
def test_a_sensor_that_freezes_as_a_slow_conveyor_brakes_does_not_stop_it(seed: int) -> None:
    """The filter followed it, and the tool touched 5 mm off the hub: 247 N."""
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    rng, state, read = np.random.default_rng(seed), bank.initial(0.0), 0.0
    for t in np.arange(T0, 1.9 + NOMINAL / STOP, T0):
        braked = max(t - 2.0, 0.0)
        at = NOMINAL * t - 0.5 * STOP * braked * braked
        if NOMINAL - STOP * braked > 0.03:
            read = 1e-3 * round(1e3 * (at + rng.normal(0.0, 2.5e-4)))
        row = PositionMeasurement(Source.DISTANCE, read, 0.0, DEVIATION**2, 4.0)
        state = bank.advance(state, [row], T0)
    assert state.x[Y] + state.x[OFFSET] == pytest.approx(at, abs=2e-3)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("again_s", [2.12, 2.5])
def test_a_frozen_sensor_that_shows_a_standing_object_again_is_no_start(
    again_s: float, seed: int
) -> None:
    """Its step was taken for a start that began 0.1 s before: 219 N."""
    bank = BankClassifier(ConveyorClasses(), FUSION, BankSettings(), DEVIATION)
    rng, truth = np.random.default_rng(seed), Truth(3.0, ((1.0, -STOP),))
    state, frozen_s = bank.initial(0.0), 1.81  # 2 mm before it stands
    for t in np.arange(T0, again_s + 0.3, T0):
        at = float(truth.at(t))
        if not frozen_s < t < again_s:
            read = round((at + rng.normal(0.0, 2.5e-4)) * 1e3) / 1e3
        rows = [PositionMeasurement(Source.DISTANCE, read, 0.0, DEVIATION**2, 4.0)]
        if t > 1.8:
            held = at + rng.normal(0.0, 1e-4)
            rows.append(PositionMeasurement(Source.TACTILE, held, 0.0, 1e-6, 20.0))
        state = bank.advance(state, rows, T0)
        assert ("start", "confirmed") not in state.events


@pytest.mark.parametrize("seed", range(4))
def test_late_readings_that_end_before_the_touch_are_no_stop(seed: int) -> None:
    """The distance sensor alone showed a stop that had begun before they ended: 268 N."""
    bank = BankClassifier(ConveyorClasses(), FUSION, BankSettings(), DEVIATION)
    rng, state = np.random.default_rng(seed), bank.initial(0.0)
    for t in np.arange(T0, 2.5, T0):
        at, rows = NOMINAL * t, []
        if t < 2.0:
            read = 1e-3 * round(1e3 * (at + rng.normal(0.0, 2.5e-4)))
        elif t < 2.11:
            read = at - 0.0032 - 0.023 * (t - 2.05)
        if not 2.0 < t < 2.05 and t < 2.2:
            rows.append(PositionMeasurement(Source.DISTANCE, read, 0.0, DEVIATION**2, 4.0))
        if t > 2.27:
            held = at + rng.normal(0.0, 4e-5)
            rows.append(PositionMeasurement(Source.TACTILE, held, 0.0, 4e-5**2, 20.0))
        state = bank.advance(state, rows, T0)
        assert state.motion is Motion.RUNNING


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("late_s", [0.025, 0.03, 0.035])
def test_a_sensor_that_becomes_late_in_contact_is_no_stop(late_s: float, seed: int) -> None:
    """The distance sensor alone showed one, while the force showed none: 226 N."""
    bank = BankClassifier(ConveyorClasses(), FUSION, BankSettings(), DEVIATION)
    rng, state = np.random.default_rng(seed), bank.initial(0.0)
    for t in np.arange(T0, 2.6, T0):
        at, rows = NOMINAL * t, []
        if not 2.2 < t < 2.2 + late_s + T0:  # it shows nothing as it becomes late
            delayed = at - NOMINAL * late_s * (t > 2.2)
            read = 1e-3 * round(1e3 * (delayed + rng.normal(0.0, 2.5e-4)))
            rows.append(PositionMeasurement(Source.DISTANCE, read, 0.0, DEVIATION**2, 4.0))
        if t > 2.1:
            held = at + rng.normal(0.0, 4e-5)
            rows.append(PositionMeasurement(Source.TACTILE, held, 0.0, 4e-5**2, 20.0))
        state = bank.advance(state, rows, T0)
        assert state.motion is Motion.RUNNING
