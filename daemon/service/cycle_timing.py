"""Cycle timing: the times of a cycle's parts, collected and closed with the cycle.

Invariants:
- No clock is read; durations and stamps come in.
- The parts come in the order in which they happen. The end of the cycle clears them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from linemate.daemon.cycle.clock.phase_lock import PhaseLock
from linemate.daemon.cycle.clock.timing import CycleTimes, Incident, Timing
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.step_log import LogEntry


@dataclass(slots=True)
class CycleTiming:
    """Times of the present cycle, and the statistics of all cycles in ``timing``."""

    timing: Timing
    _expected_ns: int | None = None
    _lead_ns: int = 0
    _woken_late_ns: int | None = None
    _step_ns: int | None = None
    _prepared: bool = False
    _state: str = ""

    def note_prepared(self, woken_late_ns: int, step_ns: int) -> None:
        """Note a step that was computed before its telegram.

        Args:
            woken_late_ns: lateness of the clock [ns].
        """
        self._woken_late_ns, self._step_ns, self._prepared = woken_late_ns, step_ns, True

    def note_step(self, step_ns: int) -> None:
        """Note a step that was computed after its telegram.

        Args:
            step_ns: computing time with decoding and encoding [ns].
        """
        self._step_ns, self._prepared = step_ns, False

    def note_schedule(self, lock: PhaseLock) -> None:
        """Note the expected time of the telegram, before the lock follows it."""
        self._expected_ns = lock.next_ns if lock.is_locked else None
        self._lead_ns = lock.lead_ns

    def note_missing(self, at_ns: int) -> None:
        """Note an expected telegram that did not come."""
        self.timing.incident("a telegram was missing", at_ns)

    def close_cycle(
        self, entries: Sequence[LogEntry], turnaround_ns: int | None
    ) -> tuple[CycleTimes, ...]:
        """Return the times of a cycle's steps; more than one step only after a stall.

        Args:
            turnaround_ns: turn-around of the reply [ns], None without one.
        """
        closed = []
        for entry in entries:
            is_last = entry is entries[-1]
            self._note_ages(entry)
            times = self._times(entry, turnaround_ns, is_measured=is_last)
            self.timing.note(times)
            closed.append(times)
            if entry.state == State.FAULT and self._state not in {State.FAULT, ""}:
                self.timing.incident("a fault was entered", entry.inputs.stamp_ns)
            self._state = entry.state
        self._expected_ns = self._woken_late_ns = self._step_ns = None
        self._prepared = False
        return tuple(closed)

    def take_incident(self) -> Incident | None:
        """Return the incident that waits to be written, once."""
        return self.timing.take_incident()

    def _times(
        self, entry: LogEntry, turnaround_ns: int | None, *, is_measured: bool
    ) -> CycleTimes:
        has_telegram = entry.counter is not None
        return CycleTimes(
            counter=entry.counter,
            arrival_ns=entry.inputs.stamp_ns,
            expected_ns=self._expected_ns if is_measured else None,
            woken_late_ns=self._woken_late_ns if is_measured else None,
            lead_ns=self._lead_ns,
            step_ns=self._step_ns if is_measured else None,
            turnaround_ns=turnaround_ns if is_measured and has_telegram else None,
            prepared=self._prepared and is_measured,
            state=entry.state,
        )

    def _note_ages(self, entry: LogEntry) -> None:
        inputs, note_age = entry.inputs, self.timing.note_age
        if inputs.distance:
            note_age("distance", inputs.stamp_ns - inputs.distance[-1].stamp_ns)
        if inputs.camera:
            note_age("camera", inputs.stamp_ns - inputs.camera[-1].stamp_ns)
        if inputs.wrench:
            note_age("wrench", inputs.stamp_ns - inputs.wrench[-1].stamp_ns)
