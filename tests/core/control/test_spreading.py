"""Below 4 ms a change of plan is spread: the command asks for no more than at 4 ms."""

import numpy as np
import pytest

from linemate.daemon.core.control import inverse_filter
from linemate.daemon.core.control.settings import EffectorMode, FilterSettings, ServoModel

FILTERS = FilterSettings()
CYCLES = (0.001, 0.002, 0.004, 0.008, 0.012, 0.024)


@pytest.mark.parametrize("cycle_s", CYCLES)
def test_the_weights_are_a_mean_and_one_from_4_ms_on(cycle_s: float) -> None:
    weights = inverse_filter.spreading(cycle_s)
    assert weights.sum() == pytest.approx(1.0)
    assert weights.min() > 0.0
    assert (len(weights) == 1) is (cycle_s >= 0.004)


@pytest.mark.parametrize("cycle_s", [0.001, 0.002])
def test_a_change_of_plan_asks_for_no_more_than_at_4_ms(cycle_s: float) -> None:
    step = np.concatenate((np.zeros(40), np.ones(40)))
    spread = np.convolve(step, inverse_filter.spreading(cycle_s))[:80]
    for order in (2, 3):
        largest = np.abs(np.diff(spread, n=order)).max() / cycle_s**order
        at_4_ms = np.abs(np.diff(step, n=order)).max() / 0.004**order
        assert largest <= at_4_ms * 1.001


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("model", [ServoModel(4.0, 0.75, 0.036), ServoModel(6.5, 0.75, 0.02)])
def test_servo_and_spreading_are_inverted_together(cycle_s: float, model: ServoModel) -> None:
    taps = inverse_filter.servo_inverse(model, FILTERS, cycle_s)
    steps = inverse_filter.tap_steps(FILTERS.servo_past_s, FILTERS.servo_future_s, cycle_s)
    chain = np.convolve(
        inverse_filter.servo_pulse(model, cycle_s), inverse_filter.spreading(cycle_s)
    )
    for hertz in (0.2, 0.7, 2.0):
        turn = 2j * np.pi * hertz * cycle_s
        answer = (np.exp(turn * steps) @ taps) * (np.exp(-turn * np.arange(len(chain))) @ chain)
        assert abs(answer - 1.0) < 0.006


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("hertz", [4.5, 7.0])
def test_an_elastic_mode_is_inverted_at_every_cycle(cycle_s: float, hertz: float) -> None:
    """With one step of the past and none of the future, 24 ms left a quarter of it at 2 Hz."""
    mode = EffectorMode(hertz, 0.02)
    taps = inverse_filter.effector_inverse(mode, FILTERS, cycle_s)
    steps = inverse_filter.tap_steps(FILTERS.effector_past_s, FILTERS.effector_future_s, cycle_s)
    s, w = 2j * np.pi * 2.0, 2.0 * np.pi * hertz
    model = (0.04 * w * s + w * w) / (s * s + 0.04 * w * s + w * w)
    assert abs((np.exp(s * cycle_s * steps) @ taps) * model - 1.0) < 0.006
