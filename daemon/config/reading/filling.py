"""Plain values to dataclasses of annotated types, or everything that is wrong with them.

Invariants:
- No value changes its kind, but for an integer that stands for a number, and a list for a tuple.
- The types are those of files: dataclasses, tuples, dicts, numbers, texts, enumerations, paths.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from decimal import Decimal
from enum import Enum
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, NamedTuple, Union, cast, get_args, get_origin
from typing import get_type_hints as hints_of

from annotated_types import Ge, Gt, Le, Len, Lt

from linemate.daemon.near_names import near_names

Place = tuple[str | int, ...]  # keys and indices from the root of the values


class Wrong(NamedTuple):
    """One thing that is wrong.

    Attributes:
        path: where in the values.
        what: message for the author of the file.
        at_key: the key is wrong, not its value.
        value: what stands there, if a message should show it.
    """

    path: Place
    what: str
    at_key: bool = False
    value: Any = MISSING


class _UnfitError(Exception):
    """A value cannot be used; what is wrong has been noted."""


Fill = Callable[[Any, Place, list[Wrong]], Any]


def fill(target: Any, value: Any) -> tuple[Any, list[Wrong]]:
    """Return the dataclass with these values, or None, and everything that is wrong.

    Args:
        value: plain values of any kind.
    """
    wrong: list[Wrong] = []
    filled = _attempt(_reader(target), value, (), wrong)
    return (None if wrong else filled), wrong


@cache
def _reader(kind: Any) -> Fill:
    """Return the function that reads a value of a type."""
    origin, inner = get_origin(kind), get_args(kind)
    if is_dataclass(kind):
        return _Mapping(cast("type[Any]", kind))
    if origin is not None:
        return _OF_PARTS[origin](inner)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return _choice({member.value: member for member in kind})
    return _PLAIN[kind]


def _attempt(read: Fill, value: Any, path: Place, wrong: list[Wrong]) -> Any:
    """Return the value as read, ``_UnfitError`` if that is impossible."""
    try:
        return read(value, path, wrong)
    except _UnfitError:
        return _UnfitError


def _refuse(wrong: list[Wrong], path: Place, what: str, value: Any = MISSING) -> _UnfitError:
    wrong.append(Wrong(path, what, value=value))
    return _UnfitError()


class _Mapping:
    """Reads a mapping to a dataclass."""

    def __init__(self, kind: type[Any]) -> None:
        hints = hints_of(kind, include_extras=True)
        own = [field for field in fields(kind) if field.init]
        self._kind = kind
        self._hints = {field.name: hints[field.name] for field in own}
        defaults = ((field.default, field.default_factory) for field in own)
        self._needed = [
            field.name
            for field, default in zip(own, defaults, strict=True)
            if default == (MISSING, MISSING)
        ]

    def __call__(self, value: Any, path: Place, wrong: list[Wrong]) -> Any:
        """Read all keys, then make the dataclass if none is wrong."""
        if not isinstance(value, Mapping):
            raise _refuse(wrong, path, "should be a mapping", value)
        before, given = len(wrong), {}
        wrong += self._misplaced(value, path)
        for name, part in value.items():
            if name in self._hints:
                given[name] = _attempt(_reader(self._hints[name]), part, (*path, name), wrong)
        if len(wrong) > before:
            raise _UnfitError
        try:
            return self._kind(**given)
        except ValueError as error:
            raise _refuse(wrong, path, str(error)) from error

    def _misplaced(self, value: Mapping[Any, Any], path: Place) -> Iterator[Wrong]:
        """Yield keys that are missing, and those that are not known."""
        yield from (Wrong((*path, name), "missing") for name in self._needed if name not in value)
        for key in value:
            if key not in self._hints:
                near = near_names(str(key), self._hints)
                yield Wrong((*path, key), f"unknown key{near}", at_key=True)


def _bounded(read: Fill, limits: Sequence[Any]) -> Fill:
    """Return a reader that checks limits too."""

    def bounded(value: Any, path: Place, wrong: list[Wrong]) -> Any:
        filled = read(value, path, wrong)
        for limit in limits:
            what = _excess(limit, filled)
            if what is not None:
                shown = MISSING if isinstance(limit, Len) else value
                raise _refuse(wrong, path, what, shown)
        return filled

    return bounded


def _excess(limit: Any, value: Any) -> str | None:
    """Return which limit a value does not keep, None if it does."""
    if isinstance(limit, Len):
        least, most = limit.min_length, limit.max_length
        items = "characters" if isinstance(value, str) else "items"
        if len(value) < least:
            return f"should have at least {least} {items}, not {len(value)}"
        if most is not None and len(value) > most:
            return f"should have at most {most} {items}, not {len(value)}"
        return None
    name, words, keeps = _LIMITS[type(limit)]
    bound = getattr(limit, name)
    return None if keeps(value, bound) else f"should be {words} {_spelled(bound)}"


_LIMITS: Final[dict[type[Any], tuple[str, str, Callable[[Any, Any], bool]]]] = {
    Ge: ("ge", "greater than or equal to", lambda value, bound: value >= bound),
    Gt: ("gt", "greater than", lambda value, bound: value > bound),
    Le: ("le", "less than or equal to", lambda value, bound: value <= bound),
    Lt: ("lt", "less than", lambda value, bound: value < bound),
}


def _spelled(number: float) -> str:
    """Return a number without an exponent."""
    return f"{Decimal(repr(number)).normalize():f}"


def _union(kinds: Sequence[Any]) -> Fill:
    """Return a reader of one type or None, or of one of several plain types."""
    others = [kind for kind in kinds if kind is not NoneType]
    if len(others) == 1:
        read = _reader(others[0])
        return lambda value, path, wrong: None if value is None else read(value, path, wrong)

    def plain(value: Any, path: Place, wrong: list[Wrong]) -> Any:
        if type(value) in others:
            return value
        raise _refuse(wrong, path, "should be true, false, a number or a text", value)

    return plain


def _choice(choices: Mapping[Any, Any]) -> Fill:
    """Return a reader of some values."""
    *most, last = map(repr, choices)
    listed = f"{', '.join(most)} or {last}" if most else last

    def choice(value: Any, path: Place, wrong: list[Wrong]) -> Any:
        is_plain = isinstance(value, (str, int, float)) and not isinstance(value, bool)
        if is_plain and value in choices:
            return choices[value]
        raise _refuse(wrong, path, f"should be {listed}", value)

    return choice


def _items(value: Any, path: Place, wrong: list[Wrong]) -> Sequence[Any]:
    if isinstance(value, (list, tuple)):
        return value
    raise _refuse(wrong, path, "should be a list", value)


def _tuple(kinds: Sequence[Any]) -> Fill:
    """Return a reader of a list whose items are of one type, or of one type each."""
    return _list(_reader(kinds[0])) if kinds[1:] == (...,) else _row([*map(_reader, kinds)])


def _list(read: Fill) -> Fill:
    """Return a reader of a list of any length."""

    def items(value: Any, path: Place, wrong: list[Wrong]) -> Any:
        before, listed = len(wrong), _items(value, path, wrong)
        filled = tuple(_attempt(read, part, (*path, i), wrong) for i, part in enumerate(listed))
        if len(wrong) > before:
            raise _UnfitError
        return filled

    return items


def _row(reads: Sequence[Fill]) -> Fill:
    """Return a reader of a list whose length is fixed."""

    def row(value: Any, path: Place, wrong: list[Wrong]) -> Any:
        before, listed = len(wrong), _items(value, path, wrong)
        if len(listed) > len(reads):
            what = f"should have at most {len(reads)} items, not {len(listed)}"
            raise _refuse(wrong, path, what)
        parts = enumerate(zip(reads, listed, strict=False))
        filled = tuple(_attempt(read, part, (*path, i), wrong) for i, (read, part) in parts)
        wrong += (Wrong((*path, i), "missing") for i in range(len(listed), len(reads)))
        if len(wrong) > before:
            raise _UnfitError
        return filled

    return row


def _dict(read_key: Fill, read: Fill) -> Fill:
    """Return a reader of a mapping with any keys."""

    def entries(value: Any, path: Place, wrong: list[Wrong]) -> Any:
        if not isinstance(value, Mapping):
            raise _refuse(wrong, path, "should be a mapping", value)
        before = len(wrong)
        filled = {}
        for key, part in value.items():
            name = _attempt(read_key, key, (*path, key), wrong)
            filled[name] = _attempt(read, part, (*path, key), wrong)
        if len(wrong) > before:
            raise _UnfitError
        return filled

    return entries


def _number(value: Any, path: Place, wrong: list[Wrong]) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if math.isfinite(value):
            return float(value)
        raise _refuse(wrong, path, "should be a finite number")
    raise _refuse(wrong, path, "should be a valid number", value)


def _integer(value: Any, path: Place, wrong: list[Wrong]) -> int:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    raise _refuse(wrong, path, "should be a valid integer", value)


def _boolean(value: Any, path: Place, wrong: list[Wrong]) -> bool:
    if isinstance(value, bool):
        return value
    raise _refuse(wrong, path, "should be a valid boolean", value)


def _text(value: Any, path: Place, wrong: list[Wrong]) -> str:
    if isinstance(value, str):
        return value
    raise _refuse(wrong, path, "should be a valid string", value)


def _path(value: Any, path: Place, wrong: list[Wrong]) -> Path:
    return Path(_text(value, path, wrong))


_PLAIN: Final[dict[Any, Fill]] = {
    float: _number,
    int: _integer,
    bool: _boolean,
    str: _text,
    Path: _path,
    Any: lambda value, _path, _wrong: value,
}

_OF_PARTS: Final[dict[Any, Callable[[Sequence[Any]], Fill]]] = {
    Annotated: lambda inner: _bounded(_reader(inner[0]), inner[1:]),
    Union: _union,
    UnionType: _union,
    Literal: lambda inner: _choice({value: value for value in inner}),
    tuple: _tuple,
    dict: lambda inner: _dict(*map(_reader, inner)),
}
