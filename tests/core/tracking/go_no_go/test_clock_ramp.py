"""Ramp of the task's clock: pure course of its times."""

import itertools

import numpy as np
import pytest

from linemate.daemon.core.tracking.go_no_go import clock_ramp
from linemate.daemon.core.tracking.go_no_go.clock_ramp import (
    ACCELERATION,
    LONGEST_S,
    RUNNING,
    STANDING,
    ClockRamp,
)

CHANGES = list(itertools.permutations((1, 0, -1), 2))


@pytest.mark.parametrize(("before", "after"), CHANGES)
@pytest.mark.parametrize("length", [0, 2, 10])
def test_a_change_begins_and_ends_at_a_whole_step_with_the_rates_before_and_after(
    before: int, after: int, length: int
) -> None:
    ramp = clock_ramp.changed(ClockRamp(before), 100, after, 6, length)
    times = clock_ramp.times_ahead(ramp, 100.0, 60)
    rates = np.diff(times)
    assert times[0] == 100.0
    assert (rates[:6] == before).all()
    assert rates[6 + length :] == pytest.approx(float(after))
    assert times[6 + length] == round(float(times[6 + length]))
    if length:
        assert np.abs(np.diff(rates)).max() <= abs(after - before) / length + 1e-9


@pytest.mark.parametrize("cycle_s", [0.001, 0.004, 0.012, 0.024])
@pytest.mark.parametrize("speed", [0.0, 0.04, 0.3, 5.0])
def test_the_duration_bounds_the_acceleration_at_every_cycle(cycle_s: float, speed: float) -> None:
    steps = clock_ramp.ramp_steps(speed, -2, cycle_s)
    assert steps % 2 == 0
    needed = min(2.0 * speed / ACCELERATION, LONGEST_S)
    assert needed - 1e-9 <= steps * cycle_s <= needed + 2.0 * cycle_s


def test_a_ramp_is_followed_step_by_step() -> None:
    ramp = clock_ramp.changed(RUNNING, 50, 0, 3, 4)
    expected = clock_ramp.times_ahead(ramp, 50.0, 12)
    for i in range(1, 12):
        ramp = clock_ramp.advanced(ramp)
        now = ramp.planned[0] if ramp.planned else float(expected[i])
        assert clock_ramp.times_ahead(ramp, now, 12 - i) == pytest.approx(expected[i:])
    assert ramp == STANDING


@pytest.mark.parametrize(("before", "after"), CHANGES)
@pytest.mark.parametrize("steps", [0, 4, 8, 20])
def test_a_clock_that_brakes_keeps_what_is_committed_and_comes_to_stand(
    before: int, after: int, steps: int
) -> None:
    ramp, now = clock_ramp.changed(ClockRamp(before), 100, after, 6, 10), 100.0
    now = float(clock_ramp.times_ahead(ramp, now, 60)[steps])
    for _ in range(steps):
        ramp = clock_ramp.advanced(ramp)
    planned = clock_ramp.times_ahead(ramp, now, 60)
    times = clock_ramp.times_ahead(clock_ramp.braked(ramp, now, 5, 8), now, 60)
    assert times[:6] == pytest.approx(planned[:6])
    assert np.abs(np.diff(times, 2)).max() <= 1.0 / 8 + 2.0 / 10
    assert (np.diff(times[14:]) == 0.0).all()


def test_a_horizon_shorter_than_the_ramp_is_cut() -> None:
    ramp = clock_ramp.changed(RUNNING, 50, -1, 3, 30)
    assert len(clock_ramp.times_ahead(ramp, 50.0, 5)) == 6
