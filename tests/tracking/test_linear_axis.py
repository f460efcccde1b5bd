"""The linear axis' plan: append only, smooth, and where it should end."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.daemon.tracking import linear_axis

STEPS = 41
targets = st.lists(st.sampled_from((0.0, 0.106, 0.05)), min_size=1, max_size=120)


@settings(max_examples=40, deadline=None)
@given(targets, st.sampled_from((0.012, 0.004)), st.floats(0.1, 3.0))
def test_what_is_planned_never_changes(wanted: list[float], dt: float, ramp: float) -> None:
    plan = linear_axis.at_rest(0.7, STEPS)
    for target in wanted:
        after = linear_axis.advance(plan, target, ramp, dt)
        assert np.array_equal(after.positions[:-1], plan.positions[1:])
        assert len(after.positions) == STEPS + 1
        plan = after


@settings(max_examples=40, deadline=None)
@given(targets, st.sampled_from((0.012, 0.004)), st.floats(0.3, 3.0))
def test_speed_acceleration_and_jerk_are_bounded_whatever_the_targets(
    wanted: list[float], dt: float, ramp: float
) -> None:
    plan = linear_axis.at_rest(0.0, 3)
    ends = [0.0, 0.0, 0.0, 0.0]
    for target in wanted:
        plan = linear_axis.advance(plan, target, ramp, dt)
        ends.append(float(plan.positions[-1]))
    speed = np.diff(ends) / dt
    acceleration, jerk = np.diff(speed) / dt, np.diff(speed, n=2) / dt**2
    rate = 6.0 / ramp  # of each of the three lags
    assert speed.min() >= -1e-12
    assert speed.max() <= 0.106 + 1e-12
    assert np.abs(acceleration).max() <= 0.106 * rate * (1 + 1e-9) + 1e-9
    assert np.abs(jerk).max() <= 2.0 * 0.106 * rate**2 * (1 + 1e-9) + 1e-6


@pytest.mark.parametrize("dt", [0.012, 0.004])
def test_after_a_ramp_or_two_the_axis_has_the_speed_it_heads_for(dt: float) -> None:
    plan = linear_axis.at_rest(1.0, STEPS)
    for _ in range(round(2.5 / dt)):
        plan = linear_axis.advance(plan, 0.106, 1.0, dt)
    assert float(np.diff(plan.positions)[-1]) / dt == pytest.approx(0.106, rel=2e-3)
    # Three lags of a sixth of the ramp cost half a ramp of way, whatever the cycle.
    assert float(plan.positions[-1]) == pytest.approx(1.0 + 0.106 * (2.5 - 0.5), abs=0.106 * 3 * dt)
    for _ in range(round(3.0 / dt)):
        plan = linear_axis.advance(plan, 0.0, 1.0, dt)
    assert float(np.ptp(plan.positions)) < 1e-5


def test_an_axis_at_rest_stays_there() -> None:
    plan = linear_axis.at_rest(0.3, STEPS)
    for _ in range(10):
        plan = linear_axis.advance(plan, 0.0, 1.0, 0.012)
    assert (plan.positions == 0.3).all()
