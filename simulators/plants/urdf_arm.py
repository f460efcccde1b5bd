"""Arm of a URDF as the plant's Denavit-Hartenberg table, without the daemon's kinematics.

Invariants:
    A pure function of the text; lengths in m, angles in rad.
    Six revolute axes; before them at most a linear axis along y of base.
    The flange of the table and that of the URDF differ by a constant pose, ``UrdfArm.flange``.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linemate.simulators.plants import rotation
from linemate.simulators.plants.rotation import Pose, Rot
from linemate.simulators.plants.scenario import DenavitHartenbergLink, Vector3

ARM_AXES = 6
SMALL = 1e-9  # of a length [m] or of the sine of an angle
UNLIMITED = 1e6
"""Limit of an axis for which the URDF has none."""

Array = NDArray[np.float64]


class UrdfArmError(ValueError):
    """A URDF that the plant cannot be made of; the message says why."""


@dataclass(frozen=True, slots=True)
class JointLimit:
    """Limits of one joint by its ``<limit>``.

    Attributes:
        low, high: positions [rad] or [m].
        speed, acceleration, jerk: magnitudes; ``UNLIMITED`` where the URDF has none.
    """

    low: float
    high: float
    speed: float
    acceleration: float
    jerk: float


@dataclass(frozen=True, slots=True)
class UrdfArm:
    """An arm as the plant takes it.

    Attributes:
        root: pose of the table's first frame in base.
        links: rows for A1..A6; a half turn about x follows the last one.
        flange: the URDF's flange, seen from the frame behind that half turn.
        limits: of A1..A6, and of E1 where there is a linear axis.
    """

    root: Pose
    links: tuple[DenavitHartenbergLink, ...]
    flange: Pose
    limits: tuple[JointLimit, ...]


@dataclass(frozen=True, slots=True)
class _Line:
    """Axis of rotation at zero: a point on it and its direction (3,), in base."""

    point: Array
    along: Array


def read(urdf: str, flange: str) -> UrdfArm:
    """Return the arm of a URDF text.

    Args:
        flange: name of the flange's link.

    Raises:
        UrdfArmError: no such link, not six revolute joints, or a linear axis along another
            direction than y of base.
    """
    place = np.eye(4)
    lines: list[_Line] = []
    limits: list[JointLimit] = []
    rail: list[JointLimit] = []
    for joint in _chain(urdf, flange):
        place = place @ _origin(joint)
        kind = joint.get("type", "")
        if kind == "fixed":
            continue
        along = _unit(place[:3, :3] @ _axis(joint))
        if kind == "prismatic" and not lines and not rail:
            if along[1] < 1.0 - SMALL:
                raise UrdfArmError(
                    f"joint {joint.get('name')}: the linear axis lies along "
                    f"({', '.join(f'{part:.3f}' for part in along)}) in base; the emulated cell "
                    "has it along y. Turn the URDF's root."
                )
            rail.append(_limit(joint))
        elif kind in {"revolute", "continuous"} and len(lines) < ARM_AXES:
            lines.append(_Line(place[:3, 3].copy(), along))
            limits.append(_limit(joint))
        else:
            raise UrdfArmError(f"joint {joint.get('name')}: {kind} is no axis of a six-axis arm")
    if len(lines) != ARM_AXES:
        raise UrdfArmError(f"{len(lines)} revolute joints up to {flange}; the emulated arm has 6")
    root, links, last = _table(lines, place[:3, 3])
    half_turn = np.diag((1.0, -1.0, -1.0, 1.0))
    behind = _pose(np.linalg.inv(last @ half_turn) @ place)
    return UrdfArm(_pose(root), links, behind, (*limits, *rail))


def _chain(urdf: str, flange: str) -> list[ET.Element]:
    """Return the joints from the root to the flange."""
    try:
        tree = ET.fromstring(urdf)  # noqa: S314 - a local file of the site's own
    except ET.ParseError as error:
        raise UrdfArmError(f"not a URDF: {error}") from error
    above = {child: joint for joint in tree.findall("joint") for child in _links(joint, "child")}
    joints: list[ET.Element] = []
    link = flange
    while link in above and len(joints) <= len(above):
        joints.append(above[link])
        link = next(_links(above[link], "parent"), "")
    if not joints:
        raise UrdfArmError(f"no joint leads to the link {flange!r}")
    return joints[::-1]


def _links(joint: ET.Element, side: str) -> Iterator[str]:
    yield from (end.get("link", "") for end in joint.findall(side))


def _numbers(element: ET.Element | None, name: str, default: str) -> Array:
    text = default if element is None else element.get(name, default)
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise UrdfArmError(f"{name}={text!r}: three numbers are needed")
    return values


def _origin(joint: ET.Element) -> Array:
    """Return the pose (4, 4) of a joint's frame in its parent's; rpy is Rz Ry Rx."""
    origin = joint.find("origin")
    pose = np.eye(4)
    roll, pitch, yaw = _numbers(origin, "rpy", "0 0 0").tolist()
    turned = rotation.compose(rotation.exp((0.0, 0.0, yaw)), rotation.exp((0.0, pitch, 0.0)))
    turned = rotation.compose(turned, rotation.exp((roll, 0.0, 0.0)))
    pose[:3, :3] = np.array(turned).reshape(3, 3)
    pose[:3, 3] = _numbers(origin, "xyz", "0 0 0")
    return pose


def _axis(joint: ET.Element) -> Array:
    axis = _numbers(joint.find("axis"), "xyz", "1 0 0")
    if float(np.linalg.norm(axis)) < SMALL:
        raise UrdfArmError(f"joint {joint.get('name')}: its axis has no direction")
    return axis


def _limit(joint: ET.Element) -> JointLimit:
    limit = joint.find("limit")
    names = ("lower", "upper", "velocity", "acceleration", "jerk")
    missing = (-UNLIMITED, *(UNLIMITED,) * 4)
    values = []
    for name, default in zip(names, missing, strict=True):
        text = None if limit is None else limit.get(name)
        try:
            values.append(default if text is None else float(text))
        except ValueError:
            raise UrdfArmError(f"joint {joint.get('name')}: {name}={text!r} is no number") from None
    return JointLimit(*values)


def _table(
    lines: list[_Line], flange: Array
) -> tuple[Array, tuple[DenavitHartenbergLink, ...], Array]:
    """Return the root (4, 4), the rows, and the last frame (4, 4) with all axes at zero.

    Craig's form: the x axis of a frame is the common normal of its axis and the next one. The last
    frame is at the foot of the flange (3,) on the last axis.
    """
    root = _root(lines[0])
    frame, rows = root, []
    for i, line in enumerate(lines):
        x, along = frame[:3, 0], line.along
        alpha = math.atan2(float(np.cross(frame[:3, 2], along) @ x), float(frame[:3, 2] @ along))
        # Foot on this axis of the common normal with the axis before: the frame before has it.
        length = float((line.point - frame[:3, 3]) @ x)
        base = frame[:3, 3] + length * x
        behind = lines[i + 1] if i + 1 < len(lines) else None
        if behind is None:
            foot, normal = base + float((flange - base) @ along) * along, x
        else:
            foot, normal = _common_normal(line, behind, base, x)
        theta = math.atan2(float(np.cross(x, normal) @ along), float(x @ normal))
        offset = float((foot - base) @ along)
        rows.append(DenavitHartenbergLink(*map(_clean, (alpha, length, offset, theta))))
        frame = np.eye(4)
        frame[:3, 0], frame[:3, 1], frame[:3, 2] = normal, np.cross(along, normal), along
        frame[:3, 3] = foot
    return root, tuple(rows), frame


def _root(first: _Line) -> Array:
    """Return base itself where the first row can reach the first axis from it, else a frame."""
    root = np.eye(4)
    meets = first.point[1] * first.along[2] - first.point[2] * first.along[1]
    if abs(first.along[0]) < SMALL and abs(meets) < SMALL:
        return root
    across = np.eye(3)[int(np.abs(first.along).argmin())]
    x = _unit(across - (across @ first.along) * first.along)
    root[:3, 0], root[:3, 1], root[:3, 2] = x, np.cross(first.along, x), first.along
    root[:3, 3] = first.point
    return root


def _common_normal(line: _Line, behind: _Line, base: Array, x: Array) -> tuple[Array, Array]:
    """Return the foot on a line of its common normal with the next one, and its direction."""
    between = behind.point - base
    across = np.cross(line.along, behind.along)
    if float(np.linalg.norm(across)) < SMALL:  # parallel: the nearest of all normals
        normal = between - (between @ line.along) * line.along
        length = float(np.linalg.norm(normal))
        return base, (x if length < SMALL else normal / length)
    normal = _unit(across)
    # The least turn from the frame before, so that the table is that of the data sheet.
    if normal @ x < -SMALL:
        normal = -normal
    along = float(np.linalg.det(np.array((between, behind.along, across))) / (across @ across))
    return base + along * line.along, normal


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _clean(value: float) -> float:
    """Return a value without the rounding error of a sum, so that zero is zero."""
    return round(value, 15) + 0.0


def _pose(matrix: Array) -> Pose:
    x, y, z = (_clean(part) for part in matrix[:3, 3].tolist())
    turned: Rot = tuple(_clean(part) for part in matrix[:3, :3].ravel().tolist())  # type: ignore[assignment]
    return (x, y, z), turned


def tool(arm: UrdfArm, tcp: Pose) -> tuple[Vector3, Vector3]:
    """Return a tcp of the URDF's flange in the table's: position [m], rotation vector [rad]."""
    position, turned = rotation.multiply(arm.flange, tcp)
    w, *vector = rotation.quaternion(turned)
    sine = math.hypot(*vector)
    # By the quaternion: a half turn has no logarithm of its matrix.
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 2.0
    x, y, z = (scale * part for part in vector)
    return position, (x, y, z)
