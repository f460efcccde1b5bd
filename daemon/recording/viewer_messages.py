"""What a step says, as the messages that viewers know: joints, transforms, poses, log.

Law of this file: pure; values in, JSON out. Shapes as published by Foxglove as ``foxglove.*`` JSON
schemas; Lichtblick, Foxglove Studio and PlotJuggler read them. Rounded to a micrometre and a
microradian: whoever wants every bit reads the steps.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

if TYPE_CHECKING:  # the process that writes recordings has nothing of the step to load
    from linemate.daemon.core.inputs import Inputs
    from linemate.daemon.core.step import Outputs

BASE: Final = "base"
AXES: Final = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
POSES: Final = {"target": "tcp", "sensed": "tcp_sensed", "part": "hub"}
"""Poses of the outputs, and what the frames are called that they make."""

INFO: Final = 2
WARNING: Final = 3

_DIGITS: Final = 6


def _object(properties: Mapping[str, Any], title: str | None = None) -> dict[str, Any]:
    named = {} if title is None else {"title": title}
    return {**named, "type": "object", "properties": properties, "required": list(properties)}


_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string"}
_TIME: Final = {
    "title": "time",
    "type": "object",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
    },
}
_VECTOR: Final = _object(dict.fromkeys("xyz", _NUMBER), "foxglove.Vector3")
_QUATERNION: Final = _object(dict.fromkeys("xyzw", _NUMBER), "foxglove.Quaternion")

SCHEMAS: Final[dict[str, dict[str, Any]]] = {
    schema["title"]: schema
    for schema in (
        _object(
            {
                "timestamp": _TIME,
                "joints": {
                    "type": "array",
                    "items": {
                        "title": "foxglove.JointState",
                        "type": "object",
                        "properties": {"name": _TEXT, "position": _NUMBER, "velocity": _NUMBER},
                        "required": ["name"],
                    },
                },
            },
            "foxglove.JointStates",
        ),
        _object(
            {
                "transforms": {
                    "type": "array",
                    "items": _object(
                        {
                            "timestamp": _TIME,
                            "parent_frame_id": _TEXT,
                            "child_frame_id": _TEXT,
                            "translation": _VECTOR,
                            "rotation": _QUATERNION,
                        },
                        "foxglove.FrameTransform",
                    ),
                }
            },
            "foxglove.FrameTransforms",
        ),
        _object(
            {
                "timestamp": _TIME,
                "frame_id": _TEXT,
                "pose": _object({"position": _VECTOR, "orientation": _QUATERNION}, "foxglove.Pose"),
            },
            "foxglove.PoseInFrame",
        ),
        _object(
            {
                "timestamp": _TIME,
                "level": {"title": "foxglove.LogLevel", "oneOf": [{"const": i} for i in range(6)]},
                "message": _TEXT,
                "name": _TEXT,
                "file": _TEXT,
                "line": {"type": "integer", "minimum": 0},
            },
            "foxglove.Log",
        ),
    )
}
"""JSON schemas by name; optional properties that are never written are left out."""

TOPICS: Final[dict[str, str]] = {
    "/joints": "foxglove.JointStates",
    "/joints_commanded": "foxglove.JointStates",
    "/tf": "foxglove.FrameTransforms",
    **{f"/pose/{name}": "foxglove.PoseInFrame" for name in POSES},
    "/log": "foxglove.Log",
}
"""Topics and the schema of each."""


class Glimpse(Struct, frozen=True):
    """What a viewer is shown of one step.

    Attributes:
        measured: joints A1..A6 [rad] and E1 [m], None without a telegram.
        poses: in base, position and quaternion w first, by their name in the outputs.
    """

    measured: tuple[float, ...] | None
    commanded: tuple[float, ...]
    poses: tuple[tuple[str, tuple[float, ...]], ...]


def glimpse(inputs: Inputs, outputs: Outputs) -> Glimpse:
    """Return what a viewer is shown of a step."""
    axes = len(outputs.command)
    robot = inputs.robot
    measured = None if robot is None else (*robot.joints, *robot.external)[:axes]
    poses = ((name, getattr(outputs, name)) for name in POSES)
    there = tuple((name, pose) for name, pose in poses if pose is not None)
    return Glimpse(measured, outputs.command, there)


def shown(seen: Glimpse, wall_ns: int, root: str) -> list[tuple[str, bytes]]:
    """Return the messages of a step, topic and JSON.

    Args:
        wall_ns: its time since the epoch [ns].
        root: the URDF's first link, which stands in base.
    """
    time = _time(wall_ns)
    messages = [("/joints_commanded", _joints(time, seen.commanded))]
    if seen.measured is not None:
        messages.append(("/joints", _joints(time, seen.measured)))
    transforms = [_transform(time, root, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))]
    for name, pose in seen.poses:
        where = {"position": _vector(pose[:3]), "orientation": _quaternion(pose[3:])}
        told = {"timestamp": time, "frame_id": BASE, "pose": where}
        messages.append((f"/pose/{name}", told))
        transforms.append(_transform(time, POSES[name], pose))
    messages.append(("/tf", {"transforms": transforms}))
    return [(topic, as_json(value)) for topic, value in messages]


def line(text: str, wall_ns: int, level: int = INFO, name: str = "linemated") -> bytes:
    """Return a line of the log, as JSON.

    Args:
        text: for whoever reads it.
        wall_ns: its time since the epoch [ns].
        name: of who writes it.
    """
    told = {"timestamp": _time(wall_ns), "level": level, "message": text, "name": name}
    return as_json({**told, "file": "", "line": 0})


def as_json(value: Any) -> bytes:
    """Return a value as compact JSON."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


