"""Parameters as operators see them: names, values, ranges, meanings.

Law of this file: the settings' own dataclasses say everything; types and ranges come from their
annotations, units and meanings from the ``Attributes`` of their docstrings. Nothing is written
down twice.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, get_type_hints

import annotated_types

from linemate.daemon.control.settings import ControlSettings
from linemate.daemon.service.settings import Config
from linemate.daemon.service.watch import WatchSettings
from linemate.daemon.tracking.settings import TrackingSettings

FIXED = "parameters are set in the configuration file and taken at the daemon's start"

_SECTIONS = {"tracking": TrackingSettings, "control": ControlSettings, "watch": WatchSettings}
_ENTRY = re.compile(r"^ {8}([a-z_][a-z_0-9, ]*): (.+(?:\n {12}.+)*)", re.MULTILINE)
_UNIT = re.compile(r"\[([^\]]+)\]")

Described = dict[str, Any]


def described(listed: Sequence[Described], params: Mapping[str, Any]) -> dict[str, Any]:
    """Answer the operation ``params``.

    Args:
        listed: every parameter.
        params: ``prefix`` picks those whose names begin so.
    """
    prefix = params.get("prefix", "")
    return {"params": [one for one in listed if one["name"].startswith(prefix)]}


def values(listed: Sequence[Described], params: Mapping[str, Any]) -> dict[str, Any]:
    """Answer the operation ``get``.

    Args:
        listed: every parameter.
        params: ``names``.
    """
    known = {one["name"]: one["value"] for one in listed}
    missing = [name for name in params["names"] if name not in known]
    if missing:
        return {"refused": f"no parameter {', '.join(missing)}"}
    return {"values": {name: known[name] for name in params["names"]}}


def every(config: Config) -> Iterator[Described]:
    """Every parameter there is; slow, for the start-up.

    Args:
        config: the daemon's.
    """
    for section, kind in _SECTIONS.items():
        yield from _of(section, getattr(config, section), kind())


def _of(name: str, value: Any, default: Any) -> Iterator[Described]:
    kind = type(value)
    about = _about(kind)
    for field in fields(value):
        path = f"{name}.{field.name}"
        item = getattr(value, field.name)
        usual = getattr(default, field.name, None) if default is not None else None
        if is_dataclass(item):
            yield from _of(path, item, usual)
        elif isinstance(item, tuple) and item and is_dataclass(item[0]):
            for index, part in enumerate(item):
                known = usual[index] if usual is not None and index < len(usual) else None
                yield from _of(f"{path}.{index}", part, known)
        else:
            yield {"name": path, "value": item, "default": usual, "live": False} | about.get(
                field.name, {}
            )


def _about(kind: type[Any]) -> dict[str, Described]:
    """Range, unit and meaning of each field of a settings class."""
    hints = get_type_hints(kind, include_extras=True)
    meanings = _meanings(kind.__doc__ or "")
    return {name: _range(hint) | meanings.get(name, {}) for name, hint in hints.items()}


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
