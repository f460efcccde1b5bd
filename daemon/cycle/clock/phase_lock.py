"""Phase lock on the controller's cycle: when the next telegram comes, and what is due when.

Invariants:
- Pure. The real timer and virtual time drive the same object.
- The controller is the master: each telegram sets the phase.
- Without telegrams the grid goes on (``next += T0``, never ``now + T0``). So the step count stays
  right.
- An arrival is late, never early. The phase is the lower envelope of the last arrivals, the period
  is the median slope of many.
"""

from collections import deque
from collections.abc import Sequence
from enum import StrEnum
from heapq import nlargest
from statistics import median
from typing import Final

from msgspec import Struct

TOLERANCE: Final = 0.05  # deviation of the controller's cycle from the configured one
WINDOW: Final = 32  # arrivals of the envelope
BLOCKS: Final = 32  # earliest arrivals, one a block, that the period is fitted to
BLOCK: Final = 16  # arrivals of a block
LEARNT: Final = 24  # cycles before a period counts as measured
# Range of a period that is not measured yet, as shares of the configured one. Two telegrams that
# a network delayed come 0.2 ms apart. Taken for the period, that made 57 steps in one cycle.
GUESSED: Final = (0.75, 4.0)
# The same once one was measured that can be followed: a session keeps its period.
KEPT: Final = (1.0 - TOLERANCE, 1.0 + TOLERANCE)
# Telegrams at a refused period before a motion is held. Jitter unlocks the phase in between.
LASTING: Final = 8
AFRESH: Final = 4  # arrivals in a row, an eighth of a cycle late, that show a moved phase
# How far apart the delays of these may be [cycles]. A network that delays each telegram by another
# time has not moved the controller's phase.
ALIKE: Final = 1 / 8
STALLED_NS: Final = 2_000_000  # the network alone does not delay by this and a whole cycle [ns]

COSTS: Final = 1024  # steps that the lead is taken from
REFRESH: Final = 32  # steps between two evaluations of the lead
MAX_LEAD_SHARE: Final = 0.75  # of a cycle; the rest is for the work after a reply
MAX_LEAD_NS: Final = 4_000_000
MARGIN_NS: Final = 40_000  # lead beyond the slowest step [ns]

LATEST_NS: Final = 100_000_000  # a telegram later than this is of another grid [ns]
ATTEND_NS: Final = 250_000  # wait for a telegram from this long before it [ns]
MAX_STEPS_AT_ONCE: Final = 25  # made after a stall; older ones are skipped and counted

Arrival = tuple[int, int]
"""Number of the cycle, and stamp [ns]."""


