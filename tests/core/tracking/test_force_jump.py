"""A jump of the force sensor is an offset, and a touch after it is felt all the same."""

import math
import random

import pytest

from linemate.daemon.core.tracking.touch import force_jump
from linemate.daemon.core.tracking.touch.contact import (
    NEAR,
    NO_CONTACT,
    TOUCHES,
    ContactState,
    ToolVibration,
    count_touches,
    record_force,
    tool_vibration,
)
from linemate.daemon.core.tracking.touch.force_jump import NO_OFFSET

STIFFNESS, SPEED, SAMPLES = 50e3, 0.024, 3


def mode(cycle_s: float = 0.012) -> ToolVibration:
    return tool_vibration(7.0, 0.02, STIFFNESS, 15.0, cycle_s, 5e-5)


def first_touch(
    force_at: list[float], *, filtered: bool = True, cycle_s: float = 0.012, speed: float = SPEED
) -> int | None:
    """Return the step of the contact in a force of ``SAMPLES`` samples a step, None if none."""
    vibration, chance = mode(cycle_s), random.Random(1)
    state: ContactState = NO_CONTACT
    offset = NO_OFFSET
    for k in range(len(force_at) // SAMPLES):
        samples = [f + chance.gauss(0.0, 1.5) for f in force_at[k * SAMPLES : (k + 1) * SAMPLES]]
        if filtered and len(state.forces) >= vibration.memory:
            largest = force_jump.largest_change(state, vibration, speed, 1.0 / SAMPLES)
            offset, samples = force_jump.without_jumps(offset, samples, largest, state.free or 0.0)
        mean = sum(samples) / SAMPLES
        each = tuple(sample - mean for sample in samples)
        state = record_force(state, vibration, mean, 0.0, held=False, samples=each)
        near = NEAR if k * cycle_s > 1.0 else -1.0
        distance = (k * cycle_s - 1.5) * speed if filtered else 0.0
        state = count_touches(state, vibration, distance, near)
        if state.touches >= TOUCHES:
            return k
    return None


def touch(since_s: float, cycle_s: float = 0.012, speed: float = SPEED) -> list[float]:
    """Return the samples of a touch by a tool that advances."""
    count = round(2.0 / cycle_s) * SAMPLES
    times = [k * cycle_s / SAMPLES for k in range(count)]
    return [-STIFFNESS * speed * max(t - since_s, 0.0) for t in times]


def jumped(force_at: list[float], size: float, begin_s: float, end_s: float) -> list[float]:
    times = [k * 0.012 / SAMPLES for k in range(len(force_at))]
    return [f + size * (begin_s <= t < end_s) for f, t in zip(force_at, times, strict=True)]


@pytest.mark.parametrize("size", [-42.0, -60.0, -300.0, 60.0])
@pytest.mark.parametrize("begin_s", [1.2, 1.204, 1.208])
def test_a_jump_is_no_touch_and_hides_none(size: float, begin_s: float) -> None:
    still = [0.0] * (round(2.0 / 0.012) * SAMPLES)
    off = jumped(still, size, begin_s, begin_s + 0.088)
    assert first_touch(off, filtered=False) is not None, "the case is one"
    assert first_touch(off) is None
    felt, plain = first_touch(jumped(touch(1.5), size, 1.2, 9.0)), first_touch(touch(1.5))
    assert felt is not None
    assert plain is not None
    assert abs(felt - plain) <= 1


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
@pytest.mark.parametrize("speed", [0.005, 0.009, 0.024, 0.04])
def test_a_touch_is_felt_as_early_as_without(cycle_s: float, speed: float) -> None:
    plain = first_touch(touch(1.5, cycle_s, speed), filtered=False, cycle_s=cycle_s)
    assert plain is not None
    felt = first_touch(touch(1.5, cycle_s, speed), cycle_s=cycle_s, speed=speed)
    assert felt is not None
    assert (felt - plain) * cycle_s <= 0.004


def test_a_sensor_that_drifts_as_the_tool_advances_is_no_touch() -> None:
    times = [k * 0.012 / SAMPLES for k in range(round(2.0 / 0.012) * SAMPLES)]
    drifting = [-252.0 * max(min(t, 1.3) - 1.02, 0.0) for t in times]
    assert first_touch(drifting, filtered=False) is not None
    assert first_touch(drifting) is None


def test_the_limit_grows_with_speed_vibration_and_time() -> None:
    still = ContactState(forces=(0.0,) * 40, calm=40)
    swinging = ContactState(forces=(-50.0, 50.0) * 20, calm=40)
    plain = force_jump.largest_change(still, mode(), SPEED, 1.0 / 3.0)
    noise = force_jump.SIGMAS * math.sqrt(2.0) * 2.5
    assert plain == pytest.approx(STIFFNESS * SPEED * 0.004 + noise)
    assert force_jump.largest_change(still, mode(), 2.0 * SPEED, 1.0 / 3.0) > plain
    assert force_jump.largest_change(still, mode(), SPEED, 1.0) > plain
    assert force_jump.largest_change(swinging, mode(), SPEED, 1.0 / 3.0) > plain + 5.0


def test_a_jump_back_to_the_free_tool_ends_the_offset() -> None:
    state, samples = force_jump.without_jumps(NO_OFFSET, [0.0, -42.0, -43.0], 24.0, 0.0)
    assert (state.size, samples) == (-42.0, [0.0, 0.0, -1.0])
    state, samples = force_jump.without_jumps(state, [-43.0, 1.0], 24.0, 0.0)
    assert (state.size, samples) == (0.0, [-1.0, 1.0])
