"""Laws of the touch: springs in series, friction, chamfer, rim first, momentum and energy."""

import numpy as np
import pytest

from linemate.simulators.plants import rotation
from linemate.simulators.plants.effector import ZERO
from linemate.simulators.plants.forces.switches import Mating
from linemate.simulators.plants.forces.touch import Six, Suspension, Touch
from linemate.simulators.plants.rotation import Pose

STEP, MOUNT, CONTACT = 0.004, 50e3, 1e6
TIPS = -0.025


def touch(mating: Mating | None = None, damping: float = 0.6, mount: float = MOUNT) -> Touch:
    suspension = Suspension.of((mount, mount, mount, 2e3, 2e3, 2e3), (5.0,) * 6, (damping,) * 6)
    return Touch(mating or Mating(bolts=5, angle=0.0), suspension)


def pose(x: float = 0.0, z: float = 0.0, tilt: float = 0.0, spin: float = 0.0) -> Pose:
    return (x, 0.0, z), rotation.exp((0.0, tilt, spin))


def rest(plant: Touch, at: Pose, seconds: float = 0.8, bent: Six = ZERO) -> Six:
    """Hold the rigid tcp still until the tool rests too; returns the deflection."""
    moving: Six = ZERO
    for _ in range(round(seconds / STEP)):
        bent, moving = plant.advance(bent, moving, ZERO, (at, at), STEP)
    return bent


def test_mount_and_contact_are_springs_in_series() -> None:
    plant = touch()
    plant.entered = True
    bent = rest(plant, pose(z=0.003))
    force = 0.003 * MOUNT * CONTACT / (MOUNT + CONTACT)
    assert plant.force[2] == pytest.approx(-force, rel=1e-3)
    assert bent[2] == pytest.approx(-force / MOUNT, rel=1e-3)


def test_bolts_next_to_their_holes_hold_the_wheel_off_at_their_tips() -> None:
    plant = touch()
    bent = rest(plant, pose(x=0.0025, z=TIPS + 0.004))
    assert not plant.entered
    assert TIPS + 0.004 + bent[2] == pytest.approx(TIPS + 0.004 / 21, abs=2e-5)


@pytest.mark.parametrize(("spin", "enters"), [(0.0, True), (0.03, True), (0.04, False)])
def test_the_bolts_angle_decides_as_an_offset_on_their_circle_does(
    spin: float, enters: bool
) -> None:
    # 0.035 rad on 56 mm is 2 mm, which is chamfer and clearance together.
    plant = touch(Mating(bolts=5, angle=spin))
    rest(plant, pose(z=TIPS - 0.001), 0.01)
    assert plant.entered is enters


def test_turning_the_tool_to_the_bolts_lets_them_in() -> None:
    plant = touch(Mating(bolts=5, angle=0.05))
    rest(plant, pose(z=TIPS - 0.001, spin=0.05), 0.01)
    assert plant.entered


def test_the_chamfer_draws_the_tool_to_the_middle() -> None:
    plant = touch()
    rest(plant, pose(x=0.0018, z=TIPS - 0.001), 0.01)
    bent = rest(plant, pose(x=0.0018, z=-0.010))
    # Only the clearance is left, and what the mount presses into the hole's edge.
    assert 0.0018 + bent[0] == pytest.approx(0.0005 + 0.0013 / 21, abs=1e-5)
    assert plant.force[0] == pytest.approx(-0.0013 * MOUNT * 20 / 21, rel=0.01)


def test_a_chamfer_pushes_back_while_it_pushes_aside() -> None:
    plant = touch()
    rest(plant, pose(x=0.0018, z=TIPS - 0.001), 0.01)
    rest(plant, pose(x=0.0018, z=TIPS + 0.0008))
    assert plant.force[0] < -1.0
    assert plant.force[2] == pytest.approx(plant.force[0], rel=0.05)


