"""The offset between a sender's clock and the local one, learned from one-way messages.

Law of this file: integers in, integers out, a bounded memory. The smallest ``arrival - sent`` of
the last seconds is the offset plus the shortest transit; longer transits are the network's
doing. Old minima leave with their slice of time, so that drifting and stepped clocks are followed.
"""

SLICES = 16


class ClockOffset:
    """Running minimum of ``arrival - sent`` over a window of time.

    The window is kept as ``SLICES`` slices with a minimum each: the memory is the same whatever
    the rate, and the window is exact to one slice.

    Attributes:
        offset_ns: local minus sender's clock [ns], None before the first message.
    """

    __slots__ = ("_current", "_minima", "_slice_ns", "offset_ns")

    def __init__(self, window_s: float = 30.0) -> None:
        """Know nothing.

        Args:
            window_s: length of the window [s].
        """
        self._slice_ns = max(1, round(window_s * 1e9 / SLICES))
        self._minima: dict[int, int] = {}
        self._current = 0
        self.offset_ns: int | None = None

    def learn(self, transit_ns: int, stamp_ns: int) -> int:
        """Take one message's ``arrival - sent``, return the offset [ns].

        Args:
            transit_ns: arrival (local clock) minus moment of sending (sender's clock) [ns].
            stamp_ns: arrival [ns]; one that goes back counts as now.
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
        """Forget everything, as after the sender's clock was set."""
        self._minima.clear()
        self.offset_ns = None

    def _turn(self, current: int) -> None:
        """Begin a slice, let the oldest go."""
        self._current = current
        self._minima = {k: v for k, v in self._minima.items() if k > current - SLICES}
        self.offset_ns = min(self._minima.values(), default=None)
