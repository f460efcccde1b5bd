"""The check of a configuration with everything that it names: what ``linemated --check`` does.

Invariants:
- No port is opened and no file is written. The daemon starts from the same functions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from linemate.daemon.commissioning.kept_rehearsals import KeptRehearsals
from linemate.daemon.commissioning.rehearsal import Peak, rehearse
from linemate.daemon.config import config
from linemate.daemon.config import overlays as overlay_files
from linemate.daemon.config import settings_tree as tree
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
        FileError: what is wrong, and which saved parameter lets it be.
    """
    try:
        return _check(path, overlays, keeps=keeps)
    except FileError as error:
        raise FileError([*error.lines, *_faults_of_saved(path, overlays, error)]) from error


def _check(path: Path, overlays: Sequence[Path], *, keeps: bool) -> CheckedConfig:
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


def _faults_of_saved(path: Path, overlays: Sequence[Path], error: FileError) -> list[str]:
    """Return a line for each saved parameter without which the configuration is good.

    Args:
        error: which may name the file of what was saved already.
    """
    try:
        station = config.load(path, overlays, saved=False)
        saved = overlay_files.saved_by_operators(station.state)
    except FileError:
        return []
    if saved is None or any(line.startswith(saved.name) for line in error.lines):
        return []
    if not _is_good(station, station.written):
        return []
    whole = saved.value if isinstance(saved.value, dict) else {}
    values = [*_values({key: whole[key] for key in tree.SECTIONS if key in whole})]
    alone = [
        key
        for key, value in values
        if not _is_good(station, tree.laid_over(station.written, key, value))
    ]
    what = (
        "saved by an operator; without it the configuration is good. Delete it here, or the file "
        "to drop everything that was saved."
    )
    return saved.lines(Complaint(key, what) for key in alone or [key for key, _ in values])


def _values(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield path and value of what an overlay holds; a list is one value."""
    if not isinstance(value, dict):
        yield path, value
        return
    for key, inner in value.items():
        yield from _values(inner, (*path, key))


def _is_good(station: LoadedConfig, settings: tree.Settings) -> bool:
    """Return whether every task of a station fits other settings."""
    whole = replace(
        station.config, tracking=settings.tracking, control=settings.control, watch=settings.watch
    )
    station = replace(station, config=whole)
    try:
        for task in (station.task, *station.variants.values()):
            rehearsed(task, compile_task(station, task))
    except FileError:
        return False
    return not [*config.device_complaints(whole, settings.tracking, station.count_m)]
