"""A change of class that the distance sensor alone shows."""

import numpy as np
import pytest

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers.bank_filter import REST_DEVIATION
from linemate.daemon.core.tracking.classifiers.classifier_bank import SURE_STOP, BankClassifier
from linemate.daemon.core.tracking.classifiers.distance import distance_change, distance_check
from linemate.daemon.core.tracking.classifiers.distance.distance_change import DistanceChange
from linemate.daemon.core.tracking.classifiers.distance.distance_check import NO_READINGS
from linemate.daemon.core.tracking.classifiers.onset_bank import OnsetBank
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings
from linemate.daemon.core.tracking.task import ConveyorClasses

T0, SIGMA, START, STOP, SPEED = 0.012, 0.38e-3, 0.013, -0.104, 0.106
SURE = 17.0
BANK = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), SIGMA, compliance=12.0)
STARTS, STOPS = (BANK.shown_priors[motion] for motion in (Motion.STANDING, Motion.RUNNING))


def start(readings: Array, least: float = SURE) -> DistanceChange | None:
    return distance_change.find(readings, START, 0.0, 3e-4, SIGMA, STARTS, least)


def stop(
    readings: Array, least: float = SURE_STOP, *, as_stated: bool = True
) -> DistanceChange | None:
    priors = STOPS[:1] if as_stated else STOPS
    return distance_change.find(readings, STOP, SPEED, 3e-3, SIGMA, priors, least)


def kept(motion: Array, seed: int) -> Array:
    """The readings of a second of a motion (84,), newest last."""
    rng = np.random.default_rng(seed)
    rows = NO_READINGS
    for way in motion.tolist():
        measured = PositionMeasurement(
            Source.DISTANCE, way + rng.normal(0.0, SIGMA), 0.001, SIGMA**2, 4.0
        )
        rows = distance_check.keep(rows, [measured], T0)
    return rows


def ramp(acceleration: float, lasting: float, speed: float = 0.0) -> Array:
    ages = T0 * np.arange(83.0, -1.0, -1.0)
    return 0.5 * acceleration * np.maximum(lasting - ages, 0.0) ** 2 - speed * ages


@pytest.mark.parametrize("seed", range(6))
def test_a_start_is_certain_after_half_a_second_with_its_onset_and_speed(seed: int) -> None:
    declared = start(kept(ramp(START, 0.5), seed))
    assert declared is not None
    assert declared.odds > SURE
    assert declared.onset == pytest.approx(0.5, abs=0.13)
    reading, speed, _ = declared.values
    assert speed == pytest.approx(START * 0.5, abs=2e-3)
    assert reading == pytest.approx(0.5 * START * 0.5**2, abs=3e-4)


@pytest.mark.parametrize(("acceleration", "lasting"), [(0.04, 0.36), (0.1, 0.2)])
def test_a_start_faster_than_stated_is_certain_sooner_with_its_speed(
    acceleration: float, lasting: float
) -> None:
    offs = []
    for seed in range(12):
        declared = start(kept(ramp(acceleration, lasting), seed))
        assert declared is not None
        off = float(declared.values[1]) - acceleration * lasting
        offs.append(off / np.hypot(REST_DEVIATION, declared.covariance[1, 1] ** 0.5))
    assert np.abs(offs).max() < 3.5
    assert abs(np.mean(offs)) < 0.5


@pytest.mark.parametrize("seed", range(6))
def test_a_stop_is_certain_after_a_third_of_a_second(seed: int) -> None:
    assert stop(kept(ramp(STOP, 0.33, SPEED), seed)) is not None


@pytest.mark.parametrize("seed", range(6))
def test_a_stop_faster_than_stated_that_the_bank_has_is_certain_after_a_sixth(seed: int) -> None:
    readings = kept(ramp(3.0 * STOP, 0.16, SPEED), seed)
    declared = stop(readings, BANK.bank.stop_confirmed, as_stated=False)
    assert declared is not None
    assert declared.values[1] == pytest.approx(SPEED + 3.0 * STOP * 0.16, abs=0.016)
    assert declared.values[2] < 1.3 * STOP


def test_what_the_change_has_made_of_another_state_is_taken_back() -> None:
    readings = kept(ramp(START, 0.5), 1)
    ages = np.linspace(0.012, 0.9, 75)
    others = OnsetBank(2e-3 * ages[None] ** 2, np.stack((ages, ages, ages, ages, ages)))
    declared = distance_change.find(readings, START, 0.0, 3e-4, SIGMA, STARTS, SURE, others)
    assert declared is not None
    assert declared.values[3] == pytest.approx(-2e-3 * 0.5**2, rel=0.4)
    assert np.linalg.eigvalsh(declared.covariance).min() > 0.0


