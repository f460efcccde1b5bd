"""Offset between a sender's clock and the local one, from one-way messages.

Invariants:
    The offset is the smallest ``arrival - sent`` of the window: the clocks' offset plus the
    shortest transit.
    Old minima leave with their slice of time, so that drifting and stepped clocks are followed.
"""

SLICES = 16  # of the window, each with its minimum


class ClockOffset:
    """Running minimum of ``arrival - sent`` over a window of time, exact to one slice.

    Attributes:
        offset_ns: local minus sender's clock [ns], None before the first message.
    """

    __slots__ = ("_current", "_minima", "_slice_ns", "offset_ns")

    def __init__(self, window_s: float = 30.0) -> None:
        """Begin without a message; the window is ``window_s`` long [s]."""
        self._slice_ns = max(1, round(window_s * 1e9 / SLICES))
        self._minima: dict[int, int] = {}
        self._current = 0
        self.offset_ns: int | None = None

    def learn(self, transit_ns: int, stamp_ns: int) -> int:
        """Add one message and return the offset [ns].

        Args:
            transit_ns: arrival (local clock) minus time of sending (sender's clock) [ns].
            stamp_ns: arrival [ns]; one that goes back belongs to the present slice.
        """
        current = stamp_ns // self._slice_ns
        if current > self._current or self.offset_ns is None:
            self._turn(current)
        if self._minima.get(self._current, transit_ns) >= transit_ns:
            self._minima[self._current] = transit_ns
        if self.offset_ns is None or transit_ns < self.offset_ns:
            self.offset_ns = transit_ns
        return self.offset_ns

    def clear(self) -> None:
        """Drop all minima, as after the sender's clock was set."""
        self._minima.clear()
        self.offset_ns = None

    def _turn(self, current: int) -> None:
        """Begin a slice, drop the oldest."""
        self._current = current
        self._minima = {k: v for k, v in self._minima.items() if k > current - SLICES}
        self.offset_ns = min(self._minima.values(), default=None)
