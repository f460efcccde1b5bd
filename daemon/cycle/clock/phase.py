"""When the next telegram will come, and how long before it the step has to begin.

Law of this file: pure; arrivals and costs are handed in, no clock is read. An arrival is late and
never early, so the phase is the lower envelope of the last arrivals and the period the median
slope of many. A controller that is not the one configured is refused here, with the reason.
Source: reference/real-time.md, 5; reference/reliability.md, R8.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from heapq import nlargest
from statistics import median
from typing import Final

TOLERANCE: Final = 0.05
"""How far the controller's cycle may be from the configured one (R8)."""

WINDOW: Final = 32
"""Arrivals that the envelope is taken over."""

BLOCKS: Final = 32
"""Earliest arrivals, one a window half, that the period is taken from."""

BLOCK: Final = 16
LEARNT: Final = 24
"""Cycles before a period is believed."""

GUESSED: Final = (0.75, 4.0)
"""Of the configured cycle, between which a period is guessed before. Two telegrams that a wire held
up come 0.2 ms apart: a clock that took this for the cycle made 57 of them before the next came."""

LASTING: Final = 8
"""Telegrams at a refused period before a motion is held for it; jitter unlocks it in between."""

AFRESH: Final = 4
"""Arrivals in a row, late by an eighth of a cycle, that say that the controller's phase moved."""

ALIKE: Final = 1 / 8
"""Of a cycle: how far apart their delays may be. A wire that delays each by another time has not
moved the controller's phase."""

STILL_NS: Final = 2_000_000
"""No wire alone is late by as much and a whole cycle."""

Arrival = tuple[int, int]
"""Number of the cycle, and stamp [ns]."""


