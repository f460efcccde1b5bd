"""Fields of the two telegrams of one configuration, in wire order.

Invariants:
    KUKA's keywords (DEF_RIst, DEF_EIPos, ...) and the names of corrections (AK, AKorr, EK, EKorr)
    are known here only.
    Every other tag is a channel with its own name, in the wire's unit.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from linemate.protocol.rsi.ethernet_config import PLACEHOLDER, Element, ElementType, RsiConfig
from linemate.protocol.rsi.telegram import Channel
from linemate.protocol.rsi.xml_scan import RsiError
from linemate.protocol.units import DEG, MM

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL_AXES = ("E1", "E2", "E3", "E4", "E5", "E6")
CARTESIAN = ("X", "Y", "Z", "A", "B", "C")

VectorName = Literal[
    "joints", "joint_setpoints", "external", "external_setpoints", "tcp", "tcp_setpoint"
]

_VECTORS: dict[str, tuple[VectorName, tuple[str, ...]]] = {
    "RIst": ("tcp", CARTESIAN),
    "RSol": ("tcp_setpoint", CARTESIAN),
    "AIPos": ("joints", AXES),
    "ASPos": ("joint_setpoints", AXES),
    "EIPos": ("external", EXTERNAL_AXES),
    "ESPos": ("external_setpoints", EXTERNAL_AXES),
}
_CHANNEL_GROUPS = {"MACur": AXES, "MECur": EXTERNAL_AXES}


@dataclass(frozen=True, slots=True)
class Field:
    """One value on the wire: an attribute, or an element's text (attribute None)."""

    element: str
    attribute: str | None
    type: ElementType

    @property
    def key(self) -> str:
        """Name as a channel: ``"DiL"``, ``"Digout.o1"``."""
        return self.element if self.attribute is None else f"{self.element}.{self.attribute}"


@dataclass(frozen=True, slots=True)
class Vector:
    """Fields that are one vector of a telegram.

    Attributes:
        fields: positions in ``Layout.fields``, one for each configured axis.
        axes: index of each field in the vector, ascending.
        scales: SI value of one unit on the wire, for each field.
        width: length of the vector when read.
        contiguous: the fields are adjacent on the wire and every axis is configured.
    """

    name: VectorName
    element: str
    fields: tuple[int, ...]
    axes: tuple[int, ...]
    scales: tuple[float, ...]
    width: int
    contiguous: bool


@dataclass(frozen=True, slots=True)
class Layout:
    """Telegram of one direction.

    Attributes:
        required: a telegram that lacks a field is refused.
        fields: every configured value in wire order, without the IPOC.
        delay: position of Delay/@D, or None.
        message: position of EStr, or None.
        channels: positions of the fields that are in no vector, by key.
    """

    root: str
    required: bool
    fields: tuple[Field, ...]
    vectors: tuple[Vector, ...]
    delay: int | None
    message: int | None
    channels: dict[str, int]


def robot_layout(config: RsiConfig, linear_external: Iterable[str]) -> Layout:
    """Return the layout of the robot's telegram: SEND.

    Args:
        linear_external: external axes in mm on the wire, by name; the others are in degrees.
    """
    fields = _grouped(field for e in config.send for field in _robot_fields(e))
    linear = frozenset(linear_external)
    keyword_elements = {e.tag.removeprefix("DEF_") for e in config.send if _is_keyword(e)}
    vectors = tuple(
        _vector(name, element, axes, fields, linear)
        for element, (name, axes) in _VECTORS.items()
        if element in keyword_elements
    )
    delay = _position(fields, "Delay", "D") if "Delay" in keyword_elements else None
    return _layout("Rob", fields, vectors, delay=delay, message=None)


def sensor_layout(
    config: RsiConfig,
    linear_external: Iterable[str],
    joint_tags: Iterable[str],
    external_tags: Iterable[str],
) -> Layout:
    """Return the layout of the reply to the robot: RECEIVE.

    Args:
        linear_external: external axes in mm on the wire, by name; the others are in degrees.
        joint_tags: names of elements with corrections of A1..A6.
        external_tags: names of elements with corrections of E1..E6.
    """
    fields = _grouped(field for e in config.receive for field in _sensor_fields(e))
    linear = frozenset(linear_external)
    wanted: tuple[tuple[VectorName, Iterable[str], tuple[str, ...]], ...] = (
        ("joints", joint_tags, AXES),
        ("external", external_tags, EXTERNAL_AXES),
    )
    vectors = tuple(
        _vector(name, element, axes, fields, linear)
        for name, tags, axes in wanted
        for element in _one_of(tags, fields)
    )
    keyword = any(e.tag == "DEF_EStr" for e in config.receive)
    message = _position(fields, "EStr", None) if keyword else None
    return _layout("Sen", fields, vectors, delay=None, message=message)


