"""Drives of the MuJoCo station: dead time, smoothing, loops."""

import numpy as np
import pytest

from linemate.simulators.mujoco_world.motor_drives import Drives
from linemate.simulators.mujoco_world.mujoco_cell import ArmDrives

START = (0.0,) * 7
STEP_S, CYCLE_S = 0.001, 0.012


def drives(dead_time_s: float = 0.030) -> Drives:
    return Drives(ArmDrives(dead_time_s=dead_time_s), START, CYCLE_S, STEP_S)


def test_setpoints_act_after_the_dead_time() -> None:
    made = drives()
    made.command(0, 0.0, (0.1, *START[1:]))
    assert made.reference(0.0299)[0] == 0.0
    assert made.reference(0.036)[0] == pytest.approx(0.05)
    assert made.reference(0.042 - 1e-9)[0] == pytest.approx(0.1, abs=1e-6)


def test_a_cycle_without_setpoints_keeps_the_last() -> None:
    made = drives()
    made.command(0, 0.0, (0.1, *START[1:]))
    assert made.reference(0.060)[0] == pytest.approx(0.1)
    made.command(5, 0.0, (0.2, *START[1:]))
    assert made.reference(0.0899)[0] == pytest.approx(0.1)
    assert made.reference(0.102 - 1e-9)[0] == pytest.approx(0.2, abs=1e-6)


def test_late_or_wrong_setpoints_are_refused() -> None:
    made = drives()
    with pytest.raises(ValueError, match="motion has begun"):
        made.command(0, 0.031, START)
    with pytest.raises(ValueError, match="seven finite"):
        made.command(0, 0.0, START[:6])
    with pytest.raises(ValueError, match="seven finite"):
        made.command(0, 0.0, (float("nan"), *START[1:]))


def test_a_motor_follows_the_smoothed_path_against_a_load() -> None:
    """A motor of one kg m^2 alone: it reaches the setpoint though a constant load pulls."""
    made = drives()
    made.fit(np.ones(7))
    goal = (0.1, *START[1:])
    position, velocity = np.zeros(7), np.zeros(7)
    seen = []
    for step in range(1500):
        if step % 12 == 0:
            made.command(step // 12, 0.0, goal)
        torque = made.torques(made.reference(step * STEP_S), position, velocity, np.zeros(7))
        velocity = velocity + STEP_S * (torque - 5.0)
        position = position + STEP_S * velocity
        seen.append(position[0])
    assert seen[-1] == pytest.approx(0.1, abs=1e-4)
    # The two averages have a length of 0.12 s: by their end the motor is there.
    assert seen[42 + 120] == pytest.approx(0.1, abs=5e-3)
    assert seen[29] < 0.01
