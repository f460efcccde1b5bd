"""What operators saved: an overlay in the daemon's own directory, laid over the user's file.

Law of this file: the user's file is never written. An overlay holds sections as the file has
them, only what differs; a list is replaced whole. There is never half of one on the disk.
"""

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import yaml

from linemate.daemon.config import documents, files, timeouts
from linemate.daemon.config import settings_tree as tree
from linemate.daemon.config.documents import Complaint, Document, FileError
from linemate.daemon.config.files import UnreadableError
from linemate.daemon.config.settings import Config
from linemate.daemon.config.settings_tree import Settings

NAME: Final = "parameters.yaml"
JOURNAL: Final = "parameters.log"
JOURNAL_BYTES: Final = 1_048_576
HEAD: Final = "# Saved by `linemate param save`; laid over the configuration. Delete to undo.\n"


def settings_of(config: Config) -> Settings:
    """Return a configuration's parameters."""
    return Settings(config.tracking, config.control, config.watch)


def directory(config: Config, base: Path) -> Path | None:
    """Return where operators' parameters are kept, None if nowhere.

    Args:
        base: directory of its file.
    """
    if config.state is not None:
        return base / config.state
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None


def laid(document: Document, config: Config, base: Path, *, saved: bool = True) -> Config:
    """Return a configuration with its overlays laid over it.

    Args:
        saved: what operators saved among them.

    Raises:
        FileError: everything that is wrong with the overlays.
    """
    paths = [base / name for name in config.overlays]
    folder = directory(config, base)
    if saved and folder is not None and (folder / NAME).exists():
        paths.append(folder / NAME)
    value = document.value
    wrong: list[str] = []
    for path in paths:
        try:
            over = _read(path)
            laid_over = tree.laid_over(value, over.value)
            merged = Document(over.name, laid_over, over.values, over.keys, over.complaints)
            config = documents.fill(merged, Config, partial(_foreign, over))
        except FileError as error:  # its neighbours are looked at without it
            wrong.extend(error.lines)
        else:
            value = laid_over
    if wrong:
        raise FileError(wrong)
    return config


def save(folder: Path, settings: Settings, written: Settings) -> Path:
    """Keep what differs from the user's file; without a difference there is no overlay.

    Args:
        written: by the user, with the overlays that he named.

    Returns:
        Path of the overlay.

    Raises:
        OSError: it cannot be written; the earlier one is as it was.
    """
    path = folder / NAME
    overlay = tree.difference(tree.plain(settings), tree.plain(written))
    if not overlay:
        path.unlink(missing_ok=True)
        return path
    body = yaml.safe_dump(overlay, sort_keys=False, default_flow_style=None, width=100)
    _replace(path, HEAD + body)
    return path


def journal(folder: Path, told: Mapping[str, Any]) -> None:
    """Add a line of JSON to the log of changes; an older half of it is kept.

    Raises:
        OSError: it cannot be written.
    """
    path = folder / JOURNAL
    if path.exists() and path.stat().st_size > JOURNAL_BYTES:
        path.replace(path.with_suffix(".log.1"))
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(told) + "\n")


def last_lines(folder: Path, count: int) -> Sequence[str]:
    """Return the last lines of the log of changes, oldest first; none if there is none."""
    try:
        return (folder / JOURNAL).read_text(encoding="utf-8").splitlines()[-count:]
    except OSError:
        return ()


def _read(path: Path) -> Document:
    try:
        data = files.read(path, documents.MAX_BYTES)
    except UnreadableError as error:
        raise FileError([f"{path}:1:1: (file): {error}"]) from error
    return documents.read(data, str(path))


def _foreign(over: Document, merged: Any) -> list[Complaint]:
    """Sections that are no parameters: an overlay opens no other port; and time-outs' order."""
    value = over.value if isinstance(over.value, dict) else {}
    return [
        Complaint((key,), f"an overlay may hold {', '.join(tree.SECTIONS)}", at_key=True)
        for key in value
        if key not in tree.SECTIONS
    ] + list(timeouts.complaints(merged))


def _replace(path: Path, text: str) -> None:
    """Write a file so that there is never half of it, also after a power cut."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
