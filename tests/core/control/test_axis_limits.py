"""Range of accelerations of one axis: the quick way and the way with all square roots."""

import math
from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.core.control.axis_limits import AxisBounds, Limits, acceleration_range


def bounds_of(cycle_s: float, acceleration: float = 6.0, jerk: float = 300.0) -> AxisBounds:
    rows = [np.array((value,)) for value in (-2.0, 2.0, 1.5, acceleration, jerk)]
    return Limits(*rows, ("A1",), cycle_s).axes[0]


@pytest.mark.parametrize("cycle_s", [0.001, 0.004, 0.012])
@pytest.mark.parametrize("jerk", [60.0, 300.0, 6000.0])
def test_an_axis_far_from_its_limits_has_the_range_that_all_limits_give(
    cycle_s: float, jerk: float
) -> None:
    bounds = bounds_of(cycle_s, jerk=jerk)
    slow_way = replace(bounds, free_speed=-math.inf)
    chance, quick = np.random.default_rng(3), 0
    for p, v, a in chance.uniform((-2.1, -1.7, -8.0), (2.1, 1.7, 8.0), (20_000, 3)).tolist():
        assert acceleration_range(p, v, a, bounds) == acceleration_range(p, v, a, slow_way)
        quick += abs(v) < bounds.free_speed
    assert quick > 1000 or bounds.free_speed < 0.2


def test_an_axis_at_the_edge_of_its_free_speed_has_the_range_that_all_limits_give() -> None:
    bounds = bounds_of(0.012)
    slow_way = replace(bounds, free_speed=-math.inf)
    for share in (0.99, 0.9999, 1.0, 1.0001):
        for v in (share * bounds.free_speed, -share * bounds.free_speed):
            for a in (-6.0, -3.0, 0.0, 3.0, 6.0):
                found = acceleration_range(0.0, v, a, bounds)
                assert found == acceleration_range(0.0, v, a, slow_way)
