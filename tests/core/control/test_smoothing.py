"""Smoothing (16): what the least squares stack leaves of a constant, a ramp and a swing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.daemon.core.control.settings import SmoothingSettings
from linemate.daemon.core.control.smoothing import smoothing_taps
from linemate.daemon.core.horizon import Array

CYCLES = (0.012, 0.004)
SPEED = 0.106

laws = st.builds(
    SmoothingSettings,
    mass=st.sampled_from((0.0, 1e-4, 1e-3, 4e-3, 0.02)),
    damper=st.sampled_from((0.0, 0.002, 0.01, 0.05)),
    steps_s=st.floats(0.05, 0.4),
)


def applied(taps: Array, x: Array) -> Array:
    """x_s(k) = sum_j r_j x(k + j) for every k for which all are known."""
    return np.correlate(x, taps, mode="valid")


def ramp_bias(settings: SmoothingSettings, cycle_s: float) -> float:
    taps = smoothing_taps(settings, cycle_s)
    return float(taps @ (SPEED * cycle_s * np.arange(len(taps))))


def minimised(settings: SmoothingSettings, cycle_s: float, x: Array) -> Array:
    """x_s (n+1,) that minimises (13)-(15) over a list x (n+1,), stacked row by row."""
    n = len(x) - 1
    rows, right = [np.eye(n + 1)], [x]
    for i in range(1, n):
        speed, force = np.zeros(n + 1), np.zeros(n + 1)
        speed[[i - 1, i + 1]] = np.array((-0.5, 0.5)) * settings.damper / cycle_s
        force[[i - 1, i, i + 1]] = np.array((1.0, -2.0, 1.0)) * settings.mass / cycle_s**2
        rows += [speed[None], force[None]]
        right += [np.zeros(1), np.zeros(1)]
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]


@settings(max_examples=30, deadline=None)
@given(laws, st.sampled_from(CYCLES))
def test_the_taps_sum_to_one(law: SmoothingSettings, cycle_s: float) -> None:
    # A constant costs nothing in any of the three equations, so it is its own smoothing.
    assert smoothing_taps(law, cycle_s).sum() == pytest.approx(1.0, abs=1e-9)


@settings(max_examples=25, deadline=None)
@given(laws, st.integers(0, 10_000))
def test_the_taps_are_the_first_answer_of_the_least_squares_stack(
    law: SmoothingSettings, seed: int
) -> None:
    taps = smoothing_taps(law, 0.012)
    x = np.random.default_rng(seed).normal(size=len(taps))
    if len(taps) == 1:
        assert (law.mass, law.damper) == (0.0, 0.0)
        return
    assert float(taps @ x) == pytest.approx(float(minimised(law, 0.012, x)[0]), abs=1e-7)


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("mass", [1e-4, 1e-3, 4e-3, 0.02])
def test_without_a_damper_a_ramp_passes_unbiased(mass: float, cycle_s: float) -> None:
    assert abs(ramp_bias(SmoothingSettings(mass=mass), cycle_s)) < 1e-9


@pytest.mark.parametrize(("damper", "bias_mm"), [(0.010, 0.25), (0.050, 4.0)])
def test_a_damper_with_a_mass_biases_a_ramp_by_millimetres(damper: float, bias_mm: float) -> None:
    law = SmoothingSettings(mass=4e-3, damper=damper, steps_s=16 * 0.012)
    assert 1e3 * ramp_bias(law, 0.012) == pytest.approx(bias_mm, rel=0.05)


@pytest.mark.parametrize("damper", [0.010, 0.020])
def test_a_damper_alone_biases_a_ramp_by_speed_times_damper(damper: float) -> None:
    # The continuous law's own answer, r + v D exp(-t/D), which short cycles approach.
    short = [ramp_bias(SmoothingSettings(damper=damper), cycle_s) for cycle_s in (2e-3, 1e-3)]
    assert 2.0 * short[1] - short[0] == pytest.approx(SPEED * damper, rel=0.03)


def test_no_mass_and_no_damper_is_no_smoothing() -> None:
    assert smoothing_taps(SmoothingSettings(), 0.012).tolist() == [1.0]


@pytest.mark.parametrize(("mass", "least_mm", "most_mm"), [(4e-3, 0.36, 0.40), (1e-3, 0.0, 0.1)])
def test_a_swing_costs_tenths_of_a_millimetre(mass: float, least_mm: float, most_mm: float) -> None:
    cycle_s = 0.012
    taps = smoothing_taps(SmoothingSettings(mass=mass), cycle_s)
    t = np.arange(600) * cycle_s
    swing = 8.0 * np.sin(2.0 * math.pi * 0.62 * t)
    smoothed = applied(taps, swing)
    assert least_mm < np.abs(smoothed - swing[: len(smoothed)]).max() < most_mm


@pytest.mark.parametrize("mass", [1e-3, 4e-3])
def test_more_mass_makes_a_jump_smoother(mass: float) -> None:
    cycle_s = 0.012
    jump = np.concatenate((np.zeros(200), np.ones(200)))
    bent = applied(smoothing_taps(SmoothingSettings(mass=mass), cycle_s), jump)
    stiff = applied(smoothing_taps(SmoothingSettings(mass=mass / 4), cycle_s), jump)
    assert np.abs(np.diff(bent, n=2)).max() < np.abs(np.diff(stiff, n=2)).max() < 1.0
