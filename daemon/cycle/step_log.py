"""Log of the steps for the recorder and others that look at them later.

Invariants:
- Bounded. The oldest entry is dropped and counted.
- The cycle waits for no reader.
"""

from collections import deque

from msgspec import Struct

from linemate.daemon.core import step as stepping
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.parameters import Parameters

LONGEST_LOG = 256


class LogEntry(Struct, frozen=True):
    """One step, with what it was made from.

    Attributes:
        counter: the one it answered, None if it answered none.
        inputs, outputs: in and out.
        before, after: the step's own state; where ``before`` is not the ``after`` of the entry
            before, a session began, or steps are missing.
        parameters: it was made with.
    """

    counter: int | None
    state: str
    inputs: Inputs
    outputs: stepping.Outputs
    before: stepping.StepState | None = None
    after: stepping.StepState | None = None
    parameters: Parameters | None = None


class StepLog:
    """Entries that were not read yet.

    Attributes:
        dropped: entries that were not read in time.
    """

    __slots__ = ("_entries", "dropped")

    def __init__(self) -> None:
        self._entries: deque[LogEntry] = deque(maxlen=LONGEST_LOG)
        self.dropped = 0

    def push(self, entry: LogEntry) -> None:
        """Add the newest step."""
        if len(self._entries) == LONGEST_LOG:
            self.dropped += 1
        self._entries.append(entry)

    def drain(self) -> list[LogEntry]:
        """Return the steps since the last call, oldest first."""
        entries = list(self._entries)
        self._entries.clear()
        return entries
