"""Friction of the drives: a command that overcomes it."""

from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.core.control import friction, inverse_filter, servo_fit
from linemate.daemon.core.control.friction import compile_friction
from linemate.daemon.core.control.settings import AxisFriction, FilterSettings, ServoModel
from linemate.simulators.plants.bending.drives import RoughServos
from linemate.simulators.plants.bending.effects_arm import Friction
from linemate.simulators.plants.scenario import Axis
from linemate.simulators.plants.servo_plant import ServoBank

CYCLE_S, SUBSTEPS, LEVEL = 0.012, 3, 0.3e-3
SERVO = ServoModel(4.0, 0.75, 0.036)
RUBS = AxisFriction(LEVEL)


def swaying(steps: int = 700) -> np.ndarray:
    """Positions (n,) that go to and fro by 8 mrad."""
    t = np.arange(steps) * CYCLE_S
    return 8e-3 * np.sin(4.0 * t) + 1e-3 * np.sin(11.0 * t)


def moved(commands: np.ndarray) -> np.ndarray:
    """Positions (n,) of the plant's rubbing axis at each cycle."""
    axis = Axis(SERVO.frequency_hz, SERVO.damping, SERVO.dead_time, 50.0, 0.0)
    rough = Friction((LEVEL,) * 7, breakaway=0.0)
    bank = ServoBank((axis,) * 7, (float(commands[0]),) * 7, CYCLE_S, SUBSTEPS)
    servos, rows = RoughServos(bank, (axis,) * 7, rough, CYCLE_S / SUBSTEPS), []
    for k, command in enumerate(commands.tolist()):
        servos.begin_cycle(k)
        rows.append(servos.positions[0])
        servos.command(k, 0.0, (command,) * 7)
        for part in range(SUBSTEPS):
            servos.advance(SUBSTEPS * k + part)
    return np.array(rows)


def largest_error(wanted: np.ndarray, settings: tuple[AxisFriction, ...]) -> float:
    """Largest distance of the axis from what is wanted, after two seconds [rad]."""
    taps = inverse_filter.servo_inverse(SERVO, FilterSettings(), CYCLE_S)
    past = 3
    model = compile_friction(settings, (SERVO,), 1, CYCLE_S)
    state, commands = friction.begin(model, wanted[past : past + 1]), []
    for k in range(past, len(wanted) - len(taps)):
        window = wanted[k - past : k - past + len(taps), None]
        command = np.array([taps @ window[:, 0]])
        if model is not None and state is not None:
            command, state = friction.overcome(model, state, window[past:], command)
        commands.append(float(command[0]))
    off = moved(np.array(commands)) - wanted[past : past + len(commands)]
    return float(np.abs(off[170:]).max())


def test_drives_that_do_not_rub_have_no_model() -> None:
    assert compile_friction((), (SERVO,), 1, CYCLE_S) is None
    assert compile_friction((AxisFriction(),), (SERVO,), 1, CYCLE_S) is None
    assert friction.begin(None, np.zeros(1)) is None


def test_an_axis_whose_friction_is_known_keeps_a_sixth_of_its_error() -> None:
    wanted = swaying()
    assert largest_error(wanted, ()) > 1.2 * LEVEL
    assert largest_error(wanted, (RUBS,)) < 0.2 * LEVEL


@pytest.mark.parametrize("share", [0.7, 1.3])
def test_a_level_that_is_a_third_off_still_takes_most_of_the_error(share: float) -> None:
    wanted = swaying()
    known = replace(RUBS, level=share * LEVEL)
    assert largest_error(wanted, (known,)) < 0.45 * largest_error(wanted, ())


def test_an_axis_at_rest_is_commanded_where_it_stands() -> None:
    model = compile_friction((RUBS,), (SERVO,), 1, CYCLE_S)
    assert model is not None
    state = friction.begin(model, np.array((0.1,)))
    assert state is not None
    for _ in range(50):
        command, state = friction.overcome(model, state, np.full((9, 1), 0.1), np.array((0.1,)))
    assert command[0] == 0.1


def test_what_the_integral_action_removes_is_not_commanded() -> None:
    model = compile_friction((RUBS,), (SERVO,), 1, CYCLE_S)
    assert model is not None
    state = friction.begin(model, np.zeros(1))
    assert state is not None
    extra = []
    for k in range(200):
        motors = 1e-4 * (k + np.arange(9.0))[:, None]
        command, state = friction.overcome(model, state, motors, motors[0])
        extra.append(float(command[0] - motors[0, 0]))
    assert max(extra) == pytest.approx(LEVEL, rel=0.3)
    assert extra[-1] < 0.01 * LEVEL


def test_the_model_agrees_with_the_plant_without_the_daemons_filter() -> None:
    wanted = swaying()
    free = servo_fit.simulate(SERVO, wanted, CYCLE_S)
    assert np.abs(moved(wanted) - free)[170:].max() > LEVEL
