"""Task files: YAML to a ``TaskFile``, with the URDF that they name. Format: interfaces.md, 9.

Invariants:
- Conditions between values are checked with the ranges: increasing times, unit quaternions, axes.
- Quaternions and axes come out with length 1 exactly.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar, cast

import yaml

from linemate.daemon.config import documents, files
from linemate.daemon.config import settings_tree as tree
from linemate.daemon.config.documents import FileError, YamlDocument
from linemate.daemon.config.files import UnreadableError
from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.core import rotations
from linemate.daemon.core.control.settings import AxisGeometry, ControlSettings
from linemate.daemon.core.tracking.task import (
    ConveyorClasses,
    Gate,
    Phase,
    PoseFile,
    TaskFile,
    ToolTimes,
)
from linemate.protocol.stamped_samples import Vector3

Vector = TypeVar("Vector", bound=tuple[float, ...])

DEFAULT_URDF = "arm.urdf"
GEOMETRY = "geometry"
UNIT_TOLERANCE = 1e-3
ALONG_TOLERANCE = 1e-6
MAX_URDF_BYTES = 8_388_608

SECTION = "task"  # of an overlay
OVERLAID: dict[str, tuple[str, ...]] = {
    "arm": ("tcp_in_flange", "camera_in_tcp", "sensor_in_tcp", "sensor_sign"),
    "conveyor": ("axis", "nominal_speed", "deceleration", "acceleration"),
    "object": ("nominal",),
}
"""What commissioning measures of a cell, by section of the task file."""


@dataclass(frozen=True, slots=True)
class Task:
    """A task file and its URDF.

    Attributes:
        text: the task file itself, for recordings.
        document: where each of its values stands.
    """

    file: TaskFile
    urdf: str
    text: str
    document: YamlDocument = field(
        default_factory=lambda: YamlDocument("task"), repr=False, compare=False
    )

    def lines(self, complaints: Iterable[Complaint]) -> list[str]:
        """Return complaints as ``file:line:col: key: what``."""
        return self.document.lines(complaints)


def load(path: Path) -> Task:
    """Load a task file and its URDF.

    Raises:
        FileError: every error of the file at once, its URDF's absence among them.
    """
    data = documents.content(path)
    urdf: list[str] = []

    def check(value: Any) -> Iterator[Complaint]:
        yield from complaints(value)
        try:
            urdf.append(_urdf(value, path.parent))
        except UnreadableError as error:
            yield Complaint(("arm", "urdf"), str(error))

    document = documents.read(data, str(path))
    file = documents.fill(document, TaskFile, check)
    return Task(exact(file), urdf[0], data.decode("utf-8-sig"), document)


def laid_over(task: Task, over: YamlDocument, *, is_variant: bool = False) -> Task:
    """Return a task with an overlay's section ``task``: frames of the tool, conveyor, object.

    A measured direction of the conveyor turns the nominal object with it, unless the overlay has
    the object too.

    Args:
        is_variant: the overlay's object is another one's and is left out.

    Raises:
        FileError: a key that an overlay may not hold, or values that do not fit.
    """
    section = _at(over.value, SECTION)
    places = {path[1:]: place for path, place in over.values.items() if path[:1] == (SECTION,)}
    keys = {path[1:]: place for path, place in over.keys.items() if path[:1] == (SECTION,)}
    document = YamlDocument(over.name, section, places, keys)
    if not isinstance(section, dict):
        raise FileError(document.lines([Complaint((), "should hold arm, conveyor or object")]))
    foreign = [*_foreign(section)]
    if foreign:
        raise FileError(document.lines(foreign))
    section = {key: part for key, part in section.items() if not (is_variant and key == "object")}
    merged = tree.merge(task.document.value, section)
    if _at(section, "conveyor", "axis") is not None and "object" not in section:
        merged = _turned_with_conveyor(merged, task.file)
    document = replace(document, value=merged)
    file = documents.fill(document, TaskFile, complaints)
    text = yaml.safe_dump(merged, sort_keys=False, default_flow_style=None, width=100)
    return Task(exact(file), task.urdf, str(text), document)


def _foreign(section: dict[Any, Any]) -> Iterator[Complaint]:
    """Yield keys that commissioning does not measure."""
    for name, part in section.items():
        known = OVERLAID.get(name)
        if known is None:
            what = f"an overlay of a task may hold {', '.join(OVERLAID)}"
            yield Complaint((name,), what, at_key=True)
            continue
        for key in part if isinstance(part, dict) else ():
            if key not in known:
                what = f"an overlay of a task may hold {', '.join(known)} here"
                yield Complaint((name, key), what, at_key=True)


def _turned_with_conveyor(merged: Any, before: TaskFile) -> Any:
    """Return the plain values with the nominal object turned as the conveyor's direction is."""
    axis = _vector(_at(merged, "conveyor", "axis"), 3)
    if axis is None or not _is_unit(axis):
        return merged  # the conditions complain
    turn = rotations.between(before.conveyor.axis, cast("Vector3", _unit(axis)))
    old = before.object.nominal.quaternion
    nominal = {**merged["object"]["nominal"], "quaternion": [*rotations.multiply(turn, old)]}
    return {**merged, "object": {**merged["object"], "nominal": nominal}}


