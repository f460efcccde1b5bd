"""The distance sensor alone tells where the conveyor unit is."""

import numpy as np
import pytest

from linemate.daemon.core.tracking.classifiers.unit_estimate import first_estimate
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source

T0, SIGMA = 0.012, 0.00038


def row(value: float) -> PositionMeasurement:
    return PositionMeasurement(Source.DISTANCE, value, 0.0, SIGMA**2, 4.0)


def test_a_unit_that_runs_is_known_better_than_one_reading() -> None:
    rng = np.random.default_rng(1)
    unit = first_estimate(row(0.0), 0.1)
    errors = []
    for k in range(1, 300):
        unit = unit.moved(T0, 0.0, stands=False)
        unit = unit.read(0.106 * k * T0 + rng.normal(0.0, SIGMA), SIGMA**2, 4.0)
        errors.append(unit.position - 0.106 * k * T0)
    assert float(np.std(errors[100:])) < 0.5 * SIGMA
    assert unit.speed == pytest.approx(0.106, abs=0.002)


def test_an_outlier_is_not_read() -> None:
    unit = first_estimate(row(0.0), 0.0).moved(T0, 0.0, stands=True)
    assert unit.read(0.1, SIGMA**2, 4.0) is unit


def test_the_past_of_a_ramp_is_a_parabola() -> None:
    unit = first_estimate(row(1.0), 0.1)
    assert unit.past(0.1, -0.1, 0.1) == pytest.approx(1.0 - 0.01 - 0.0005)
    assert unit.past(0.1, -0.1, 0.0) == pytest.approx(0.99)
