"""The loop's account of its own time: what a cycle's parts took, put together when it is over.

Law of this file: durations in, nothing out but the account; it reads no clock and decides nothing.
The parts of a cycle come in the order in which they happen and are cleared with its end.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from linemate.daemon.cycle.clock.phase_lock import PhaseLock
from linemate.daemon.cycle.clock.timing import CycleTimes, Incident, Timing
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.step_log import LogEntry


@dataclass(slots=True)
class Account:
    """Takes the parts of a cycle as they happen."""

    timing: Timing
    _expected_ns: int | None = None
    _lead_ns: int = 0
    _woken_late_ns: int | None = None
    _step_ns: int | None = None
    _prepared: bool = False
    _state: str = ""

    def prepared(self, woken_late_ns: int, step_ns: int) -> None:
        """The step was made before its telegram.

        Args:
            woken_late_ns: the clock [ns].
            step_ns: computing it [ns].
        """
        self._woken_late_ns, self._step_ns, self._prepared = woken_late_ns, step_ns, True

    def stepped(self, step_ns: int) -> None:
        """The step was made in line.

        Args:
            step_ns: computing it, reading and writing telegrams included [ns].
        """
        self._step_ns, self._prepared = step_ns, False

    def expected(self, lock: PhaseLock) -> None:
        """What was expected of this cycle.

        Args:
            lock: before its telegram, or its deadline.
        """
        self._expected_ns = lock.next_ns if lock.is_locked else None
        self._lead_ns = lock.lead_ns

    def missing(self, at_ns: int) -> None:
        """A telegram that was expected did not come.

        Args:
            at_ns: its time [ns].
        """
        self.timing.incident("a telegram was missing", at_ns)

    def close(
        self, entries: Sequence[LogEntry], turnaround_ns: int | None
    ) -> tuple[CycleTimes, ...]:
        """The cycle is over.

        Args:
            entries: its steps, more than one only after a stall.
            turnaround_ns: of the reply, None if there was none [ns].

        Returns:
            What they took, one for each step.
        """
        closed = []
        for entry in entries:
            last = entry is entries[-1]
            self._ages(entry)
            times = self._times(entry, turnaround_ns, measured=last)
            self.timing.note(times)
            closed.append(times)
            if entry.state == State.FAULT and self._state not in {State.FAULT, ""}:
                self.timing.incident("a fault was entered", entry.inputs.stamp_ns)
            self._state = entry.state
        self._expected_ns = self._woken_late_ns = self._step_ns = None
        self._prepared = False
        return tuple(closed)

    def take_incident(self) -> Incident | None:
        """Return the ring that waits to be written, once."""
        return self.timing.take_incident()

    def _times(self, entry: LogEntry, turnaround_ns: int | None, *, measured: bool) -> CycleTimes:
        robot = entry.ipoc is not None
        return CycleTimes(
            ipoc=entry.ipoc,
            arrival_ns=entry.inputs.stamp_ns,
            expected_ns=self._expected_ns if measured else None,
            woken_late_ns=self._woken_late_ns if measured else None,
            lead_ns=self._lead_ns,
            step_ns=self._step_ns if measured else None,
            turnaround_ns=turnaround_ns if measured and robot else None,
            prepared=self._prepared and measured,
            state=entry.state,
        )

    def _ages(self, entry: LogEntry) -> None:
        inputs, note = entry.inputs, self.timing.note_age
        if inputs.distance:
            note("distance", inputs.stamp_ns - inputs.distance[-1].stamp_ns)
        if inputs.camera:
            note("camera", inputs.stamp_ns - inputs.camera[-1].stamp_ns)
        if inputs.wrench:
            note("wrench", inputs.stamp_ns - inputs.wrench[-1].stamp_ns)
