"""The periodic part of the ripple: a frequency known roughly, of unknown phase and size."""

import math

import numpy as np
import pytest
from conveyor_bank import NO_RIPPLE, SETTINGS, TOUCH
from conveyor_truth import DEVIATION, START, STOP, T0, Truth

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers.bank_model import FREQUENCY, RIPPLE, V
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings, RippleSettings
from linemate.daemon.core.tracking.task import ConveyorClasses

RIPPLE_HZ, RIPPLE_M = 1.2, 0.0001


def ripple_errors(bank: BankClassifier, hz: float, ahead: float, *, touch: bool) -> Array:
    """Errors of the prediction ``ahead`` s, of the last 10 s of 14 on a conveyor with a ripple."""
    rng = np.random.default_rng(7)
    truth = Truth(14.0, seed=7)

    def at(t: float) -> float:
        return float(truth.at(t)) + RIPPLE_M * math.sin(2.0 * math.pi * hz * t)

    state = bank.initial(at(-1.5))
    errors = []
    for t in np.arange(-1.5 + T0, 13.8, T0):
        read = round((at(t - 0.001) + rng.normal(0.0, 0.00025)) * 1e3) / 1e3
        rows = [PositionMeasurement(Source.DISTANCE, read, 0.001, DEVIATION**2, 4.0)]
        if touch:
            felt = at(t - 0.006) + rng.normal(0.0, TOUCH)
            rows.append(PositionMeasurement(Source.TACTILE, felt, 0.006, TOUCH**2, 5.0))
        state = bank.advance(state, rows, T0)
        if t > 4.0:
            errors.append(
                float(bank.predict_positions(state, np.array((ahead,)))[0]) - at(t + ahead)
            )
    return np.array(errors)


@pytest.mark.row
@pytest.mark.long
@pytest.mark.parametrize("touch", [False, True], ids=["distance alone", "in contact"])
@pytest.mark.parametrize("off", [0.97, 1.0, 1.03])
def test_a_periodic_ripple_is_foreseen_with_its_frequency_a_few_hundredths_off(
    off: float, touch: bool
) -> None:
    quiet = BankSettings(penalty=50.0, contact_penalty=50.0)
    plain, foreseeing = (
        BankClassifier(ConveyorClasses(), FusionSettings(), quiet, DEVIATION, ripple=ripple)
        for ripple in (NO_RIPPLE, RippleSettings(frequency_hz=RIPPLE_HZ))
    )
    before, now = (
        float(np.std(ripple_errors(bank, RIPPLE_HZ * off, 0.12, touch=touch)))
        for bank in (plain, foreseeing)
    )
    assert now < (0.8 if touch else 0.9) * before


def test_a_large_ripple_far_off_its_frequency_is_found_and_is_no_stop() -> None:
    """The chain of a plant: 0.2 mm, and 12 % slower than configured."""
    wide = RippleSettings(spread=0.1, deviation=0.0001, walk=0.00002, pace=0.004)
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), SETTINGS, DEVIATION, ripple=wide)
    hz, rng, late = 0.88 * bank.ripple.frequency_hz, np.random.default_rng(7), 0
    truth = Truth(14.0, seed=7)
    state = bank.initial(float(truth.at(-1.5)))
    for t in np.arange(-1.5 + T0, 13.8, T0):
        past = t - 0.001
        at = float(truth.at(past)) + 0.0002 * math.sin(2.0 * math.pi * hz * past)
        read = round((at + rng.normal(0.0, 0.00025)) * 1e3) / 1e3
        rows = [PositionMeasurement(Source.DISTANCE, read, 0.001, DEVIATION**2, 4.0)]
        state = bank.advance(state, rows, T0)
        late += t > 4.0 and state.tentative
    assert bank.ripple_omega(state) == pytest.approx(2.0 * math.pi * hz, rel=0.02)
    assert float(np.hypot(*state.x[7:9])) == pytest.approx(0.0002, rel=0.5)
    assert late == 0


