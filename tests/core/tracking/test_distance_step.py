"""A step of the distance sensor is no stop, and a stop is no step."""

import numpy as np
import pytest

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers.distance import distance_step
from linemate.daemon.core.tracking.classifiers.onset_bank import AmplitudePrior

T0, SIGMA, STOP, SPEED, UNIT = 0.012, 0.39e-3, -0.104, 0.106, 1e-3
PRIOR = AmplitudePrior(STOP, (0.15 * STOP) ** 2)
FASTER = AmplitudePrior(STOP, 0.1**2, 1.45, -4.6)
LATE_S = 0.02


def readings(way: Array, ages: Array, seed: int) -> Array:
    """Readings (2, m) of a sensor with noise and a unit, as the classifier keeps them."""
    noise = np.random.default_rng(seed).normal(0.0, 0.25e-3, len(ages))
    return np.stack((ages, UNIT * np.round((way - SPEED * ages + noise) / UNIT)))


def steady_ages() -> Array:
    return T0 * np.arange(60.0, -1.0, -1.0)


def late(since_s: float, seed: int) -> Array:
    """Readings of a sensor that is late from a moment on, and shows none until then."""
    ages = steady_ages()
    is_late = ages < since_s
    seen = np.abs(ages - since_s) > 0.5 * LATE_S
    way = np.where(is_late, -SPEED * LATE_S, 0.0)
    return readings(way[seen], ages[seen], seed)


def stopping(since_s: float, seed: int, share: float = 1.0) -> Array:
    ages = steady_ages()
    return readings(0.5 * share * STOP * np.maximum(since_s - ages, 0.0) ** 2, ages, seed)


def find(kept: Array, faster: AmplitudePrior | None = FASTER) -> distance_step.DistanceStep | None:
    return distance_step.find(kept, PRIOR, SPEED, 0.003, SIGMA, faster)


@pytest.mark.parametrize("seed", range(20))
def test_a_sensor_that_becomes_late_is_a_step_of_its_size(seed: int) -> None:
    step = find(late(0.06, seed))
    assert step is not None
    assert step.is_certain
    assert step.size == pytest.approx(-SPEED * LATE_S, abs=4.0 * step.deviation)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("since_s", [0.16, 0.2, 0.3])
def test_a_stop_is_no_step(since_s: float, seed: int) -> None:
    step = find(stopping(since_s, seed))
    assert step is None or not step.is_certain


def test_an_emergency_stop_is_no_step() -> None:
    taken = []
    for faster in (None, FASTER):
        steps = [find(stopping(0.12, seed, share=5.0), faster) for seed in range(60)]
        taken.append(sum(step is not None and step.is_certain for step in steps))
    as_stated, known = taken
    assert known == 0
    assert as_stated > 10


@pytest.mark.parametrize("since_s", [0.1, 0.12, 0.14])
def test_a_fast_stop_is_no_step(since_s: float) -> None:
    """A stop of 0.24 m/s^2 was taken for a step of 2 mm by a sensor that missed no reading."""
    steps = [find(stopping(since_s, seed, share=2.3)) for seed in range(100)]
    assert steps.count(None) >= 99


def test_a_step_of_a_sensor_that_misses_no_reading_is_one() -> None:
    for seed in range(20):
        ages = steady_ages()
        step = find(readings(np.where(ages < 0.06, -3e-3, 0.0), ages, seed))
        assert step is not None
        assert step.is_certain


@pytest.mark.parametrize("since_s", [0.16, 0.2, 0.3])
@pytest.mark.parametrize("at", [-2, -3, -4])
def test_an_outlier_next_to_a_stop_is_no_step(at: int, since_s: float) -> None:
    certain = 0
    for seed in range(20):
        kept = stopping(since_s, seed)
        kept[1, at] -= 20e-3
        step = find(kept)
        certain += step is not None and step.is_certain
    assert certain <= 1


def test_less_than_a_late_sensor_shows_is_no_step() -> None:
    """A stop of which less than a unit of the sensor showed was held for a step: 258 N."""
    for seed in range(20):
        ages = steady_ages()
        way = np.where(ages < 0.06, -0.9e-3, 0.0)
        step = find(readings(way, ages, seed))
        assert step is None or abs(step.size) > 1.4e-3


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("silent_s", [0.04, 0.07, 0.1])
def test_a_stop_behind_a_silence_is_no_step(silent_s: float, seed: int) -> None:
    """A sensor that was silent for 0.1 s and is late since then reads 11 mm less, a stop 1 mm."""
    kept = stopping(0.2, seed)
    ages = kept[0]
    step = find(kept[:, (ages < 0.1 - 0.5 * silent_s) | (ages > 0.1 + 0.5 * silent_s)])
    assert step is None or not step.is_certain


@pytest.mark.parametrize("seed", range(20))
def test_a_steady_conveyor_shows_no_step(seed: int) -> None:
    assert find(readings(np.zeros(61), steady_ages(), seed)) is None


def test_one_outlier_and_too_few_readings_are_no_step() -> None:
    kept = stopping(0.0, 1)
    kept[1, -1] -= 3e-3
    assert find(kept) is None
    assert find(kept[:, -8:]) is None


def test_a_step_that_is_longer_ago_is_not_looked_for() -> None:
    step = find(late(0.3, 1))
    assert step is None or abs(step.size) < 0.5 * SPEED * LATE_S


@pytest.mark.parametrize("seed", range(5))
def test_readings_that_a_stalled_host_read_at_once_are_no_silence(seed: int) -> None:
    ages = np.repeat(steady_ages()[::3], 3)
    assert find(readings(np.zeros_like(ages), ages, seed)) is None
    step = find(readings(np.where(ages < 0.06, -SPEED * LATE_S, 0.0), ages, seed))
    assert step is not None
    assert step.size == pytest.approx(-SPEED * LATE_S, abs=4.0 * step.deviation)


def test_levelled_readings_have_no_step_left() -> None:
    kept = late(0.06, 3)
    step = find(kept)
    assert step is not None
    level = distance_step.levelled(kept, step)
    assert level[1, -1] == kept[1, -1]
    assert np.ptp(level[1] + SPEED * level[0]) < 2.5 * UNIT
    assert np.ptp(kept[1] + SPEED * kept[0]) > 2.5 * UNIT
    assert find(level) is None
