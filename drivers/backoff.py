"""Delay before a lost link is opened again."""

from dataclasses import dataclass, field


@dataclass(slots=True)
class Backoff:
    """A delay that doubles from the first to the longest.

    Attributes:
        first_s: delay before the first reopening [s].
        longest_s: the upper limit [s].
    """

    first_s: float = 0.1
    longest_s: float = 2.0
    _next_s: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        """Refuse delays that are not positive.

        Raises:
            ValueError: if not 0 < first_s <= longest_s.
        """
        if not 0.0 < self.first_s <= self.longest_s:
            raise ValueError(f"need 0 < {self.first_s} <= {self.longest_s}")
        self.reset()

    def next_delay(self) -> float:
        """Return the delay to wait now [s], and double the next one."""
        delay_s = self._next_s
        self._next_s = min(2.0 * delay_s, self.longest_s)
        return delay_s

    def reset(self) -> None:
        """Begin with the first delay again: the link has worked."""
        self._next_s = self.first_s
