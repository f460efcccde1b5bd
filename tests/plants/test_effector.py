"""Laws of the elastic tool: each mode exact, frames kept, energy lost as damping says."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

from linemate.simulators.plants import rotation
from linemate.simulators.plants.effector import ZERO, EffectorPlant, deflected, deflection_between
from linemate.simulators.plants.rotation import IDENTITY, Pose
from linemate.simulators.plants.scenario import Effector

H = 0.004
TURNED = rotation.exp((0.3, -0.8, 0.5))


def along(axis: int, value: float) -> tuple[float, float, float]:
    x, y, z = ((value if i == axis else 0.0) for i in range(3))
    return (x, y, z)


@pytest.mark.parametrize("axis", range(6))
def test_a_mode_follows_scipy(axis: int) -> None:
    effector = Effector()
    plant = EffectorPlant(effector, H)
    times = H * np.arange(200)
    motion = 0.01 * (1 - np.cos(math.tau * 0.9 * times))
    seen = [0.0]
    poses = [_place(axis, float(value)) for value in motion]
    for before, after in pairwise(poses):
        plant.swing_free(before, after)
        seen.append(plant.deflection[axis])
    omega, zeta = math.tau * effector.frequency_hz[axis], effector.damping[axis]
    # d'' + 2 zeta w d' + w^2 d = -r'', so d = -s^2 / (s^2 + 2 zeta w s + w^2) r.
    system = signal.TransferFunction([-1.0, 0.0, 0.0], [1.0, 2 * zeta * omega, omega**2])
    _, expected, _ = signal.lsim(system, motion, times, interp=True)
    assert seen == pytest.approx(expected, abs=1e-9)


def _place(axis: int, value: float) -> Pose:
    if axis < 3:
        return rotation.apply(TURNED, along(axis, value)), TURNED
    return (1.0, 2.0, 3.0), rotation.compose(TURNED, rotation.exp(along(axis - 3, value)))


def test_steady_motion_bends_nothing_once_the_start_has_faded() -> None:
    plant = EffectorPlant(Effector(damping=(0.2,) * 6), H)
    for k in range(2000):
        plant.swing_free(
            ((0.0, 0.106 * H * k, 0.0), TURNED), ((0.0, 0.106 * H * (k + 1), 0.0), TURNED)
        )
    assert np.abs(plant.deflection).max() < 1e-10


def test_free_vibration_loses_energy_as_damping_says() -> None:
    effector = Effector()
    plant = EffectorPlant(effector, H)
    rest: Pose = ((0.0, 0.0, 0.0), IDENTITY)
    plant.hold(rest, rest, (0.001,) * 6)
    plant.hold(rest, rest, (0.001,) * 6)
    seconds = 2.0
    for _ in range(round(seconds / H)):
        plant.swing_free(rest, rest)
    states = zip(plant.deflection, plant._velocity, effector.frequency_hz, strict=True)
    for d, v, f in states:
        omega = math.tau * f
        size = math.hypot(d, v / omega)
        assert size == pytest.approx(0.001 * math.exp(-0.02 * omega * seconds), rel=0.05)


def test_a_turning_robot_keeps_the_tools_motion_in_space() -> None:
    plant = EffectorPlant(Effector(frequency_hz=(1e-3,) * 6, damping=(0.0,) * 6), H)
    step = rotation.exp((0.0, 0.0, 0.002))
    pose: Pose = ((0.0, 0.0, 0.0), IDENTITY)
    moved: Pose = ((0.001, 0.0, 0.0), IDENTITY)
    plant.hold(pose, moved, (0.0,) * 6)
    pose = moved
    for _ in range(500):
        turned = rotation.compose(pose[1], step)
        following: Pose = (pose[0], turned)
        plant.swing_free(pose, following)
        pose = following
    # Hardly held, the tool flies on along x at 0.25 m/s although the robot has turned by 1 rad.
    tip = deflected(pose, (*plant.deflection[:3], 0.0, 0.0, 0.0))[0]
    assert tip == pytest.approx((0.001 + 0.25 * 2.0, 0.0, 0.0), abs=2e-3)


def test_peeking_to_the_end_of_a_step_is_stepping() -> None:
    plant = EffectorPlant(Effector(), H)
    rng = np.random.default_rng(0)
    pose: Pose = ((0.0, 0.0, 0.0), TURNED)
    for _ in range(50):
        x, y, z, a, b, c = (1e-3 * rng.standard_normal(6)).tolist()
        following = rotation.multiply(pose, ((x, y, z), rotation.exp((a, b, c))))
        foreseen = plant.peek(pose, following, H)
        plant.swing_free(pose, following)
        assert plant.deflection == pytest.approx(foreseen, abs=1e-15)
        pose = following


def test_holding_at_rest_then_letting_go_starts_from_there() -> None:
    plant = EffectorPlant(Effector(), H)
    rest: Pose = ((0.0, 0.0, 0.0), IDENTITY)
    plant.hold(rest, rest, (0.002, 0, 0, 0, 0, 0))
    plant.hold(rest, rest, (0.002, 0, 0, 0, 0, 0))
    plant.swing_free(rest, rest)
    omega = math.tau * Effector().frequency_hz[0]
    assert plant.deflection[0] == pytest.approx(0.002 * (1 - (omega * H) ** 2 / 2), rel=1e-3)
    assert plant.deflection[1:] == ZERO[1:]


def test_deflection_between_undoes_deflected() -> None:
    rigid: Pose = ((1.0, -2.0, 0.5), TURNED)
    bent = (0.001, -0.002, 0.003, 0.01, -0.02, 0.03)
    assert deflection_between(rigid, deflected(rigid, bent)) == pytest.approx(bent, abs=1e-14)
