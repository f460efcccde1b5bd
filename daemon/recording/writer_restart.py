"""Restart of the writer process after it has ended by itself.

Invariants:
- A thread starts the process. The loop waits neither for a process nor for a disk.
- The time between two starts grows. After MOST_IN_A_ROW starts in a row there are no more.
"""

import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Final, Generic, TypeVar

MOST_IN_A_ROW: Final = 8
FIRST_NS: Final = 500_000_000  # from the end of a process to its next start [ns]
LONGEST_NS: Final = 30_000_000_000
STEADY_NS: Final = 60_000_000_000  # a process that runs this long ends a row [ns]

log = logging.getLogger(__name__)

T = TypeVar("T")


@dataclass(slots=True)
class WriterRestart(Generic[T]):
    """Back-off between starts.

    Attributes:
        restarts: number of starts since the daemon began.
    """

    restarts: int = 0
    _in_a_row: int = 0
    _due_ns: int | None = None
    _began_ns: int = 0
    _thread: ThreadPoolExecutor | None = field(default=None)
    _work: "Future[T] | None" = field(default=None)

    @property
    def is_running(self) -> bool:
        """A start has begun and its result has not been taken."""
        return self._work is not None

    @property
    def is_over(self) -> bool:
        """It has been started too often in a row."""
        return self._in_a_row >= MOST_IN_A_ROW

    def reset(self) -> None:
        """Begin a new row of starts."""
        self._in_a_row, self._due_ns = 0, None

    def start_if_due(self, now_ns: int, start: Callable[[], T]) -> None:
        """Start the process when its back-off is over; it is known to have ended.

        Args:
            start: starts the process; called in a thread.
        """
        if self._work is not None or self.is_over:
            return
        if self._due_ns is None:
            if self._in_a_row and now_ns - self._began_ns >= STEADY_NS:
                self._in_a_row = 0
            self._due_ns = now_ns + min(FIRST_NS << self._in_a_row, LONGEST_NS)
        if now_ns < self._due_ns:
            return
        self._due_ns, self._began_ns = None, now_ns
        self._in_a_row += 1
        self.restarts += 1
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "recorder")
        self._work = self._thread.submit(start)
        if self.is_over:
            log.error(
                "the process that writes recordings is started again for the last time: "
                "%d starts in a row, limit %d. `linemate record start` tries again.",
                self._in_a_row,
                MOST_IN_A_ROW,
            )

    def pop_result(self) -> "Future[T] | None":
        """Return the result of a start, once; None if there is none yet."""
        work = self._work
        if work is None or not work.done():
            return None
        self._work = None
        return work

    def close(self) -> "Future[T] | None":
        """Wait for a start that runs, and return its result."""
        if self._thread is not None:
            self._thread.shutdown(wait=True)
            self._thread = None
        return self.pop_result()
