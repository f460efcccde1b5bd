"""Inverse filters: the model is the servo that scipy integrates, and the inverse undoes it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from linemate.daemon.core.control import inverse_filter
from linemate.daemon.core.control.settings import (
    ControlSettings,
    EffectorMode,
    FilterSettings,
    ServoModel,
)
from linemate.daemon.core.horizon import Array

CYCLES = (0.012, 0.004)
FINE = 24
FILTERS = FilterSettings()
# The slowest, a middling and the quickest of the shipped ones.
SERVOS = ControlSettings().servos[1::2]
MODES = sorted(ControlSettings().effector, key=lambda mode: mode.frequency_hz)[::2]

servos = st.builds(
    ServoModel,
    frequency_hz=st.floats(2.0, 10.0),
    damping=st.floats(0.3, 1.8),
    dead_time=st.floats(0.0, 0.06),
)


def sampled(numerator: list[float], denominator: list[float], u: Array, dt: float) -> Array:
    """A linear system's answer to straight lines between samples, exact, from rest at u[0]."""
    b, a, _ = signal.cont2discrete((numerator, denominator), dt, method="foh")
    return np.asarray(u[0] + signal.lfilter(np.ravel(b), a, u - u[0]))


def simulated(model: ServoModel, setpoints: Array, cycle_s: float, before: float) -> Array:
    """A servo's answer (m,) at the instants of the telegrams, from rest at ``before``.

    Setpoint k is on its way from telegram k on and reached one cycle later; the dead time comes
    between. Integrated on a fine grid, on which no default's dead time falls between two points.
    """
    dt = cycle_s / FINE
    t = np.arange((len(setpoints) - 1) * FINE + 1) * dt
    corners = np.arange(len(setpoints) + 1) * cycle_s
    seen = np.interp(t - model.dead_time, corners, np.concatenate(((before,), setpoints)))
    w = 2.0 * math.pi * model.frequency_hz
    seen[0] = before
    return sampled([w * w], [1.0, 2.0 * model.damping * w, w * w], seen, dt)[::FINE]


def swing(t: Array) -> Array:
    return np.asarray(0.008 * np.sin(2.0 * math.pi * 0.62 * t))


def ramp(t: Array) -> Array:
    return np.asarray(0.106 * t)


def band_limited(t: Array) -> Array:
    """A sum of sines up to 2 Hz, 1 mm each."""
    rng = np.random.default_rng(7)
    freqs = rng.uniform(0.1, FILTERS.band_hz, 8)
    phases = rng.uniform(0.0, 2.0 * math.pi, 8)
    return np.asarray(0.001 * np.sin(2.0 * math.pi * np.outer(t, freqs) + phases).sum(axis=1))


MOTIONS = {"swing": swing, "ramp": ramp, "band": band_limited}


def filtered(taps: Array, steps: Array, x: Array) -> Array:
    """sum_j taps_j x(k + steps_j) for every k for which all are known, the rest as nearest."""
    padded = np.pad(x, (-int(steps[0]), int(steps[-1])), mode="edge")
    return np.correlate(padded, taps, mode="valid")


@settings(max_examples=30, deadline=None)
@given(servos, st.sampled_from(CYCLES))
def test_the_pulse_response_is_scipys_simulation_of_one_setpoint(
    model: ServoModel, cycle_s: float
) -> None:
    h = inverse_filter.servo_pulse(model, cycle_s)
    setpoints = np.zeros(len(h))
    setpoints[0] = 1.0
    # A dead time between two points of the fine grid bends a corner; the tail is cut and shared.
    assert np.allclose(h, simulated(model, setpoints, cycle_s, 0.0), atol=3e-3 * h.max())


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("model", SERVOS)
def test_convolution_with_the_pulse_is_the_servo(model: ServoModel, cycle_s: float) -> None:
    setpoints = np.cumsum(np.random.default_rng(3).normal(0.0, 0.001, 200))
    predicted = np.convolve(inverse_filter.servo_pulse(model, cycle_s), setpoints)[: len(setpoints)]
    answer = simulated(model, setpoints, cycle_s, 0.0)
    assert np.abs(predicted - answer).max() < 1e-4 * np.abs(answer).max()


@settings(max_examples=40, deadline=None)
@given(servos, st.sampled_from(CYCLES))
def test_nothing_answers_before_its_dead_time(model: ServoModel, cycle_s: float) -> None:
    h = inverse_filter.servo_pulse(model, cycle_s)
    assert (h[np.arange(len(h)) * cycle_s <= model.dead_time] == 0.0).all()
    assert h.sum() == pytest.approx(1.0, abs=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.floats(1.0, 60.0), st.floats(0.06, 2.9))
