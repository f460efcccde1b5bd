"""Log lines on standard error that never delay the cycle.

Invariants:
    A line is written if it does not have to wait, else it is dropped and counted.
    A pipe that is ready takes ``LONGEST`` bytes.
"""

import logging
import select
from typing import Final, TextIO

STDERR: Final = 2
LONGEST: Final = 4096  # PIPE_BUF of Linux [bytes]; a longer line may wait for the reader
NOTE_BYTES: Final = 128  # of it, for the note about dropped lines and the line's end


class LogStream(logging.StreamHandler[TextIO]):
    """Writes to standard error; a reader that stands still costs lines, not cycles.

    Attributes:
        dropped: lines that were dropped since the last one that was written.
    """

    def __init__(self) -> None:
        super().__init__()
        self.dropped = 0
        self._ready = select.poll()
        self._ready.register(STDERR, select.POLLOUT)

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, or drop it."""
        if not self._ready.poll(0):
            self.dropped += 1
            return
        super().emit(record)
        self.dropped = 0

    def format(self, record: logging.LogRecord) -> str:
        """Return the end of the line that fits, after a note about dropped lines."""
        text = super().format(record).encode(errors="replace")[NOTE_BYTES - LONGEST :]
        note = f"{self.dropped} lines dropped: the log's reader was too slow\n"
        return (note if self.dropped else "") + text.decode(errors="ignore")
