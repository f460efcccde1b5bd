"""Laws of the sensor's errors: constant bias, drift that ends, own draws."""

import math

import numpy as np
import pytest

from linemate.simulators.plants.forces.gauge import GaugeErrors, new_gauge
from linemate.simulators.plants.forces.switches import ForceTorqueEffects
from linemate.simulators.plants.scenario import ForceTorque, Scenario
from linemate.simulators.plants.world import World

EFFECTS = ForceTorqueEffects(5.0, 0.5, 3.0, 0.2, 10.0)


def test_sizes_of_zero_are_no_error() -> None:
    assert new_gauge(ForceTorqueEffects(), 1, 0.0) is None


def test_the_bias_is_there_from_the_start_within_its_range() -> None:
    drawn = np.array([GaugeErrors(EFFECTS, seed, -2.0).at(-2.0) for seed in range(200)])
    largest, ranges = np.abs(drawn).max(axis=0), np.array((5, 5, 5, 0.5, 0.5, 0.5))
    assert (largest <= ranges).all()
    assert (largest >= 0.9 * ranges).all()


def test_the_drift_goes_to_its_end_with_its_time_constant() -> None:
    gauge = GaugeErrors(EFFECTS, 3, 0.0)
    begin, middle, end = (np.array(gauge.at(t)) for t in (0.0, 10.0, 1e4))
    assert middle - begin == pytest.approx((1 - math.exp(-1)) * (end - begin))
    assert np.abs(end - begin)[:3].max() <= 3.0
    assert np.abs(end - begin)[3:].max() <= 0.2
    assert np.abs(end - begin).min() > 0.0


def test_bias_and_drift_add_to_the_readings_and_shift_no_noise() -> None:
    plain = World(Scenario(seed=6))
    biased = World(Scenario(seed=6, force_torque=ForceTorque(effects=EFFECTS)))
    plain.advance(0.0)
    biased.advance(0.0)
    gauge = GaugeErrors(EFFECTS, 6, -2.0)
    for a, b in zip(plain.take_wrench(), biased.take_wrench(), strict=True):
        error = gauge.at(a.exposure_s)
        assert np.subtract((*b.force, *b.torque), (*a.force, *a.torque)) == pytest.approx(error)


def test_the_same_seed_has_the_same_bias() -> None:
    assert GaugeErrors(EFFECTS, 4, 0.0).at(3.0) == GaugeErrors(EFFECTS, 4, 0.0).at(3.0)
    assert GaugeErrors(EFFECTS, 4, 0.0).at(3.0) != GaugeErrors(EFFECTS, 5, 0.0).at(3.0)
