"""The check of a configuration with everything that it names: what ``linemated --check`` does.

Invariants:
- No port is opened and no file is written. The daemon starts from the same functions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from linemate.daemon.commissioning.kept_rehearsals import KeptRehearsals
from linemate.daemon.commissioning.rehearsal import Peak, rehearse
from linemate.daemon.config import config
from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.config.task_file import Task
from linemate.daemon.core import parameters
from linemate.daemon.core.control.kinematics import KinematicsError
from linemate.daemon.core.parameters import Parameters


@dataclass(frozen=True, slots=True)
class CheckedConfig:
    """A configuration without an error.

    Attributes:
        parameters: of the configured task.
        peaks: of that task: largest speeds, and margins to the limits; empty if not rehearsed.
        variants: parameters of the production's variants, by name.
        kept: rehearsals that need not be repeated.
    """

    station: LoadedConfig
    parameters: Parameters
    peaks: tuple[Peak, ...]
    variants: dict[str, Parameters]
    kept: KeptRehearsals


def check(path: Path, overlays: Sequence[Path] = (), *, keeps: bool = False) -> CheckedConfig:
    """Check a configuration file and everything that it names.

    Args:
        overlays: laid over those that it names, as if it named them last.
        keeps: leave out rehearsals that the state directory knows as good.

    Raises:
        FileError: what is wrong.
    """
    station = config.load(path, overlays)
    kept = KeptRehearsals(station.state if keeps else None)
    compiled = compile_task(station, station.task)
    is_known = kept.is_known(station, station.task)
    peaks = () if is_known else rehearsed(station.task, compiled)
    variants = {name: compile_task(station, task) for name, task in station.variants.items()}
    for name, task in station.variants.items():
        if not kept.is_known(station, task):
            rehearsed(task, variants[name])
    return CheckedConfig(station, compiled, peaks, variants, kept)


def compile_task(station: LoadedConfig, task: Task) -> Parameters:
    """Compile the step's parameters of a task.

    Raises:
        FileError: settings, task and arm do not fit together.
    """
    settings = station.config
    try:
        return parameters.build(
            task.file, task.urdf, settings.tracking, settings.control, station.cycle_s
        )
    except KinematicsError as error:
        raise FileError(task.lines([Complaint(("arm",), str(error))])) from error
    except ValueError as error:
        raise FileError([f"{station.path}:1:1: (file): {error}"]) from error


def rehearsed(task: Task, compiled: Parameters) -> tuple[Peak, ...]:
    """Run a task once through the kinematics.

    Raises:
        FileError: it asks for what the robot cannot or must not do.
    """
    rehearsal = rehearse(compiled)
    if rehearsal.complaints:
        raise FileError(task.lines(rehearsal.complaints))
    return rehearsal.peaks
