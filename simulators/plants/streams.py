"""Named random streams: one generator a name.

Invariants:
    A stream depends on the seed and its name alone.
    Values do not depend on the block size of the draws.
"""

import hashlib
from collections.abc import Callable

import numpy as np
from numpy.random import Generator

_BLOCK = 512


def stream(seed: int, name: str) -> Generator:
    """Make the generator of one name.

    Args:
        seed: of the run, not negative.

    Returns:
        A fresh generator, always the same for the same arguments.
    """
    digest = hashlib.blake2b(name.encode(), digest_size=16).digest()
    words = [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words])))


class Draws:
    """Numbers of one stream, handed out a few at a time."""

    __slots__ = ("_draw", "_next", "_values")

    def __init__(self, draw: Callable[[int], list[float]]) -> None:
        self._draw = draw
        self._values: list[float] = []
        self._next = 0

    @classmethod
    def normal(cls, seed: int, name: str) -> "Draws":
        """Standard normal numbers of the stream `name`."""
        generator = stream(seed, name)

        def draw(count: int) -> list[float]:
            values: list[float] = generator.standard_normal(count).tolist()
            return values

        return cls(draw)

    @classmethod
    def uniform(cls, seed: int, name: str) -> "Draws":
        """Numbers uniform in [0, 1) of the stream `name`."""
        generator = stream(seed, name)

        def draw(count: int) -> list[float]:
            values: list[float] = generator.random(count).tolist()
            return values

        return cls(draw)

    def next_number(self) -> float:
        """Return the next number."""
        if self._next >= len(self._values):
            self._values, self._next = self._draw(_BLOCK), 0
        value = self._values[self._next]
        self._next += 1
        return value

    def next_numbers(self, count: int) -> list[float]:
        """Return the next ``count`` numbers, at most a block."""
        end = self._next + count
        if end > len(self._values):
            self._values = self._values[self._next :] + self._draw(_BLOCK)
            self._next, end = 0, count
        values = self._values[self._next : end]
        self._next = end
        return values
