"""Motions for commissioning: within the limits of any arm, and each axis by its 0.2 degrees."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from linemate.daemon.commissioning.motion.measuring_motion import (
    AXIS_ANGLE,
    MARGIN,
    RAIL_MOVE,
    RAIL_SPEED,
    axis_task,
    exercise_task,
)
from linemate.daemon.commissioning.rehearsal import rehearse
from linemate.daemon.config import documents, task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.task_file import Task
from linemate.daemon.core import rotations
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.parameters import Parameters, build
from linemate.daemon.core.step import REST_DISTANCE
from linemate.daemon.core.tracking.settings import TrackingSettings

CELLS = Path(__file__).parents[3] / "simulators" / "harness" / "data" / "cells"
TASKS = (DAEMON_DATA / "wheel.yaml", CELLS / "kr10" / "task.yaml")


@cache
def cell(path: Path) -> tuple[Task, Parameters]:
    task = task_file.load(path)
    return task, compiled(task, task.urdf)


def compiled(task: Task, urdf: str) -> Parameters:
    return build(task.file, urdf, TrackingSettings(), ControlSettings(), 0.012)


def loaded(tmp_path: Path, urdf: str, made: dict[str, Any]) -> Task:
    (tmp_path / "arm.urdf").write_text(urdf)
    (tmp_path / "t.yaml").write_text(yaml.safe_dump(made))
    return task_file.load(tmp_path / "t.yaml")


@pytest.mark.parametrize("path", TASKS, ids=lambda path: str(path.parent.name))
def test_the_exercise_is_within_the_limits_of_the_arm_that_it_is_made_for(
    path: Path, tmp_path: Path
) -> None:
    task, parameters = cell(path)
    plain = documents.read(task.text.encode(), "t").value
    made = loaded(tmp_path, task.urdf, exercise_task(parameters, plain))
    assert 10 < len(made.file.waypoints) <= 100
    rehearsal = rehearse(compiled(made, task.urdf))
    assert rehearsal.complaints == ()
    for peak in rehearsal.peaks:
        assert peak.speed < 0.6 * peak.limit
        assert peak.margin > 0.9 * MARGIN
    turning = {peak.name: peak.speed for peak in rehearsal.peaks}
    assert all(turning[f"A{axis}"] > 0.05 for axis in range(1, 7))


@pytest.mark.parametrize("path", TASKS, ids=lambda path: str(path.parent.name))
def test_each_axis_turns_alone_by_its_angle_and_comes_back(path: Path, tmp_path: Path) -> None:
    task, parameters = cell(path)
    plain = documents.read(task.text.encode(), "t").value
    made = loaded(tmp_path, task.urdf, axis_task(parameters, plain))
    assert made.file.linear_axis.travel == 0.0
    assert rehearse(compiled(made, task.urdf)).complaints == ()
    arm, home = parameters.controller.arm, compiled(made, task.urdf).home
    turned = []
    for point in made.file.waypoints:
        place, turn = np.array(point.pose.position), rotations.matrix(point.pose.quaternion)
        turned.append(arm.solve(home, place, turn, tolerance=1e-9) - home)
    largest = np.abs(np.array(turned)).max(axis=0)[:6]
    assert largest == pytest.approx(np.full(6, AXIS_ANGLE), rel=1e-3)
    alone = [np.sort(np.abs(each))[-2] for each in turned]
    assert max(alone) < 1e-5
    away = home - parameters.home
    assert np.abs(away[:6]).max() < 1e-9
    if arm.linear_axis:
        # More than an arm order allows, so that the way home moves it.
        assert abs(away[6]) == pytest.approx(RAIL_MOVE)
        assert RAIL_MOVE > REST_DISTANCE
    assert made.file.home.speed == RAIL_SPEED


def test_an_axis_at_its_end_turns_to_the_other_side() -> None:
    task, parameters = cell(TASKS[0])
    plain = documents.read(task.text.encode(), "t").value
    upper = parameters.controller.limits.upper.copy()
    parameters.controller.limits.upper[0] = parameters.home[0] + MARGIN
    try:
        made = axis_task(parameters, plain)
    finally:
        parameters.controller.limits.upper[:] = upper
    first = made["waypoints"][2]["pose"]["position"]
    assert first[1] < made["waypoints"][0]["pose"]["position"][1] or first[1] != 0.0
