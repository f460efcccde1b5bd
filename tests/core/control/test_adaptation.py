"""Adaptation of the servo models: drifts are followed within bounds."""

from dataclasses import replace

import numpy as np
import pytest
from traces import CYCLE_S, Array, answers

from linemate.daemon.core.control import adaptation
from linemate.daemon.core.control.adaptation import AdaptationSettings, ServoEstimates, ServoWindow
from linemate.daemon.core.control.settings import ControlSettings
from linemate.simulators.plants.scenario import Axis, Robot

SETTINGS = AdaptationSettings()
IDENTIFIED = ControlSettings().servos
EVERY = 42  # cycles between two updates
LENGTH = 250  # cycles of a window


def drifted(factor: float) -> tuple[Axis, ...]:
    return tuple(replace(a, frequency_hz=factor * a.frequency_hz) for a in Robot().axes)


def following(seconds: float) -> Array:
    """What a robot is asked that follows a swing on a conveyor."""
    t = np.arange(round(seconds / CYCLE_S)) * CYCLE_S
    columns = [0.004 * np.cos(2 * np.pi * 0.62 * t + i) + 0.06 * t for i in range(7)]
    path = np.column_stack(columns)
    return path - path[0]


def run(
    commands: Array, measured: Array, settings: AdaptationSettings = SETTINGS
) -> list[ServoEstimates]:
    """Return the estimates after each update; the window slides."""
    history = [adaptation.initial(IDENTIFIED)]
    for end in range(EVERY, len(commands) + 1, EVERY):
        rows = slice(max(end - LENGTH, 0), end)
        window = ServoWindow(commands[rows], measured[rows])
        history.append(
            adaptation.update(settings, IDENTIFIED, history[-1], window, CYCLE_S, EVERY * CYCLE_S)
        )
    return history


@pytest.mark.parametrize("factor", [0.9, 1.12])
def test_a_servo_that_drifted_is_learned_from_ordinary_motion(factor: float) -> None:
    commands = following(9.0)
    measured = answers(drifted(factor), commands)
    measured += 1e-5 * np.random.default_rng(0).normal(size=measured.shape)
    last = run(commands, measured)[-1]
    assert [b.factor for b in last.axes] == pytest.approx([factor] * 7, abs=0.01)
    for model, was in zip(last.models, IDENTIFIED, strict=True):
        assert model.frequency_hz == pytest.approx(factor * was.frequency_hz, rel=0.012)
        assert (model.damping, model.dead_time) == (was.damping, was.dead_time)


def test_it_moves_no_faster_than_the_rate_and_no_farther_than_the_reach() -> None:
    settings = replace(SETTINGS, reach=0.1)
    commands = following(9.0)
    history = run(commands, answers(drifted(0.7), commands), settings)
    factors = np.array([[b.factor for b in estimates.axes] for estimates in history])
    assert np.abs(np.diff(factors, axis=0)).max() <= settings.rate * EVERY * CYCLE_S + 1e-12
    assert factors.min() >= 0.9 - 1e-12


def test_a_servo_that_did_not_drift_stays_what_it_is() -> None:
    commands = following(6.0)
    measured = answers(drifted(1.0), commands)
    measured += 1e-5 * np.random.default_rng(1).normal(size=measured.shape)
    for learned in run(commands, measured):
        assert [b.factor for b in learned.axes] == pytest.approx([1.0] * 7, abs=0.01)


def test_an_axis_at_rest_teaches_nothing_and_says_so() -> None:
    commands = following(5.0)
    commands[:, 3] = 0.2
    measured = answers(drifted(0.9), commands)
    measured += 1e-5 * np.random.default_rng(2).normal(size=measured.shape)
    last = run(commands, measured)[-1]
    assert last.axes[3].factor == 1.0
    assert last.axes[3].rejection == "the axis hardly moved"
    assert last.axes[2].rejection is None


def test_answers_that_no_servo_gives_are_not_believed() -> None:
    commands = following(5.0)
    t = np.arange(len(commands)) * CYCLE_S
    measured = answers(drifted(1.0), commands)
    measured[:, 0] += 0.004 * np.sin(2 * np.pi * 1.7 * t)
    last = run(commands, measured)[-1]
    assert last.axes[0].rejection is not None
    assert last.axes[0].factor == pytest.approx(1.0, abs=0.02)


def test_lost_telegrams_and_wild_answers_do_no_harm() -> None:
    commands = following(8.0)
    measured = answers(drifted(0.93), commands)
    measured[::7] = np.nan
    measured[200:203] += 0.1
    last = run(commands, measured)[-1]
    assert [b.factor for b in last.axes] == pytest.approx([0.93] * 7, abs=0.01)
