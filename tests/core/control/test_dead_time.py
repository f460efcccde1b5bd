"""Tests of the drift of the dead times."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from linemate.daemon.core.control import dead_time, inverse_filter
from linemate.daemon.core.control.settings import ControlSettings, DeadTimeDrift
from linemate.daemon.core.horizon import Array

AXES = 7
DRIFT = DeadTimeDrift(shorter=0.02, longer=0.1, rate=0.05)
SETTINGS = ControlSettings(drift=DRIFT)


@cache
def compiled(cycle_s: float = 0.008, settings: ControlSettings = SETTINGS) -> dead_time.DriftModel:
    model = dead_time.compile_drift(settings, AXES, cycle_s)
    assert model is not None
    return model


def moved(seconds: float, cycle_s: float, speed: float = 0.1) -> Array:
    """Return setpoints (m, axes) of axes that swing, the linear one at a speed."""
    t = np.arange(round(seconds / cycle_s)) * cycle_s
    swing = 0.05 * np.sin(0.6 * 2.0 * np.pi * t)[:, None] * np.linspace(0.3, 1.0, AXES)
    swing[:, -1] += speed * np.maximum(t - 0.3, 0.0)
    return swing


def answered(setpoints: Array, cycle_s: float, later_s: float, stretch: float = 1.0) -> Array:
    """Return the positions (m, axes) of servos whose dead times are longer."""
    servos = [
        replace(each, dead_time=each.dead_time + later_s, frequency_hz=each.frequency_hz * stretch)
        for each in SETTINGS.servos
    ]
    return np.column_stack([
        np.convolve(column, inverse_filter.servo_pulse(servo, cycle_s))[: len(column)]
        for column, servo in zip(setpoints.T, servos, strict=True)
    ])  # fmt: skip


def followed(model: dead_time.DriftModel, setpoints: Array, reported: Array) -> Array:
    """Return the drift after each cycle."""
    state, drifts = dead_time.begin(model, setpoints[0]), []
    for setpoint, q in zip(setpoints, reported, strict=True):
        state = dead_time.follow(model, state, setpoint, q)
        drifts.append(state.drift)
    return np.array(drifts)


@pytest.mark.long
@pytest.mark.row
@pytest.mark.parametrize("cycle_s", [0.002, 0.008, 0.024])
@pytest.mark.parametrize("later_s", [-0.015, 0.083])
def test_the_drift_becomes_that_of_the_answers(cycle_s: float, later_s: float) -> None:
    model, setpoints = compiled(cycle_s), moved(4.0, cycle_s)
    drifts = followed(model, setpoints, answered(setpoints, cycle_s, later_s))
    assert drifts[-1] == pytest.approx(later_s, abs=0.0008)


@pytest.mark.long
def test_a_servo_without_dead_time_is_computed_exactly() -> None:
    for cycle_s in (0.008, 0.024):
        setpoints = moved(3.0, cycle_s)
        model = compiled(cycle_s)
        state = dead_time.begin(model, setpoints[0])
        for setpoint in setpoints:
            state = dead_time.follow(model, state, setpoint, None)
        still = [replace(servo, dead_time=0.0) for servo in SETTINGS.servos]
        expected = [
            np.convolve(column, inverse_filter.servo_pulse(servo, cycle_s))[len(column) - 1]
            for column, servo in zip(setpoints.T, still, strict=True)
        ]
        assert state.responses[0] == pytest.approx(np.array(expected), abs=3e-6)


@pytest.mark.long
def test_the_drift_is_never_faster_than_its_rate() -> None:
    cycle_s, slow = 0.008, replace(DRIFT, rate=0.004)
    model = compiled(cycle_s, replace(SETTINGS, drift=slow))
    setpoints = moved(5.0, cycle_s)
    drifts = followed(model, setpoints, answered(setpoints, cycle_s, 0.09))
    steps = np.abs(np.diff(drifts))
    assert steps.max() == pytest.approx(0.004 * cycle_s)
    assert drifts[-1] < 0.004 * 5.0 + 1e-9


@pytest.mark.long
def test_an_arm_at_rest_keeps_its_drift() -> None:
    model = compiled()
    setpoints = np.zeros((500, AXES))
    noise = 1e-5 * np.random.default_rng(0).standard_normal(setpoints.shape)
    state = dead_time.begin(model, setpoints[0], 0.04)
    for q in noise:
        state = dead_time.follow(model, state, setpoints[0], q)
    assert state.drift == 0.04


def test_axes_that_contradict_each_other_keep_the_drift() -> None:
    cycle_s = 0.008
    model, setpoints = compiled(cycle_s), moved(5.0, cycle_s)
    late, early = (answered(setpoints, cycle_s, each) for each in (0.09, -0.02))
    late[:, ::2] = early[:, ::2]
    drifts = followed(model, setpoints, late)
    assert np.abs(drifts).max() < 0.012


def test_a_wrong_telegram_moves_the_drift_by_no_more_than_its_rate() -> None:
    cycle_s = 0.008
    model, setpoints = compiled(cycle_s), moved(3.0, cycle_s)
    reported = answered(setpoints, cycle_s, 0.0)
    reported[200] += 0.3
    reported[210, 2] = np.nan
    assert np.abs(followed(model, setpoints, reported)).max() < 0.001


def test_the_drift_stays_within_its_bounds() -> None:
    cycle_s = 0.008
    model, setpoints = compiled(cycle_s), moved(8.0, cycle_s)
    assert followed(model, setpoints, answered(setpoints, cycle_s, 0.15)).max() == 0.1
    assert followed(model, setpoints, answered(setpoints, cycle_s, -0.02)).min() >= -0.02
    assert dead_time.begin(model, setpoints[0], 0.5).drift == 0.1


def test_slower_servos_move_the_drift_by_their_longer_lag() -> None:
    cycle_s = 0.008
    model, setpoints = compiled(cycle_s), moved(6.0, cycle_s)
    drifts = followed(model, setpoints, answered(setpoints, cycle_s, 0.05, stretch=0.9))
    assert 0.05 < drifts[-1] < 0.06


def test_filters_between_two_designs_are_exact_at_rest_and_on_a_ramp() -> None:
    cycle_s = 0.008
    model = compiled(cycle_s)
    for drift in (-0.02, -0.0131, 0.0017, 0.05, 0.1):
        state = dead_time.begin(model, np.zeros(AXES), drift)
        taps = dead_time.servo_taps(model, state)
        steps = np.arange(len(taps)) - round(SETTINGS.filters.servo_past_s / cycle_s + 0.499)
        assert taps.sum(axis=0) == pytest.approx(np.ones(AXES), abs=1e-9)
        lags = [
            servo.dead_time + drift + cycle_s + 2.0 * servo.damping / (6.2832 * servo.frequency_hz)
            for servo in SETTINGS.servos
        ]
        assert cycle_s * (steps @ taps) == pytest.approx(np.array(lags), abs=2e-4)


def test_without_bounds_the_dead_time_is_fixed_and_the_reach_is_the_set_one() -> None:
    assert dead_time.compile_drift(ControlSettings(), AXES, 0.012) is None
    assert dead_time.compile_drift(replace(SETTINGS, feed_forward=False), AXES, 0.012) is None
    assert dead_time.future_reach(ControlSettings()) == 0.096


@pytest.mark.long
def test_the_horizon_reaches_as_far_as_the_longest_dead_time_needs() -> None:
    late = [replace(servo, dead_time=0.084) for servo in ControlSettings().servos]
    settings = ControlSettings(servos=tuple(late), drift=DeadTimeDrift(longer=0.096))
    assert dead_time.future_reach(settings) == pytest.approx(0.24)
    for more in (0.0, 0.05):
        wider = replace(settings, drift=DeadTimeDrift(longer=0.096 + more))
        assert len(compiled(0.008, wider).taps[0]) * 0.008 >= 0.24 + 0.036 + more