def test_the_ramp_response_is_scipys(omega: float, damping: float) -> None:
    t = np.linspace(-0.2, 3.0, 400)
    late = t[t >= 0.0]
    system = signal.lti([omega**2], [1.0, 2.0 * damping * omega, omega**2, 0.0, 0.0])
    _, known = signal.impulse(system, T=np.linspace(0.0, late[-1] - late[0], len(late)))
    shifted = inverse_filter.ramp_response(t - late[0], omega, damping)
    assert (shifted[t < late[0]] == 0.0).all()
    assert np.allclose(shifted[t >= late[0]], known, atol=1e-6)


@pytest.mark.parametrize("omega", [5.0, 30.0])
def test_the_ramp_response_does_not_jump_at_critical_damping(omega: float) -> None:
    t = np.linspace(0.0, 2.0, 200)
    below, at, above = (
        inverse_filter.ramp_response(t, omega, damping) for damping in (1 - 3e-6, 1.0, 1 + 3e-6)
    )
    assert np.abs(below - at).max() < 1e-5 / omega
    assert np.abs(above - at).max() < 1e-5 / omega


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("model", SERVOS)
def test_the_servos_taps_sum_to_one(model: ServoModel, cycle_s: float) -> None:
    assert inverse_filter.servo_inverse(model, FILTERS, cycle_s).sum() == pytest.approx(1.0)


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("mode", MODES)
def test_the_effectors_taps_sum_to_one(mode: EffectorMode, cycle_s: float) -> None:
    assert inverse_filter.effector_inverse(mode, FILTERS, cycle_s).sum() == pytest.approx(1.0)


def test_the_inverses_reach_as_far_as_their_settings_say() -> None:
    at_12 = inverse_filter.tap_steps(FILTERS.servo_past_s, FILTERS.servo_future_s, 0.012)
    at_4 = inverse_filter.tap_steps(FILTERS.servo_past_s, FILTERS.servo_future_s, 0.004)
    assert (at_12[0], at_12[-1]) == (-3, 8)
    assert at_4[-1] == 24
    reach = inverse_filter.tap_steps(FILTERS.effector_past_s, FILTERS.effector_future_s, 0.012)
    assert (reach[0], reach[-1]) == (-3, 1)


# Residuals [m] at 12 ms: of a swing of 8 mm, of a ramp of 106 mm/s, of eight sines of 1 mm.
# A ramp is exact by construction; the band pays for it with a hundredth of what it has.
BOUNDS = {"swing": 5e-6, "ramp": 2e-6, "band": 6.2e-6}


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("model", SERVOS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_inverse_then_servo_leaves_micrometres(
    motion: str, model: ServoModel, cycle_s: float
) -> None:
    t = np.arange(round(4.0 / cycle_s)) * cycle_s
    wanted = MOTIONS[motion](t)
    taps = inverse_filter.servo_inverse(model, FILTERS, cycle_s)
    steps = inverse_filter.tap_steps(FILTERS.servo_past_s, FILTERS.servo_future_s, cycle_s)
    command = filtered(taps, steps, wanted)
    answer = simulated(model, command, cycle_s, float(command[0]))
    inside = slice(round(2.0 / cycle_s), -round(0.3 / cycle_s))
    assert np.abs(answer - wanted)[inside].max() < BOUNDS[motion] * cycle_s / CYCLES[0]


@pytest.mark.parametrize("cycle_s", CYCLES)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("motion", MOTIONS)
def test_inverse_then_elastic_mode_leaves_micrometres(
    motion: str, mode: EffectorMode, cycle_s: float
) -> None:
    t = np.arange(round(8.0 / cycle_s)) * cycle_s
    # Faded in, that the mode's own ringing, which lasts for seconds, is not started.
    fade = np.clip(t / 2.0, 0.0, 1.0)
    fade = fade**3 * (10.0 - 15.0 * fade + 6.0 * fade**2)
    wanted = fade * MOTIONS[motion](t)
    taps = inverse_filter.effector_inverse(mode, FILTERS, cycle_s)
    steps = inverse_filter.tap_steps(FILTERS.effector_past_s, FILTERS.effector_future_s, cycle_s)
    w = 2.0 * math.pi * mode.frequency_hz
    model = [2.0 * mode.damping * w, w * w], [1.0, 2.0 * mode.damping * w, w * w]
    inside = slice(round(2.0 / cycle_s), -round(0.3 / cycle_s))

    def off(moved: Array) -> float:
        dense_t = np.arange((len(t) - 1) * 12 + 1) * cycle_s / 12
        answer = sampled(*model, np.interp(dense_t, t, moved), cycle_s / 12)[::12]
        return float(np.abs(answer - wanted)[inside].max())

    left, undamped = off(filtered(taps, steps, wanted)), off(wanted)
    assert left < (25e-6 if motion != "ramp" else 5.5e-3 * cycle_s)
    assert left < undamped / (1.0 if motion == "ramp" else 8.0)
