"""When a distance was measured, where only the reading of it has a date.

Law of this file: integers in, samples out, a bounded memory. An adapter on a serial line gives no
stamps: what a busy host reads 12 ms late in one portion seems to have come at once, and three
readings behind one another at one instant look like a conveyor that stops. A sensor that measures
evenly is dated by its own evenness: a reading comes a period after the one before, and one that
is followed by another in the same portion came a period before that. A reading can be late, never
early. Where the gaps are not even, nothing is touched.
"""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise

from linemate.protocol.samples import DistanceSample

KEPT = 64
LEARN_EVERY = 16
EVEN = 0.25
"""A gap is even if it is within so much of the median."""

MOST, ENOUGH = 2 / 3, 0.4
"""So many gaps must be even before anything is dated by them, and so many for that to go on."""

LATE = 0.125
"""Lateness below so much of a period is left alone: it is the line's own."""

LEAK = 1 / 64
"""Of a lateness that stays, so much is believed with each reading: the sensor's phase may move."""

SHORTER = 0.98
"""Of a period: no reading followed another sooner."""


class EvenClock:
    """Dates readings.

    Attributes:
        redated: readings that were read late.
    """

    __slots__ = ("_arrivals", "_fresh", "_last_ns", "_period_ns", "redated")

    def __init__(self) -> None:
        """Know nothing."""
        self._arrivals: deque[int] = deque(maxlen=KEPT + 1)
        self._fresh = 0
        self._last_ns: int | None = None
        self._period_ns = 0.0
        self.redated = 0

    def date(self, samples: Sequence[DistanceSample]) -> Sequence[DistanceSample]:
        """Return readings with their stamps at the moments at which they came.

        Args:
            samples: all that came since the last call, oldest first.
        """
        for sample in samples:
            self._learn(sample.stamp_ns)
        if not self._period_ns:
            if samples:
                self._last_ns = samples[-1].stamp_ns
            return samples
        behind = len(samples)
        dated = []
        for sample in samples:
            behind -= 1
            latest_ns = samples[-1].stamp_ns - round(behind * SHORTER * self._period_ns)
            stamp_ns = self._came(min(sample.stamp_ns, latest_ns))
            self._last_ns = stamp_ns
            if stamp_ns != sample.stamp_ns:
                self.redated += 1
                sample = DistanceSample(stamp_ns, sample.position, sample.strength)  # noqa: PLW2901
            dated.append(sample)
        return dated

    def _came(self, read_ns: int) -> int:
        """Return when a reading came that was read then [ns]."""
        last_ns, period_ns = self._last_ns, self._period_ns
        if last_ns is None:
            return read_ns
        cycles = max(1, round((read_ns - last_ns) / period_ns))
        expected_ns = last_ns + round(cycles * period_ns)
        late_ns = read_ns - expected_ns
        if late_ns > LATE * period_ns:
            return expected_ns + round(LEAK * late_ns)
        return max(read_ns, last_ns + 1)

    def _learn(self, read_ns: int) -> None:
        """Learn the period from gaps between readings, if most of them are even."""
        arrivals = self._arrivals
        arrivals.append(read_ns)
        self._fresh += 1
        if self._fresh < LEARN_EVERY or len(arrivals) <= LEARN_EVERY:
            return
        self._fresh = 0
        listed = list(arrivals)
        gaps = [after - before for before, after in pairwise(listed)]
        median = sorted(gaps)[len(gaps) // 2]
        even = [gap for gap in gaps if abs(gap - median) <= EVEN * median]
        if len(even) >= MOST * len(gaps):
            # Their mean is finer than their median, whose quantum is that of the host's noise.
            self._period_ns = sum(even) / len(even)
        elif len(even) < ENOUGH * len(gaps):
            self._period_ns = 0.0
