"""Messages for viewers: joints, transforms, poses and log lines of a step, as JSON.

Foxglove publishes the shapes as ``foxglove.*`` JSON schemas. Lichtblick, Foxglove Studio and
PlotJuggler read them.

Invariants:
- Values are rounded to 1 um and 1 urad. The exact values are in the steps.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from linemate.protocol.stamped_samples import AXES

if TYPE_CHECKING:  # the writer process must not import daemon.core
    from linemate.daemon.core.inputs import Inputs
    from linemate.daemon.core.step_state import Outputs

BASE: Final = "base"
POSES: Final = {"target": "tcp", "sensed": "tcp_sensed", "part": "hub"}  # output: frame

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

# JSON schemas by name, without the optional properties that are never written.
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

# Schema of each topic.
TOPICS: Final[dict[str, str]] = {
    "/joints": "foxglove.JointStates",
    "/joints_commanded": "foxglove.JointStates",
    "/tf": "foxglove.FrameTransforms",
    **{f"/pose/{name}": "foxglove.PoseInFrame" for name in POSES},
    "/log": "foxglove.Log",
}


class StepView(Struct, frozen=True):
    """Joints and poses of one step.

    Attributes:
        measured: joints A1..A6 [rad] and E1 [m], None without a telegram.
        poses: (name in the outputs, position [m] and quaternion w first), in base.
    """

    measured: tuple[float, ...] | None
    commanded: tuple[float, ...]
    poses: tuple[tuple[str, tuple[float, ...]], ...]


def step_view(inputs: Inputs, outputs: Outputs) -> StepView:
    """Return the joints and poses of a step."""
    axes = len(outputs.command)
    robot = inputs.robot
    measured = None if robot is None else (*robot.joints, *robot.external)[:axes]
    poses = ((name, getattr(outputs, name)) for name in POSES)
    known = tuple((name, pose) for name, pose in poses if pose is not None)
    return StepView(measured, outputs.command, known)


def encode_view(view: StepView, wall_ns: int, root: str) -> list[tuple[str, bytes]]:
    """Return the topics and JSON messages of a step.

    Args:
        wall_ns: time of the step since the epoch [ns].
        root: first link of the URDF, whose frame is base.
    """
    time = _time(wall_ns)
    messages = [("/joints_commanded", _joints(time, view.commanded))]
    if view.measured is not None:
        messages.append(("/joints", _joints(time, view.measured)))
    transforms = [_transform(time, root, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))]
    for name, pose in view.poses:
        where = {"position": _vector(pose[:3]), "orientation": _quaternion(pose[3:])}
        message = {"timestamp": time, "frame_id": BASE, "pose": where}
        messages.append((f"/pose/{name}", message))
        transforms.append(_transform(time, POSES[name], pose))
    messages.append(("/tf", {"transforms": transforms}))
    return [(topic, as_json(value)) for topic, value in messages]


def encode_line(text: str, wall_ns: int, level: int = INFO, name: str = "linemated") -> bytes:
    """Return a log line as JSON.

    Args:
        wall_ns: time of the line since the epoch [ns].
    """
    message = {"timestamp": _time(wall_ns), "level": level, "message": text, "name": name}
    return as_json({**message, "file": "", "line": 0})


def as_json(value: Any) -> bytes:
    """Return a value as compact JSON."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


def root_link(urdf: str) -> str:
    """Return the link of a URDF that is no joint's child, ``base`` if there is none."""
    try:
        robot = ET.fromstring(urdf)  # noqa: S314 - of our own configuration
    except ET.ParseError:
        return BASE
    children = {child.get("link") for child in robot.iterfind("joint/child")}
    names = (link.get("name") for link in robot.iterfind("link"))
    return next((name for name in names if name and name not in children), BASE)


def scene(texts: Mapping[str, str], cycle_s: float) -> dict[str, Any]:
    """Return what a viewer needs once to draw the cell: task, arm and period T0 [s].

    Args:
        texts: texts of the cell by name, as in a recording.
    """
    geometry = {"geometry": texts["geometry"]} if "geometry" in texts else {}
    return {
        "task": texts.get("task", ""),
        "urdf": kinematics(texts.get("urdf", "")),
        **geometry,
        "cycle_s": cycle_s,
    }


def kinematics(urdf: str) -> str:
    """Return a URDF with links and joints only, an empty text if it is not XML."""
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
            element = joint.find(part)
            if element is not None:
                ET.SubElement(kept, part, dict(element.attrib))
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
