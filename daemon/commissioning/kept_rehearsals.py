"""Rehearsals that were good, kept for the next start of the same task in the same program.

Invariants:
- A digest covers all that a rehearsal depends on: task, arm, settings, cycle, sources, packages.
- A file that others may read or write, or that is damaged, counts as empty.
"""

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

import linemate.daemon
import linemate.protocol
from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.task_file import Task
from linemate.protocol.command.preshared_keys import unsafe_file

NAME = "rehearsed"  # in the state directory, a digest a line, the newest last
MOST = 16
MAX_BYTES = 4096

_DIGESTS = re.compile(r"([0-9a-f]{64}\n)*", re.ASCII)
_SOURCES = (
    *(Path(linemate.daemon.__path__[0]) / name for name in ("core", "config", "commissioning")),
    Path(linemate.protocol.__path__[0]),
)
_PACKAGES = ("numpy", "scipy", "pinocchio", "coal", "eigenpy")


class KeptRehearsals:
    """Digests of good rehearsals in a state directory.

    Attributes:
        left_out: tasks that were not rehearsed, because they are known to be good.
        unusable: files that did not count.
        trouble: why, empty if all is well.
    """

    def __init__(self, folder: Path | None) -> None:
        """Read them.

        Args:
            folder: the state directory; without one nothing is known, and nothing is kept.
        """
        self._folder = folder
        self._known: tuple[str, ...] = ()
        self._good: list[str] = []
        self.left_out: list[str] = []
        self.unusable, self.trouble = 0, ""
        if folder is not None and (folder / NAME).exists():
            self._read(folder / NAME)

    def is_known(self, station: LoadedConfig, task: Task) -> bool:
        """Return whether a task's rehearsal was good; if not, it is to be good before ``keep``."""
        if self._folder is None:
            return False
        self._good.append(_digest(station, task))
        if self._good[-1] not in self._known:
            return False
        self.left_out.append(task.file.name)
        return True

    def keep(self) -> None:
        """Write the digests of the tasks that were asked for, all of which are good.

        Raises:
            OSError: they cannot be written.
        """
        if self._folder is None or {*self._good} <= {*self._known}:
            return
        lines = [*dict.fromkeys((*self._known, *self._good))][-MOST:]
        # Only its owner may read the new file.
        handle, name = tempfile.mkstemp(prefix=f".{NAME}.", dir=self._folder)
        try:
            with os.fdopen(handle, "w", encoding="ascii") as file:
                file.writelines(f"{line}\n" for line in lines)
            Path(name).replace(self._folder / NAME)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise

    def _read(self, path: Path) -> None:
        try:
            with path.open(encoding="ascii") as file:
                status = os.fstat(file.fileno())
                unsafe = unsafe_file(status.st_mode, status.st_uid, os.geteuid())
                text = file.read(MAX_BYTES)
        except (OSError, UnicodeDecodeError) as error:
            unsafe, text = str(error), ""
        if unsafe is None and not _DIGESTS.fullmatch(text):
            unsafe = "damaged"
        if unsafe is None:
            self._known = tuple(text.split())
        else:
            self.unusable, self.trouble = 1, f"{path}: {unsafe}"


def _digest(station: LoadedConfig, task: Task) -> str:
    """Return the digest of all that the rehearsal of a task depends on."""
    settings = station.config
    values = (task.file, task.urdf, settings.tracking, settings.control, station.cycle_s)
    return sha256(repr((values, sys.version, [*_program()])).encode()).hexdigest()


def _program() -> Iterator[tuple[str, int, int]]:
    """Yield name, size and time of each source, and of the beginning of each package."""
    for root in _SOURCES:
        for folder, folders, names in os.walk(root):
            folders.sort()
            yield from (_state(f"{folder}/{name}") for name in sorted(names) if name[-3:] == ".py")
    for package in _PACKAGES:
        spec = find_spec(package)
        for name in ("__init__.py", "version.py"):
            place = "" if spec is None or spec.origin is None else spec.origin
            with suppress(OSError):
                yield _state(str(Path(place).with_name(name)))


def _state(path: str) -> tuple[str, int, int]:
    status = os.stat(path)  # noqa: PTH116 - 200 files at each start
    return path, status.st_size, status.st_mtime_ns
