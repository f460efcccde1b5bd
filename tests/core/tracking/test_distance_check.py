"""What the distance sensor alone says of a change: it sees the conveyor, not the body."""

import numpy as np
import pytest

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers.distance import distance_check
from linemate.daemon.core.tracking.classifiers.distance.distance_check import NO_READINGS, Ramp
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source

T0 = 0.012
SIGMA = 0.38e-3
START = 0.013
BRAKING = 0.104


def readings(acceleration: float, moved_s: float, seed: int, speed: float = 0.0) -> Array:
    """A second of readings of a conveyor that accelerates since ``moved_s``."""
    rng = np.random.default_rng(seed)
    kept = NO_READINGS
    for k in range(84):
        left = max(moved_s - (83 - k) * T0, 0.0)
        value = speed * k * T0 + 0.5 * acceleration * left * left + rng.normal(0.0, SIGMA)
        kept = distance_check.keep(
            kept, [PositionMeasurement(Source.DISTANCE, value, 0.001, SIGMA**2, 4.0)], T0
        )
    return kept


def odds(
    kept: Array, onset: float, change: float, speed_deviation: float = 3e-4, speed: float = 0.0
) -> float:
    found = distance_check.log_odds(kept, onset, change, speed_deviation, SIGMA, speed=speed)
    assert found is not None
    return found


def test_a_conveyor_that_starts_is_distinguished_from_one_that_stands() -> None:
    started = [odds(readings(START, 0.4, seed), 0.4, START) for seed in range(40)]
    stands = [odds(readings(0.0, 0.4, seed), 0.4, START) for seed in range(40)]
    assert np.mean(started) > 5.0
    assert np.mean(stands) < -5.0
    assert sum(each > 1.5 for each in stands) <= 1


def test_a_stop_of_a_running_conveyor_is_found_without_knowing_its_speed() -> None:
    stopped = [odds(readings(-0.1, 0.15, s, 0.106), 0.15, -0.1, 0.003) for s in range(40)]
    runs = [odds(readings(0.0, 0.15, s, 0.106), 0.15, -0.1, 0.003) for s in range(40)]
    assert np.mean(stopped) > 1.5
    assert np.mean(runs) < -1.5


def test_the_odds_are_those_of_two_likelihoods() -> None:
    """Against the densities of all readings at once, with the prior of level and speed."""
    kept = readings(START, 0.3, 5)
    times, way = 0.3 - kept[0], kept[1] - kept[1][-1]
    cov = SIGMA**2 * np.eye(len(times)) + 1.0 + 9e-8 * np.outer(times, times)
    shift = 0.5 * START * np.maximum(times, 0.0) ** 2
    inverse = np.linalg.inv(cov)
    ratio = float(shift @ inverse @ way - 0.5 * shift @ inverse @ shift)
    assert odds(kept, 0.3, START) == pytest.approx(ratio, rel=1e-3, abs=1e-3)


def test_a_stop_after_a_silence_is_found_by_the_speed_that_was_known() -> None:
    """Few readings: a steady speed that is expected to be 0 denied stops."""

    def after_silence(acceleration: float, seed: int) -> Array:
        kept = readings(acceleration, 0.2, seed, 0.106)
        ages = kept[0]
        return kept[:, (ages < 0.05) | ((ages > 0.2) & (ages < 0.4))]

    def all_odds(acceleration: float, speed: float) -> list[float]:
        kept = (after_silence(acceleration, seed) for seed in range(40))
        return [odds(each, 0.2, -0.1, 0.003, speed) for each in kept]

    assert np.mean(all_odds(-0.1, 0.106)) > 5.0
    assert np.mean(all_odds(0.0, 0.106)) < -5.0
    assert np.mean(all_odds(-0.1, 0.0)) < np.mean(all_odds(-0.1, 0.106)) - 3.0


def late_until(age: float, acceleration: float, seed: int) -> Array:
    """Readings of a running conveyor, late by 20 ms up to an age; the next one comes too early."""
    kept = readings(acceleration, 0.2, seed, 0.106)
    kept[1, kept[0] > age] -= 0.106 * 0.02
    last = int(np.count_nonzero(kept[0] > age)) - 1
    kept[0, last] -= 0.7 * T0
    return kept