def sensor_constants(
    config: RsiConfig, layout: Layout, constants: Mapping[str, Channel]
) -> dict[str, Channel]:
    """Return constants by the key of their channel.

    Args:
        constants: by TAG; that of a function generator is the value of each of its parameters.

    Raises:
        RsiError: no such element in RECEIVE, or one whose value is in every reply.
    """
    elements = {element.tag: element for element in config.receive}
    known: dict[str, Channel] = {}
    for tag, value in constants.items():
        if tag not in elements:
            raise RsiError("not in RECEIVE", element=tag)
        for field in _sensor_fields(elements[tag]):
            if field.key not in layout.channels:
                raise RsiError("every reply gives it a value", element=tag)
            known[field.key] = value
    return known


def _layout(
    root: str,
    fields: tuple[Field, ...],
    vectors: tuple[Vector, ...],
    *,
    delay: int | None,
    message: int | None,
) -> Layout:
    named = {position for vector in vectors for position in vector.fields} | {delay, message}
    channels = {f.key: n for n, f in enumerate(fields) if n not in named}
    return Layout(root, root == "Rob", fields, vectors, delay, message, channels)


def _is_keyword(element: Element) -> bool:
    return element.tag.startswith("DEF_")


def _robot_fields(element: Element) -> list[Field]:
    if not _is_keyword(element):
        return _plain_fields(element)
    name = element.tag.removeprefix("DEF_")
    if name == "Delay":
        return [Field(name, "D", "LONG")]
    axes = _VECTORS[name][1] if name in _VECTORS else _CHANNEL_GROUPS.get(name)
    if axes is not None:
        return [Field(name, axis, "DOUBLE") for axis in axes]
    return _technology_fields(name)


def _sensor_fields(element: Element) -> list[Field]:
    if not _is_keyword(element):
        return _plain_fields(element)
    name = element.tag.removeprefix("DEF_")
    return [Field(name, None, "STRING")] if name == "EStr" else _technology_fields(name)


def _technology_fields(name: str) -> list[Field]:
    """Return the fields of a function generator, ``Tech.C2`` -> C21..C210.

    Another keyword has no fields: it cannot be written, and is skipped when read.
    """
    head, _, generator = name.partition(".")
    if head != "Tech" or len(generator) != 2 or generator[0] not in "CT":
        return []
    return [Field(head, f"{generator}{n}", "DOUBLE") for n in range(1, 11)]


def _plain_fields(element: Element) -> list[Field]:
    if element.tag == PLACEHOLDER:
        return []
    name, _, attribute = element.tag.partition(".")
    return [Field(name, attribute or None, element.type)]


def _grouped(fields: Iterable[Field]) -> tuple[Field, ...]:
    """Group the fields by element, elements in the order of their first field."""
    by_element: dict[str, list[Field]] = {}
    keys: set[str] = set()
    for field in fields:
        if field.key in keys or field.element == "IPOC":
            raise RsiError("stands twice in one telegram", element=field.key)
        keys.add(field.key)
        by_element.setdefault(field.element, []).append(field)
    for name, group in by_element.items():
        if len({field.attribute is None for field in group}) > 1:
            raise RsiError("is both a value and a group", element=name)
    return tuple(field for group in by_element.values() for field in group)


def _position(fields: tuple[Field, ...], element: str, attribute: str | None) -> int:
    return next(n for n, f in enumerate(fields) if (f.element, f.attribute) == (element, attribute))


def _one_of(tags: Iterable[str], fields: tuple[Field, ...]) -> list[str]:
    wanted = set(tags)
    present = list(dict.fromkeys(f.element for f in fields if f.element in wanted))
    if len(present) > 1:
        raise RsiError("two elements for the same axes", element=" and ".join(present))
    return present


def _vector(
    name: VectorName,
    element: str,
    axes: tuple[str, ...],
    fields: tuple[Field, ...],
    linear: frozenset[str],
) -> Vector:
    axis_positions = []
    for n, field in enumerate(fields):
        if field.element != element:
            continue
        if field.attribute not in axes or field.type != "DOUBLE":
            raise RsiError(f"must be DOUBLE and one of {', '.join(axes)}", element=field.key)
        axis_positions.append((axes.index(field.attribute), n))
    axis_positions.sort()
    width = axis_positions[-1][0] + 1 if axes is EXTERNAL_AXES else 6
    members = tuple(n for _, n in axis_positions)
    return Vector(
        name=name,
        element=element,
        fields=members,
        axes=tuple(axis for axis, _ in axis_positions),
        scales=tuple(_scale(axes[axis], linear) for axis, _ in axis_positions),
        width=width,
        contiguous=members == tuple(range(members[0], members[0] + width)),
    )


def _scale(axis: str, linear: frozenset[str]) -> float:
    return MM if axis in linear or axis in {"X", "Y", "Z"} else DEG
