"""The tool's modes from its ringing: the plant's own, or a reason."""

from dataclasses import replace

import numpy as np
import pytest
from traces import ringing, trace, without

from linemate.daemon.identification.outcome import Estimate, Refusal
from linemate.daemon.identification.ring_down import identify_modes, reading_rate, stretches
from linemate.simulators.plants.scenario import Effector

EFFECTOR = Effector()
RUNG = ringing(EFFECTOR, seed=0)


def test_every_axis_rings_with_its_own_mode() -> None:
    for result, true in zip(identify_modes([RUNG]), EFFECTOR.frequency_hz, strict=True):
        assert result.mode is not None
        assert isinstance(result.frequency_hz, Estimate)
        assert isinstance(result.damping, Estimate)
        assert abs(result.frequency_hz.value - true) < 4.0 * result.frequency_hz.deviation + 2e-3
        assert abs(result.damping.value - 0.02) < 4.0 * result.damping.deviation + 5e-4
        assert result.frequency_hz.deviation < 0.01 * true


def test_a_well_damped_mode_is_separated_from_a_hard_one() -> None:
    damped = replace(EFFECTOR, damping=(0.08, 0.02, 0.02, 0.02, 0.02, 0.02))
    result = identify_modes([ringing(damped, seed=1)])[0]
    assert result.mode is not None
    assert result.mode.damping == pytest.approx(0.08, abs=0.01)


def test_the_noise_of_the_sensor_is_what_remains() -> None:
    result = identify_modes([RUNG])[2]
    assert result.noise == pytest.approx(0.05e-3 * 50e3, rel=0.1)


def test_a_tool_that_was_not_excited_is_refused() -> None:
    gentle = ringing(EFFECTOR, seed=2, moves=2, size=0.0)
    for result in identify_modes([gentle]):
        assert isinstance(result.frequency_hz, Refusal)
        assert "not enough excitation" in result.frequency_hz.reason


def test_a_robot_that_never_rests_is_refused() -> None:
    moving = without(RUNG, tcp=RUNG.tcp + 0.05 * RUNG.robot_times[:, None])
    for result in identify_modes([moving]):
        assert isinstance(result.frequency_hz, Refusal)
        assert "never stands still" in result.frequency_hz.reason


def test_what_is_clamped_does_not_ring() -> None:
    assert stretches(without(RUNG, contact=np.array([[0.0, 100.0]]))) == []


def test_a_recording_without_a_sensor_is_refused() -> None:
    assert isinstance(identify_modes([trace()])[0].frequency_hz, Refusal)


def test_readings_too_rare_for_a_fast_mode_are_refused_and_not_folded() -> None:
    assert reading_rate(stretches(RUNG)) == pytest.approx(250.0, rel=0.01)
    rare = without(RUNG, wrenches=RUNG.wrenches[::14])  # a mode of 11.1 Hz would look like 6.76 Hz
    for result in identify_modes([rare]):
        assert result.mode is None
        assert isinstance(result.frequency_hz, Refusal)
        assert "readings come at 17.9 Hz, at least 50 Hz are needed" in result.frequency_hz.reason
        assert "a mode above 8.9 Hz would appear as a slower one" in result.frequency_hz.reason
