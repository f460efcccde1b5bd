"""Readings of the distance sensor show their noise, whatever the object does."""

import math

import numpy as np
import pytest

from linemate.daemon.core.tracking.classifiers.distance.measured_noise import (
    AS_CONFIGURED,
    LARGEST_INFLATION,
    MeasuredNoise,
    update,
)
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source

T0, SIGMA = 0.012, 0.00038
SPEED = 0.104
EMERGENCY = 3.0  # [m/s^2]


def positions(count: int) -> np.ndarray:
    """Way of a conveyor that runs evenly."""
    return SPEED * T0 * np.arange(count)


def after(
    readings: np.ndarray, sigma: float = SIGMA, noise: MeasuredNoise = AS_CONFIGURED
) -> list[MeasuredNoise]:
    """Return the noise after each step; a NaN is a step without a reading."""
    states = []
    for value in readings.tolist():
        reading = PositionMeasurement(Source.DISTANCE, value, 0.001, sigma**2, 4.0)
        noise = update(noise, [] if np.isnan(value) else [reading], T0)
        states.append(noise)
    return states


@pytest.mark.parametrize("seed", range(10))
def test_a_sensor_with_its_configured_noise_is_believed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    readings = positions(3000) + rng.normal(0.0, SIGMA, 3000)
    states = after(readings)
    assert max(each.inflation for each in states) == 1.0
    assert states[-1].nis == pytest.approx(1.0, abs=0.5)


@pytest.mark.parametrize("step", [0.0005, 0.001])
@pytest.mark.parametrize("speed", [0.0, SPEED])
def test_a_sensor_with_a_coarse_step_is_believed(step: float, speed: float) -> None:
    rng = np.random.default_rng(4)
    sigma = np.hypot(0.00025, step / np.sqrt(12.0))
    readings = speed * T0 * np.arange(3000) + 0.5 * step + rng.normal(0.0, 0.00025, 3000)
    states = after(step * np.round(readings / step), sigma)
    assert max(each.inflation for each in states) == 1.0


@pytest.mark.parametrize("factor", [2.0, 3.0, 5.0])
@pytest.mark.parametrize("kept", [1.0, 0.5])
def test_a_sensor_that_is_noisier_than_configured_is_believed_less(
    factor: float, kept: float
) -> None:
    rng = np.random.default_rng(7)
    readings = positions(1200) + rng.normal(0.0, factor * SIGMA, 1200)
    readings[rng.random(1200) > kept] = np.nan
    states = after(readings)
    first = next(k for k, each in enumerate(states) if each.inflation > 1.0)
    assert first * kept < 600.0 / factor
    assert 0.6 * factor**2 < states[-1].inflation < 4.0 * factor**2


def test_a_noise_that_grows_is_followed_quickly() -> None:
    needed = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        states = after(positions(400) + rng.normal(0.0, 5.0 * SIGMA, 400))
        needed.append(next(k for k, each in enumerate(states) if each.inflation > 12.0))
    assert np.median(needed) < 160


def test_the_inflation_is_bounded_and_ends_with_the_noise() -> None:
    rng = np.random.default_rng(2)
    readings = positions(4000)
    readings[:1000] += rng.normal(0.0, 100.0 * SIGMA, 1000)
    readings[1000:] += rng.normal(0.0, SIGMA, 3000)
    states = after(readings)
    assert states[999].inflation == LARGEST_INFLATION
    assert states[-1].inflation <= 2.0


@pytest.mark.parametrize("sigma", [0.0001, SIGMA])
def test_emergency_stops_are_no_noise(sigma: float) -> None:
    """The conveyor stops with 3 m/s^2 once a second, and starts again as quickly."""
    rng = np.random.default_rng(3)
    times = T0 * np.arange(3000)
    speeds = np.clip(np.abs((times % 2.0) - 1.0) - 0.5, -0.5, 0.5) * EMERGENCY
    readings = np.cumsum(np.clip(speeds, 0.0, SPEED)) * T0 + rng.normal(0.0, sigma, 3000)
    assert max(each.inflation for each in after(readings, sigma)) == 1.0


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_outliers_are_no_noise(share: float) -> None:
    rng = np.random.default_rng(5)
    readings = positions(3000) + rng.normal(0.0, SIGMA, 3000)
    readings[rng.random(3000) < share] += 0.02
    assert max(each.inflation for each in after(readings)) == 1.0


def test_a_slow_error_of_the_sensor_is_no_noise() -> None:
    """What a filter does not average out is no matter of the reading's variance."""
    rng = np.random.default_rng(6)
    slow = np.zeros(3000)
    for k in range(1, 3000):
        slow[k] = 0.98 * slow[k - 1] + 0.2 * rng.normal(0.0, 0.001)
    states = after(positions(3000) + slow + rng.normal(0.0, 0.5 * SIGMA, 3000))
    assert max(each.inflation for each in states) == 1.0


def test_a_coarse_sensor_stays_noisy_while_the_conveyor_stands() -> None:
    """A step of 2 mm, given as 0.15 mm: on a conveyor that stands it shows no noise at all."""
    way = np.concatenate((positions(2000), np.full(100_000, 2.5)))
    states = after(0.002 * np.round(way / 0.002), 0.00015)
    assert states[1999].inflation >= 8.0
    assert states[-1].inflation == states[1999].inflation


def test_a_sensor_that_repeats_itself_for_hours_is_noisy_soon_after() -> None:
    rng = np.random.default_rng(8)
    readings = np.concatenate((np.zeros(100_000), rng.normal(0.0, 5.0 * SIGMA, 400)))
    states = after(readings)
    assert states[99_999].inflation == 1.0
    assert states[-1].inflation >= 16.0


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
def test_what_is_no_distance_counts_as_an_outlier(value: float) -> None:
    noise = AS_CONFIGURED
    for each in (0.0, 0.0, value, 0.0, 0.0, 0.0):
        reading = PositionMeasurement(Source.DISTANCE, each, 0.001, SIGMA**2, 4.0)
        noise = update(noise, [reading], T0)
    assert 1.0 < noise.nis < 1.3


def test_readings_of_other_sensors_do_not_count() -> None:
    image = PositionMeasurement(Source.CAMERA, 0.1, 0.1, SIGMA**2, 4.0)
    assert update(AS_CONFIGURED, [image], T0) == AS_CONFIGURED


def test_a_reading_that_is_older_than_the_last_does_not_count() -> None:
    noise = AS_CONFIGURED
    for value, delay in ((0.0, 0.001), (0.1, 0.001), (0.0, 0.2)):
        reading = PositionMeasurement(Source.DISTANCE, value, delay, SIGMA**2, 4.0)
        noise = update(noise, [reading], T0)
    assert noise.nis == 1.0
