"""Histogram of durations: fixed size, percentiles within 9 %, about a microsecond a value.

Invariants:
- Pure. A bucket is an eighth of an octave wide. The greatest value is exact.
"""

from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

PER_OCTAVE = 8
OCTAVES = 40  # of nanoseconds: up to 18 minutes
EDGE_OCTAVES = range(14, 28)  # of a status' histograms: 16 us to 134 ms
EDGES_NS = tuple(1 << octave for octave in EDGE_OCTAVES)


@dataclass(slots=True)
class Histogram:
    """Durations, counted."""

    count: int = 0
    greatest_ns: int = 0
    sum_ns: int = 0
    _buckets: list[int] = field(default_factory=lambda: [0] * (PER_OCTAVE * OCTAVES))

    def add(self, duration_ns: int) -> None:
        """Count one; a negative one counts as 0."""
        value = max(0, duration_ns)
        self.count += 1
        self.greatest_ns = max(self.greatest_ns, value)
        self.sum_ns += value
        self._buckets[min(_bucket(value), len(self._buckets) - 1)] += 1

    def percentile(self, share: float) -> float | None:
        """A duration that this share of all does not exceed.

        Returns:
            Its bucket's upper edge, at most the greatest value [s]; None if there is none.
        """
        if not self.count:
            return None
        wanted = share * self.count
        seen = 0
        for index, count in enumerate(self._buckets):
            seen += count
            if seen >= wanted and count:
                return min(_edge(index + 1), self.greatest_ns) / 1e9
        return self.greatest_ns / 1e9

    def cumulative(self) -> dict[str, Any]:
        """Return what a status has for histograms: ``count``, ``sum_s`` and ``buckets``.

        ``buckets`` counts the durations below each of ``EDGES_NS``.
        """
        counted = list(accumulate(self._buckets))
        below = [counted[octave * PER_OCTAVE - 1] for octave in EDGE_OCTAVES]
        return {"count": self.count, "sum_s": self.sum_ns / 1e9, "buckets": below}

    def summary_us(self) -> dict[str, float | None]:
        """What a status shows [us]."""
        shares = {"p50": 0.5, "p99": 0.99, "p999": 0.999}
        found = {name: self.percentile(share) for name, share in shares.items()}
        found["max"] = self.greatest_ns / 1e9 if self.count else None
        return {k: None if v is None else round(v * 1e6, 1) for k, v in found.items()}


def _bucket(value: int) -> int:
    octave = max(0, value.bit_length() - 1)
    if octave < 3:
        return value  # fewer values than buckets
    return octave * PER_OCTAVE + ((value >> (octave - 3)) & (PER_OCTAVE - 1))


def _edge(index: int) -> int:
    """The least value of a bucket [ns]."""
    octave, eighth = divmod(index, PER_OCTAVE)
    if octave < 3:
        return index
    return (PER_OCTAVE + eighth) << (octave - 3)
