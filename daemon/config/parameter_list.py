"""Parameters as operators see them: names, values, types, ranges, meanings, and when they change.

Law of this file: the settings' own dataclasses say everything; types and ranges come from their
annotations, units and meanings from the ``Attributes`` of their docstrings. Only when a parameter
may change stands here, by its name.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from enum import Enum, StrEnum
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import annotated_types

from linemate.daemon.config.settings import Config
from linemate.daemon.config.settings_tree import SECTIONS
from linemate.daemon.near_names import near_names

_ENTRY = re.compile(r"^ {8}([a-z_][a-z_0-9, ]*): (.+(?:\n {12}.+)*)", re.MULTILINE)
_UNIT = re.compile(r"\[([^\]]+)\]")

Described = dict[str, Any]


class Change(StrEnum):
    """When a parameter may change."""

    LIVE = "live"
    IDLE = "idle"
    RESTART = "restart"


@dataclass(frozen=True, slots=True)
class Rule:
    """When a parameter may change, and whether in contact too."""

    change: Change
    in_contact: bool = True


_LIVE: Final = Rule(Change.LIVE)
_NOT_IN_CONTACT: Final = Rule(Change.LIVE, in_contact=False)
_IDLE: Final = Rule(Change.IDLE, in_contact=False)
_RESTART: Final = Rule(Change.RESTART, in_contact=False)

# Live is what changes no shape of the step's state and enters the command through the merge
# alone, which takes up any change of the prediction smoothly. Whatever would be felt at once, a
# delay or a model of the robot among it, waits until the robot stands.
RULES: Final[dict[str, Rule]] = {
    "tracking": _IDLE,
    "tracking.distance.deviation": _LIVE,
    "tracking.distance.gate": _LIVE,
    "tracking.camera": _LIVE,
    "tracking.fusion": _LIVE,
    "tracking.fusion.ripple_time": _IDLE,
    "tracking.fusion.initial_images": _IDLE,
    "tracking.tactile": _NOT_IN_CONTACT,
    "tracking.rule": _NOT_IN_CONTACT,
    "tracking.bank": _NOT_IN_CONTACT,
    "tracking.bank.longest_onset": _IDLE,
    "tracking.imm": _NOT_IN_CONTACT,
    "control": _IDLE,
    "watch": _LIVE,
}
"""By name or what a name begins with, the longest counts; what is not here waits for a restart."""


def rule(name: str) -> Rule:
    """Return when a parameter may change."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        found = RULES.get(".".join(parts[:length]))
        if found is not None:
            return found
    return _RESTART


def described(listed: Sequence[Described], params: Mapping[str, Any]) -> dict[str, Any]:
    """Answer the operation ``params``.

    Args:
        params: ``prefix`` picks those whose names begin so.
    """
    prefix = params.get("prefix", "")
    return {"params": [one for one in listed if one["name"].startswith(prefix)]}


def values(listed: Sequence[Described], params: Mapping[str, Any]) -> dict[str, Any]:
    """Answer the operation ``get``."""
    known = {one["name"]: one["value"] for one in listed}
    missing = [name for name in params["names"] if name not in known]
    if missing:
        return {"refused": f"no parameter {', '.join(missing)}{near_names(missing[0], known)}"}
    return {"values": {name: known[name] for name in params["names"]}}


def every(config: Config) -> Iterator[Described]:
    """Every parameter there is; slow, for the start-up."""
    usual = Config(task=config.task)
    for section in SECTIONS:
        yield from _of(section, getattr(config, section), getattr(usual, section))
    meanings = about(Config)
    for field in fields(config):
        value, default = getattr(config, field.name), getattr(usual, field.name)
        if field.name in SECTIONS or value is None:
            continue
        if is_dataclass(value):
            yield from _of(field.name, value, default)
        else:
            yield _one(field.name, value, default) | meanings.get(field.name, {})


def _of(name: str, value: Any, default: Any) -> Iterator[Described]:
    kind = type(value)
    meanings = about(kind)
    for field in fields(value):
        path = f"{name}.{field.name}"
        item = getattr(value, field.name)
        # A section that is off by default has defaults all the same, once it is there.
        usual = _usual(field) if default is None else getattr(default, field.name, None)
        if is_dataclass(item):
            yield from _of(path, item, usual)
        elif isinstance(item, tuple) and item and is_dataclass(item[0]):
            for index, part in enumerate(item):
                known = usual[index] if usual is not None and index < len(usual) else None
                yield from _of(f"{path}.{index}", part, known)
        else:
            yield _one(path, item, usual) | meanings.get(field.name, {})


def _usual(field: Field[Any]) -> Any:
    return None if field.default is MISSING else field.default


def _one(name: str, value: Any, default: Any) -> Described:
    found = rule(name)
    told: Described = {
        "name": name,
        "value": value,
        "default": default,
        "live": found.change is Change.LIVE,
        "change": found.change.value,
    }
    if found.change is Change.LIVE and not found.in_contact:
        told["in_contact"] = False
    return told


def kinds(kind: type[Any]) -> Iterator[type[Any]]:
    """Every settings class below one, in the order of its fields."""
    for hint in get_type_hints(kind).values():
        for inner in _classes(hint):
            yield inner
            yield from kinds(inner)


def _classes(hint: Any) -> Iterator[type[Any]]:
    if is_dataclass(hint) and isinstance(hint, type):
        yield hint
    for part in get_args(hint):
        yield from _classes(part)


def about(kind: type[Any]) -> dict[str, Described]:
    """Type, range, unit and meaning of each field of a settings class."""
    hints = get_type_hints(kind, include_extras=True)
    meanings = _meanings(kind.__doc__ or "")
    return {
        name: _type(hint) | _range(hint) | meanings.get(name, {}) for name, hint in hints.items()
    }


_PLAIN: Final[dict[Any, str]] = {
    bool: "bool", int: "int", float: "float", str: "text", dict: "map", tuple: "list",
}  # fmt: skip


def _type(hint: Any) -> Described:
    """A type in one word, and the choices where there are only some."""
    origin = get_origin(hint)
    if hasattr(hint, "__metadata__"):
        return _type(get_args(hint)[0])
    if origin in {Union, UnionType}:
        (inner, *_) = [part for part in get_args(hint) if part is not NoneType]
        return _type(inner)
    if origin is Literal:
        choices = list(get_args(hint))
        return {"type": _PLAIN[type(choices[0])], "choices": choices}
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"type": "text", "choices": [member.value for member in hint]}
    return {"type": _PLAIN.get(origin or hint, "text")}


def _range(hint: Any) -> Described:
    bounds: Described = {}
    for bound in getattr(hint, "__metadata__", ()):
        if isinstance(bound, annotated_types.Ge):
            bounds["min"] = bound.ge
        elif isinstance(bound, annotated_types.Gt):
            bounds["min"] = bound.gt
        elif isinstance(bound, annotated_types.Le):
            bounds["max"] = bound.le
        elif isinstance(bound, annotated_types.Lt):
            bounds["max"] = bound.lt
    return bounds


def _meanings(docstring: str) -> dict[str, Described]:
    found: dict[str, Described] = {}
    for names, text in _ENTRY.findall(docstring):
        meaning = " ".join(text.split())
        unit = _UNIT.search(meaning)
        one: Described = {"describe": meaning} | ({"unit": unit[1]} if unit else {})
        found |= {name.strip(): one for name in names.split(",")}
    return found
