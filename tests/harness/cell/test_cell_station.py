"""A cell's files for one host: the configurations of daemon and emulator."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from linemate.daemon.config import config
from linemate.simulators.harness import emulator_command
from linemate.simulators.harness.cell import cell_files, cell_station, families
from linemate.simulators.harness.cell.cell_files import CellFiles
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.demo import DemoStation
from linemate.simulators.lab.faults.dst_cells import TASKS
from linemate.simulators.plants.scenario import Scenario

KR10 = cell_files.named("kr10")


def station_of(folder: Path, cell: CellFiles, family: str = families.RSI) -> DemoStation:
    scenario = Scenario(cycle_s=1e-3 * families.CYCLE_MS[family])
    return DemoStation(folder, scenario, controller=family, cell=cell)


def daemon_of(folder: Path, cell: CellFiles, family: str = families.RSI) -> config.LoadedConfig:
    """Return the daemon's configuration as the demonstration writes it."""
    station = station_of(folder, cell, family)
    return config.load(station.write("daemon", station.daemon_file()))


def emulated_of(folder: Path, cell: CellFiles, family: str = families.RSI) -> Any:
    station = station_of(folder, cell, family)
    station.write("scenario", {})
    listening = {"robot": ["127.0.0.1", 1], "camera": ["127.0.0.1", 2]}
    file = station.write("emulator", station.emulator_file(listening))
    return emulator_command.load(file)[0]


def test_the_daemon_believes_its_own_files_and_has_the_links_of_this_host(tmp_path: Path) -> None:
    loaded, own = daemon_of(tmp_path, KR10), KR10.station
    assert own is not None
    assert loaded.config.tracking == own.config.tracking
    assert loaded.config.control == own.config.control
    assert loaded.task.file == own.task.file
    assert loaded.controller_file == own.controller_file
    assert (loaded.robot.bind, loaded.robot.port) == ("127.0.0.1", 0)
    assert loaded.config.camera is not None
    assert (loaded.config.camera.object, loaded.config.camera.port) == ("panel", 0)


def test_the_emulated_cell_has_the_same_files_and_the_limits_of_the_arm(tmp_path: Path) -> None:
    emulated = emulated_of(tmp_path, KR10)
    assert KR10.station is not None
    assert emulated.rsi_xml.read_text() == KR10.station.texts["rsi"]
    assert emulated.camera_object == "panel"
    assert emulated.distance_mount == 0.5
    speeds = [limit.speed for limit in emulated.controller.limits[:6]]
    assert speeds == [limit.speed for limit in KR10.station.config.control.limits]


@pytest.mark.parametrize("family", [families.FANUC, families.EGM])
def test_another_controller_has_no_linear_axis_on_either_side(tmp_path: Path, family: str) -> None:
    loaded = daemon_of(tmp_path, KR10, family)
    assert loaded.config.controller.kind.value == family
    emulated = emulated_of(tmp_path, KR10, family)
    controller = getattr(emulated, family)
    assert len(controller.limits) == 7
    if family == families.FANUC:
        assert not loaded.config.fanuc.rail
        assert not controller.has_rail


def test_a_task_alone_runs_with_the_shipped_links(tmp_path: Path) -> None:
    args = Namespace(cell=None, config=None, task=TASKS / "dst_six_axes_task.yaml")
    cell = cell_files.chosen(args)
    assert cell is not None
    station = station_of(tmp_path, cell)
    written = station.daemon_file()
    assert written["task"] == str(args.task.resolve())
    start = cell.task.file.conveyor.start_position
    assert start != KR10.task.file.conveyor.start_position
    assert emulated_of(tmp_path, cell).distance_mount == start


def test_an_own_task_goes_before_that_of_the_configuration(tmp_path: Path) -> None:
    cell = replace(KR10, task_path=TASKS / "dst_six_axes_task.yaml")
    assert cell_station.daemon_file(cell)["task"].endswith("dst_six_axes_task.yaml")


def test_a_message_that_is_not_in_the_dbc_is_refused(tmp_path: Path) -> None:
    for file in (cell_files.DATA / "kr10").iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    path = tmp_path / cell_files.CONFIG
    value = yaml.safe_load(path.read_text())
    value["distance"]["can_id"] = 0x123
    path.write_text(yaml.safe_dump(value))
    with pytest.raises(SetupError, match=r"distance\.can_id"):
        emulated_of(tmp_path, cell_files.named(str(tmp_path)))


def test_sections_that_belong_to_a_plant_are_left_out(tmp_path: Path) -> None:
    for file in (cell_files.DATA / "kr10").iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    with (tmp_path / cell_files.CONFIG).open("a") as file:
        file.write("production: {variants: {mirror: task.yaml}}\n")
    plain = cell_station.daemon_file(cell_files.named(str(tmp_path)))
    assert not plain.keys() & set(cell_station.OWN_LINKS)
