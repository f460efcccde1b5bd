"""A jump of the estimate moves the target smoothly and no faster than bounded."""

import math

import numpy as np
import pytest

from linemate.daemon.core.tracking.go_no_go import target_shift
from linemate.daemon.core.tracking.go_no_go.target_shift import (
    ACCELERATION,
    LEAST_JUMP,
    NO_SHIFT,
    TargetShift,
    advanced,
    remaining,
)

T0_NS, T0, SPEED = 12_000_000, 0.012, 0.1
NOW = np.zeros(1)


def targets(jump: float, steps: int = 100, *, eases: bool = True) -> np.ndarray:
    """Return the target's way (n,) beyond a steady motion, of an estimate that jumps in step 10."""
    shift, found = NO_SHIFT, []
    for k in range(steps):
        off = jump if k >= 10 else 0.0
        shift = advanced(shift, k * T0_NS, SPEED * k * T0 + off, SPEED, eases=eases)
        found.append(off + remaining(shift, NOW)[0])
    return np.array(found)


@pytest.mark.parametrize("jump", [0.028, -0.028, 0.005])
def test_a_jump_is_eased_within_the_acceleration_and_ends_at_the_estimate(jump: float) -> None:
    way = targets(jump)
    assert abs(way[10]) < 1e-12
    assert way[-1] == pytest.approx(jump)
    assert np.abs(np.diff(way, 2)).max() / T0**2 < 1.02 * ACCELERATION
    assert np.abs(np.diff(way, 2)).max() / T0**2 > 0.8 * ACCELERATION


def test_a_small_jump_and_one_in_contact_are_not_eased() -> None:
    assert targets(0.9 * LEAST_JUMP)[10] == pytest.approx(0.9 * LEAST_JUMP)
    assert targets(0.028, eases=False)[10] == pytest.approx(0.028)


def test_the_shift_over_a_horizon_is_what_it_becomes() -> None:
    shift = TargetShift(-0.02, 0.1, 0, 0.0)
    later = advanced(shift, 5 * T0_NS // 2, SPEED * 2.5 * T0, SPEED, eases=True)
    assert remaining(later, NOW)[0] == pytest.approx(remaining(shift, np.array((2.5 * T0,)))[0])


def test_a_second_jump_adds_to_what_is_left_of_the_first() -> None:
    shift = advanced(TargetShift(-0.02, 0.2, 0, 0.0), T0_NS, SPEED * T0 + 0.01, SPEED, eases=True)
    left = remaining(TargetShift(-0.02, 0.2 + T0), NOW)[0]
    assert remaining(shift, NOW)[0] == pytest.approx(left - 0.01)
    assert shift.age == 0.0


def test_after_a_pause_nothing_is_compared() -> None:
    shift = advanced(TargetShift(0.0, math.inf, 0, 0.0), 10**9, 5.0, SPEED, eases=True)
    assert not remaining(shift, NOW)[0]
    assert shift.position == 5.0
    assert target_shift.advanced(NO_SHIFT, 0, 5.0, SPEED, eases=True).begun == 0.0


@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_a_jump_of_the_speed_is_eased_for_a_tool_that_has_let_go(speed: float) -> None:
    shift, whole, way = NO_SHIFT, NO_SHIFT, []
    for k in range(180):
        now, place = SPEED if k < 10 else speed, T0 * (SPEED * min(k, 10) + speed * max(k - 10, 0))
        shift = advanced(shift, k * T0_NS, place, now, eases=True, slope=now)
        whole = advanced(whole, k * T0_NS, place, now, eases=True)
        way.append(place + remaining(shift, NOW)[0])
    assert np.abs(np.diff(way, 2)).max() / T0**2 < 1.05 * ACCELERATION
    assert way[-1] == pytest.approx(place)
    assert not whole.rate


def test_a_target_that_stayed_behind_goes_back_behind_what_is_committed() -> None:
    """A merge made up in 0.1 s for what the way back had gone by then: 1.4 times its speed."""
    shift = target_shift.left_behind(NO_SHIFT, 0.006, 7 * T0)
    ways = remaining(shift, T0 * np.arange(80))
    assert ways[:8] == pytest.approx(-0.006)
    assert ways[8] > ways[7]
    assert ways[-1] == pytest.approx(0.0)
    later = target_shift.left_behind(shift, 0.001, 7 * T0)
    assert remaining(later, NOW)[0] == pytest.approx(-0.007)
