"""Where the times of a bad moment are kept: a few files, written in the slack.

Law of this file: some lines a cycle are made into text, so that no cycle pays for the whole; one
thread writes the finished text. The number of files is bounded, and what fails is counted.
"""

import asyncio
import itertools
import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from linemate.daemon.service.timing import Incident

LINES_A_CYCLE: Final = 8
MOST_FILES: Final = 32

log = logging.getLogger(__name__)


@dataclass(slots=True)
class IncidentFiles:
    """Writes incidents into a directory.

    Attributes:
        directory: where; None keeps nothing.
        written, failed, refused: files; ``refused`` found another one unfinished, or the most
            there may be.
    """

    directory: Path | None
    written: int = 0
    failed: int = 0
    refused: int = 0
    _name: str = ""
    _lines: Iterator[str] | None = None
    _text: list[str] = field(default_factory=list)

    def take(self, incident: Incident) -> None:
        """Begin to write one.

        Args:
            incident: the ring and why it was taken.
        """
        full = self.written + self.failed >= MOST_FILES
        if self.directory is None or self._lines is not None or full:
            self.refused += 1
            return
        self._name = f"incident-{incident.at_ns}.csv"
        self._lines = iter(incident.lines())
        log.warning(
            "%s: the last %d cycles go to %s", incident.why, len(incident.cycles), self._name
        )

    def slack(self) -> None:
        """Make a little more text; hand it to the thread when it is whole."""
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

    def _done(self, done: "asyncio.Future[None]") -> None:
        error = None if done.cancelled() else done.exception()
        self.failed += error is not None
        self.written += error is None
        if error is not None:
            log.warning("%s was not written: %s", self._name, error)


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)