class CycleEstimate:
    """Period and phase of the controller, from the arrivals of its telegrams.

    Attributes:
        nominal_ns: the configured cycle [ns].
        period_ns: the controller's cycle as far as it is known [ns].
        relocks: how often the phase moved and was learned again.
    """

    def __init__(self, nominal_ns: int) -> None:
        self.nominal_ns = nominal_ns
        self.relocks = 0
        self._late: deque[int] = deque(maxlen=AFRESH)
        self._recent: deque[Arrival] = deque(maxlen=WINDOW)
        self._earliest: deque[Arrival] = deque(maxlen=BLOCKS)
        self._block: list[Arrival] = []
        self._line_ns: int | None = None  # grid line of the last telegram
        self.restart()

    def restart(self) -> None:
        """Forget the last session."""
        self.period_ns = float(self.nominal_ns)
        self._measured = False
        self._guessed = GUESSED
        self._refused = 0
        self._refusal: str | None = None
        self._cycle = 0
        self._forget()

    def add(self, stamp_ns: int, cycles: int = 1) -> None:
        """Add the arrival of a telegram.

        Args:
            cycles: since the telegram before, by their counters.
        """
        expected_ns = self.expected_ns(cycles)
        self._cycle += max(1, cycles)
        if expected_ns is not None:
            late_ns = stamp_ns - expected_ns
            if late_ns > 0.125 * self.period_ns:
                self._late.append(late_ns)
            else:
                self._late.clear()
            if self._has_moved() or self._has_stalled(late_ns):
                self._relock()
        self._recent.append((self._cycle, stamp_ns))
        self._block.append((self._cycle, stamp_ns))
        if not self._measured and self._span() < WINDOW:
            self._fit(self._recent)
        if len(self._block) >= BLOCK:
            self._close_block()
        self._count_refusals()
        self._line_ns = self._envelope(stamp_ns)

    def expected_ns(self, ahead: int = 1) -> int | None:
        """Return when a telegram is expected that nothing delays [ns], None before the first.

        Args:
            ahead: cycles after the last telegram.
        """
        if self._line_ns is None:
            return None
        return self._line_ns + round(ahead * self.period_ns)

    @property
    def measured_ns(self) -> float | None:
        """The measured cycle [ns], None until enough telegrams have come."""
        return self.period_ns if self._measured else None

    @property
    def refusal(self) -> str | None:
        """Why the measured period cannot be followed; None if it can or is not measured."""
        if not self._measured:
            return None
        deviation = self.period_ns / self.nominal_ns - 1.0
        if abs(deviation) <= TOLERANCE:
            return None
        return (
            f"the controller's cycle is {self.period_ns * 1e-6:.3f} ms, "
            f"{100.0 * abs(deviation):.1f} % off the {self.nominal_ns * 1e-6:g} ms configured, "
            f"limit {100.0 * TOLERANCE:g} %. Set the same cycle in the configuration "
            "(cycle_ms of the controller's section) and on the controller."
        )

    @property
    def lasting_refusal(self) -> str | None:
        """``refusal`` once it has lasted for ``LASTING`` telegrams."""
        return self._refusal if self._refused >= LASTING else None

    @property
    def arm_refusal(self) -> str | None:
        """Why the robot must not be armed: ``refusal``, or the period is not measured yet."""
        if self._measured:
            return self.refusal
        return (
            f"the controller's cycle is not measured yet: {len(self._recent)} of {LEARNT + 1} "
            f"telegrams at {self.nominal_ns * 1e-6:g} ms. Order arm again in a second; if it "
            "stays so, the telegrams come at no steady cycle."
        )

    def _count_refusals(self) -> None:
        # A phase that moved unlocks the period, and says nothing of it.
        if not self._measured:
            return
        self._refusal = self.refusal
        self._refused = 0 if self._refusal is None else self._refused + 1

    def _has_moved(self) -> bool:
        """Return whether the last arrivals are late by the same time."""
        late = self._late
        return len(late) == AFRESH and max(late) - min(late) <= ALIKE * self.period_ns

    def _has_stalled(self, late_ns: int) -> bool:
        """Return whether the controller was stalled without counting, or the network was.

        On the old grid the clock would make the cycles of the stall again for each telegram.
        Telegrams that a network delayed are early on the new grid, and are followed at once.
        """
        return self._measured and late_ns >= max(self.period_ns, STALLED_NS)

    def _envelope(self, stamp_ns: int) -> int:
        """Return the grid line of the last telegram, at most its arrival [ns].

        Each recent arrival is an upper bound of the grid. The least bound is the nearest.
        """
        cycle, period = self._cycle, self.period_ns
        over = min([stamp - stamp_ns + (cycle - number) * period for number, stamp in self._recent])
        return stamp_ns + round(over)

    def _span(self) -> int:
        """Return the cycles that the closed blocks cover."""
        return self._earliest[-1][0] - self._earliest[0][0] if self._earliest else 0

    def _close_block(self) -> None:
        period = self.period_ns
        first = self._block[0][0]
        self._earliest.append(min(self._block, key=lambda at: at[1] - (at[0] - first) * period))
        self._block.clear()
        if self._span() >= WINDOW:
            self._fit(self._earliest)

    def _fit(self, points: Sequence[Arrival]) -> None:
        """Fit the period: median slope between points of the first and of the second half."""
        half = len(points) // 2
        if half == 0:
            return
        self.period_ns = median(
            (points[i + half][1] - points[i][1]) / (points[i + half][0] - points[i][0])
            for i in range(len(points) - half)
        )
        if points[-1][0] - points[0][0] >= LEARNT:
            self._measured = True
        else:
            low, high = (share * self.nominal_ns for share in self._guessed)
            self.period_ns = min(max(self.period_ns, low), high)

    def _relock(self) -> None:
        """Forget the arrivals of the old grid.

        The period stays, unless it was wrong twice within a window or is refused. Then it may come
        from arrivals of two grids, and would reject every better one.
        """
        self.relocks += 1
        if self._measured and self.refusal is None:
            self._guessed = KEPT
        if len(self._recent) < WINDOW or self.refusal is not None:
            self.period_ns, self._measured = float(self.nominal_ns), False
        self._forget()

    def _forget(self) -> None:
        self._line_ns = None
        self._late.clear()
        self._recent.clear()
        self._earliest.clear()
        self._block.clear()