def parse(data: bytes, name: str) -> TaskFile:
    """Read a task from bytes, without its URDF.

    Raises:
        FileError: every error at once.
    """
    return exact(documents.fill(documents.read(data, name), TaskFile, complaints))


def schema() -> dict[str, Any]:
    """Return the JSON schema of task files."""
    return documents.schema(TaskFile, "linemate task")


def complaints(value: Any) -> Iterator[Complaint]:
    """Yield conditions between the values of a task that do not hold.

    Args:
        value: plain values of any kind; what is of a wrong kind is passed over here.
    """
    waypoints = _at(value, "waypoints")
    points = waypoints if isinstance(waypoints, list) else []
    yield from _falling(points)
    for path in (
        ("object", "nominal", "quaternion"),
        ("arm", "tcp_in_flange", "quaternion"),
        ("arm", "camera_in_tcp", "quaternion"),
        ("arm", "sensor_in_tcp", "quaternion"),
        ("conveyor", "axis"),
        *(("waypoints", i, "pose", "quaternion") for i in range(len(points))),
    ):
        yield from _not_unit(value, path)
    yield from _across(value)
    yield from _never_ordered(value, points)
    yield from _ordered_early(value, points)


def _never_ordered(value: Any, points: list[Any]) -> Iterator[Complaint]:
    """Yield a gate that waits for a signal before the order for it."""
    for gate, order in ((Gate.SCREWS_FIXED, "fix_screws"), (Gate.WHEEL_RELEASED, "release_wheel")):
        ordered = _tool_time(value, order)
        for i, point in enumerate(points):
            time = _at(point, "time")
            if _at(point, "gate") != gate.value or not (_is_number(time) and _is_number(ordered)):
                continue
            if ordered > time:
                what = f"{ordered:g} s is after waypoints[{i}] at {time:g} s, which waits for it"
                yield Complaint(("tool", order), what)


def _ordered_early(value: Any, points: list[Any]) -> Iterator[Complaint]:
    """Yield an order to the tool before the task's contact, and a release before the screws.

    A clamp that opens in free air drops what it holds.
    """
    screws, release = _tool_time(value, "fix_screws"), _tool_time(value, "release_wheel")
    if not (_is_number(screws) and _is_number(release)):
        return
    if release < screws:
        what = f"{release:g} s is before tool.fix_screws at {screws:g} s"
        yield Complaint(("tool", "release_wheel"), what)
    for i, point in enumerate(points):
        time = _at(point, "time")
        if _at(point, "phase") == Phase.CONTACT.value and _is_number(time):
            if screws < time:
                what = f"{screws:g} s is before waypoints[{i}] at {time:g} s, where contact begins"
                yield Complaint(("tool", "fix_screws"), what)
            return


def _tool_time(value: Any, order: str) -> Any:
    """Return when the tool gets an order, by the task or by default."""
    time = _at(value, "tool", order)
    return getattr(ToolTimes(), order) if time is None else time


