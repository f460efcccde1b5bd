"""The sampling clock without its timer: schedule, phase lock and lead in one hand.

Law of this file: pure; the real clock and virtual time drive the same object. A telegram sets
when the next step is due, a wake says what to do, and what a step cost sets how early the next
one begins.
"""

from dataclasses import dataclass, field

from linemate.daemon.cycle.clock import schedule as scheduling
from linemate.daemon.cycle.clock.phase import Lead, PhaseLock
from linemate.daemon.cycle.clock.schedule import Due, Schedule

LATEST_NS = 100_000_000
"""A telegram that is later than this was not held up: its controller's cycles are others [ns]."""


@dataclass(slots=True)
class Pace:
    """What is due when.

    Attributes:
        adapts: the lead follows what steps cost; else it is the schedule's own, 0 for none.
        phase: the controller's, as its telegrams tell it.
        lead: from what steps cost.
    """

    schedule: Schedule
    adapts: bool = False
    phase: PhaseLock = field(init=False)
    lead: Lead = field(init=False)

    def __post_init__(self) -> None:
        """Begin with the configured period."""
        self.phase = PhaseLock(self.schedule.period_ns)
        self.lead = Lead(self.schedule.period_ns)

    @classmethod
    def free(cls, period_ns: int, now_ns: int, lead_ns: int | None = 0) -> "Pace":
        """A pace that runs free from now on.

        Args:
            period_ns: T0 [ns].
            now_ns: monotonic time [ns].
            lead_ns: how long before a telegram its step is made [ns]; 0: when the telegram comes;
                None: as long as steps have lately needed.

        Raises:
            ValueError: a lead of a cycle or more.
        """
        if lead_ns is not None:
            return cls(scheduling.free(period_ns, now_ns, lead_ns))
        return cls(scheduling.free(period_ns, now_ns, Lead(period_ns).lead_ns), adapts=True)

    @property
    def _period_ns(self) -> int:
        """The controller's cycle for the clock: the measured one, else the configured one.

        A guess from a few late telegrams made 31 steps more than the controller had cycles.
        """
        measured = self.phase.measured_ns
        return self.phase.nominal_ns if measured is None else round(measured)

    @property
    def wake_ns(self) -> int:
        """When something is due next [ns]."""
        return scheduling.wake_ns(self.schedule)

    def telegram(self, stamp_ns: int, cycles: int = 1, *, anew: bool = False) -> None:
        """A telegram was answered: follow it.

        Args:
            stamp_ns: its arrival [ns].
            cycles: of the controller since the telegram before, by their IPOCs.
            anew: it begins a session.
        """
        if anew:
            self.phase.restart()
        self.phase.arrival(stamp_ns, cycles)
        expected_ns = self.phase.expected_ns()
        period_ns = self.phase.nominal_ns if self.phase.refusal else self._period_ns
        self.schedule = scheduling.follow(
            self.schedule,
            stamp_ns + period_ns if expected_ns is None else expected_ns,
            period_ns,
            self.lead.lead_ns if self.adapts else self.schedule.lead_ns,
        )

    def date(self, stamp_ns: int, cycles: int) -> int:
        """Return when the controller's cycle began whose telegram has come [ns].

        A telegram is late by what held it up. Taken for the time of its cycle, 12 ms would place
        the robot and the object 1.3 mm apart beside a line at 106 mm/s.

        Args:
            stamp_ns: the telegram's arrival [ns].
            cycles: of the controller since the telegram before, by their IPOCs.
        """
        expected_ns = self.phase.expected_ns(cycles)
        if expected_ns is None or self.phase.refusal or not self.schedule.locked:
            return stamp_ns
        return expected_ns if 0 < stamp_ns - expected_ns <= LATEST_NS else stamp_ns

    def run_free(self) -> None:
        """The robot is gone: keep the configured period, the next telegram sets the phase."""
        self.schedule = scheduling.run_free(self.schedule, self.phase.nominal_ns)
        self.phase.restart()

    def wake(self, now_ns: int) -> tuple[Due, ...]:
        """Find what is due, in this order.

        Args:
            now_ns: monotonic time [ns].
        """
        self.schedule, due = scheduling.on_wake(self.schedule, now_ns)
        return due

    def attend(self, now_ns: int) -> int | None:
        """Find the telegram that is about to come and whose reply is ready.

        Args:
            now_ns: monotonic time [ns].

        Returns:
            When it is expected [ns], once; None if it is not time.
        """
        self.schedule, expected_ns = scheduling.attend(self.schedule, now_ns)
        return expected_ns

    def prepared(self, cost_ns: int) -> None:
        """A step was made before its telegram.

        Args:
            cost_ns: from when the clock should have woken to when its reply was ready [ns].
        """
        self.lead.note(cost_ns)
