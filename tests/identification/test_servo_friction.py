"""Friction of a drive, from setpoints and answers of the plant."""

import numpy as np
import pytest

from linemate.daemon.core.control import servo_fit
from linemate.daemon.core.control.servo_fit import Passage
from linemate.daemon.identification.outcome import Estimate, Refusal
from linemate.daemon.identification.servo_models import RubbingAxis, identify_friction
from linemate.simulators.plants.bending.drives import RoughServos
from linemate.simulators.plants.bending.effects_arm import Friction
from linemate.simulators.plants.scenario import Axis
from linemate.simulators.plants.servo_plant import ServoBank

CYCLE_S, SUBSTEPS, NOISE = 0.012, 3, 2e-6
AXIS = Axis(4.5, 0.8, 0.030, 50.0, 0.0)


def passage(level: float, recovery_s: float = 0.3, steps: int = 900) -> Passage:
    """A motion to and fro of an axis that rubs."""
    t = np.arange(steps) * CYCLE_S
    commands = 6e-3 * np.sin(3.1 * t) + 2e-3 * np.sin(1.3 * t) + 1e-3 * np.sin(9.0 * t)
    rough = Friction((level,) * 7, breakaway=0.0, recovery_s=recovery_s)
    bank = ServoBank((AXIS,) * 7, (0.0,) * 7, CYCLE_S, SUBSTEPS)
    servos, answers = RoughServos(bank, (AXIS,) * 7, rough, CYCLE_S / SUBSTEPS), []
    for k, command in enumerate(commands.tolist()):
        servos.begin_cycle(k)
        answers.append(servos.positions[0])
        servos.command(k, 0.0, (command,) * 7)
        for part in range(SUBSTEPS):
            servos.advance(SUBSTEPS * k + part)
    noise = NOISE * np.random.default_rng(1).normal(size=steps)
    return Passage(commands, np.array(answers) + noise)


def found(*passages: Passage) -> RubbingAxis:
    fit = servo_fit.fit(passages, CYCLE_S)
    assert fit is not None
    return identify_friction(passages, fit, CYCLE_S)


@pytest.mark.parametrize(("level", "recovery_s"), [(0.06e-3, 0.3), (0.3e-3, 0.3), (0.1e-3, 1.0)])
def test_level_and_recovery_are_found_and_the_servo_without_them(
    level: float, recovery_s: float
) -> None:
    axis = found(passage(level, recovery_s))
    assert axis.friction.level == pytest.approx(level, rel=0.1)
    assert axis.friction.recovery_s == recovery_s
    assert isinstance(axis.level, Estimate)
    fit = servo_fit.fit([passage(level, recovery_s)], CYCLE_S)
    assert fit is not None
    off, alone = (abs(each.model.dead_time - AXIS.dead_time_s) for each in (axis.fit, fit))
    assert off < min(0.005, 0.5 * alone)


def test_a_servo_fitted_with_its_friction_is_wrong() -> None:
    fit = servo_fit.fit([passage(0.3e-3)], CYCLE_S)
    assert fit is not None
    assert abs(fit.model.frequency_hz - AXIS.frequency_hz) > 0.05 * AXIS.frequency_hz


def test_a_drive_that_does_not_rub_is_refused_and_keeps_its_servo() -> None:
    smooth = passage(0.0)
    fit = servo_fit.fit([smooth], CYCLE_S)
    assert fit is not None
    axis = identify_friction([smooth], fit, CYCLE_S)
    assert axis.friction.level == 0.0
    assert isinstance(axis.level, Refusal)
    assert axis.fit is fit


def test_answers_that_are_all_lost_tell_of_no_friction() -> None:
    whole = passage(0.1e-3, steps=200)
    fit = servo_fit.fit([whole], CYCLE_S)
    assert fit is not None
    lost = Passage(whole.commands, np.full_like(whole.answers, np.nan))
    axis = identify_friction([lost], fit, CYCLE_S)
    assert isinstance(axis.level, Refusal)
