"""Turn-around times of replies, measured at the controller.

Invariants:
    Bounded memory.
    Percentiles are order statistics of all values, without interpolation.
"""

from array import array
from dataclasses import dataclass, field

KEEP = 200_000
PERCENTILES = {"p50": 0.50, "p99": 0.99, "p999": 0.999}


@dataclass(slots=True)
class TurnAround:
    """Times from a telegram's sending to its reply's arrival.

    Attributes:
        latest_ns: the last one [ns], None before the first.
        forgotten: values that were not kept.
    """

    latest_ns: int | None = None
    longest_ns: int = 0
    forgotten: int = 0
    _values: "array[int]" = field(default_factory=lambda: array("q"))

    def __len__(self) -> int:
        return len(self._values)

    def add(self, elapsed_ns: int) -> None:
        """Note one reply.

        Args:
            elapsed_ns: sending to arrival [ns].
        """
        self.latest_ns = elapsed_ns
        self.longest_ns = max(self.longest_ns, elapsed_ns)
        if len(self._values) < KEEP:
            self._values.append(elapsed_ns)
        else:
            self.forgotten += 1

    def clear(self) -> None:
        """Forget everything."""
        self.latest_ns, self.longest_ns, self.forgotten = None, 0, 0
        del self._values[:]

    def summary_us(self, newest: int | None = None) -> dict[str, float] | None:
        """Median, 99th and 99.9th percentile and maximum.

        Args:
            newest: of how many of the newest values; None: of all.

        Returns:
            By name [us]; None before the first reply.
        """
        if not self._values:
            return None
        values = sorted(self._values if newest is None else self._values[-newest:])
        summary = {
            name: values[min(int(share * len(values)), len(values) - 1)] / 1e3
            for name, share in PERCENTILES.items()
        }
        summary["max"] = (self.longest_ns if newest is None else values[-1]) / 1e3
        return summary
