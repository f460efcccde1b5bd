"""Rows as identified: the exercise is in the row's cell, and its overlay is the daemon's."""

from dataclasses import replace
from pathlib import Path

import pytest

from linemate.daemon.identification.pipeline import Identified
from linemate.daemon.operator import identify_command
from linemate.simulators.harness import setup
from linemate.simulators.harness.setup import Setup
from linemate.simulators.lab import identify_run
from linemate.simulators.lab.world.as_identified import CELL, CellJob, identified

ROW = setup.make("world/windup-1mrad", ())
OVERLAY = {"control": {"windup": [{"depth": 0.5e-3, "travel": 1e-3}]}}


def test_the_exercise_is_in_the_rows_plant_by_the_rows_daemon() -> None:
    exercise = identify_run.exercise_in(ROW)
    assert exercise.scenario.robot == ROW.scenario.robot
    assert exercise.scenario.conveyor.events != ROW.scenario.conveyor.events
    assert exercise.control == replace(ROW.control, damping=False)
    assert exercise.tracking.swing == ROW.tracking.swing


def test_a_cell_is_identified_once_and_its_runs_are_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded: list[Setup] = []

    def record(exercise: Setup, seed: int, path: Path) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        recorded.append(exercise)
        return path

    monkeypatch.setattr(identify_run, "record", record)
    monkeypatch.setattr(identify_command, "from_files", lambda _: Identified((), OVERLAY, ()))
    job = CellJob(ROW, 2, tmp_path, "sources")
    known = identified(job)
    assert identified(job) == known
    assert [each.scenario.cell_seed for each in recorded] == [CELL, CELL]
    assert known.scenario == replace(ROW.scenario, cell_seed=CELL)
    assert known.control.windup[0].depth == pytest.approx(0.5e-3)
    assert known.tracking == ROW.tracking
