"""Cycle timing: histograms of all cycles, and a ring of the last two seconds for incidents.

Invariants:
- Pure, of fixed size. A cycle costs a few microseconds, so it is always on.
- A missed deadline or a new fault copies the ring, at most once in ``PAUSE_S``.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

from msgspec import Struct

from linemate.daemon.cycle.clock.histogram import EDGES_NS, Histogram

KEPT_S: Final = 2.0  # length of the ring [s]
PAUSE_S: Final = 10.0  # between two rings that are written, so that no disk is filled [s]

SENSORS: Final = ("distance", "camera", "wrench")


class CycleTimes(Struct, frozen=True):
    """One cycle. Times are [ns], None where there was no such thing.

    Attributes:
        counter: of the telegram, None if it was missing.
        arrival_ns: of the telegram, or the deadline that stood in for it.
        woken_late_ns: the clock, for this cycle's step.
        turnaround_ns: from arrival to the reply sent.
        prepared: the reply was ready before its telegram.
        state: the operating state after it.
    """

    counter: int | None
    arrival_ns: int
    expected_ns: int | None
    woken_late_ns: int | None
    lead_ns: int
    step_ns: int | None
    turnaround_ns: int | None
    prepared: bool
    state: str


COLUMNS: Final = CycleTimes.__struct_fields__


@dataclass(frozen=True, slots=True)
class Incident:
    """A copy of the ring, with its reason and time."""

    why: str
    at_ns: int
    cycles: tuple[CycleTimes, ...]

    def lines(self) -> Iterable[str]:
        """Return the ring as comma separated values, oldest cycle first, after its reason."""
        yield f"# {self.why} at {self.at_ns} ns; times in ns\n"
        yield ",".join(COLUMNS) + "\n"
        for cycle in self.cycles:
            values = (getattr(cycle, name) for name in COLUMNS)
            yield ",".join("" if value is None else str(value) for value in values) + "\n"


@dataclass(slots=True)
class Timing:
    """Timing of the cycles.

    Attributes:
        lateness: of the clock's wakes.
        lead: in force, cycle by cycle.
        ages: of each sensor's newest sample when a step took it.
        late: replies that took longer than a cycle.
        missing: cycles without a telegram.
        incidents: rings that were copied.
    """

    period_ns: int
    turnaround: Histogram = field(default_factory=Histogram)
    lateness: Histogram = field(default_factory=Histogram)
    step: Histogram = field(default_factory=Histogram)
    lead: Histogram = field(default_factory=Histogram)
    ages: dict[str, Histogram] = field(
        default_factory=lambda: {name: Histogram() for name in SENSORS}
    )
    late: int = 0
    missing: int = 0
    incidents: int = 0
    _ring: deque[CycleTimes] = field(default_factory=deque)
    _taken_ns: int | None = None
    _waiting: Incident | None = None

    def __post_init__(self) -> None:
        """Make the ring as long as ``KEPT_S``."""
        self._ring = deque(maxlen=max(1, round(KEPT_S * 1e9 / self.period_ns)))

    def note(self, cycle: CycleTimes) -> None:
        """Take in one cycle."""
        self._ring.append(cycle)
        self.lead.add(cycle.lead_ns)
        if cycle.step_ns is not None:
            self.step.add(cycle.step_ns)
        if cycle.woken_late_ns is not None:
            self.lateness.add(cycle.woken_late_ns)
        if cycle.counter is None:
            self.missing += 1
        if cycle.turnaround_ns is not None:
            self.turnaround.add(cycle.turnaround_ns)
            if cycle.turnaround_ns > self.period_ns:
                self.late += 1
                self.incident("a reply was late", cycle.arrival_ns)

    def note_age(self, sensor: str, age_ns: int) -> None:
        """Take in how old a sensor's newest sample was when a step took it."""
        self.ages[sensor].add(age_ns)

    def incident(self, why: str, at_ns: int) -> None:
        """Copy the ring, unless one was copied a moment ago.

        Args:
            why: one line for the reader.
        """
        if self._taken_ns is not None and at_ns - self._taken_ns < PAUSE_S * 1e9:
            return
        self._taken_ns = at_ns
        self.incidents += 1
        self._waiting = Incident(why, at_ns, tuple(self._ring))

    def take_incident(self) -> Incident | None:
        """Return the ring that waits to be written, once."""
        waiting, self._waiting = self._waiting, None
        return waiting

    def last(self) -> tuple[CycleTimes, ...]:
        """The ring as it stands, oldest cycle first."""
        return tuple(self._ring)

    def summary(self) -> dict[str, Any]:
        """What a status shows; times in [us], plain values only."""
        return {
            "turnaround_us": self.turnaround.summary_us(),
            "wakeup_us": self.lateness.summary_us(),
            "step_us": self.step.summary_us(),
            "lead_us": self.lead.summary_us(),
            "histograms": {
                "edges_s": [edge / 1e9 for edge in EDGES_NS],
                "turnaround": self.turnaround.cumulative(),
                "wakeup": self.lateness.cumulative(),
                "step": self.step.cumulative(),
                "lead": self.lead.cumulative(),
            },
            "age_us": {name: ages.summary_us() for name, ages in self.ages.items()},
            "late": self.late,
            "missing": self.missing,
            "incidents": self.incidents,
        }