def root_link(urdf: str) -> str:
    """Return the link of a URDF that no joint leads to, the base's own name if there is none."""
    try:
        robot = ET.fromstring(urdf)  # noqa: S314 - of our own configuration
    except ET.ParseError:
        return BASE
    children = {child.get("link") for child in robot.iterfind("joint/child")}
    names = (link.get("name") for link in robot.iterfind("link"))
    return next((name for name in names if name and name not in children), BASE)


def scene(texts: Mapping[str, str], cycle_s: float) -> dict[str, Any]:
    """Return what a view must know once to draw the cell: its task, its arm, its cycle.

    Args:
        texts: of the cell, by name, as a recording holds them.
        cycle_s: T0 [s].
    """
    return {
        "task": texts.get("task", ""),
        "urdf": kinematics(texts.get("urdf", "")),
        "cycle_s": cycle_s,
    }


def kinematics(urdf: str) -> str:
    """Return a URDF with its links and joints alone, without what they look like or weigh.

    Args:
        urdf: the text; one that is no URDF gives an empty text.
    """
    try:
        robot = ET.fromstring(urdf)  # noqa: S314 - of our own configuration
    except ET.ParseError:
        return ""
    bare = ET.Element("robot", {"name": robot.get("name", "")})
    for link in robot.iterfind("link"):
        ET.SubElement(bare, "link", {"name": link.get("name", "")})
    for joint in robot.iterfind("joint"):
        kept = ET.SubElement(bare, "joint", dict(joint.attrib))
        for part in ("parent", "child", "origin", "axis"):
            found = joint.find(part)
            if found is not None:
                ET.SubElement(kept, part, dict(found.attrib))
    return ET.tostring(bare, encoding="unicode")


def _time(wall_ns: int) -> dict[str, int]:
    seconds, rest = divmod(max(wall_ns, 0), 1_000_000_000)
    return {"sec": seconds, "nsec": rest}


def _joints(time: dict[str, int], axes: Sequence[float]) -> dict[str, Any]:
    named = zip(AXES, axes, strict=False)
    joints = [{"name": name, "position": round(value, _DIGITS)} for name, value in named]
    return {"timestamp": time, "joints": joints}


def _transform(time: dict[str, int], child: str, pose: Sequence[float]) -> dict[str, Any]:
    return {
        "timestamp": time,
        "parent_frame_id": BASE,
        "child_frame_id": child,
        "translation": _vector(pose[:3]),
        "rotation": _quaternion(pose[3:]),
    }


def _vector(values: Sequence[float]) -> dict[str, float]:
    return {axis: round(value, _DIGITS) for axis, value in zip("xyz", values, strict=True)}


def _quaternion(values: Sequence[float]) -> dict[str, float]:
    return {part: round(value, _DIGITS) for part, value in zip("wxyz", values, strict=True)}
