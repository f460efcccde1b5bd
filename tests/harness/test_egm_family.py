"""The same task behind an ABB controller with EGM, in virtual time."""

import pytest

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.harness.cell import families
from linemate.simulators.judge.judge import judge
from linemate.simulators.plants.scenario import Axis, Robot, Scenario


def test_each_family_has_servos_of_its_own_and_a_scenario_may_have_others() -> None:
    plain = Scenario()
    assert families.truth("rsi", plain) is plain
    behind = families.truth("egm", plain)
    assert behind.robot.axes != plain.robot.axes
    own = Scenario(robot=Robot(axes=(Axis(9.0, 0.8, 0.01, 5.0),) * 7))
    assert families.truth("egm", own) is own


def test_the_servos_behind_egm_are_those_identified_and_not_the_plants() -> None:
    made = setup.make("quiet", controller="egm", cycle_ms=4)
    plant = made.scenario.robot.axes
    for model, axis in zip(made.control.servos, plant, strict=True):
        assert model.frequency_hz != axis.frequency_hz
        assert model.frequency_hz == pytest.approx(axis.frequency_hz, rel=0.1)


def test_the_wheel_is_assembled_behind_egm_within_the_limits_of_control() -> None:
    """19 s of the task take 5 s: nothing shorter has the approach, a stop and the screws."""
    evidence = lockstep.run(setup.make("wheel", controller="egm", cycle_ms=8), 1)
    result = judge(evidence)
    assert result["outcome"] == "assembled"
    assert result["telegrams"]["answered"] == result["telegrams"]["sent"]
    assert result["control_error"]["approach"]["max_mm"] < 0.5
    assert result["limits"]["violations"] == 0
