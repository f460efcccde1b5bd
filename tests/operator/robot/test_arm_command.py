"""``linemate identify-arm``: an overlay that the daemon takes, or a reason."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from linemate.daemon.config import config
from linemate.daemon.config.task_file import geometry_of
from linemate.daemon.core.control.settings import AxisGeometry
from linemate.daemon.identification.geometry.arm_geometry import MeasuredArm
from linemate.daemon.identification.geometry.measured_poses import MeasuredPoses, text_of
from linemate.daemon.operator import main as tool
from linemate.simulators.harness.cell import cell_files

TURN = (0.0, 0.8e-3, 0.0)


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    shutil.copytree(cell_files.DATA / "wheel", tmp_path / "wheel")
    return tmp_path / "wheel" / "linemated.yaml"


def table(path: Path, cell: Path) -> Path:
    """Poses of an arm whose A2 has another zero."""
    station = config.load(cell)
    measured = MeasuredArm(station.task.file, station.task.urdf, station.config.control)
    real = measured.load([AxisGeometry(), AxisGeometry(turn=TURN)])
    random = np.random.default_rng(1)
    rest = np.array((*station.task.file.arm.rest_joints, 0.5))
    joints = rest + random.uniform(-0.3, 0.3, (30, 7))
    placed = [real.tcp_in_base(row) for row in joints]
    positions = np.array([row[0] for row in placed]) + 2e-5 * random.standard_normal((30, 3))
    lines, turns = tuple(range(30)), np.array([row[1] for row in placed])
    path.write_text(text_of(MeasuredPoses(lines, joints, positions, turns)))
    return path


def run(*words: str | Path) -> int:
    return tool.main(["identify-arm", *map(str, words)])


def test_the_overlay_is_one_that_the_daemon_takes(
    cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "arm.yaml"
    assert run(table(tmp_path / "poses.csv", cell), "--config", cell, "--out", out) == 0
    printed = capsys.readouterr()
    assert "tcp error, poses held back" in printed.out
    assert "control.bend is not set" in printed.err
    loaded = config.load(cell, [out])
    geometry = loaded.config.control.geometry
    assert len(geometry) == 6
    assert geometry[1].turn[1] == pytest.approx(TURN[1], abs=0.1e-3)
    assert geometry_of(loaded.texts, "daemon") == geometry
    assert "geometry" not in config.load(cell).texts


def test_json_has_the_findings_and_the_overlay(
    cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "arm.yaml"
    poses = table(tmp_path / "poses.csv", cell)
    assert run(poses, "--config", cell, "--out", out, "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["overlay"] == yaml.safe_load(out.read_text())
    assert printed["findings"][0]["name"] == "tcp error, URDF"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "no header"),
        (b"\xff\xfe\x00", "not a text"),
        (b"x_mm\n1\n", "line 1: missing: A1"),
        (b"A1_deg,A2_deg,A3_deg,A4_deg,A5_deg,A6_deg,E1_mm,x_mm,y_mm,z_mm\n", "0 poses"),
    ],
)
def test_a_table_that_is_none_is_a_reason_and_no_overlay(
    content: bytes, says: str, cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "poses.csv").write_bytes(content)
    out = tmp_path / "arm.yaml"
    assert run(tmp_path / "poses.csv", "--config", cell, "--out", out) == 1
    error = capsys.readouterr().err
    assert says in error
    assert str(tmp_path / "poses.csv") in error
    assert not out.exists()


def test_a_missing_file_and_a_wrong_configuration_are_reasons(
    cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path / "none.csv", "--config", cell, "--out", tmp_path / "a.yaml") == 1
    assert "none.csv: No such file" in capsys.readouterr().err
    (tmp_path / "bad.yaml").write_text("version: 9")
    assert run(tmp_path / "x.csv", "--config", tmp_path / "bad.yaml") == 78
    assert capsys.readouterr().err.startswith(f"{tmp_path / 'bad.yaml'}:1:")


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("{shift: [0.004, 0, 0]}", "less than or equal to 0.003"),
        ("{turn: [0, 0.2, 0]}", "less than or equal to 0.005"),
        ("{zero: 0.001}", "unknown key"),
    ],
)
def test_a_geometry_out_of_range_is_refused_by_the_daemon(
    row: str, says: str, cell: Path, tmp_path: Path
) -> None:
    over = tmp_path / "arm.yaml"
    over.write_text(f"control: {{geometry: [{row}]}}\n")
    with pytest.raises(config.FileError, match=says):
        config.load(cell, [over])