class Lead:
    """Lead of a step before its telegram: the 99.9 % slowest of the last steps and a margin.

    Sensor samples age by the lead, so it is no longer than needed.

    Attributes:
        lead_ns: the lead [ns]; the longest until steps were made.
    """

    def __init__(self, period_ns: int) -> None:
        self.max_ns = min(MAX_LEAD_NS, int(MAX_LEAD_SHARE * period_ns))
        self.lead_ns = self.max_ns
        self._costs: deque[int] = deque(maxlen=COSTS)
        self._since_refresh = 0

    def add(self, cost_ns: int) -> None:
        """Add the time from when a step was due to when its reply was ready [ns]."""
        self._costs.append(cost_ns)
        self._since_refresh += 1
        if self._since_refresh >= REFRESH:
            self._since_refresh = 0
            slowest = nlargest(1 + len(self._costs) // 1000, self._costs)[-1]
            self.lead_ns = min(self.max_ns, max(0, slowest) + MARGIN_NS)


class DueKind(StrEnum):
    """What is due."""

    PREPARE = "prepare"
    MISSING = "missing"


class Due(Struct, frozen=True):
    """A step that is due, ahead of its telegram or because the telegram is missing.

    Attributes:
        stamp_ns: expected time of the telegram [ns].
    """

    kind: DueKind
    stamp_ns: int


class PhaseLock:
    """The grid of sampling steps, locked to the controller's telegrams.

    Attributes:
        estimate: period and phase of the controller.
        next_ns: when the next telegram is expected [ns].
        grace_ns: how long after that it counts as missing [ns].
        lead_ns: how long before that its step is prepared [ns]; 0: never.
        is_locked: telegrams set the phase; else the grid runs free.
        skipped: cycles after stalls for which no step was made.
        arrival_ns: of the answered telegram that is to be followed, None without one [ns].
        unfollowed: cycles of telegrams that were counted and then failed.
    """

    def __init__(self, period_ns: int, now_ns: int, lead_ns: int | None = 0) -> None:
        """Run free from now on.

        Args:
            period_ns: the configured cycle T0 [ns].
            lead_ns: how long before a telegram its step is prepared [ns]; 0: never; None: as long
                as steps have lately needed.

        Raises:
            ValueError: a lead of a cycle or more.
        """
        # A late telegram is answered or given up before the next one's step begins.
        if lead_ns is not None and not 0 <= lead_ns < period_ns:
            raise ValueError(f"a lead of {lead_ns} ns does not fit into a cycle of {period_ns} ns")
        self.estimate = CycleEstimate(period_ns)
        self._lead = None
        if lead_ns is None:
            self._lead = Lead(period_ns)
            lead_ns = self._lead.lead_ns
        self.lead_ns = lead_ns
        self.next_ns = now_ns + period_ns
        self.is_locked = self._is_prepared = self._is_attended = self._is_followed = False
        self.skipped = self.unfollowed = self._rest_ns = self._slow_ns = 0
        self.arrival_ns: int | None = None
        self._set_period(period_ns)

    def follow(
        self, stamp_ns: int, cycles: int = 1, *, ahead: int = 0, restarts: bool = False
    ) -> None:
        """Follow a telegram that was answered.

        Args:
            cycles: since the telegram before, by their counters.
            ahead: cycles after it whose steps were made, because it is late. The grid goes on
                behind them: no cycle gets a second step.
            restarts: it begins a session.
        """
        estimate = self.estimate
        if restarts:
            estimate.restart()
        estimate.add(stamp_ns, cycles)
        # A guess from a few late telegrams made 31 steps more than the controller had cycles.
        measured_ns = None if estimate.refusal else estimate.measured_ns
        self._set_period(estimate.nominal_ns if measured_ns is None else round(measured_ns))
        expected_ns = estimate.expected_ns(1 + ahead)
        self.next_ns = stamp_ns + self.period_ns if expected_ns is None else expected_ns
        if self._lead is not None:
            self.lead_ns = self._lead.lead_ns
        self._is_prepared = self._is_attended = False
        self.is_locked = self._is_followed = True
        self._rest_ns = 0

    def date(self, stamp_ns: int, cycles: int) -> int:
        """Return when the controller's cycle began whose telegram has come [ns].

        A delayed telegram is dated back. 12 ms would put robot and object 1.3 mm apart at 106 mm/s.

        Args:
            stamp_ns: the telegram's arrival [ns].
            cycles: since the telegram before, by their counters.
        """
        if self.arrival_ns is not None:
            return stamp_ns
        expected_ns = self.estimate.expected_ns(cycles + self.unfollowed)
        if expected_ns is None or not self.is_locked or self.estimate.refusal:
            return stamp_ns
        return expected_ns if 0 < stamp_ns - expected_ns <= LATEST_NS else stamp_ns

    def run_free(self, rest_s: float = 0.0) -> None:
        """Keep the configured period. The next telegram sets the phase, however late it is.

        Args:
            rest_s: by how much later the clock may wake, for some steps at once [s]. It is bounded
                by the steps that are made at once after a stall.
        """
        self.is_locked = False
        self._rest_ns = min(round(rest_s * 1e9), (MAX_STEPS_AT_ONCE - 5) * self.period_ns)
        self.estimate.restart()
        self._set_period(self.estimate.nominal_ns)

    @property
    def is_slow(self) -> bool:
        """Whether nothing is prepared, because telegrams are answered without steps."""
        return self._slow_ns > 0

    def set_slow(self, rest_s: float) -> None:
        """Prepare nothing, and let the clock notice a missing telegram later, or as ever with 0.

        Args:
            rest_s: by how much later [s], bounded as in ``run_free``.
        """
        self._slow_ns = min(round(rest_s * 1e9), (MAX_STEPS_AT_ONCE - 5) * self.period_ns)

    @property
    def wake_ns(self) -> int:
        """When something is due next [ns]."""
        if self._can_prepare:
            return self.next_ns - self.lead_ns
        if self._can_attend:
            return self.next_ns - ATTEND_NS
        return self.next_ns + self.grace_ns + max(self._rest_ns, self._slow_ns)

    def may_pass_over(self, now_ns: int) -> bool:
        """Return whether a step is due now [ns] that could pass over a telegram that waits.

        None waits before its time, unless it is that of a cycle before. An empty read is 15 us.
        """
        if self._is_followed and now_ns < self.next_ns:
            return False
        if self.next_ns + self.grace_ns <= now_ns:
            return True
        return self._can_prepare and self.next_ns - self.lead_ns <= now_ns

    def take_due(self, now_ns: int) -> tuple[Due, ...]:
        """Return the steps that are due now [ns], in order."""
        due: list[Due] = []
        if self.next_ns + self.grace_ns <= now_ns:
            self._skip(now_ns)
        while self.next_ns + self.grace_ns <= now_ns:
            due.append(Due(DueKind.MISSING, self.next_ns))
            self.next_ns += self.period_ns
            self._is_prepared = self._is_attended = self._is_followed = False
        if self._can_prepare and self.next_ns - self.lead_ns <= now_ns:
            due.append(Due(DueKind.PREPARE, self.next_ns))
            self._is_prepared = True
        return tuple(due)

    def attend(self, now_ns: int) -> int | None:
        """Return when the telegram is expected that is to be waited for now [ns].

        It is returned once, when its reply is ready and it is about to come; else None.
        """
        if not self._can_attend or now_ns < self.next_ns - ATTEND_NS:
            return None
        self._is_attended = True
        return self.next_ns

    def add_cost(self, cost_ns: int) -> None:
        """Add the time from when a step was due to when its reply was ready [ns]."""
        if self._lead is not None:
            self._lead.add(cost_ns)

    @property
    def _can_attend(self) -> bool:
        return self._is_prepared and not self._is_attended

    @property
    def _can_prepare(self) -> bool:
        """Nothing is prepared for a robot that is not there, or gets no steps."""
        if self._slow_ns:
            return False
        return self.is_locked and not self._is_prepared and self.lead_ns > 0

    def _set_period(self, period_ns: int) -> None:
        self.period_ns, self.grace_ns = period_ns, period_ns // 2

    def _skip(self, now_ns: int) -> None:
        overdue = (now_ns - self.next_ns - self.grace_ns) // self.period_ns + 1
        excess = max(0, overdue - MAX_STEPS_AT_ONCE)
        self.next_ns += excess * self.period_ns
        self.skipped += excess