def _falling(points: list[Any]) -> Iterator[Complaint]:
    latest = -math.inf
    for i, point in enumerate(points):
        time = _at(point, "time")
        if not _is_number(time):
            continue
        if time <= latest:
            what = f"should be later than the waypoint before ({latest:g}), not {time:g}"
            yield Complaint(("waypoints", i, "time"), what)
        latest = max(latest, time)


def _not_unit(value: Any, path: tuple[str | int, ...]) -> Iterator[Complaint]:
    vector = _vector(_at(value, *path), 3 if path[-1] == "axis" else 4)
    if vector is None:
        return
    length = math.hypot(*vector)
    if abs(length - 1.0) > UNIT_TOLERANCE:
        yield Complaint(path, f"should have length 1, not {length:.6g}")


def _across(value: Any) -> Iterator[Complaint]:
    """Yield a y axis of the nominal object that is not the conveyor's direction."""
    quaternion = _vector(_at(value, "object", "nominal", "quaternion"), 4)
    axis = _vector(_at(value, "conveyor", "axis"), 3) or ConveyorClasses().axis
    if quaternion is None or not (_is_unit(quaternion) and _is_unit(axis)):
        return
    w, x, y, z = _unit(quaternion)
    along = (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x))
    if sum(a * b for a, b in zip(along, _unit(axis), strict=True)) < 1.0 - ALONG_TOLERANCE:
        what = "its y axis should lie along conveyor.axis"
        yield Complaint(("object", "nominal", "quaternion"), what)


def geometry_text(geometry: Sequence[AxisGeometry]) -> dict[str, str]:
    """Return ``control.geometry`` as a text of the cell, which goes with its URDF.

    Returns:
        The text by its name; nothing for an arm that was not measured.
    """
    rows = [asdict(axis) for axis in geometry]
    return {GEOMETRY: json.dumps({GEOMETRY: rows})} if rows else {}


def geometry_of(texts: Mapping[str, str], name: str) -> tuple[AxisGeometry, ...]:
    """Return ``control.geometry`` from the texts of a cell.

    Args:
        name: of a recording, for messages.

    Raises:
        FileError: the text is wrong.
    """
    if GEOMETRY not in texts:
        return ()
    document = documents.read(texts[GEOMETRY].encode(), f"{name}: {GEOMETRY}")
    return documents.fill(document, ControlSettings).geometry


def _urdf(value: Any, base: Path) -> str:
    name = _at(value, "arm", "urdf")
    path = files.find(name if isinstance(name, str) else DEFAULT_URDF, base, files.DAEMON_DATA)
    return files.read_text(path, MAX_URDF_BYTES)


def exact(task: TaskFile) -> TaskFile:
    """Return the task with exact unit quaternions and axes.

    Args:
        task: as read; lengths are 1 within ``UNIT_TOLERANCE``.
    """
    arm = replace(
        task.arm,
        tcp_in_flange=_exact_pose(task.arm.tcp_in_flange),
        camera_in_tcp=_exact_pose(task.arm.camera_in_tcp),
        sensor_in_tcp=_exact_pose(task.arm.sensor_in_tcp),
    )
    return replace(
        task,
        arm=arm,
        object=replace(task.object, nominal=_exact_pose(task.object.nominal)),
        waypoints=tuple(replace(w, pose=_exact_pose(w.pose)) for w in task.waypoints),
        conveyor=replace(task.conveyor, axis=_unit(task.conveyor.axis)),
    )


def _exact_pose(pose: PoseFile) -> PoseFile:
    return replace(pose, quaternion=_unit(pose.quaternion))


def _unit(vector: Vector) -> Vector:
    length = math.hypot(*vector)
    return cast("Vector", tuple(part / length for part in vector))


def _at(value: Any, *path: str | int) -> Any:
    """Return the value at a path, None if there is none."""
    for part in path:
        if isinstance(part, str) and isinstance(value, dict):
            value = value.get(part)
        elif isinstance(part, int) and isinstance(value, list):
            value = value[part]
        else:
            return None
    return value


def _vector(value: Any, length: int) -> tuple[float, ...] | None:
    if isinstance(value, list) and len(value) == length and all(map(_is_number, value)):
        return tuple(map(float, value))
    return None


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_unit(vector: tuple[float, ...]) -> bool:
    return abs(math.hypot(*vector) - 1.0) <= UNIT_TOLERANCE
