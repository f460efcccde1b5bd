"""Histogram of durations: fixed size, percentiles within 9 %.

Invariants:
- Pure. A bucket is an eighth of an octave wide. The greatest value is exact.
- A value is kept, and sorted into its bucket with others: in a cold cache each costs 4 us alone.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

PER_OCTAVE = 8
OCTAVES = 40  # of nanoseconds: up to 18 minutes
TOGETHER = 32  # values that are sorted into buckets at once
LAST = PER_OCTAVE * OCTAVES - 1  # bucket of all longer values
LEADING = 4  # bits of a value that choose its bucket; a shorter value is its own
EDGE_OCTAVES = range(14, 28)  # of a status' histograms: 16 us to 134 ms
EDGES_NS = tuple(1 << octave for octave in EDGE_OCTAVES)


@dataclass(slots=True)
class Histogram:
    """Durations, counted."""

    _count: int = 0
    _greatest_ns: int = 0
    _sum_ns: int = 0
    _buckets: list[int] = field(default_factory=lambda: [0] * (PER_OCTAVE * OCTAVES))
    _waiting: list[int] = field(default_factory=list)

    def add(self, duration_ns: int) -> None:
        """Count one; a negative one counts as 0."""
        self._waiting.append(duration_ns)
        if len(self._waiting) >= TOGETHER:
            self._sort()

    @property
    def count(self) -> int:
        """Number of durations."""
        self._sort()
        return self._count

    def _sort(self) -> None:
        """Sort the waiting values into their buckets."""
        if not self._waiting:
            return
        values = [max(0, value) for value in self._waiting]
        self._waiting.clear()
        self._count += len(values)
        self._sum_ns += sum(values)
        self._greatest_ns = max(self._greatest_ns, *values)
        buckets = self._buckets
        for value in values:
            shift = value.bit_length() - LEADING
            index = value if shift < 0 else (shift + 2) * PER_OCTAVE + (value >> shift)
            buckets[min(LAST, index)] += 1

    def percentile(self, share: float) -> float | None:
        """A duration that this share of all does not exceed.

        Returns:
            Its bucket's upper edge, at most the greatest value [s]; None if there is none.
        """
        return self._percentiles((share,))[0]

    def _percentiles(self, shares: Sequence[float]) -> list[float | None]:
        """Return the percentile of each share: one pass over the buckets."""
        if not self.count:
            return [None] * len(shares)
        counted = list(accumulate(self._buckets))
        # The first bucket with a value whose count reaches the share.
        wanted = (max(share * self._count, 1) for share in shares)
        edges = (_edge(bisect_left(counted, least) + 1) for least in wanted)
        return [min(edge, self._greatest_ns) / 1e9 for edge in edges]

    def cumulative(self) -> dict[str, Any]:
        """Return what a status has for histograms: ``count``, ``sum_s`` and ``buckets``.

        ``buckets`` counts the durations below each of ``EDGES_NS``.
        """
        self._sort()
        counted = list(accumulate(self._buckets))
        below = [counted[octave * PER_OCTAVE - 1] for octave in EDGE_OCTAVES]
        return {"count": self._count, "sum_s": self._sum_ns / 1e9, "buckets": below}

    def summary_us(self) -> dict[str, float | None]:
        """What a status shows [us]."""
        values = self._percentiles((0.5, 0.99, 0.999))
        summary = dict(zip(("p50", "p99", "p999"), values, strict=True))
        summary["max"] = self._greatest_ns / 1e9 if self._count else None
        return {k: None if v is None else round(v * 1e6, 1) for k, v in summary.items()}


def _edge(index: int) -> int:
    """The least value of a bucket [ns]."""
    octave, eighth = divmod(index, PER_OCTAVE)
    if octave < 3:
        return index
    return (PER_OCTAVE + eighth) << (octave - 3)
