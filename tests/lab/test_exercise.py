"""The exercise of a cell: the shipped motions about its own first pose."""

import numpy as np
import pytest

from linemate.daemon.config import task_file
from linemate.daemon.core import rotations
from linemate.simulators.harness.cell import cell_files
from linemate.simulators.harness.cell.cell_truth import shipped_task
from linemate.simulators.lab import exercise

CELL = cell_files.named("kr10").task


def test_the_shipped_cell_has_the_shipped_exercise() -> None:
    assert exercise.of_cell(shipped_task()) is exercise.shipped()


def test_another_arm_makes_the_same_motions_about_its_own_first_pose() -> None:
    plain, made = exercise.shipped().file.waypoints, exercise.of_cell(CELL).file.waypoints
    assert made[0].pose.position == pytest.approx(CELL.file.waypoints[0].pose.position)
    for before, after in zip(plain, made, strict=True):
        away = np.subtract(before.pose.position, plain[0].pose.position)
        assert after.time == before.time
        # Both cells have the tool along x of base.
        moved = np.subtract(after.pose.position, made[0].pose.position)
        assert moved == pytest.approx(away, abs=1e-6)
        turn = rotations.matrix(after.pose.quaternion).T @ rotations.matrix(before.pose.quaternion)
        assert turn == pytest.approx(np.eye(3), abs=1e-6)


def test_its_text_is_a_task_file() -> None:
    made = exercise.of_cell(CELL)
    assert made.file.arm == CELL.file.arm
    assert task_file.parse(made.text.encode(), "exercise.yaml") == made.file
