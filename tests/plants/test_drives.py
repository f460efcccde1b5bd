"""Laws of the drives: friction at a reversal, its recovery, servos that vary."""

from dataclasses import replace

import numpy as np
import pytest

from linemate.simulators.plants.bending.drives import RoughServos, drives
from linemate.simulators.plants.bending.effects_arm import (
    ArmEffects,
    Friction,
    Posture,
    WarmingController,
)
from linemate.simulators.plants.scenario import Robot
from linemate.simulators.plants.servo_plant import ServoBank

CYCLE_S, SUBSTEPS = 0.012, 3
COULOMB = 0.2e-3


def robot(**effects: object) -> Robot:
    return replace(Robot(), effects=ArmEffects(**effects))  # type: ignore[arg-type]


def rubbing(**values: float) -> Robot:
    return robot(friction=Friction(coulomb=(COULOMB,) * 7, **values))


def driven(arm: Robot, speed: float = 0.03) -> np.ndarray:
    """Motor positions off the start (n, 7): to and fro for 4 s, a turn each second."""
    bank = drives(arm, CYCLE_S, SUBSTEPS)
    rows, setpoint = [], 0.0
    for cycle in range(round(4.0 / CYCLE_S)):
        bank.begin_cycle(cycle)
        setpoint += speed * CYCLE_S * (1.0 if int(cycle * CYCLE_S) % 2 == 0 else -1.0)
        bank.command(cycle, 0.0, tuple(q + setpoint for q in arm.start))
        for part in range(SUBSTEPS):
            bank.advance(cycle * SUBSTEPS + part)
            rows.append(bank.positions)
    return np.array(rows) - arm.start


def at(rows: np.ndarray, seconds: float) -> np.ndarray:
    return np.asarray(rows[round(seconds / CYCLE_S * SUBSTEPS)])


def test_a_robot_without_effects_has_the_plain_servos() -> None:
    assert type(drives(Robot(), CYCLE_S, SUBSTEPS)) is ServoBank


def test_friction_holds_the_motor_back_on_either_way() -> None:
    off = driven(rubbing(recovery_s=0.0)) - driven(Robot())
    assert at(off, 0.9) == pytest.approx(-COULOMB, rel=0.02)
    assert at(off, 1.9) == pytest.approx(COULOMB, rel=0.02)


def test_the_integral_action_removes_the_error_until_the_next_reversal() -> None:
    off = driven(rubbing(recovery_s=0.1)) - driven(Robot())
    assert np.abs(at(off, 1.95)).max() < 0.02 * COULOMB
    turning = off[round(1.0 / 0.004) : round(1.6 / 0.004)]
    assert turning.max() > 0.5 * COULOMB


def test_breakaway_adds_to_friction_near_standstill() -> None:
    arm = rubbing(recovery_s=0.0, breakaway=0.5)
    for speed, share in ((1e-3, 0.48), (30e-3, 0.0)):
        off = driven(arm, speed) - driven(Robot(), speed)
        assert at(off, 0.9) == pytest.approx(-COULOMB * (1.0 + share), rel=0.02)


def test_a_peek_is_where_the_motor_will_be() -> None:
    bank = drives(rubbing(), CYCLE_S, SUBSTEPS)
    assert isinstance(bank, RoughServos)
    for cycle in range(20):
        bank.begin_cycle(cycle)
        bank.command(cycle, 0.0, tuple(q + 1e-4 * cycle for q in Robot().start))
        for part in range(SUBSTEPS):
            index = cycle * SUBSTEPS + part
            seen = bank.peek(index, CYCLE_S / SUBSTEPS)
            assert bank.peek(index, CYCLE_S / SUBSTEPS) == seen
            bank.advance(index)
            assert bank.positions == pytest.approx(seen, abs=1e-12)


def test_a_servo_as_set_does_not_vary() -> None:
    arm = robot(posture=Posture(frequency_share=1e-12))
    assert type(drives(arm, CYCLE_S, SUBSTEPS)) is not ServoBank
    assert driven(arm) == pytest.approx(driven(Robot()), abs=1e-12)


def test_an_arm_that_reaches_far_follows_more_slowly() -> None:
    near, far = (
        driven(robot(posture=Posture(frequency_share=0.2, reach=reach))) for reach in (3.0, 0.5)
    )
    assert (at(near, 0.5) - at(far, 0.5))[:6].min() > 0.2e-3


def test_a_longer_dead_time_lets_the_axes_follow_later() -> None:
    arm = robot(posture=Posture(dead_time_amplitude=0.01, dead_time_period_s=2.0))
    behind = driven(Robot()) - driven(arm)
    assert at(behind, 0.6) == pytest.approx(0.03 * 0.01, rel=0.1)


def test_a_controller_that_warms_up_answers_later_and_stays_so() -> None:
    warm = WarmingController(growth_s=0.03, begin_s=0.1, duration_s=0.2)
    behind = driven(Robot()) - driven(robot(warming=warm))
    assert at(behind, 0.1) == pytest.approx(0.0, abs=1e-12)
    assert at(behind, 0.6) == pytest.approx(0.03 * 0.03, rel=0.1)
