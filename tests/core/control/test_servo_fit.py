"""The servo's forward fit against the plant's servos, an independent model."""

import math
from dataclasses import replace

import numpy as np
import pytest
from traces import CYCLE_S, answers, wander

from linemate.daemon.core.control import servo_fit
from linemate.daemon.core.control.servo_fit import Passage
from linemate.daemon.core.control.settings import ServoModel
from linemate.simulators.plants.scenario import Axis, Robot

AXES = Robot().axes
COMMANDS = wander(900, 7, seed=1)
ANSWERS = answers(AXES, COMMANDS)


@pytest.mark.parametrize("axis", range(7))
def test_a_clean_answer_gives_the_plants_own_servo(axis: int) -> None:
    found = servo_fit.fit([Passage(COMMANDS[:, axis], ANSWERS[:, axis])], CYCLE_S)
    assert found is not None
    true = AXES[axis]
    assert found.converged
    assert found.model.frequency_hz == pytest.approx(true.frequency_hz, rel=2e-3)
    assert found.model.damping == pytest.approx(true.damping, abs=1e-3)
    assert found.model.dead_time == pytest.approx(true.dead_time_s, abs=1e-4)
    assert found.residual < 1e-3 * found.motion


@pytest.mark.parametrize("dead_time_s", [0.084, 0.180, 0.200])
def test_a_controller_that_lags_by_up_to_200_ms_is_identified(dead_time_s: float) -> None:
    late = tuple(replace(axis, dead_time_s=dead_time_s) for axis in AXES)
    found = servo_fit.fit([Passage(COMMANDS[:, 2], answers(late, COMMANDS)[:, 2])], CYCLE_S)
    assert found is not None
    assert found.model.dead_time == pytest.approx(dead_time_s, abs=1e-4)
    assert found.model.frequency_hz == pytest.approx(AXES[2].frequency_hz, rel=2e-3)


def test_simulation_is_what_the_plant_does() -> None:
    model = ServoModel(4.5, 0.8, 0.030)
    answer = servo_fit.simulate(model, COMMANDS[:, 2], CYCLE_S)
    assert answer == pytest.approx(ANSWERS[:, 2], abs=1e-6)


def test_noise_biases_nothing_and_its_deviation_is_honest() -> None:
    offs = []
    for seed in range(8):
        noise = 2e-5 * np.random.default_rng(seed).normal(size=len(ANSWERS))
        found = servo_fit.fit([Passage(COMMANDS[:, 0], ANSWERS[:, 0] + noise)], CYCLE_S)
        assert found is not None
        deviation = math.sqrt(found.covariance[0, 0])
        assert 0.0 < deviation < 0.1
        offs.append((found.model.frequency_hz - 4.0) / deviation)
    assert max(map(abs, offs)) < 4.0
    assert abs(np.mean(offs)) < 4.0 / math.sqrt(len(offs))
    assert 0.3 < np.std(offs) < 2.0


def test_an_offset_between_encoder_and_setpoint_is_no_property_of_the_servo() -> None:
    found = servo_fit.fit([Passage(COMMANDS[:, 1], ANSWERS[:, 1] + 0.01)], CYCLE_S)
    assert found is not None
    assert found.model.frequency_hz == pytest.approx(4.0, rel=2e-3)


def test_missing_and_wild_answers_are_left_out() -> None:
    measured = ANSWERS[:, 3].copy()
    measured[100:140] = np.nan
    measured[500:505] += 0.05
    found = servo_fit.fit([Passage(COMMANDS[:, 3], measured)], CYCLE_S)
    assert found is not None
    assert found.left_out >= 5
    assert found.model.frequency_hz == pytest.approx(5.5, rel=5e-3)


def test_a_recording_that_begins_in_motion_is_read_behind_its_begin() -> None:
    found = servo_fit.fit([Passage(COMMANDS[300:, 4], ANSWERS[300:, 4])], CYCLE_S)
    assert found is not None
    assert found.model.frequency_hz == pytest.approx(6.0, rel=5e-3)


def test_two_recordings_are_fitted_together() -> None:
    halves = [Passage(COMMANDS[a:b, 5], ANSWERS[a:b, 5]) for a, b in ((0, 450), (450, 900))]
    both, one = servo_fit.fit(halves, CYCLE_S), servo_fit.fit(halves[:1], CYCLE_S)
    assert both is not None
    assert one is not None
    assert both.rows > one.rows
    assert both.model.frequency_hz == pytest.approx(6.5, rel=5e-3)


def test_an_overdamped_slow_servo_is_found_too() -> None:
    axis = Axis(1.5, 1.3, 0.05, 100.0)
    commands = wander(1200, 1, seed=4, size=0.01)
    found = servo_fit.fit([Passage(commands[:, 0], answers((axis,), commands)[:, 0])], CYCLE_S)
    assert found is not None
    assert found.model.frequency_hz == pytest.approx(1.5, rel=2e-2)
    assert found.model.damping == pytest.approx(1.3, rel=2e-2)


def test_too_few_answers_give_nothing() -> None:
    assert servo_fit.fit([Passage(np.zeros(10), np.zeros(10))], CYCLE_S) is None