@dataclass(slots=True)
class PhaseLock:
    """Period and phase of the controller, as its telegrams tell them.

    Attributes:
        nominal_ns: the configured cycle [ns].
        relocks: how often the phase moved and was taken afresh.
    """

    nominal_ns: int
    relocks: int = 0
    _period_ns: float = 0.0
    _cycle: int = 0
    _late: deque[int] = field(default_factory=lambda: deque(maxlen=AFRESH))
    _line_ns: int | None = None
    _measured: bool = False
    _refused: int = 0
    _refusal: str | None = None
    _recent: deque[Arrival] = field(default_factory=lambda: deque(maxlen=WINDOW))
    _earliest: deque[Arrival] = field(default_factory=lambda: deque(maxlen=BLOCKS))
    _block: list[Arrival] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Begin with what is configured."""
        self.restart()

    def restart(self) -> None:
        """Another session: nothing of the last one holds."""
        self._period_ns = float(self.nominal_ns)
        self._measured = False
        self._refused, self._refusal = 0, None
        self._cycle = 0
        self._forget()

    def arrival(self, stamp_ns: int, cycles: int = 1) -> None:
        """Take in one telegram.

        Args:
            stamp_ns: its arrival [ns].
            cycles: of the controller since the telegram before, by their IPOCs.
        """
        expected_ns = self.expected_ns(cycles)
        self._cycle += max(1, cycles)
        if expected_ns is not None:
            late_ns = stamp_ns - expected_ns
            if late_ns > 0.125 * self._period_ns:
                self._late.append(late_ns)
            else:
                self._late.clear()
            if self._has_moved() or self._stood_still(late_ns):
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
        """When a telegram is to be expected, if none is held up.

        Args:
            ahead: cycles after the last telegram.

        Returns:
            Stamp [ns], None before the first telegram.
        """
        if self._line_ns is None:
            return None
        return self._line_ns + round(ahead * self._period_ns)

    @property
    def period_ns(self) -> int:
        """The controller's cycle as far as it is known [ns]."""
        return round(self._period_ns)

    @property
    def measured_ns(self) -> float | None:
        """The measured cycle [ns], None until it is believed."""
        return self._period_ns if self._measured else None

    @property
    def refusal(self) -> str | None:
        """Why this controller cannot be followed, None if it can (or is not known yet)."""
        if not self._measured:
            return None
        deviation = self._period_ns / self.nominal_ns - 1.0
        if abs(deviation) <= TOLERANCE:
            return None
        return (
            f"the controller's cycle is {self._period_ns * 1e-6:.3f} ms, "
            f"{100.0 * abs(deviation):.1f} % off the {self.nominal_ns * 1e-6:g} ms configured, "
            f"limit {100.0 * TOLERANCE:g} %. Set rsi.cycle_ms and RSI_ON's cycle on the controller "
            "to the same value."
        )

    @property
    def lasting_refusal(self) -> str | None:
        """``refusal`` once it has lasted for ``LASTING`` telegrams."""
        return self._refusal if self._refused >= LASTING else None

    @property
    def arm_refusal(self) -> str | None:
        """Why the robot must not be armed: as ``refusal``, or the period is not measured yet."""
        if self._measured:
            return self.refusal
        return (
            f"the controller's cycle is not measured yet: {len(self._recent)} of {LEARNT + 1} "
            f"telegrams at {self.nominal_ns * 1e-6:g} ms. Order arm again in a second; if it "
            "stays so, the telegrams come at no steady cycle."
        )

    def _count_refusals(self) -> None:
        """Count telegrams at a refused period; a grid that moved says nothing of the period."""
        if not self._measured:
            return
        refusal = self.refusal
        self._refused = 0 if refusal is None else self._refused + 1
        self._refusal = refusal

    def _has_moved(self) -> bool:
        """Tell whether the last arrivals are late by the same time."""
        late = self._late
        return len(late) == AFRESH and max(late) - min(late) <= ALIKE * self._period_ns

    def _stood_still(self, late_ns: int) -> bool:
        """Tell whether the controller was held up without counting, or its wire was stuffed.

        On the old grid the clock would make the cycles of the stillness again for each telegram.
        What comes out of a stuffed wire is early next, and the early ones are followed at once.
        """
        return self._measured and late_ns >= max(self._period_ns, STILL_NS)

    def _envelope(self, stamp_ns: int) -> int:
        """The grid line of the last telegram, at most its arrival [ns].

        Every recent arrival is an upper bound of the grid; the least bound is nearest to it.
        """
        cycle, period = self._cycle, self._period_ns
        over = min([stamp - stamp_ns + (cycle - number) * period for number, stamp in self._recent])
        return stamp_ns + round(over)

    def _span(self) -> int:
        """Cycles that the closed blocks cover."""
        return self._earliest[-1][0] - self._earliest[0][0] if self._earliest else 0

    def _close_block(self) -> None:
        period = self._period_ns
        first = self._block[0][0]
        self._earliest.append(min(self._block, key=lambda at: at[1] - (at[0] - first) * period))
        self._block.clear()
        if self._span() >= WINDOW:
            self._fit(self._earliest)

    def _fit(self, points: Sequence[Arrival]) -> None:
        """Take the period from points in two halves, each paired with its like in the other."""
        half = len(points) // 2
        if half == 0:
            return
        self._period_ns = median(
            (points[i + half][1] - points[i][1]) / (points[i + half][0] - points[i][0])
            for i in range(len(points) - half)
        )
        if points[-1][0] - points[0][0] >= LEARNT:
            self._measured = True
        else:
            least, most = (share * self.nominal_ns for share in GUESSED)
            self._period_ns = min(max(self._period_ns, least), most)

    def _relock(self) -> None:
        """The grid has moved: the arrivals before it bound another one.

        The period stays, unless it has led astray twice within a window or is refused: it may have
        been learnt from arrivals of two grids, and would throw every better one away.
        """
        self.relocks += 1
        if len(self._recent) < WINDOW or self.refusal is not None:
            self._period_ns, self._measured = float(self.nominal_ns), False
        self._forget()

    def _forget(self) -> None:
        self._late.clear()
        self._line_ns = None
        self._recent.clear()
        self._earliest.clear()
        self._block.clear()


COSTS: Final = 1024
REFRESH: Final = 32
MOST_SHARE: Final = 0.75
"""Of a cycle: the rest is for what follows a reply. A step that the machine holds up may so take
longer than most."""

MOST_NS: Final = 4_000_000
MARGIN_NS: Final = 40_000


@dataclass(slots=True)
class Lead:
    """How long before its telegram a step has to be begun: no more than it needs.

    Sensor samples grow older by it, so it follows the 99.9 % slowest of the last steps, counted
    from when the clock should have woken to when the reply was ready.

    Attributes:
        period_ns: T0 [ns].
        lead_ns: the lead [ns].
    """

    period_ns: int
    lead_ns: int = 0
    _costs: deque[int] = field(default_factory=lambda: deque(maxlen=COSTS))
    _since: int = 0

    def __post_init__(self) -> None:
        """Begin with the longest, for nothing is known yet."""
        self.lead_ns = self.most_ns

    @property
    def most_ns(self) -> int:
        """The longest lead there may be [ns]."""
        return min(MOST_NS, int(MOST_SHARE * self.period_ns))

    def note(self, cost_ns: int) -> None:
        """Take in one step.

        Args:
            cost_ns: from when it should have begun to when its reply was ready [ns].
        """
        self._costs.append(cost_ns)
        self._since += 1
        if self._since >= REFRESH:
            self._since = 0
            slowest = nlargest(1 + len(self._costs) // 1000, self._costs)[-1]
            self.lead_ns = min(self.most_ns, max(0, slowest) + MARGIN_NS)