@pytest.mark.parametrize("friction", [0.1, 0.3])
def test_a_sliding_tool_feels_friction_times_the_normal_force(friction: float) -> None:
    plant = touch(Mating(bolts=5, angle=0.0, friction=friction, clearance=0.02))
    plant.entered = True
    bent, moving, x = rest(plant, pose(z=0.003)), ZERO, 0.0
    for _ in range(100):
        ways = pose(x=x, z=0.003), pose(x=x + 0.02 * STEP, z=0.003)
        bent, moving = plant.advance(bent, moving, ZERO, ways, STEP)
        x += 0.02 * STEP
    assert plant.force[0] == pytest.approx(friction * plant.force[2], rel=0.02)
    assert bent[0] == pytest.approx(plant.force[0] / MOUNT, rel=0.1)


def test_a_tilted_wheel_touches_with_its_rim_first() -> None:
    level, tilted = touch(), touch()
    level.entered = tilted.entered = True
    rest(level, pose(z=-0.0005), STEP)
    rest(tilted, pose(z=-0.0005, tilt=0.010), STEP)
    assert not level.force.any()
    assert tilted.force[2] < -1.0
    # The rim pushes the tilt back.
    assert tilted.force[4] < 0.0


@pytest.mark.parametrize(("damping", "low", "high"), [(0.0, 0.9, 1.0), (0.2, 0.3, 0.8)])
def test_a_tool_bounces_back_no_faster_than_it_came(
    damping: float, low: float, high: float
) -> None:
    plant = touch(Mating(bolts=5, angle=0.0, contact_damping=damping), 0.0, mount=1.0)
    plant.entered = True
    # Without a mount to speak of: mass as of a mount of 1 N/m at 5 Hz would be tiny.
    plant._suspension = Suspension(np.full(6, 26.0), np.zeros(6), np.full(6, 1e-6))
    plant._damper = 2 * damping * np.sqrt(CONTACT * 26.0)
    bent, moving = (0.0, 0.0, -0.001, 0.0, 0.0, 0.0), (0.0, 0.0, 0.05, 0.0, 0.0, 0.0)
    for _ in range(40):
        bent, moving = plant.advance(bent, moving, ZERO, (pose(), pose()), STEP)
    assert low * 0.05 <= -moving[2] <= high * 0.05 * 1.001


def test_a_touch_keeps_the_momentum_of_tool_and_hub() -> None:
    plant = touch()
    plant.entered = True
    plant._suspension = Suspension(np.full(6, 26.0), np.zeros(6), np.full(6, 1e-6))
    plant.give_way = lambda: np.diag((0, 0, 1 / 200.0, 0, 0, 0))
    bent, moving = (0.0, 0.0, -0.0001, 0.0, 0.0, 0.0), (0.0, 0.0, 0.05, 0.0, 0.0, 0.0)
    got = np.zeros(6)
    for _ in range(20):
        bent, moving = plant.advance(bent, moving, ZERO, (pose(), pose()), STEP)
        got = got + plant.impulse
    assert 26.0 * moving[2] + got[2] == pytest.approx(26.0 * 0.05)
    assert got[2] > 26.0 * 0.05


def test_the_hub_moves_by_the_integral_of_its_impulse() -> None:
    plant = touch()
    plant.entered = True
    plant.give_way = lambda: np.eye(6) / 300.0
    rest(plant, pose(z=0.002), STEP, (0.0, 0.0, -0.001, 0.0, 0.0, 0.0))
    assert 0.0 < plant.impulse_time[2] < plant.impulse[2] * STEP


def test_nothing_touches_out_of_reach() -> None:
    plant = touch()
    assert not plant.near(pose(z=-0.031))
    assert not plant.near(pose(x=0.03, z=-0.02))
    assert plant.near(pose(z=-0.02))
    plant.entered = True
    plant.leave(pose(z=-0.04))
    assert not plant.entered


def test_a_hub_that_has_moved_by_the_expected_force_is_not_moved_by_it_again() -> None:
    plant = touch()
    plant.entered = True
    bent = rest(plant, pose(z=0.003))
    force = plant.force
    plant.give_way = lambda: np.eye(6) / 50.0
    plant.begin(STEP)
    plant.advance(bent, ZERO, ZERO, (pose(z=0.003), pose(z=0.003)), STEP)
    assert plant.force == pytest.approx(force, abs=1e-2)
