"""Record files: a line of JSON and a row of CSV a part, one pair of files a day.

Invariants:
- Nothing is written in the cycle: a thread writes, one record after the other.
- At most ``MOST_WAITING`` records wait. A further one is dropped and counted.
- A day that has grown to ``MOST_BYTES`` takes no more. Days beyond the limit are removed.
"""

import asyncio
import csv
import io
import json
import logging
import os
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from linemate.daemon.production import record as records

MOST_WAITING: Final = 64
MOST_BYTES: Final = 256 * 1024 * 1024
PREFIX: Final = "parts-"

log = logging.getLogger(__name__)


class RecordFiles:
    """Writes records into a directory."""

    def __init__(self, directory: Path | None, days: int) -> None:
        """Begin without records.

        Args:
            directory: None keeps no records.
            days: days whose files are kept.
        """
        self.written = self.failed = self.dropped = 0
        self._directory, self._days = directory, days
        self._waiting: deque[Mapping[str, Any]] = deque()
        self._is_writing = False

    def add(self, record: Mapping[str, Any]) -> None:
        """Add a record; a thread writes it."""
        if self._directory is None:
            return
        if len(self._waiting) >= MOST_WAITING:
            self.dropped += 1
            return
        self._waiting.append(record)
        self._write_next()

    def _write_next(self) -> None:
        if self._is_writing or not self._waiting or self._directory is None:
            return
        self._is_writing = True
        record = self._waiting.popleft()
        loop = asyncio.get_running_loop()
        done = loop.run_in_executor(None, write, self._directory, record, self._days)
        done.add_done_callback(self._done)

    def _done(self, done: "asyncio.Future[None]") -> None:
        self._is_writing = False
        error = None if done.cancelled() else done.exception()
        self.written += error is None
        self.failed += error is not None
        if error is not None:
            log.error("a quality record is not written: %s", error)
        self._write_next()


def write(directory: Path, record: Mapping[str, Any], days: int) -> None:
    """Append a record to its day's files, and remove days beyond the limit.

    Raises:
        OSError: the files cannot be written, or the day is full.
    """
    day = str(record["at"])[:10]
    lines, table = directory / f"{PREFIX}{day}.jsonl", directory / f"{PREFIX}{day}.csv"
    is_new = not table.exists()
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    if is_new:
        writer.writerow(records.COLUMNS)
    writer.writerow(records.row(record))
    _append(lines, json.dumps(record, separators=(",", ":"), allow_nan=False) + "\n")
    _append(table, text.getvalue())
    if is_new:
        _remove_old(directory, days)


def _append(path: Path, text: str) -> None:
    """Append one whole line in one call, so that a sudden end leaves no half of it between two."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    try:
        if os.fstat(descriptor).st_size + len(text) > MOST_BYTES:
            raise OSError(f"{path} has grown to {MOST_BYTES} bytes")
        os.write(descriptor, text.encode())
    finally:
        os.close(descriptor)


def _remove_old(directory: Path, days: int) -> None:
    """Remove the files of the oldest days."""
    for suffix in (".jsonl", ".csv"):
        files = sorted(directory.glob(f"{PREFIX}*{suffix}"))
        for path in files[:-days]:
            path.unlink(missing_ok=True)
