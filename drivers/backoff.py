"""How long to wait before a lost link is opened again.

Law of this file: pure arithmetic, no clock and no randomness. Delays double from the first
to the longest, and start afresh once a link has lived.
"""

from dataclasses import dataclass, field


@dataclass(slots=True)
class Backoff:
    """A doubling delay.

    Attributes:
        first_s: delay before the first reopening [s].
        longest_s: delay that is never exceeded [s].
    """

    first_s: float = 0.1
    longest_s: float = 2.0
    _next_s: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        """Refuse delays that would spin or run backwards.

        Raises:
            ValueError: if not 0 < first_s <= longest_s.
        """
        if not 0.0 < self.first_s <= self.longest_s:
            raise ValueError(f"need 0 < {self.first_s} <= {self.longest_s}")
        self.reset()

    def next_delay(self) -> float:
        """The delay to wait now; the one after it is twice as long.

        Returns:
            A delay [s].
        """
        delay_s = self._next_s
        self._next_s = min(2.0 * delay_s, self.longest_s)
        return delay_s

    def reset(self) -> None:
        """Start afresh: the link has lived."""
        self._next_s = self.first_s
