"""Count the lines of the daemon's log by second of virtual time."""

import contextlib
import logging
from collections import Counter
from typing import Any

from linemate.simulators.harness.virtual.virtual_time import VirtualTime

MOST_LINES = 10  # in any second after the first one of a start
STARTING_NS = 1_000_000_000  # after a start the log has 12 lines: links, sensors and states


class LogCounter(logging.Handler):
    """Counts the daemon's lines, second by second of virtual time."""

    def __init__(self, time: VirtualTime) -> None:
        super().__init__(logging.INFO)
        self.example = ""
        self._time = time
        self._started_ns = 0
        self._lines: Counter[int] = Counter()

    def note_start(self) -> None:
        """Note that the daemon starts now."""
        self._started_ns = self._time.now_ns

    @property
    def worst(self) -> int:
        """Most lines in a second."""
        return max(self._lines.values(), default=0)

    def emit(self, record: logging.LogRecord) -> None:
        """Count a line."""
        if self._time.now_ns - self._started_ns >= STARTING_NS:
            self._lines[self._time.now_ns // 10**9] += 1
        error = record.exc_info[1] if record.exc_info else None
        self.example = f"{record.getMessage()} {error!r}"[:300] if error else record.getMessage()

    @contextlib.contextmanager
    def listening(self) -> Any:
        """Listen to the daemon and to its drivers."""
        logger = logging.getLogger("linemate")
        level, propagate = logger.level, logger.propagate
        logger.addHandler(self)
        logger.setLevel(logging.INFO)
        logger.propagate = False
        try:
            yield
        finally:
            logger.removeHandler(self)
            logger.setLevel(level)
            logger.propagate = propagate
