"""Values that are right for certain, filled by msgspec without the time that pydantic needs.

Invariants:
- What is accepted here, pydantic accepts with the same values; the tests compare them.
- Anything else is left to pydantic, which says what is wrong with it.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import repeat, starmap
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
from annotated_types import Ge, Gt, Le, Len, Lt

T = TypeVar("T")


def filled(target: type[T], value: Any) -> T | None:
    """Return a dataclass with these plain values; None if pydantic has to judge them."""
    try:
        whole = msgspec.convert(value, target, dec_hook=_path)
    except (msgspec.ValidationError, ValueError, TypeError, OverflowError, RecursionError):
        return None
    is_whole = _is_all_there(value, msgspec.to_builtins(whole, enc_hook=str))
    return whole if is_whole and _keeps(target, whole) else None


def _path(kind: type[Any], value: Any) -> Any:
    if kind is Path and isinstance(value, str):
        return Path(value)
    raise TypeError(kind)


def _is_all_there(value: Any, whole: Any) -> bool:
    """Return whether plain values stand in others as they are: no key lost, no kind changed."""
    if isinstance(value, Mapping):
        same = isinstance(whole, Mapping) and value.keys() <= whole.keys()
        return same and all(_is_all_there(part, whole[key]) for key, part in value.items())
    if isinstance(value, list):
        same = isinstance(whole, (list, tuple)) and len(value) == len(whole)
        return same and all(map(_is_all_there, value, whole))
    if isinstance(value, float) and not math.isfinite(value):
        return False
    is_number = type(value) is int and type(whole) is float
    return bool(value == whole) and (is_number or type(value) is type(whole))


def _keeps(hint: Any, value: Any) -> bool:
    """Return whether a value is of an annotated type and keeps its limits."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _keeps(inner[0], value) and all(_is_within(limit, value) for limit in inner[1:])
    if origin in (Union, UnionType):
        return any(_keeps(option, value) for option in inner)
    if origin is Literal:
        return any(value == option and type(value) is type(option) for option in inner)
    kind = origin or hint
    is_kind = kind is Any or (isinstance(value, kind) and (kind is bool) is (type(value) is bool))
    return is_kind and all(starmap(_keeps, _parts(hint, value)))


def _parts(hint: Any, value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the parts of a value, each behind its annotated type."""
    inner = get_args(hint)
    if isinstance(value, tuple):
        yield from zip(repeat(inner[0]) if inner[-1] is Ellipsis else inner, value, strict=False)
    elif isinstance(value, Mapping) and inner:
        for key, part in value.items():
            yield from ((inner[0], key), (inner[1], part))
    elif is_dataclass(hint) and isinstance(hint, type):
        for name, kind in _hints(hint).items():
            yield kind, getattr(value, name)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Return the annotated types of a dataclass by the names of its fields."""
    hints = get_type_hints(kind, include_extras=True)
    return {part.name: hints[part.name] for part in fields(kind)}


def _is_within(limit: Any, value: Any) -> bool:
    match limit:
        case Ge():
            return bool(value >= limit.ge)
        case Gt():
            return bool(value > limit.gt)
        case Le():
            return bool(value <= limit.le)
        case Lt():
            return bool(value < limit.lt)
        case Len():
            return limit.min_length <= len(value) <= (limit.max_length or math.inf)
    return False
