"""Laws of the weight: static sag by posture, and a wheel that is gone when it is released."""

import itertools
import math

import pytest

from linemate.simulators.plants import rotation
from linemate.simulators.plants.effector import ZERO, EffectorPlant
from linemate.simulators.plants.forces.switches import Load
from linemate.simulators.plants.forces.weight import GRAVITY, Weight, new_weight
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Effector, Scenario
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.world import World

STEP = 0.004
STIFFNESS = Effector().stiffness
UPRIGHT: Pose = ((0.0, 0.0, 0.0), rotation.IDENTITY)
LYING: Pose = ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0))
"""z of the tool along x of base: x of the tool points down."""

WHEEL = Load(wheel_mass=25.0, wheel_centre=(0.0, 0.0, -0.1))


def test_a_wheel_of_25_kg_sags_by_its_weight_over_the_stiffness() -> None:
    sag = Weight(WHEEL, STIFFNESS).sag(LYING)
    assert sag[0] == pytest.approx(25 * GRAVITY / 50e3)
    assert sag[0] == pytest.approx(4.9e-3, abs=0.05e-3)
    assert sag[1:3] == pytest.approx((0.0, 0.0))
    # The force down (x) at z = -0.1 turns about y: torque = c x F.
    assert sag[4] == pytest.approx(-0.1 * 25 * GRAVITY / 2000.0)


def test_the_sag_turns_with_the_posture() -> None:
    sag = Weight(WHEEL, STIFFNESS).sag(UPRIGHT)
    assert sag == pytest.approx((0, 0, -25 * GRAVITY / 50e3, 0, 0, 0), abs=1e-15)


def test_tool_and_wheel_add_up_about_their_common_centre() -> None:
    load = Load(10.0, (0.0, 0.02, 0.0), 20.0, (0.0, -0.01, 0.0))
    assert Weight(load, STIFFNESS).sag(LYING) == pytest.approx(
        (30 * GRAVITY / 50e3, 0, 0, 0, 0, 0), abs=1e-12
    )


def test_without_mass_there_is_no_weight() -> None:
    assert new_weight(Load(), STIFFNESS) is None
    assert EffectorPlant(Effector(), STEP).sag(LYING) == ZERO


def test_a_hanging_tool_stays_where_it_hangs() -> None:
    plant = EffectorPlant(Effector(load=WHEEL), STEP)
    plant.rest(LYING)
    for _ in range(500):
        plant.swing_free(LYING, LYING)
    assert plant.deflection == pytest.approx(plant.sag(LYING), abs=1e-15)
    assert plant.peek(LYING, LYING, 0.002) == pytest.approx(plant.deflection, abs=1e-15)


def test_a_tool_that_is_turned_slowly_hangs_as_its_posture_says() -> None:
    plant = EffectorPlant(Effector(load=WHEEL, damping=(0.3,) * 6), STEP)
    plant.rest(UPRIGHT)
    before = UPRIGHT
    for k in range(1, 2001):
        after: Pose = ((0.0, 0.0, 0.0), rotation.exp((0.0, math.pi / 2 * k / 2000, 0.0)))
        plant.swing_free(before, after)
        before = after
    assert plant.deflection == pytest.approx(plant.sag(before), abs=3e-5)
    assert plant.deflection[0] == pytest.approx(25 * GRAVITY / 50e3, rel=0.01)


def test_a_peek_is_the_step_it_looks_ahead_to() -> None:
    plant = EffectorPlant(Effector(load=WHEEL), STEP)
    after: Pose = ((0.001, 0.0, 0.002), rotation.exp((0.01, 0.02, 0.0)))
    ahead = plant.peek(LYING, after, STEP)
    plant.swing_free(LYING, after)
    assert plant.deflection == pytest.approx(ahead, abs=1e-12)


def test_a_released_wheel_leaves_a_lighter_and_faster_tool() -> None:
    load = Load(tool_mass=15.0, wheel_mass=25.0)
    plant = EffectorPlant(Effector(load=load, damping=(0.0,) * 6), STEP)
    plant.rest(LYING)
    plant.drop_wheel()
    assert plant.sag(LYING)[0] == pytest.approx(15 * GRAVITY / 50e3)
    seen = []
    for _ in range(2000):
        plant.swing_free(LYING, LYING)
        seen.append(plant.deflection[0] - plant.sag(LYING)[0])
    # The tool rings about its new sag with the weight that is gone.
    assert max(seen) == pytest.approx(25 * GRAVITY / 50e3, rel=0.01)
    crossings = sum(a * b < 0 for a, b in itertools.pairwise(seen))
    assert crossings / 2 / 8.0 == pytest.approx(5.0 * math.sqrt(40 / 15), rel=0.02)


def test_the_world_begins_with_a_tool_that_hangs_still() -> None:
    world = World(Scenario(seed=1, effector=Effector(load=WHEEL)))
    sag = world.sag()
    assert sag[0] == pytest.approx(4.9e-3, rel=0.01)
    world.advance(-1.0)
    assert world.deflection() == pytest.approx(sag, abs=1e-12)
    felt = world.take_wrench()[-1].force
    assert felt[0] == pytest.approx(25 * GRAVITY, abs=15.0)


def test_each_car_has_its_own_wheel_within_the_spread() -> None:
    load = Load(wheel_mass=24.0, wheel_mass_spread=0.15)
    masses = {
        sample(s, Scenario(effector=Effector(load=load))).effector.load.wheel_mass
        for s in range(20)
    }
    assert len(masses) == 20
    assert all(20.4 <= mass <= 27.6 for mass in masses)
