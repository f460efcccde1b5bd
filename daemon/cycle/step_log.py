"""The steps that were made, for the recorder and whoever else looks on.

Law of this file: values and a bounded queue; the oldest is dropped and counted. Nothing in the
cycle waits for anybody who reads it.
"""

from collections import deque

from msgspec import Struct

from linemate.daemon.core import step as stepping
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.parameters import Parameters

LONGEST_LOG = 256


class LogEntry(Struct, frozen=True):
    """One step as the recorder wants it.

    Attributes:
        ipoc: the one it answered, None if it answered none.
        inputs, outputs: in and out.
        before, after: the step's own state; where ``before`` is not the ``after`` of the entry
            before, a session began anew, or steps are missing.
        parameters: it was made with.
    """

    ipoc: int | None
    state: str
    inputs: Inputs
    outputs: stepping.Outputs
    before: stepping.StepState | None = None
    after: stepping.StepState | None = None
    parameters: Parameters | None = None

    def answering(self, ipoc: int) -> "LogEntry":
        """Return the same step, said to have answered a telegram."""
        return LogEntry(
            ipoc,
            self.state,
            self.inputs,
            self.outputs,
            self.before,
            self.after,
            self.parameters,
        )


class StepLog:
    """Entries that nobody has taken yet.

    Attributes:
        dropped: entries that were never taken.
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
