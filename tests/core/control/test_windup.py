"""Windup of the axes: links from motors, motors for links."""

import numpy as np
import pytest

from linemate.daemon.core.control import windup
from linemate.daemon.core.control.settings import AxisWindup
from linemate.daemon.core.control.windup import WindupState, compile_windup

DEPTH, TRAVEL = 0.6e-3, 3e-3
SETTINGS = (AxisWindup(), AxisWindup(DEPTH, TRAVEL), AxisWindup(0.3e-3, 10e-3))


def compiled() -> windup.Windup:
    found = compile_windup(SETTINGS, 7)
    assert found is not None
    return found


def swaying(steps: int = 400) -> np.ndarray:
    """Links (m, 7) that go to and fro by 8 mrad."""
    t = np.arange(steps) * 0.012
    return np.outer(8e-3 * np.sin(4.0 * t) + 1e-3 * np.sin(11.0 * t), np.ones(7))


def led(model: windup.Windup, wanted: np.ndarray) -> np.ndarray:
    """Motors (m, 7) of a horizon that moves on by a step at a time."""
    state, rows = windup.begin(model, wanted[0]), []
    for k in range(len(wanted) - 12):
        motors, state = windup.motors(model, state, wanted[k : k + 12])
        rows.append(motors[0])
    return np.array(rows)


def test_an_arm_without_windup_has_no_model() -> None:
    assert compile_windup((), 7) is None
    assert compile_windup((AxisWindup(),) * 7, 7) is None
    assert compile_windup((*(AxisWindup(),) * 6, AxisWindup(DEPTH)), 6) is None


def test_links_lie_behind_their_motors_after_a_long_way() -> None:
    model = compiled()
    state = windup.begin(model, np.zeros(7))
    for motor in np.linspace(0.0, 0.1, 50):
        state = windup.follow(model, state, np.full(7, motor))
    off = windup.links(model, state, np.full(7, 0.1)) - 0.1
    assert off == pytest.approx([0.0, -DEPTH, -0.3e-3, 0.0, 0.0, 0.0, 0.0], abs=1e-7)


@pytest.mark.parametrize("travel", [1e-3, 3e-3, 10e-3])
def test_motors_that_are_led_bring_the_links_where_they_are_wanted(travel: float) -> None:
    model = compile_windup((AxisWindup(0.4e-3, travel),) * 3, 7)
    assert model is not None
    wanted = swaying()
    motors = led(model, wanted)
    state, placed = windup.begin(model, motors[0]), []
    for row in motors:
        state = windup.follow(model, state, row)
        placed.append(windup.links(model, state, row))
    off = np.abs(np.array(placed) - wanted[: len(placed)])[:, :3].max()
    assert off < 0.04e-3
    assert np.abs(motors - wanted[: len(motors)]).max() > 0.25e-3


def test_the_state_that_is_returned_is_that_of_the_second_row() -> None:
    model, wanted = compiled(), swaying()[:12]
    state = WindupState((0.0, 0.0), (0.2, -0.5))
    _, later = windup.motors(model, state, wanted)
    _, again = windup.motors(model, state, wanted[:2])
    assert later == again != state


def test_axes_without_windup_are_led_as_they_are_wanted() -> None:
    wanted = swaying()
    assert (led(compiled(), wanted)[:, 3:] == wanted[: len(wanted) - 12, 3:]).all()


def test_noise_of_the_encoders_turns_no_hysteresis() -> None:
    model = compiled()
    state = WindupState((0.0, 0.0), (1.0, -1.0))
    noise = np.random.default_rng(1).normal(0.0, 1e-6, (1000, 7))
    for row in noise:
        state = windup.follow(model, state, row)
    assert state.w == (1.0, -1.0)


def test_a_gear_of_pure_play_is_led_across_it_and_not_farther() -> None:
    model = compile_windup((AxisWindup(0.1e-3, 2e-5),), 7)
    assert model is not None
    state = WindupState((0.0,), (1.0,))
    wanted = np.outer(-0.1e-3 - 50e-6 * np.arange(5), np.ones(7))
    motors, _ = windup.motors(model, state, wanted)
    assert motors[0, 0] == pytest.approx(0.0)
    assert motors[-1, 0] == pytest.approx(wanted[-1, 0] - 0.1e-3, abs=1e-6)
    assert (np.abs(motors - wanted) <= 0.1e-3).all()
