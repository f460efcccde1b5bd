"""Cell of a run by files: the daemon's configuration, the task, and the scenario in its folder.

Invariants:
    A cell's folder has ``linemated.yaml`` and ``scenario.yaml``; a shipped one goes by its name.
    The configuration is read as ``linemated`` reads it, with its overlays.
"""

from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path

from linemate.daemon.config import config, files, task_file
from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.settings import ControllerKind
from linemate.daemon.config.task_file import Task
from linemate.daemon.near_names import near_names
from linemate.simulators.harness.cell.variants import SetupError

DATA = Path(__file__).parents[1] / "data" / "cells"
CONFIG, SCENARIO = "linemated.yaml", "scenario.yaml"
SHIPPED = DEFAULT_SCENARIO = "wheel"


@dataclass(frozen=True, slots=True)
class CellFiles:
    """A cell as files describe it.

    Attributes:
        task: what is assembled, by which arm.
        station: the daemon's configuration; None: that of the shipped cell.
        scenario: path of the scenario in its folder, None if there is none.
        task_path: the task file, if it is not the configuration's.
    """

    task: Task
    station: LoadedConfig | None = None
    scenario: str | None = None
    task_path: Path | None = None

    @property
    def nominal(self) -> Task:
        """The task file without overlays: where a scenario is silent, the truth is as this says."""
        if self.station is None or self.task_path is not None:
            return self.task
        return written_task(self.station, self.station.config.task)

    @property
    def family(self) -> str | None:
        """Family of the configured controller, None without a configuration."""
        return None if self.station is None else self.station.config.controller.kind.value

    @property
    def cycle_ms(self) -> float | None:
        """Period of the configured controller [ms], None without a configuration."""
        return None if self.station is None else round(1e3 * self.station.cycle_s, 6)


def shipped() -> tuple[str, ...]:
    """Names of the cells that come with the package."""
    return tuple(sorted(file.parent.name for file in DATA.glob(f"*/{CONFIG}")))


def named(cell: str) -> CellFiles:
    """Return a shipped cell, or that of a folder.

    Raises:
        FileError, SetupError: as ``chosen``.
    """
    cell_files = chosen(Namespace(cell=cell, config=None, task=None))
    assert cell_files is not None  # noqa: S101 - it has a configuration
    return cell_files


def chosen(args: Namespace) -> CellFiles | None:
    """Return the cell that ``--cell``, ``--config`` and ``--task`` name, None for the default.

    Raises:
        FileError: every error of the files at once.
        SetupError: no such cell.
    """
    scenario, file, task = None, args.config, args.task
    if args.cell is not None:
        place = folder(args.cell)
        file = place / CONFIG if file is None else file
        truth = place / SCENARIO
        scenario = str(truth) if truth.is_file() else None
    station = None if file is None else config.load(file)
    if task is None:
        return None if station is None else CellFiles(station.task, station, scenario)
    own = task_file.load(task)
    if station is not None:
        texts = {**station.texts, "task": own.text, "urdf": own.urdf}
        station = replace(station, task=own, texts=texts)
        _refuse_missing_axis(station)
    return CellFiles(own, station, scenario, task)


def scenario(named: str | None, cell: CellFiles | None) -> str:
    """Return the scenario of a run: the one named, else the cell's, else the default."""
    return named or (None if cell is None else cell.scenario) or DEFAULT_SCENARIO


def written_task(station: LoadedConfig, name: str) -> Task:
    """Return a task file that a configuration names, without the overlays.

    Raises:
        FileError: what is wrong in it.
    """
    return task_file.load(files.find(name, station.path.parent, DAEMON_DATA))


def folder(name: str) -> Path:
    """Return the folder of a shipped cell, or the one of that path.

    Raises:
        SetupError: no such cell.
    """
    place = DATA / name if name in shipped() else Path(name)
    if not (place / CONFIG).is_file():
        near = near_names(name, shipped()) or f"; there are {', '.join(shipped())}"
        raise SetupError(f"--cell {name}: neither a shipped cell nor a folder with {CONFIG}{near}")
    return place


def _refuse_missing_axis(station: LoadedConfig) -> None:
    """Refuse a task with a linear axis for a controller's file without one.

    Raises:
        SetupError: the axis is missing.
    """
    if station.controller_file is None or station.config.controller.kind is not ControllerKind.RSI:
        return
    tags = {element.tag for element in station.controller_file.receive}
    if station.task.file.arm.linear_axis and not tags & {"EK.E1", "EKorr.E1"}:
        raise SetupError("--task: its arm has a linear axis, and rsi.config has no EK.E1")
