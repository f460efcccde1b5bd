"""Which files a run's cell is made of."""

import shutil
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import pytest

from linemate.daemon.config.documents import FileError
from linemate.simulators.harness import setup
from linemate.simulators.harness.cell import cell_files
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.lab.faults.dst_cells import TASKS

CONFIG, TASK = TASKS / "dst_six_axes.yaml", TASKS / "dst_six_axes_task.yaml"


def chosen(**given: object) -> cell_files.CellFiles | None:
    return cell_files.chosen(Namespace(**{"cell": None, "config": None, "task": None, **given}))


def test_without_files_the_cell_is_the_shipped_one() -> None:
    assert chosen() is None
    assert cell_files.scenario(None, None) == "wheel"
    assert cell_files.scenario("quiet", None) == "quiet"


def test_a_configuration_brings_task_family_and_period() -> None:
    cell = chosen(config=CONFIG)
    assert cell is not None
    assert (cell.task.file.name, cell.family, cell.cycle_ms) == ("dst-six-axes", "rsi", 12.0)
    assert cell.scenario is None


def test_a_task_alone_leaves_the_links_as_they_are_shipped() -> None:
    cell = chosen(task=TASK)
    assert cell is not None
    assert (cell.station, cell.family, cell.cycle_ms) == (None, None, None)


def test_a_task_replaces_that_of_the_configuration(tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    urdf = TASKS / "dst_six_axes.urdf"
    other.write_text(TASK.read_text().replace("name: dst-six-axes", "name: other"))
    (tmp_path / urdf.name).write_text(urdf.read_text())
    cell = chosen(config=CONFIG, task=other)
    assert cell is not None
    assert cell.station is not None
    assert cell.task.file.name == cell.station.task.file.name == "other"
    assert cell.station.texts["task"] == other.read_text()


def test_a_folder_is_a_cell_with_its_scenario(tmp_path: Path) -> None:
    for file in TASKS.glob("dst_six_axes*"):
        (tmp_path / file.name).write_text(
            file.read_text().replace("../cells/wheel/", "").replace("../parameters/", "")
        )
    for name in ("cells/wheel/identified.yaml", "parameters/wheel.yaml"):
        shutil.copy(TASKS.parent / name, tmp_path)
    (tmp_path / "dst_six_axes.yaml").rename(tmp_path / cell_files.CONFIG)
    bare = chosen(cell=str(tmp_path))
    assert bare is not None
    assert bare.scenario is None
    (tmp_path / cell_files.SCENARIO).write_text("duration_s: 5.0")
    cell = chosen(cell=str(tmp_path))
    assert cell_files.scenario(None, cell) == str(tmp_path / cell_files.SCENARIO)
    assert cell_files.scenario("quiet", cell) == "quiet"


def test_a_folder_without_a_configuration_is_no_cell(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"--cell .*: neither a shipped cell nor a folder"):
        chosen(cell=str(tmp_path))


def test_a_task_on_a_linear_axis_needs_its_correction() -> None:
    with pytest.raises(SetupError, match=r"no EK\.E1"):
        chosen(config=CONFIG, task=TASKS / "dst.yaml")


def test_errors_of_a_file_are_those_of_the_daemon(tmp_path: Path) -> None:
    file = tmp_path / "linemated.yaml"
    file.write_text("task: nowhere.yaml\n")
    with pytest.raises(FileError, match=r"task: no such file"):
        chosen(config=file)


def test_a_shipped_cell_goes_by_its_name() -> None:
    assert cell_files.shipped() == ("kr10", "wheel")
    cell = cell_files.named("kr10")
    assert cell.task.file.name == "mirror"
    with pytest.raises(SetupError, match="near is kr10"):
        chosen(cell="kr1")


def test_the_shipped_wheel_by_its_files_is_the_default_cell() -> None:
    own, default = setup.make("wheel", cell=cell_files.named("wheel")), setup.make("wheel")
    assert replace(own, station=None) == default


def test_another_world_names_the_cell_as_the_reason() -> None:
    with pytest.raises(SetupError, match="--world mujoco has the shipped cell alone"):
        setup.make("wheel", cell=cell_files.named("kr10"), world="mujoco")
