"""Parameters as operators see them: name, value, type, range, unit, meaning, and when they change.

Types, ranges and defaults come from the JSON schema of the configuration, units and meanings from
the ``Attributes`` of the settings' docstrings. Only when a parameter may change is listed here.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any, Final

from linemate.daemon.config import documents
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.settings import Config
from linemate.daemon.config.settings_tree import SECTIONS, leaves
from linemate.daemon.near_names import near_names

_UNIT = re.compile(r"\[([^\]]+)\]")

Parameter = dict[str, Any]
Node = Mapping[str, Any]  # of a JSON schema


class ChangeTime(StrEnum):
    """When a parameter may change."""

    LIVE = "live"
    IDLE = "idle"
    RESTART = "restart"


@dataclass(frozen=True, slots=True)
class ChangeRule:
    """When a parameter may change, and whether also in contact, and in motion without it."""

    change: ChangeTime
    in_contact: bool = True
    in_motion: bool = True

    @property
    def shown(self) -> ChangeTime:
        """When it may change as operators see it, with or without the compiler."""
        return self.change if self.in_motion else ChangeTime.IDLE


_LIVE: Final = ChangeRule(ChangeTime.LIVE)
_NOT_IN_CONTACT: Final = ChangeRule(ChangeTime.LIVE, in_contact=False)
_AT_REST: Final = ChangeRule(ChangeTime.LIVE, in_contact=False, in_motion=False)
_IDLE: Final = ChangeRule(ChangeTime.IDLE, in_contact=False, in_motion=False)
_RESTART: Final = ChangeRule(ChangeTime.RESTART, in_contact=False)

# Rules by name or beginning of a name; the longest counts, all others need a restart. A parameter
# is live if it keeps the shapes of the step's state and reaches the command through the merge only,
# which smooths any change of the prediction. A delay or a model of the robot waits for idle.
RULES: Final[dict[str, ChangeRule]] = {
    "tracking": _IDLE,
    "tracking.distance.deviation": _LIVE,
    "tracking.distance.gate": _LIVE,
    "tracking.distance.late": _AT_REST,  # the object would jump by its speed times this
    "tracking.distance.scale": _AT_REST,
    "tracking.camera": _LIVE,
    "tracking.camera.blind_below": _IDLE,  # the plan's waypoint moves with it
    "tracking.camera.lasting": _IDLE,  # the filter has states for it, or none
    "tracking.camera.felt": _NOT_IN_CONTACT,
    "tracking.camera.felt_depth": _NOT_IN_CONTACT,
    "tracking.camera.felt_turn": _NOT_IN_CONTACT,
    "tracking.fusion": _LIVE,
    "tracking.fusion.ripple_time": _IDLE,
    "tracking.fusion.initial_images": _IDLE,
    "tracking.payload.part_mass": _NOT_IN_CONTACT,
    "tracking.tactile": _NOT_IN_CONTACT,
    "tracking.tactile.stiffness": _IDLE,  # the plan's touch is as slow as it and the overload need
    "tracking.tactile.overload_force": _IDLE,
    "tracking.rule": _NOT_IN_CONTACT,
    "tracking.bank": _NOT_IN_CONTACT,
    "tracking.bank.longest_onset": _IDLE,
    "tracking.imm": _NOT_IN_CONTACT,
    "control": _IDLE,
    "watch": _LIVE,
}


def change_rule(name: str) -> ChangeRule:
    """Return when a parameter, by its dotted name, may change."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        rule = RULES.get(".".join(parts[:length]))
        if rule is not None:
            return rule
    return _RESTART


def select(parameters: Sequence[Parameter], params: Mapping[str, Any]) -> dict[str, Any]:
    """Answer the operation ``params``; its ``prefix`` selects names that begin so."""
    prefix = params.get("prefix", "")
    return {"params": [item for item in parameters if item["name"].startswith(prefix)]}


def read_values(parameters: Sequence[Parameter], params: Mapping[str, Any]) -> dict[str, Any]:
    """Answer the operation ``get``, whose ``names`` are dotted."""
    known = {item["name"]: item["value"] for item in parameters}
    missing = [name for name in params["names"] if name not in known]
    if missing:
        return {"refused": f"no parameter {', '.join(missing)}{near_names(missing[0], known)}"}
    return {"values": {name: known[name] for name in params["names"]}}


def list_parameters(config: Config) -> Iterator[Parameter]:
    """Yield every parameter, tracking, control and watch first."""
    defaults = dict(leaves(Config(task=config.task)))
    order = [*SECTIONS]

    def rank(leaf: tuple[str, Any]) -> int:
        section = leaf[0].partition(".")[0]
        return order.index(section) if section in SECTIONS else len(order)

    for name, value in sorted(leaves(config), key=rank):
        if value is None and "." not in name:
            continue  # a section that is left out
        node = _schema()
        for part in name.split("."):
            node = _below(node, part)
        rule = change_rule(name)
        parameter: Parameter = {
            "name": name,
            "value": value,
            "default": defaults.get(name, node.get("default")),
            "live": rule.shown is ChangeTime.LIVE,
            "change": rule.shown.value,
        }
        if rule.shown is ChangeTime.LIVE and not rule.in_contact:
            parameter["in_contact"] = False
        yield parameter | _describe(node, _schema())


def describe_fields(kind: type[Any]) -> dict[str, Parameter]:
    """Return type, range, unit and meaning of each field of a settings class."""
    schema = documents.schema(kind, kind.__name__)
    return {name: _describe(node, schema) for name, node in schema["properties"].items()}


@cache
def _schema() -> Node:
    """Return the shipped schema of the configuration: to make it is a tenth of a start."""
    text = (DAEMON_DATA / "linemated.schema.json").read_text(encoding="utf-8")
    schema: Node = json.loads(text)
    return schema


def _resolve(node: Node, schema: Node) -> Node:
    """Return the definition of a node, without ``None`` as its alternative."""
    for alternative in node.get("anyOf", ()):
        if alternative.get("type") != "null":
            return _resolve(alternative, schema)
    if "$ref" in node:
        definition: Node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        return _resolve(definition, schema)
    return node


def _below(node: Node, part: str) -> Node:
    """Return the node of a field, or of an item of a list."""
    node = _resolve(node, _schema())
    if not part.isdecimal():
        below: Node = node["properties"][part]
        return below
    items = node.get("prefixItems", ())
    item: Node = items[int(part)] if int(part) < len(items) else node["items"]
    return item


_TYPES: Final = {
    "boolean": "bool", "integer": "int", "number": "float", "string": "text", "object": "map",
    "array": "list",
}  # fmt: skip
_BOUNDS: Final = {
    "minimum": "min", "exclusiveMinimum": "min", "maximum": "max", "exclusiveMaximum": "max",
}  # fmt: skip


def _describe(node: Node, schema: Node) -> Parameter:
    """Return type, choices, range, unit and meaning."""
    resolved = _resolve(node, schema)
    described: Parameter = {"type": _TYPES.get(resolved.get("type", ""), "text")}
    if "enum" in resolved or "const" in resolved:
        described["choices"] = resolved.get("enum", [resolved.get("const")])
    described |= {name: resolved[key] for key, name in _BOUNDS.items() if key in resolved}
    excluded = [_BOUNDS[key] for key in _BOUNDS if key in resolved and key.startswith("exclusive")]
    described |= {"excluded": excluded} if excluded else {}
    meaning = node.get("description")
    if meaning is not None:
        unit = _UNIT.search(meaning)
        described |= {"describe": meaning} | ({"unit": unit[1]} if unit else {})
    return described
