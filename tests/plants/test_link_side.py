"""Laws of the link side: hysteresis of windup and play, weight, drawn errors."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from linemate.simulators.plants.arm import ArmPlant
from linemate.simulators.plants.bending.effects_arm import (
    ArmEffects,
    Elasticity,
    Geometry,
    WindupEffect,
)
from linemate.simulators.plants.bending.link_side import LinkSide, link_side, true_links
from linemate.simulators.plants.scenario import Robot

DEPTH, TRAVEL = 0.6e-3, 3e-3


def robot(**effects: object) -> Robot:
    return replace(Robot(), effects=ArmEffects(**effects))  # type: ignore[arg-type]


def only(axis: int, value: float) -> tuple[float, ...]:
    return tuple(value if i == axis else 0.0 for i in range(6))


def moved(side: LinkSide, axis: int, angles: list[float]) -> list[float]:
    """Link minus motor of one axis after each of some motor angles."""
    start = Robot().start
    off = []
    for angle in angles:
        motor = tuple(q + angle * (i == axis) for i, q in enumerate(start))
        off.append(side.advance(motor, (0.0,) * 7, 0.004)[axis] - motor[axis])
    return off


def wound() -> LinkSide:
    side = link_side(robot(windup=WindupEffect(only(1, DEPTH), (TRAVEL,) * 6)), seed=0)
    assert side is not None
    return side


def test_an_arm_without_effects_has_no_link_side() -> None:
    assert link_side(Robot(), seed=3) is None
    assert true_links(Robot(), seed=3) is Robot().links


def test_windup_reaches_its_depth_behind_the_motion() -> None:
    there, back = moved(wound(), 1, [0.05, 0.0])
    assert there == pytest.approx(-DEPTH, rel=1e-6)
    assert back == pytest.approx(DEPTH, rel=1e-6)


def test_windup_turns_by_63_percent_in_its_travel() -> None:
    _, after = moved(wound(), 1, [0.05, 0.05 - TRAVEL])
    assert after == pytest.approx(-DEPTH + 2 * DEPTH * (1 - math.exp(-1.0)), rel=1e-6)


def test_windup_depends_on_the_way_and_not_on_its_division() -> None:
    fine = [0.05 * i / 40 for i in range(1, 41)] + [0.05 - 0.004 * i / 20 for i in range(1, 21)]
    assert moved(wound(), 1, fine)[-1] == pytest.approx(moved(wound(), 1, [0.05, 0.046])[-1])


def test_a_standing_motor_keeps_its_windup() -> None:
    there, *later = moved(wound(), 1, [0.002] * 20)
    assert set(later) == {there}


def test_looking_does_not_turn_the_hysteresis() -> None:
    side, unseen = wound(), wound()
    start = Robot().start
    moved(side, 1, [0.01])
    moved(unseen, 1, [0.01])
    for step in (0.0, 0.3, -0.2):
        side.at(tuple(q + step for q in start))
    assert moved(side, 1, [0.009]) == moved(unseen, 1, [0.009])


def test_lost_motion_is_a_play_between_two_flanks() -> None:
    side = link_side(robot(lost_motion=only(2, 0.2e-3)), seed=0)
    assert side is not None
    off = moved(side, 2, [0.01, 0.00995, 0.0099, 0.0098, 0.0])
    assert off == pytest.approx([-0.1e-3, -0.05e-3, 0.0, 0.1e-3, 0.1e-3], abs=1e-12)


def test_weight_lets_the_tool_sag_and_turns_no_vertical_axis() -> None:
    arm = robot(elasticity=Elasticity(compliance=(0.25e-6,) * 3 + (2e-6,) * 3))
    side = link_side(arm, seed=0)
    assert side is not None
    joints = side.at(arm.start)
    plant = ArmPlant(arm)
    place, straight = plant.tcp(joints)[0], plant.tcp(arm.start)[0]
    assert -4e-3 < place[2] - straight[2] < -0.5e-3
    assert joints[0] == pytest.approx(arm.start[0], abs=1e-12)


def test_the_moment_of_the_weights_is_the_slope_of_their_energy() -> None:
    """Virtual work: with one mass at the flange the moments are m g dz/dq."""
    mass = 100.0
    sizes = Elasticity(compliance=(1.0,) * 6, masses=(0.0, 0.0, mass), balanced=0.0)
    arm = robot(elasticity=sizes)
    side = link_side(arm, seed=0)
    assert side is not None
    plant = ArmPlant(arm)
    motor = (0.3, -1.2, 1.1, 0.4, 0.7, -0.5, 0.2)
    held = np.subtract(motor, side.at(motor))[:6]
    step = 1e-5
    for axis in range(6):
        up, down = (
            plant.flange(tuple(q + s * (i == axis) for i, q in enumerate(motor)))[0][2]
            for s in (step, -step)
        )
        assert held[axis] == pytest.approx(9.81 * mass * (up - down) / (2 * step), abs=1e-3)


def test_an_accelerated_arm_lags_behind_its_motor() -> None:
    sizes = Elasticity(compliance=only(0, 0.25e-6), masses=(0.0,) * 3)
    side = link_side(robot(elasticity=sizes), seed=0)
    assert side is not None
    start = Robot().start
    off = side.advance(start, (0.004, 0, 0, 0, 0, 0, 0), 0.004)[0] - start[0]
    assert off == pytest.approx(-0.25e-6 * sizes.inertia[0] * 1.0)


def test_zeros_and_lengths_are_drawn_from_the_seed() -> None:
    arm = robot(geometry=Geometry(zero_sigma=0.3e-3, length_sigma=0.2e-3, angle_sigma=0.1e-3))
    joints = []
    for seed in (1, 1, 2):
        side = link_side(arm, seed)
        assert side is not None
        joints.append(side.at(arm.start))
    assert joints[0] == joints[1] != joints[2]
    off = np.subtract(joints[2], arm.start)[:6]
    assert 0.05e-3 < np.abs(off).max() < 1.2e-3
    assert true_links(arm, 1) == true_links(arm, 1) != true_links(arm, 2)
    place, drawn = arm.links[2].a, true_links(arm, 1)[2].a
    assert 0.0 < abs(place - drawn) < 1e-3


@pytest.mark.parametrize("name", ["A", "B"])
def test_the_plant_winds_up_as_the_recorded_kuka_kr300(name: str) -> None:
    """Motor recorded, link recorded 3 ms later; the depth is that of the fit to both."""
    with np.load(Path(__file__).parents[1] / "data" / "kr300" / f"{name}.npz") as data:
        motor = np.radians(data["act_pos_mot_deg"][:, :3].astype(float))
        link = np.radians(data["act_pos_se_deg"][:, :3].astype(float))
    depth = (0.05e-3,) * 3 + (0.0,) * 3
    side = link_side(robot(windup=WindupEffect(depth, (TRAVEL,) * 6)), seed=0)
    assert side is not None
    rest = Robot().start[3:]
    rows = [side.advance((*row, *rest), (0.0,) * 7, 0.004)[:3] for row in motor.tolist()]
    late = np.array(rows) - 0.0028 * np.gradient(motor, 0.004, axis=0)
    off = link - late
    off -= off.mean(axis=0)
    bent = link - motor
    assert np.sqrt(np.mean(off**2, axis=0)).max() < 0.25e-3
    assert np.sqrt(np.mean((bent - bent.mean(axis=0)) ** 2, axis=0)).min() > 0.5e-3
