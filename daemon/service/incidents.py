"""Incident files: the times of the cycles before a missed deadline or a fault.

Invariants:
    * A few lines a cycle are made into text; a thread writes the finished text.
    * The directory holds at most MOST_FILES incidents, of earlier runs as well: the newest.
    * What is removed, fails or is refused is logged and counted.
"""

import asyncio
import contextlib
import itertools
import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from linemate.daemon.cycle.clock.timing import Incident

LINES_A_CYCLE: Final = 8
MOST_FILES: Final = 32
PATTERN: Final = "incident-*.csv"

log = logging.getLogger(__name__)


@dataclass(slots=True)
class IncidentFiles:
    """Writes incidents into a directory.

    Attributes:
        directory: where; None keeps nothing.
        refused: incidents that found another one unfinished.
        removed: number of older files removed beyond MOST_FILES.
    """

    directory: Path | None
    written: int = 0
    failed: int = 0
    refused: int = 0
    removed: int = 0
    _name: str = ""
    _lines: Iterator[str] | None = None
    _text: list[str] = field(default_factory=list)

    def begin(self, incident: Incident) -> None:
        """Begin to write one.

        Args:
            incident: the ring and why it was taken.
        """
        if self.directory is None or self._lines is not None:
            self.refused += 1
            return
        self._name = f"incident-{incident.at_ns}.csv"
        self._lines = iter(incident.lines())
        log.warning(
            "%s: the last %d cycles go to %s", incident.why, len(incident.cycles), self._name
        )

    def write_some(self) -> None:
        """Format LINES_A_CYCLE more lines; a thread writes the complete text."""
        if self._lines is None or self.directory is None:
            return
        some = list(itertools.islice(self._lines, LINES_A_CYCLE))
        self._text += some
        if len(some) == LINES_A_CYCLE:
            return
        text, self._text, self._lines = "".join(self._text), [], None
        done = asyncio.get_running_loop().run_in_executor(
            None, _write, self.directory / self._name, text.encode()
        )
        done.add_done_callback(self._done)

    def _done(self, done: "asyncio.Future[list[str]]") -> None:
        error = None if done.cancelled() else done.exception()
        self.failed += error is not None
        self.written += error is None
        if error is not None:
            log.warning("%s was not written: %s", self._name, error)
            return
        removed = [] if done.cancelled() else done.result()
        self.removed += len(removed)
        if removed:
            log.warning(
                "incident files removed, the oldest of more than %d: %s",
                MOST_FILES,
                ", ".join(removed),
            )


def _write(path: Path, data: bytes) -> list[str]:
    """Write a file and remove the oldest others beyond MOST_FILES; return their names."""
    path.write_bytes(data)
    # Sorted by time of writing: the stamps in the names restart with the host.
    # The new file is no candidate: after a step of the clock its time may be the oldest.
    aged: list[tuple[int, str]] = []
    for file in {*path.parent.glob(PATTERN)} - {path}:
        with contextlib.suppress(FileNotFoundError):  # another program has removed it
            aged.append((file.stat().st_mtime_ns, file.name))
    aged.sort()
    removed = [name for _, name in aged[: 1 - MOST_FILES]]
    for name in removed:
        (path.parent / name).unlink(missing_ok=True)
    return removed
