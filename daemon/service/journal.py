"""Journal lines: a rate limit, and the text of sensors that come and go.

Invariants:
- Time comes in as a stamp.
- At most ``most`` lines in any second. A line beyond that is joined to the next one.
"""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Final

from linemate.daemon.cycle.sensing.samples import SensorFact

SECOND_NS: Final = 1_000_000_000
WAITING: Final = 8  # texts that wait; further ones are counted only


class Journal:
    """Rate limiter for lines. Lines beyond the limit wait and are joined.

    Attributes:
        suppressed: dropped texts that no line has counted yet.
    """

    def __init__(self, write: Callable[[str], object], most: int) -> None:
        """Begin without lines.

        Args:
            most: lines in any second.
        """
        self.suppressed = 0
        self._write = write
        self._waiting: deque[str] = deque()
        self._stamps: deque[int] = deque([-SECOND_NS] * most, maxlen=most)

    def write_line(self, now_ns: int, text: str) -> None:
        """Write a line, at once if the limit allows."""
        if len(self._waiting) < WAITING:
            self._waiting.append(text)
        else:
            self.suppressed += 1
        self.catch_up(now_ns)

    def catch_up(self, now_ns: int) -> None:
        """Write the waiting texts as one line if the limit allows at a monotonic time [ns]."""
        if not self._waiting or now_ns - self._stamps[0] < SECOND_NS:
            return
        left_out = [f"{self.suppressed} more, see the recording's /log"] if self.suppressed else []
        line = " | ".join([*self._waiting, *left_out])
        self._waiting.clear()
        self.suppressed = 0
        self._stamps.append(now_ns)
        self._write(line)


class SensorChanges:
    """Sensors that come and go."""

    def __init__(self) -> None:
        self._out_since_ns: dict[str, int | None] = {}

    def changes(
        self,
        now_ns: int,
        sensors: Mapping[str, SensorFact],
        limits_s: Mapping[str, float],
        covered: frozenset[str] = frozenset(),
    ) -> list[str]:
        """Return a line for each sensor that came or went since the last call.

        Args:
            limits_s: age of the newest sample beyond which a sensor counts as out [s].
            covered: sensors that the tool covers now; their silence is normal.
        """
        lines = []
        for name, sensor in sensors.items():
            if sensor.stamp_ns is None:
                continue
            why = _why_out(now_ns, sensor, limits_s[name])
            was_out = self._out_since_ns.get(name, sensor.stamp_ns)
            if why is None and was_out is not None:
                is_first = name not in self._out_since_ns
                lasted = "" if is_first else f" after {(now_ns - was_out) * 1e-9:.2f} s"
                lines.append(f"sensor {name} in{lasted}")
                self._out_since_ns[name] = None
            elif why is not None and was_out is None:
                todo = "The tool covers it." if name in covered else "Check its link."
                lines.append(f"sensor {name} out: {why}. {todo}")
                self._out_since_ns[name] = now_ns
        return lines


def _why_out(now_ns: int, sensor: SensorFact, limit_s: float) -> str | None:
    if sensor.excluded is not None:
        return f"excluded, {sensor.excluded}"
    assert sensor.stamp_ns is not None  # noqa: S101 - the caller looked
    age_s = (now_ns - sensor.stamp_ns) * 1e-9
    return f"silent for {age_s:.2f} s, limit {limit_s:.2f} s" if age_s > limit_s else None
