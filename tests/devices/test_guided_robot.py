"""A robot that its own programme guides, with corrections on top and axes that count backwards."""

import math
from dataclasses import replace

import pytest

from linemate.simulators.devices.guided_robot import GuidedRobot, PostureProgramme
from linemate.simulators.devices.rsi_controller import Applied, Seven
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.world import World

THERE: Seven = (0.1, -math.pi / 2, math.pi / 2, 0.2, math.pi / 2, 0.0, 0.05)
MIRRORED: Seven = (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


def robot(signs: Seven) -> GuidedRobot:
    scenario = replace(Scenario(), lead_in_s=0.5, duration_s=4.0)
    world = World(sample(1, scenario))
    return GuidedRobot(world, PostureProgramme([THERE], 0.0, 1.0, 1.0), signs)


def run(guided: GuidedRobot, correction: float = 0.0) -> Seven:
    """Where the axes are in the end, with a correction of the first axis."""
    a, b, c, d, e, f, g = guided.start
    setpoints = (a + correction, b, c, d, e, f, g)
    for n in range(300):
        guided.apply(Applied(n, n, setpoints, 0, None, clamped=False))
    return guided.read().axes


def test_the_programme_takes_the_robot_to_its_posture() -> None:
    guided = robot((1.0,) * 7)
    assert run(guided) == pytest.approx(THERE, abs=1e-3)
    assert PostureProgramme([THERE], 0.0, 1.0, 1.0).end_s == 2.0


def test_a_correction_is_added_in_the_sense_in_which_the_controller_counts() -> None:
    guided = robot(MIRRORED)
    read = run(guided, correction=0.02)
    assert read[0] == pytest.approx(-THERE[0] + 0.02, abs=1e-3)
    true = guided.world.encoders()  # type: ignore[attr-defined]
    assert true[0] == pytest.approx(THERE[0] - 0.02, abs=1e-3)
