"""Quality record of one part: times, classes, errors that the daemon can know, force, outcome.

Invariants:
- A step adds a bounded amount; a record has at most ``MOST_EVENTS`` events and ``COURSE`` forces.
- Only what the daemon knows is recorded. The error to the true object is not among it.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import FIX_SCREWS, RELEASE_WHEEL
from linemate.daemon.core.tracking.estimation.tool_weight import carried_weights
from linemate.daemon.core.tracking.tracker_state import TrackerState
from linemate.daemon.core.wrench_frame import each_at_tcp
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.production.object_queue import AnnouncedPart

VERSION: Final = 1
MOST_EVENTS: Final = 64
COURSE: Final = 120  # forces of the course in contact
COURSE_S: Final = 0.1  # time between two of them [s]
IMPACT_S: Final = 0.3  # time from the first contact in which the largest force is the impact [s]
SCREWS_FIXED: Final = 1  # bit of the controller's signals
CLAMP_OPEN: Final = 2

COLUMNS: Final = (
    "at", "station", "part", "variant", "ok", "reason", "duration_s", "impact_n", "force_n",
    "prediction_mm", "prediction_mrad", "sigma_mm", "reach_mm", "replies_lost", "missing",
    "waited_s", "recording",
)  # fmt: skip
"""Columns of the CSV file."""


class PartRecord:
    """Collects the record of the present part."""

    def __init__(self, part: AnnouncedPart, stamp_ns: int, at: str, station: str) -> None:
        """Begin.

        Args:
            at: the same as UTC in ISO 8601.
        """
        self.part = part
        self.seen = False
        self._began_ns = stamp_ns
        self._at, self._station = at, station
        self._times: dict[str, float] = {}
        self._events: list[tuple[float, str, str]] = []
        self._course: list[float] = []
        self._course_ns = 0
        self._contact_ns: int | None = None
        self._impact = self._force = 0.0
        self._estimates: dict[str, float] = {}
        self._reach = 0.0
        self._missing = 0
        self._waited_s = 0.0

    def add(self, entry: LogEntry) -> None:
        """Add one step."""
        outputs, inputs = entry.outputs, entry.inputs
        since_s = (inputs.stamp_ns - self._began_ns) * 1e-9
        self._times.setdefault(entry.state, round(since_s, 3))
        self._missing += entry.counter is None
        self._waited_s = outputs.waited_s or self._waited_s
        if outputs.part is not None and not self.seen:
            self.seen = True
            self._times["seen"] = round(since_s, 3)
        for kind, what in outputs.events[: MOST_EVENTS - len(self._events)]:
            self._events.append((round(since_s, 3), kind, what))
        self._note_tool(entry, since_s)
        self._note_force(entry)
        if entry.after is not None and entry.parameters is not None and not outputs.contact:
            self._note_estimates(entry.after.tracker, entry.parameters)

    def finish(
        self, stamp_ns: int, *, is_good: bool, reason: str, replies_lost: int, recording: str | None
    ) -> dict[str, Any]:
        """Return the record as plain values.

        Args:
            replies_lost: replies to the robot that were lost or late since the beginning.
            recording: file that has the part's steps, None without one.
        """
        touched = self._contact_ns is not None
        return {
            "version": VERSION,
            "at": self._at,
            "station": self._station,
            "part": self.part.part,
            "variant": self.part.variant,
            "ok": is_good,
            "reason": reason,
            "duration_s": round((stamp_ns - self._began_ns) * 1e-9, 3),
            "times_s": dict(self._times),
            "classes": [
                {"at_s": at, "event": kind, "what": what} for at, kind, what in self._events
            ],
            "latencies_s": _latencies(self._events),
            "estimates": dict(self._estimates),
            "reach_mm": round(1e3 * self._reach, 3),
            "force": {
                "impact_n": round(self._impact, 2) if touched else None,
                "largest_n": round(self._force, 2) if touched else None,
                "course_s": COURSE_S,
                "course_n": list(self._course),
            },
            "replies_lost": replies_lost,
            "missing": self._missing,
            "waited_s": round(self._waited_s, 3),
            "recording": recording,
        }

    def _note_tool(self, entry: LogEntry, since_s: float) -> None:
        """Note when the tool's orders went out and its signals came."""
        out, robot = entry.outputs.digital_out, entry.inputs.robot
        given = 0 if robot is None else robot.digital_in
        for name, bits, mask in (
            ("fix_screws", out, FIX_SCREWS),
            ("screws_fixed", given, SCREWS_FIXED),
            ("release", out, RELEASE_WHEEL),
        ):
            if bits & mask:
                self._times.setdefault(name, round(since_s, 3))
        if given & CLAMP_OPEN and "release" in self._times:
            self._times.setdefault("released", round(since_s, 3))

    def _note_force(self, entry: LogEntry) -> None:
        """Note the force from the first contact on."""
        if not entry.inputs.wrench:
            return
        if entry.outputs.contact and self._contact_ns is None:
            self._contact_ns = entry.inputs.stamp_ns
        if self._contact_ns is None or not entry.outputs.contact:
            return
        forces = _contact_forces(entry)
        for sample, force in zip(entry.inputs.wrench, forces, strict=True):
            self._force = max(self._force, force)
            if (sample.stamp_ns - self._contact_ns) * 1e-9 <= IMPACT_S:
                self._impact = max(self._impact, force)
        if len(self._course) < COURSE and entry.inputs.stamp_ns >= self._course_ns:
            self._course.append(round(forces[-1], 1))
            self._course_ns = entry.inputs.stamp_ns + round(COURSE_S * 1e9)

    def _note_estimates(self, state: TrackerState, parameters: Parameters) -> None:
        """Note what is known of the errors; the last values before contact stay."""
        self._reach = state.search.reach or self._reach
        if state.transverse is None or not state.started or state.releasing is not None:
            return
        short, long = state.monitor.leads
        transverse = parameters.tracker.transverse
        rows = transverse.observation_rows(state.transverse, 0.0)
        variance = float(rows[0] @ state.transverse.P @ rows[0])
        self._estimates = {
            "prediction_mm": round(1e3 * max(short.lateral, long.lateral), 3),
            "prediction_mrad": round(1e3 * max(short.angle, long.angle), 3),
            "sigma_mm": round(1e3 * math.sqrt(max(variance, 0.0)), 3),
            "nis": round(float(state.transverse.nis), 3),
        }


