"""Overlays: files of parameters over the configuration, among them what operators saved.

Invariants:
- The user's file is never written.
- The section ``task`` goes over the task file: frames of the tool, and the conveyor as measured.
- An overlay holds only what differs. A list is replaced whole.
- A power cut leaves the old overlay or the new one, never half of one.
"""

import json
import os
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import yaml

from linemate.daemon.config import documents, files, task_file, timeouts
from linemate.daemon.config import settings_tree as tree
from linemate.daemon.config.documents import FileError, YamlDocument
from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.config.section_checks import DRIFT_LEARNED, PlainValues, drifts
from linemate.daemon.config.settings import Config
from linemate.daemon.config.settings_tree import Settings
from linemate.daemon.config.task_file import Task

NAME: Final = "parameters.yaml"
JOURNAL: Final = "parameters.log"
JOURNAL_BYTES: Final = 1_048_576
_SECTIONS: Final = (*tree.SECTIONS, task_file.SECTION)
HEAD: Final = "# Saved by `linemate param save`; laid over the configuration. Delete to undo.\n"


def settings_of(config: Config) -> Settings:
    """Return a configuration's parameters."""
    return Settings(config.tracking, config.control, config.watch)


def directory(config: Config, base: Path) -> Path | None:
    """Return the directory of what operators save, None if there is none.

    Args:
        base: directory of the configuration file.
    """
    if config.state is not None:
        return base / config.state
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None


def apply(document: YamlDocument, config: Config, base: Path, *, saved: bool = True) -> Config:
    """Return a configuration with its overlays.

    Args:
        saved: include what operators saved.

    Raises:
        FileError: everything that is wrong with the overlays.
    """
    value = document.value
    wrong: list[str] = []
    for path in _paths(config, base, saved=saved):
        try:
            over = _read(path)
            merged_value = tree.merge(value, _without_task(over.value))
            merged = YamlDocument(over.name, merged_value, over.values, over.keys, over.complaints)
            config = documents.fill(merged, Config, partial(_complaints, over))
        except FileError as error:  # the next overlays are read without it
            wrong.extend(error.lines)
        else:
            value = merged_value
    if wrong:
        raise FileError(wrong)
    return config


def apply_to_task(task: Task, config: Config, base: Path, *, is_variant: bool = False) -> Task:
    """Return a task with what the overlays say of the cell.

    Args:
        is_variant: its own object stays.

    Raises:
        FileError: everything that does not fit.
    """
    wrong: list[str] = []
    for path in _paths(config, base, saved=True):
        over = _read(path)
        value = over.value if isinstance(over.value, dict) else {}
        if task_file.SECTION not in value:
            continue
        try:
            task = task_file.laid_over(task, over, is_variant=is_variant)
        except FileError as error:
            wrong.extend(error.lines)
    if wrong:
        raise FileError(wrong)
    return task


def saved_by_operators(folder: Path | None) -> YamlDocument | None:
    """Return what operators saved, None if there is nothing.

    Args:
        folder: the directory for it, None without one.

    Raises:
        FileError: it cannot be read.
    """
    return None if folder is None or not (folder / NAME).exists() else _read(folder / NAME)


def save(folder: Path, settings: Settings, written: Settings) -> Path:
    """Write what differs from the user's file; without a difference remove the overlay.

    Args:
        written: the user's parameters, with the overlays that the file names.

    Returns:
        Path of the overlay.

    Raises:
        OSError: it cannot be written; the earlier one is unchanged.
    """
    path = folder / NAME
    overlay = tree.difference(tree.plain(settings), tree.plain(written))
    if not overlay:
        path.unlink(missing_ok=True)
        return path
    body = yaml.safe_dump(overlay, sort_keys=False, default_flow_style=None, width=100)
    files.write(path, HEAD + body)
    return path


def append_change(folder: Path, change: Mapping[str, Any]) -> None:
    """Append a line of JSON to the log of changes; one older file is kept.

    Raises:
        OSError: it cannot be written.
    """
    path = folder / JOURNAL
    if path.exists() and path.stat().st_size > JOURNAL_BYTES:
        path.replace(path.with_suffix(".log.1"))
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(change) + "\n")


def _paths(config: Config, base: Path, *, saved: bool) -> list[Path]:
    """Return the overlays in their order, what operators saved last."""
    paths = [base / name for name in config.overlays]
    folder = directory(config, base)
    if saved and folder is not None and (folder / NAME).exists():
        paths.append(folder / NAME)
    return paths


def _without_task(value: Any) -> Any:
    """Return an overlay's values for the configuration, whose key ``task`` names a file."""
    if not isinstance(value, dict):
        return value
    return {key: part for key, part in value.items() if key != task_file.SECTION}


def _read(path: Path) -> YamlDocument:
    return documents.read(documents.content(path), str(path))


def _complaints(over: YamlDocument, merged: Any) -> list[Complaint]:
    """Return sections that are not parameters, and time-outs out of order."""
    value = over.value if isinstance(over.value, dict) else {}
    return [
        Complaint((key,), f"an overlay may hold {', '.join(_SECTIONS)}", at_key=True)
        for key in value
        if key not in _SECTIONS
    ] + [*timeouts.complaints(merged), *_learned_drift(over, merged)]


def _learned_drift(over: YamlDocument, merged: Any) -> Iterator[Complaint]:
    """Yield a drift of the dead times over a configuration that learns the servos."""
    values = PlainValues(merged)
    if (
        PlainValues(over.value).has("control", "drift")
        and values.has("learning")
        and drifts(values)
    ):
        yield Complaint(("control", "drift"), f"learning is set: {DRIFT_LEARNED} Remove this.")
