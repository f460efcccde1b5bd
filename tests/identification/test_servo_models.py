"""Servos of whole recordings: with their deviation, or refused with the reason."""

import math
from dataclasses import replace

import numpy as np
import pytest
from traces import CYCLE_S, answers, trace, wander

from linemate.daemon.identification.outcome import Estimate, Refusal
from linemate.daemon.identification.servo_models import identify_servos
from linemate.simulators.plants.scenario import Robot

AXES = Robot().axes
COMMANDS = wander(700, 7, seed=3)
COMMANDS[:, 3] = 0.1  # A4 rests
ANSWERS = answers(AXES, COMMANDS)


def test_axes_that_moved_are_reported_and_the_one_at_rest_is_refused() -> None:
    results = identify_servos([trace(COMMANDS, ANSWERS)])
    for result, true in zip(results, AXES, strict=True):
        if result.axis == 3:
            assert result.model is None
            assert isinstance(result.dead_time, Refusal)
            assert "hardly moved" in result.dead_time.reason
            continue
        assert result.model is not None
        assert isinstance(result.frequency_hz, Estimate)
        off = abs(result.frequency_hz.value - true.frequency_hz)
        assert off < 4.0 * result.frequency_hz.deviation + 1e-9
        assert result.model.dead_time == pytest.approx(true.dead_time_s, abs=2e-4)


def test_a_slow_drift_under_noise_cannot_tell_frequency_from_dead_time() -> None:
    t = np.arange(700) * CYCLE_S
    slow = np.tile(0.01 * np.sin(2 * np.pi * 0.1 * t)[:, None] ** 2, (1, 7))
    noise = 1e-4 * np.random.default_rng(0).normal(size=slow.shape)
    results = identify_servos([trace(slow, answers(AXES, slow) + noise)])
    for result in results:
        assert isinstance(result.frequency_hz, Refusal)
        assert "not enough excitation" in result.frequency_hz.reason


def test_recordings_of_two_controllers_are_refused_by_name() -> None:
    later = [replace(axis, dead_time_s=axis.dead_time_s + 0.003) for axis in AXES]
    together = [trace(COMMANDS, ANSWERS), trace(COMMANDS, answers(tuple(later), COMMANDS))]
    result = identify_servos(together, ("monday.mcap", "friday.mcap"))[0]
    assert isinstance(result.frequency_hz, Refusal)
    late = 1e3 * (AXES[0].dead_time_s + AXES[0].damping / (math.pi * AXES[0].frequency_hz))
    assert f"{late:.1f} ms late in monday.mcap" in result.frequency_hz.reason
    assert f"{late + 3.0:.1f} ms in friday.mcap" in result.frequency_hz.reason


def test_answers_of_something_else_are_refused() -> None:
    strange = COMMANDS + 0.02 * np.sin(2 * np.pi * 3.3 * np.arange(700) * CYCLE_S)[:, None]
    result = identify_servos([trace(COMMANDS, strange)])[0]
    assert isinstance(result.frequency_hz, Refusal)


def test_a_recording_without_answers_is_refused() -> None:
    result = identify_servos([trace(COMMANDS, np.full_like(COMMANDS, np.nan))])[0]
    assert isinstance(result.frequency_hz, Refusal)
    assert "too few" in result.frequency_hz.reason


def test_no_recordings_tell_of_no_axis() -> None:
    assert identify_servos([]) == ()
