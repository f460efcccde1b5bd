"""Values that are made thousands of times a second: frozen to whoever reads, cheap to make.

Law of this file: no class here, one decorator. ``dataclass(frozen=True)`` sets each field by way
of ``object.__setattr__``: 20 fields take 4.9 us instead of 0.4 us (CPython 3.11), and a cycle
makes some 250. The type checker holds these values frozen all the same, and with
``LINEMATE_FROZEN`` in the environment, as in every test run, the interpreter does as well.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar, dataclass_transform

T = TypeVar("T")

FROZEN = "LINEMATE_FROZEN"


@dataclass_transform(frozen_default=True)
def frozen(*, slots: bool = True, eq: bool = True) -> Callable[[type[T]], type[T]]:
    """Make a class a frozen dataclass that costs little to make.

    Args:
        slots: fields in slots; else in a ``__dict__``, as ``daemon.core.changed`` wants them.
        eq: equal when all fields are, and hashable.
    """
    is_frozen = bool(os.environ.get(FROZEN))
    options: dict[str, Any] = {"slots": slots, "eq": eq, "frozen": is_frozen}
    if not is_frozen:
        options["unsafe_hash"] = eq
    return dataclass(**options)