def test_a_sensor_that_is_late_no_more_denies_no_stop() -> None:
    denied = [odds(late_until(0.1, -0.1, seed), 0.2, -0.1, 0.003, 0.106) for seed in range(40)]
    assert min(denied) > -3.0
    runs = [odds(late_until(0.1, 0.0, seed), 0.2, -0.1, 0.003, 0.106) for seed in range(40)]
    assert np.mean(runs) < np.mean(denied) - 1.0


def test_a_sensor_that_is_uneven_all_the_time_keeps_its_say() -> None:
    kept = readings(0.0, 0.2, 3, 0.106)
    kept[0, 1::4] += 0.7 * T0
    kept[1, 1::4] -= 0.106 * 0.7 * T0
    assert odds(kept, 0.2, -0.1, 0.003, 0.106) < -5.0


def test_an_outlier_of_100_mm_does_not_speak() -> None:
    kept = readings(0.0, 0.4, 7)
    clean = odds(kept, 0.4, START)
    kept[1, 70] += 0.1
    assert odds(kept, 0.4, START) == pytest.approx(clean, abs=2.5)


def test_a_silent_sensor_has_no_say() -> None:
    kept = readings(0.0, 0.4, 1)
    assert distance_check.log_odds(NO_READINGS, 0.2, START, 3e-4, SIGMA) is None
    silent = distance_check.keep(kept, [], 0.2)
    assert distance_check.log_odds(silent, 0.2, START, 3e-4, SIGMA) is None


def test_readings_older_than_a_second_are_dropped_and_no_other_sensor_is_kept() -> None:
    kept = readings(0.0, 0.0, 1)
    camera = PositionMeasurement(Source.CAMERA, 0.0, 0.1, 1e-6, 4.0)
    later = distance_check.keep(kept, [camera], 0.5)
    assert later.shape[1] < kept.shape[1]
    assert later[0].max() <= distance_check.SPAN_S


def on_a_ramp(restart: float, seed: int) -> Array:
    """A second of readings: the conveyor brakes for 0.6 s, and starts again since ``restart``."""
    rng = np.random.default_rng(seed)
    kept, position, speed = NO_READINGS, 0.0, 0.106
    for k in range(84):
        left = (84 - k) * T0
        speed += T0 * (START if left <= restart else -BRAKING if left <= 0.6 else 0.0)
        position += speed * T0
        value = position + rng.normal(0.0, SIGMA)
        kept = distance_check.keep(
            kept, [PositionMeasurement(Source.DISTANCE, value, 0.0, SIGMA**2, 4.0)], T0
        )
    return kept


@pytest.mark.parametrize("share", [0.9, 1.0, 1.1])
def test_a_restart_is_distinguished_from_a_stop_that_goes_on(share: float) -> None:
    ramp = Ramp(0.6, -share * BRAKING)
    change = START + BRAKING

    def odds_of(restart: float, seed: int) -> float:
        kept = on_a_ramp(restart, seed)
        odds = distance_check.log_odds(kept, 0.2, change, 0.003, SIGMA, ramp)
        assert odds is not None
        return odds

    assert min(odds_of(0.2, seed) for seed in range(20)) > 1.5
    assert max(odds_of(0.0, seed) for seed in range(20)) < -1.5


def test_the_speed_on_a_ramp_is_that_of_the_readings() -> None:
    for seed in range(20):
        found = distance_check.speed_now(on_a_ramp(0.0, seed), Ramp(0.6, -BRAKING), SIGMA)
        assert found == pytest.approx(0.106 - 0.6 * BRAKING, abs=0.005)
    assert distance_check.speed_now(NO_READINGS, Ramp(0.6, -BRAKING), SIGMA) is None


def test_only_the_readings_since_an_age_are_asked() -> None:
    kept = readings(0.0, 0.0, 1)
    assert distance_check.since(kept, 0.1)[0].max() <= 0.1
    assert distance_check.since(kept, 2.0) is kept