def _contact_forces(entry: LogEntry) -> list[float]:
    """Return the force of each sample without the weight that its sensor states [N]."""
    after, parameters, stated = entry.after, entry.parameters, entry.inputs.wrench
    if after is None or parameters is None:
        return [math.hypot(*sample.force) for sample in stated]
    weights = carried_weights(parameters.tracker, after.tracker)
    samples = each_at_tcp(parameters.wrench_frame, stated)
    return [min(math.dist(sample.force, weight) for weight in weights) for sample in samples]


def _latencies(events: list[tuple[float, str, str]]) -> list[dict[str, Any]]:
    """Return for each confirmed change how long it was tentative before [s]."""
    confirmed, tentative = [], {}
    for at_s, kind, what in events:
        if what == "tentative":
            tentative[kind] = at_s
        elif what == "confirmed":
            confirmed.append(
                {"event": kind, "tentative_s": round(at_s - tentative.pop(kind, at_s), 3)}
            )
        elif what == "cancelled":
            tentative.pop(kind, None)
    return confirmed


def missed(part: AnnouncedPart, at: str, station: str, reason: str) -> dict[str, Any]:
    """Return the record of a part that was never begun, as plain values."""
    empty = PartRecord(part, 0, at, station)
    return empty.finish(0, is_good=False, reason=reason, replies_lost=0, recording=None)


def row(record: Mapping[str, Any]) -> list[Any]:
    """Return a record's row of the CSV file, in the order of ``COLUMNS``."""
    flat = {**record, **record["estimates"]}
    flat["impact_n"], flat["force_n"] = (record["force"]["impact_n"], record["force"]["largest_n"])
    return [flat.get(name) for name in COLUMNS]
