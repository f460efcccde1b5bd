"""The measuring command: which rows, a short share of runs, and that it goes on where it was."""

import json
from pathlib import Path
from typing import Any

import pytest

from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.main import main
from linemate.simulators.lab.world import measure

SHORT = ("--set", "scenario.lead_in_s=1.3", "--set", "scenario.duration_s=0.1")


def measured(kept: Path, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, Any]:
    arguments = ["world", "--rows", "nominal", "--kept", str(kept), "--json", "--workers", "1"]
    assert main([*arguments, *SHORT, *more]) == 0
    whole: dict[str, Any] = json.loads(capsys.readouterr().out)
    return whole


def test_a_short_share_gives_a_run_a_seed_and_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    row = measured(tmp_path, capsys, "--seeds", "3..4")["rows"]["nominal"]
    assert [run["seed"] for run in row["runs"]] == [3, 4]
    assert row["summary"]["held"] == 2
    assert all("never started" in run["reason"] or run["reason"] for run in row["runs"])
    assert row["runs"][0]["impact_mm"] is None


def test_a_finished_run_is_taken_from_where_it_is_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = measured(tmp_path, capsys, "--seeds", "5")
    (path,) = tmp_path.glob("*.json")
    path.write_text(path.read_text().replace('"held"', '"collision"'), encoding="utf-8")
    again = measured(tmp_path, capsys, "--seeds", "5")
    assert first["rows"]["nominal"]["summary"]["held"] == 1
    assert again["rows"]["nominal"]["summary"]["collision"] == 1
    arguments = ["world", "--rows", "nominal", "--kept", str(tmp_path), "--seeds", "5", *SHORT]
    assert main([*arguments, "--check"]) == 1
    assert main([*arguments, "--check", "--set", "scenario.camera.sigma=1e-3"]) == 0


def test_another_setting_is_another_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured(tmp_path, capsys, "--seeds", "5")
    measured(tmp_path, capsys, "--seeds", "5", "--set", "scenario.camera.sigma=1e-3")
    assert len(list(tmp_path.glob("*.json"))) == 2


def test_rows_are_chosen_by_name_or_beginning() -> None:
    assert measure.chosen("nominal") == ("nominal",)
    assert set(measure.chosen("camera*")) >= {"camera-blind-60mm"}
    assert {*measure.known()} - {*measure.chosen(None)} == {*measure.DRAWN}
    with pytest.raises(SetupError, match="no row 'camera'"):
        measure.chosen("camera")


def test_a_row_of_the_other_world_is_refused_with_that_world() -> None:
    with pytest.raises(SetupError, match="it is of --world mujoco"):
        measure.chosen("mujoco")
    with pytest.raises(SetupError, match="it is not of --world mujoco"):
        measure.chosen("plant-floor", "mujoco")
