"""Sensor and payload from made postures: truth, standard errors, and refusals."""

import numpy as np
import pytest

from linemate.daemon.commissioning.postures import StandingPosture
from linemate.daemon.commissioning.sensor_mount import GRAVITY, SensorMount, find_sensor
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.outcome import Refusal

TURN = np.array((0.4, -1.0, 2.0))
CENTRE = np.array((0.05, -0.02, 0.15))
BIAS = np.array((12.0, -30.0, 5.0, 1.0, -0.5, 2.0))
MASS = 35.0
SPREAD = np.array((1.0, 1.0, 1.0, 0.1, 0.1, 0.1))


def postures(
    turns: Array, *, sign: int = 1, mass: float = MASS, skewed: float = 1.0, seed: int = 1
) -> list[StandingPosture]:
    rng = np.random.default_rng(seed)
    made = []
    for turn in turns:
        R = rotations.exp(turn)
        weight = sign * mass * rotations.exp(TURN).T @ R.T @ np.array((0.0, 0.0, -GRAVITY))
        weight = weight * np.array((skewed, 1.0, 1.0))
        wrench = np.concatenate((weight, np.cross(CENTRE, weight))) + BIAS
        wrench += 0.1 * SPREAD * rng.standard_normal(6)
        made.append(StandingPosture(0.0, 1.0, np.zeros(7), np.zeros(3), R, None, wrench, SPREAD))
    return made


def all_sides(count: int = 10) -> Array:
    turns: Array = np.random.default_rng(5).uniform(-2.0, 2.0, (count, 3))
    return turns


@pytest.mark.parametrize("sign", [1, -1])
def test_frame_sign_and_payload_are_found(sign: int) -> None:
    found = find_sensor(postures(all_sides(), sign=sign))
    assert isinstance(found, SensorMount)
    assert found.sign == sign
    off = rotations.log(rotations.exp(TURN).T @ found.rotation)
    assert np.abs(off).max() < 2e-3
    assert found.mass == pytest.approx(MASS, abs=0.05)
    assert found.centre == pytest.approx(CENTRE, abs=1e-3)
    assert found.force_bias == pytest.approx(BIAS[:3], abs=0.3)


def test_the_standard_errors_are_those_of_many_tries() -> None:
    ratios = []
    for seed in range(30):
        found = find_sensor(postures(all_sides(), seed=seed))
        assert isinstance(found, SensorMount)
        ratios.append((found.mass - MASS) / found.deviations[3])
        ratios += ((found.centre - CENTRE) / found.deviations[4:7]).tolist()
    assert 0.7 < float(np.sqrt(np.mean(np.square(ratios)))) < 1.3


def test_postures_that_tilt_too_little_are_refused() -> None:
    refusal = find_sensor(postures(0.1 * all_sides(12)))
    assert isinstance(refusal, Refusal)
    assert "Tilt the tool" in refusal.reason


def test_a_sensor_without_a_tool_is_refused() -> None:
    refusal = find_sensor(postures(all_sides(), mass=0.01))
    assert isinstance(refusal, Refusal)
    assert "Check that the tool hangs on the sensor" in refusal.reason


def test_axes_that_weigh_differently_are_refused() -> None:
    refusal = find_sensor(postures(all_sides(), skewed=0.5))
    assert isinstance(refusal, Refusal)
    assert "which should be equal" in refusal.reason


def test_too_few_postures_are_refused() -> None:
    refusal = find_sensor(postures(all_sides(5)))
    assert isinstance(refusal, Refusal)
    assert refusal.reason.startswith("5 postures with wrenches, at least 6")


def test_a_hand_on_the_tool_is_refused() -> None:
    made = postures(all_sides())
    for n in (2, 5, 7):
        wrench = made[n].wrench
        assert wrench is not None
        wrench[:3] += np.array((0.0, 150.0 * (-1) ** n, 90.0))
    assert isinstance(find_sensor(made), Refusal)
