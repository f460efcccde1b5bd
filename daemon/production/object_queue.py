"""Queue of announced parts: bounded, in the order of the conveyor.

Invariants:
- At most ``MOST_WAITING`` parts wait. A further one is refused.
- A part that was announced before is refused, among the last ``MOST_KNOWN``.
"""

from collections import deque
from collections.abc import Container
from typing import Final

from msgspec import Struct

MOST_WAITING: Final = 32
MOST_KNOWN: Final = 256


class AnnouncedPart(Struct, frozen=True):
    """A part on the conveyor.

    Attributes:
        variant: name of the variant, which chooses the task.
        distance: reading of the distance sensor as the part was announced [m].
    """

    part: str
    variant: str
    distance: float


class ObjectQueue:
    """Parts that wait for their turn, the next one first."""

    def __init__(self, variants: Container[str]) -> None:
        """Begin empty.

        Args:
            variants: names that may be announced.
        """
        self._variants = variants
        self._waiting: deque[AnnouncedPart] = deque()
        self._known: deque[str] = deque(maxlen=MOST_KNOWN)

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def waiting(self) -> tuple[AnnouncedPart, ...]:
        """The parts that wait, the next one first."""
        return tuple(self._waiting)

    @property
    def next(self) -> AnnouncedPart | None:
        """The next part, None if none waits."""
        return self._waiting[0] if self._waiting else None

    def announce(self, part: AnnouncedPart) -> str | None:
        """Add a part; return why it is refused, or None."""
        if part.variant not in self._variants:
            return f"variant {part.variant!r} is not known. Add it to production.variants."
        if part.part in self._known:
            return f"part {part.part!r} was announced before"
        if len(self._waiting) >= MOST_WAITING:
            return f"{len(self._waiting)} parts wait, at most {MOST_WAITING}. Skip some."
        last = self._waiting[-1] if self._waiting else None
        if last is not None and part.distance < last.distance:
            return (
                f"distance {part.distance:g} m is before that of part {last.part!r}, "
                f"{last.distance:g} m. Announce parts in their order on the conveyor."
            )
        self._waiting.append(part)
        self._known.append(part.part)
        return None

    def pop_part(self) -> AnnouncedPart:
        """Remove and return the next part.

        Raises:
            IndexError: none waits.
        """
        return self._waiting.popleft()

    def remove(self, part: str) -> AnnouncedPart | None:
        """Remove and return a part that waits, None if it does not."""
        for waiting in self._waiting:
            if waiting.part == part:
                self._waiting.remove(waiting)
                return waiting
        return None
