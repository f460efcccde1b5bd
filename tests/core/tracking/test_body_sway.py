"""A body that sways along the conveyor in contact, and pitches with it."""

import math

import numpy as np
import pytest
from transverse_runs import FILTER, T0, run

from linemate.daemon.core.tracking.across.body_sway import NO_SWAY
from linemate.daemon.core.tracking.across.transverse_state import TransverseState
from linemate.daemon.core.tracking.observation import PoseMeasurement


def felt(x: float, state: TransverseState) -> PoseMeasurement:
    """A deflection as the filter across the conveyor takes it of an object that gives way."""
    variance = np.r_[(2.4e-3,) * 3, (2.4e-3,) * 3] ** 2
    place = np.array((x, 0.0, float(state.x[1])))
    return PoseMeasurement(place, state.rotation, 0.0, variance)


@pytest.mark.parametrize("ratio", [-0.4, 0.25])
def test_a_body_that_pitches_in_step_with_its_sway_is_led_after_an_eighth_of_it(
    ratio: float,
) -> None:
    """12 mm along at 0.7 Hz: by the first extreme x has moved by 3 to 5 mm."""
    state = run(1.0)
    begin, before = float(state.x[0]), 0.0
    for k in range(1, 60):
        sway = 0.012 * math.sin(2.0 * math.pi * 0.7 * k * T0)
        state = FILTER.predict(state, T0, swayed=sway - before)
        before = sway
        measured = felt(begin + ratio * sway, state)
        state, _ = FILTER.correct(FILTER.correct_ratio(state, measured, T0), measured, 20.0)
        if k * T0 > 0.125 / 0.7:
            assert float(state.x[0]) == pytest.approx(begin + ratio * sway, abs=0.8e-3)
    assert FILTER.ratio(state) == pytest.approx(ratio, rel=0.15)


def test_a_felt_pose_without_a_sway_moves_the_object_no_sooner() -> None:
    state = run(1.0)
    x = float(state.x[0])
    for _ in range(20):
        state = FILTER.predict(state, T0)
        after = FILTER.correct_ratio(state, felt(x + 0.003, state), T0)
        assert float(after.x[0]) == pytest.approx(float(state.x[0]), abs=1e-9)
        state = after
    assert FILTER.ratio(state) == 0.0


def test_a_part_that_is_off_in_a_quiet_contact_shows_no_ratio_as_the_body_sways() -> None:
    """2 mm off for 8 s, and a sway of 3 mm then: read as a ratio, that gave 1200 N."""
    state = run(1.0)
    x, sway = float(state.x[0]), 0.0
    for k in range(700):
        way = 0.03 * T0 if k > 600 else 0.0
        sway += way
        state = FILTER.predict(state, T0, swayed=way)
        state = FILTER.correct_ratio(state, felt(x + 0.002, state), T0)
    assert sway == pytest.approx(0.0356, rel=0.01)
    assert abs(FILTER.ratio(state)) < 0.01


def test_a_sway_that_jumps_or_drifts_is_another_estimate() -> None:
    sway, drift = NO_SWAY.moved(0.01, T0), 0.0
    assert sway.way == 0.0
    assert sway.moved(0.011, T0).way == pytest.approx(0.001, rel=0.01)
    assert sway.moved(0.02, T0).way == 0.0
    for _ in range(500):
        drift += 0.001 * T0
        sway = sway.moved(0.01 + drift, T0)
    assert drift == pytest.approx(0.006)
    assert sway.off < 0.0016