def test_a_steady_motion_is_no_change() -> None:
    for seed in range(40):
        assert start(kept(ramp(0.0, 0.5), seed), 6.0) is None
        assert stop(kept(ramp(0.0, 0.5, SPEED), seed), 6.0, as_stated=False) is None


@pytest.mark.parametrize("ago", [0.04, 0.06, 0.08, 0.1, 0.2, 0.3, 0.6])
def test_a_frozen_or_stepping_reading_is_no_change(ago: float) -> None:
    ages = T0 * np.arange(83.0, -1.0, -1.0)
    frozen = -SPEED * np.maximum(ages, ago)
    stepped = np.where(ages < ago, 0.006, 0.0)
    assert stop(kept(frozen, 1)) is None
    assert start(kept(stepped, 1)) is None


@pytest.mark.parametrize("phase", np.linspace(0.0, 5.5, 12))
def test_the_ripple_of_a_chain_is_no_stop(phase: float) -> None:
    ages = T0 * np.arange(83.0, -1.0, -1.0)
    chain = -SPEED * ages + 0.75e-3 * np.sin(2.0 * np.pi * 1.06 * ages + phase)
    assert stop(kept(chain, 1)) is None


def test_too_few_readings_show_nothing() -> None:
    few = kept(ramp(START, 0.5), 1)[:, -5:]
    assert start(few) is None


def started(*, gives_way: bool) -> float | None:
    """Time until a start is confirmed [s] of an object that the tool holds; None if it is not.

    The object swings with the tool by 1.5 mm, and does not follow the conveyor.
    """
    rng = np.random.default_rng(3)
    state = BANK.initial(0.0)
    for k in range(round(6.5 / T0)):
        t = k * T0
        late = max(t - 5.0, 0.0)
        way = 0.5 * START * late * late
        rows = [
            PositionMeasurement(Source.DISTANCE, way + rng.normal(0.0, SIGMA), 0.001, SIGMA**2, 4.0)
        ]
        if t > 3.0:
            swing = 0.0015 * np.sin(2.0 * np.pi * 3.6 * t) * (1.0 - np.exp(-(t - 3.0) / 0.3))
            rows.append(
                PositionMeasurement(
                    Source.TACTILE, float(swing), 0.005, 3e-5**2, 20.0, is_firm=not gives_way
                )
            )
        state = BANK.advance(state, rows, T0)
        if state.motion is Motion.STARTING and t > 5.0:
            assert state.x[0] == pytest.approx(0.0, abs=2e-3)
            assert float(state.x[1]) == pytest.approx(START * late, abs=3e-3)
            return late
    return None


def test_a_start_is_confirmed_although_the_held_object_swings() -> None:
    """It was hidden for 1.6 s, and the filter then jumped by 2 mm and 25 mm/s."""
    late = started(gives_way=True)
    assert late is not None
    assert late < 0.6


def test_the_force_counts_where_the_object_is_firm() -> None:
    late = started(gives_way=False)
    assert late is None or late > 0.6


def begun_before(speed: float, acceleration: float, seed: int) -> tuple[float, float] | None:
    """The speed [m/s] and acceleration [m/s^2] of a start, 0.3 s after the conveyor "stood".

    Args:
        speed: that it had then [m/s].
    """
    readings = distance_check.since(kept(ramp(acceleration, 0.3 + speed / acceleration), seed), 0.3)
    found = start(readings)
    if found is None:
        return None
    found = distance_change.begun_before(readings, found, START, 3e-4, SIGMA)
    return float(found.values[1]), float(found.values[2])


@pytest.mark.parametrize("seed", range(6))
def test_a_start_before_the_conveyor_stood_has_its_speed_and_no_large_acceleration(
    seed: int,
) -> None:
    found = begun_before(0.007, START, seed)
    assert found is not None
    assert found[0] == pytest.approx(0.007 + 0.3 * START, abs=0.003)
    assert 0.0 < found[1] < 3.0 * START


@pytest.mark.parametrize("seed", range(6))
def test_a_start_faster_than_stated_did_not_begin_before_the_readings(seed: int) -> None:
    readings = distance_check.since(kept(ramp(10.0 * START, 0.25), seed), 0.5)
    found = start(readings)
    assert found is not None
    assert distance_change.begun_before(readings, found, START, 3e-4, SIGMA) is found
