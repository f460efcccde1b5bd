"""Date the readings of a distance sensor that measures evenly.

An adapter on a serial line gives no stamps. Readings that a busy host reads 12 ms late in one
portion seem to have come at once, which looks like a stop of the conveyor.

A reading that comes alone after a gap, between two periods, is late. By how much is unknown: those
before it are lost, or late as well. Dated 12 ms too late it looks like a stop of the conveyor.

Invariants:
    A reading comes one period after the one before. A reading can be late, never early.
    Where the gaps are not even, the stamps are not changed.
    A reading of unknown date is left out, until the next ones show it or for ``UNDATED_S`` at most.
    A reading that is older than the last one's date is left out: that one was late.
"""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise

from linemate.protocol.stamped_samples import DistanceSample

KEPT = 64  # gaps from which the period is learned
LEARN_EVERY = 16  # readings
EVEN = 0.25  # a gap is even within this share of the median
MOST, ENOUGH = 2 / 3, 0.4  # share of even gaps to begin dating, and to continue
LATE = 0.125  # lateness up to this share of a period is the line's own and not corrected
LEAK = 1 / 64  # share of a lasting lateness accepted with each reading: the phase may move
SHORTER = 0.98  # least time between two readings, share of a period
UNDATED_S = 0.1  # for which readings of unknown date are left out [s]


class EvenClock:
    """Dates readings.

    Attributes:
        redated: readings whose stamp was changed.
        undated: readings that were left out.
    """

    __slots__ = (
        "_arrivals",
        "_fresh",
        "_last_ns",
        "_period_ns",
        "_unsure",
        "_unsure_ns",
        "redated",
        "undated",
    )

    def __init__(self) -> None:
        self._arrivals: deque[int] = deque(maxlen=KEPT + 1)
        self._fresh = 0
        self._last_ns: int | None = None
        self._period_ns = 0.0
        self._unsure = 0  # readings in a row of unknown date
        self._unsure_ns = 0  # the newest of them
        self.redated = self.undated = 0

    def date(self, samples: Sequence[DistanceSample]) -> Sequence[DistanceSample]:
        """Return all readings since the last call, oldest first, with their corrected stamps."""
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
            read_ns = min(sample.stamp_ns, latest_ns)
            if self._leave_out(read_ns, sample.stamp_ns):
                continue
            stamp_ns = self._arrival(read_ns)
            self._last_ns = stamp_ns
            if stamp_ns != sample.stamp_ns:
                self.redated += 1
                sample = DistanceSample(stamp_ns, sample.position, sample.strength)  # noqa: PLW2901
            dated.append(sample)
        return dated

    def _leave_out(self, read_ns: int, came_ns: int) -> bool:
        """Leave a reading out whose date is unknown; return whether it is.

        Args:
            came_ns: the same, in a portion as of its last reading [ns].
        """
        if self._last_ns is None:
            return False
        gap = (read_ns - self._last_ns) / self._period_ns
        if gap < -LATE:  # its portion shows that the last one was dated too late
            self.undated += 1
            return True
        is_missing = round(gap) > 1 + self._unsure
        is_recent = gap * self._period_ns < UNDATED_S * 1e9
        if is_missing and is_recent and not self._is_even(gap, came_ns):
            self._unsure, self._unsure_ns = self._unsure + 1, came_ns
            self.undated += 1
            return True
        if is_missing and self._unsure:
            self._last_ns = None
        self._unsure = 0
        return False

    def _is_even(self, gap: float, came_ns: int) -> bool:
        """Return whether a reading is even with the last one of known date, or with one left out.

        Args:
            gap: since the last one of known date, in periods.
            came_ns: when its portion's last reading was read [ns].
        """
        off = gap - round(gap)
        if self._unsure:
            off = (came_ns - self._unsure_ns) / self._period_ns - 1.0
        return abs(off) <= LATE

    def _arrival(self, read_ns: int) -> int:
        """Return the arrival of a reading that was read at ``read_ns`` [ns]."""
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
            # The mean is finer than the median, which has the resolution of the host's noise.
            self._period_ns = sum(even) / len(even)
        elif len(even) < ENOUGH * len(gaps):
            self._period_ns = 0.0
