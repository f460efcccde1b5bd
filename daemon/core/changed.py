"""A frozen value with some of its fields changed, cheaply.

Law of this file: what ``dataclasses.replace`` does, for the few states that every step changes
several times over. Those keep their fields in a ``__dict__`` (no slots), so that a copy is one
call of C: 0.7 us for seventeen fields, where ``replace`` takes 9 us.
"""

from typing import Any, TypeVar

T = TypeVar("T")


def changed(value: T, **fields: Any) -> T:
    """Return a frozen dataclass without slots, some fields changed; nothing is checked."""
    made = object.__new__(type(value))
    made.__dict__.update(value.__dict__, **fields)
    return made
