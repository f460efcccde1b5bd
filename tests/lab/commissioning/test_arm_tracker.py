"""The emulated laser tracker: it sees the plant's arm, and nothing but its noise is added."""

from pathlib import Path

import numpy as np
import pytest

from linemate.daemon.core import rotations
from linemate.daemon.core.control import kinematics
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.geometry import measured_poses
from linemate.simulators.harness import setup
from linemate.simulators.harness.main import main
from linemate.simulators.harness.setup import Setup
from linemate.simulators.lab.commissioning import arm_tracker

FRAME_M = 5.0 * (arm_tracker.FRAME_PLACE + 3.0 * arm_tracker.FRAME_TURN)
"""Largest place of the tracker's frame, with its turn over 3 m [m]."""


def off(run: Setup, seed: int, count: int = 4) -> Array:
    """Measured positions against those of the URDF at the shown joints (2 count, 3) [m]."""
    tool = run.task.arm.tcp_in_flange
    arm = kinematics.load(
        run.urdf,
        run.task.arm.flange,
        np.array(tool.position),
        rotations.matrix(tool.quaternion),
        linear_axis=run.task.arm.linear_axis,
    )
    poses = arm_tracker.measure(run, seed, count)
    placed = [arm.tcp_in_base(joints)[0] for joints in poses.joints]
    return np.asarray(poses.positions - np.array(placed))


def test_an_arm_without_errors_is_seen_where_the_urdf_has_it() -> None:
    errors = off(setup.make("wheel"), 3)
    assert np.abs(errors).max() < FRAME_M
    # The tracker's frame is the same for all poses; what is left is noise.
    assert 0.3 < (errors - errors.mean(axis=0)).std() / arm_tracker.PLACE_NOISE < 3.0


def test_a_pose_is_wound_up_to_both_sides() -> None:
    plant = "scenario.robot.effects.windup.depth"
    run = setup.make("wheel", (f"{plant}=[0.5e-3, 0, 0, 0, 0, 0]",))
    errors = off(run, 3)
    # A1 is 1.6 to 2.6 m from the tool, and winds up by 0.5 mrad to either side.
    apart = np.linalg.norm(errors[0::2] - errors[1::2], axis=1)
    assert (apart > 1.3e-3).all()
    assert (apart < 2.9e-3).all()
    assert np.abs(errors[0::2] + errors[1::2]).max() / 2.0 < FRAME_M


def test_a_seed_measures_the_same_again_and_another_cell_another_arm() -> None:
    run = setup.make("world/uncalibrated-arm")
    first, again, other = (arm_tracker.measure(run, seed, 2) for seed in (3, 3, 4))
    assert np.array_equal(first.positions, again.positions)
    assert not np.allclose(first.positions, other.positions)


def test_poses_turn_every_axis() -> None:
    poses = np.array(arm_tracker.rest_poses(setup.make("wheel"), 0, 40))
    assert (np.ptp(poses, axis=0)[:6] > 0.25).all()
    assert (np.diff(poses[:, 6]) >= 0.0).all()


@pytest.mark.parametrize("cell", ["wheel", "kr10"])
def test_the_command_writes_a_table_of_any_cell(
    cell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "poses.csv"
    words = ("--cell", cell, "--poses", "3", "--positions")
    assert main(["measure-arm", str(path), *words]) == 0
    assert capsys.readouterr().out == f"{path}: 6 rows of 3 poses\n"
    poses = measured_poses.read(path.read_text(), linear_axis=cell == "wheel")
    assert len(poses.lines) == 6
    assert poses.turns is None


def test_a_table_that_cannot_be_written_is_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["measure-arm", str(tmp_path / "none" / "poses.csv")]) == 2
    assert "no such directory" in capsys.readouterr().err
