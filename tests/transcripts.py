"""Long random conversations with a pure machine, as one digest each.

What a machine answered is hashed word for word. A digest says that nothing has
changed, not that it is right: other tests check that. After a wanted change
copy the new digest from the failure. Random numbers come from ``random()`` alone, which
is the same in every version of Python.
"""

import random
from collections.abc import Sequence
from hashlib import blake2b
from typing import TypeVar

T = TypeVar("T")


class Chance:
    """A seeded source of choices."""

    def __init__(self, seed: object) -> None:
        self._random = random.Random(str(seed))

    def pick(self, among: Sequence[T]) -> T:
        return among[int(self._random.random() * len(among))]

    def happens(self, share: float) -> bool:
        return self._random.random() < share

    def between(self, low: float, high: float) -> float:
        return low + (high - low) * self._random.random()


class Transcript:
    """What was reported so far."""

    def __init__(self) -> None:
        self._hash = blake2b(digest_size=8)

    def say(self, *what: object) -> None:
        text = repr(what)
        assert " at 0x" not in text, f"it has no words of its own: {text}"
        self._hash.update((text + "\n").encode())

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()