def test_the_readings_that_a_stop_is_sought_in_are_without_the_ripple() -> None:
    """A chain wheel of eight teeth was taken for a stop of 0.1 m/s^2."""
    wide = RippleSettings(spread=0.1, deviation=0.0001, walk=0.00002, pace=0.004)
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), SETTINGS, DEVIATION, ripple=wide)
    state, rng = bank.initial(0.0), np.random.default_rng(3)
    speed = state.cruise
    for t in np.arange(T0, 12.0, T0):
        at = speed * t + 0.0005 * math.sin(2.0 * math.pi * 1.07 * t)
        read = round((at + rng.normal(0.0, 0.00025)) * 1e3) / 1e3
        rows = [PositionMeasurement(Source.DISTANCE, read, 0.0, DEVIATION**2, 4.0)]
        state = bank.advance(state, rows, T0)
    off = [
        float(np.std(ways - np.polyval(np.polyfit(ages, ways, 1), ages)))
        for ages, ways in (state.readings, bank._readings(state))
    ]
    assert off[1] < 1.1 * DEVIATION < off[0]


@pytest.mark.parametrize("seed", range(3))
def test_the_chain_of_a_conveyor_that_starts_is_no_stop(seed: int) -> None:
    """0.3 mm at each pitch of 0.1 m: its frequency rises with the speed."""
    wide = RippleSettings(spread=0.1, deviation=0.0001, walk=0.00002, pace=0.004)
    bank = BankClassifier(
        ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION, ripple=wide
    )
    truth, rng = Truth(10.0, ((0.5, START),), seed=seed, speed=0.0), np.random.default_rng(seed)
    state, errors, events = bank.initial(0.0), [], []
    for t in np.arange(-1.5 + T0, 9.5, T0):
        at = float(truth.at(t))
        seen = at + 0.0003 * math.sin(20.0 * math.pi * at) + rng.normal(0.0, DEVIATION)
        rows = [PositionMeasurement(Source.DISTANCE, seen, 0.0, DEVIATION**2, 4.0)]
        state = bank.advance(state, rows, T0)
        events += state.events
        if t > 3.0:
            errors.append(float(state.x[V]) - float(np.interp(t, truth.times, truth.speeds)))
    assert ("stop", "confirmed") not in events
    assert float(np.std(errors)) < 0.0007


@pytest.mark.long
@pytest.mark.parametrize("touch", [False, True], ids=["distance alone", "in contact"])
def test_a_ripple_where_none_is_expected_costs_little(touch: bool) -> None:
    quiet = BankSettings(penalty=50.0, contact_penalty=50.0)
    plain, foreseeing = (
        BankClassifier(ConveyorClasses(), FusionSettings(), quiet, DEVIATION, ripple=ripple)
        for ripple in (NO_RIPPLE, RippleSettings(frequency_hz=RIPPLE_HZ))
    )
    before, now = (
        float(np.std(ripple_errors(bank, 2.1, 0.12, touch=touch))) for bank in (plain, foreseeing)
    )
    assert now < 1.1 * before


def test_a_conveyor_that_has_stood_keeps_its_learnt_ripple_frequency() -> None:
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    truth = Truth(8.0, ((5.0, -STOP),))
    rng = np.random.default_rng(4)
    state, paces = bank.initial(float(truth.at(-1.5))), []
    for t in np.arange(-1.5 + T0, 7.5, T0):
        read = round((float(truth.at(t - 0.001)) + rng.normal(0.0, 0.00025)) * 1e3) / 1e3
        state = bank.advance(
            state, [PositionMeasurement(Source.DISTANCE, read, 0.001, DEVIATION**2, 4.0)], T0
        )
        paces.append(state.ripple_factor)
    assert state.motion is Motion.STANDING
    assert np.diag(state.P)[RIPPLE:FREQUENCY] == pytest.approx(
        RippleSettings().deviation ** 2, rel=1e-3
    )
    assert paces[-1] == pytest.approx(paces[-60], abs=1e-4)
    assert state.P[FREQUENCY, FREQUENCY] < RippleSettings().spread ** 2
