"""The arm's chain from its URDF: where its joints are, for a picture.

Invariants:
    * Pure, plain floats, no numeric library: a view starts at once.
    * It is only for the eye; the daemon computes its kinematics with pinocchio.
    * Axes are A1..A6 [rad] and then E1 [m]. Points and poses are in base, quaternions w first.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Pose = tuple[float, float, float, float, float, float, float]  # position [m], quaternion

UNIT_ORIGIN: Final[Vector] = (0.0, 0.0, 0.0)
UNIT: Final[Matrix] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
MAX_JOINTS: Final = 64
E1: Final = 6  # index among the axes
RAIL_M: Final = 1.5  # drawn to both sides if the URDF has no limits


class ChainError(ValueError):
    """The URDF has no chain to the flange; the text says why."""


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint of the chain.

    Attributes:
        origin: Position of its frame in the one before, at zero [m].
        turn: Rotation of its frame in the one before, at zero.
        axis: Unit vector in its own frame.
        slides: Whether it moves along the axis instead of about it.
        number: Index of the axis that moves it, None for a fixed joint.
        travel: Limits of a joint that slides [m].
    """

    origin: Vector
    turn: Matrix
    axis: Vector
    slides: bool
    number: int | None
    travel: tuple[float, float] = (-RAIL_M, RAIL_M)


@dataclass(frozen=True, slots=True)
class Chain:
    """Joints from the base to the flange, and the tool at its end."""

    joints: tuple[Joint, ...]
    tool: Pose

    def rail(self) -> tuple[Vector, Vector] | None:
        """Return both ends of the linear axis that carries the arm, None without one."""
        here, turned = UNIT_ORIGIN, UNIT
        for joint in self.joints:
            here = _moved(here, turned, joint.origin)
            turned = product(turned, joint.turn)
            if joint.number is None:
                continue
            if not joint.slides:
                return None
            x, y, z = joint.axis
            low, high = (_moved(here, turned, (x * s, y * s, z * s)) for s in joint.travel)
            return low, high
        return None

    def reach(self) -> float:
        """Return the length of the stretched arm, without the way along its rail [m]."""
        points, _ = self.place(())
        return sum(math.dist(a, b) for a, b in pairwise(points[1:]))

    def place(self, axes: Sequence[float]) -> tuple[list[Vector], Pose]:
        """Return the positions of base, joints and tcp, and the tcp's pose.

        Args:
            axes: A1..A6 [rad] and E1 [m]; missing ones are 0.
        """
        here, turned = UNIT_ORIGIN, UNIT
        points = [here]
        for joint in self.joints:
            here = _moved(here, turned, joint.origin)
            turned = product(turned, joint.turn)
            if joint.number is not None:
                value = axes[joint.number] if joint.number < len(axes) else 0.0
                if joint.slides:
                    x, y, z = joint.axis
                    here = _moved(here, turned, (x * value, y * value, z * value))
                else:
                    turned = product(turned, about(joint.axis, value))
            points.append(here)
        tcp = _moved(here, turned, self.tool[:3])
        points.append(tcp)
        return points, (*tcp, *quaternion(product(turned, matrix(self.tool[3:]))))


def read_chain(
    urdf: str,
    flange: str,
    tool: Pose,
    *,
    linear_axis: bool,
    geometry: Sequence[tuple[Vector, Vector]] = (),
) -> Chain:
    """Return the chain of a URDF that ends at the flange.

    Args:
        flange: Name of its last link.
        tool: Pose of the tcp in the flange.
        linear_axis: Whether the first joint that moves is E1.
        geometry: Place [m] and rotation vector [rad] of A1..A6 as measured, seen from the URDF's.

    Raises:
        ChainError: The text is not a URDF, or has no such link or chain.
    """
    try:
        robot = ET.fromstring(urdf)  # noqa: S314 - from our own daemon or recording
    except ET.ParseError as error:
        raise ChainError(f"not a URDF: {error}") from error
    leading = {_name(joint, "child"): joint for joint in robot.iterfind("joint")}
    if flange not in leading:
        raise ChainError(f"the URDF has no joint that leads to {flange!r}")
    elements: list[ET.Element] = []
    link = flange
    while link in leading and len(elements) <= MAX_JOINTS:
        elements.append(leading[link])
        link = _name(elements[-1], "parent")
    if len(elements) > MAX_JOINTS:
        raise ChainError(f"the URDF has a loop, or more than {MAX_JOINTS} joints")
    numbers = iter((E1, *range(E1)) if linear_axis else range(E1))
    joints = (_joint(element, numbers) for element in reversed(elements))
    return Chain(tuple(_measured(joint, geometry) for joint in joints), tool)


def _measured(joint: Joint, geometry: Sequence[tuple[Vector, Vector]]) -> Joint:
    """Return a joint where it was measured."""
    if joint.number is None or joint.number >= len(geometry):
        return joint
    shift, turn = geometry[joint.number]
    angle = math.hypot(*turn)
    turned = product(joint.turn, about(_of_length_one(turn), angle)) if angle else joint.turn
    return replace(joint, origin=_moved(joint.origin, joint.turn, shift), turn=turned)


def _joint(element: ET.Element, numbers: Iterator[int]) -> Joint:
    kind = element.get("type", "fixed")
    origin = element.find("origin")
    axis = element.find("axis")
    place = {} if origin is None else origin.attrib
    number = None if kind == "fixed" else next(numbers, None)
    return Joint(
        origin=_vector(place.get("xyz", "0 0 0")),
        turn=from_rpy(*_vector(place.get("rpy", "0 0 0"))),
        axis=_of_length_one(_vector("1 0 0" if axis is None else axis.get("xyz", "1 0 0"))),
        slides=kind == "prismatic",
        number=number,
        travel=_travel(element),
    )


def _travel(joint: ET.Element) -> tuple[float, float]:
    limit = joint.find("limit")
    try:
        low, high = (float(limit.get(name, "")) for name in ("lower", "upper"))  # type: ignore[union-attr]
    except (AttributeError, ValueError):
        return -RAIL_M, RAIL_M
    return (low, high) if math.isfinite(low) and math.isfinite(high) else (-RAIL_M, RAIL_M)


def _name(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _vector(text: str) -> Vector:
    try:
        x, y, z = (float(word) for word in text.split())
    except ValueError as error:
        raise ChainError(f"{text!r} is not a vector") from error
    if not all(math.isfinite(part) for part in (x, y, z)):
        raise ChainError(f"{text!r} is not a vector")
    return x, y, z


def _of_length_one(axis: Vector) -> Vector:
    length = math.hypot(*axis)
    if length == 0.0:
        raise ChainError("an axis of length 0")
    return axis[0] / length, axis[1] / length, axis[2] / length


def _moved(here: Vector, turned: Matrix, by: Sequence[float]) -> Vector:
    x, y, z = by
    (a, b, c), (d, e, f), (g, h, i) = turned
    return (
        here[0] + a * x + b * y + c * z,
        here[1] + d * x + e * y + f * z,
        here[2] + g * x + h * y + i * z,
    )


def product(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two rotations."""
    columns = tuple(zip(*b, strict=True))
    rows = [[r[0] * c[0] + r[1] * c[1] + r[2] * c[2] for c in columns] for r in a]
    (p, q, r), (s, t, u), (v, w, x) = rows
    return (p, q, r), (s, t, u), (v, w, x)


def about(axis: Vector, angle: float) -> Matrix:
    """Return the rotation about an axis of length one [rad]."""
    x, y, z = axis
    s, c = math.sin(angle), math.cos(angle)
    v = 1.0 - c
    return (
        (c + x * x * v, x * y * v - z * s, x * z * v + y * s),
        (y * x * v + z * s, c + y * y * v, y * z * v - x * s),
        (z * x * v - y * s, z * y * v + x * s, c + z * z * v),
    )


def from_rpy(roll: float, pitch: float, yaw: float) -> Matrix:
    """Return a URDF's rotation: about the fixed x, then y, then z [rad]."""
    x, y, z = UNIT
    return product(product(about(z, yaw), about(y, pitch)), about(x, roll))


def matrix(q: Sequence[float]) -> Matrix:
    """Return the rotation of a unit quaternion, w first."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def quaternion(m: Matrix) -> tuple[float, float, float, float]:
    """Return the unit quaternion of a rotation, w first and not negative."""
    (a, b, c), (d, e, f), (g, h, i) = m
    # Divide by the largest of the four: no cancellation.
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    largest = max(range(4), key=squares.__getitem__)
    s = 2.0 * math.sqrt(squares[largest])
    w, x, y, z = (
        (s / 4.0, (h - f) / s, (c - g) / s, (d - b) / s),
        ((h - f) / s, s / 4.0, (b + d) / s, (c + g) / s),
        ((c - g) / s, (b + d) / s, s / 4.0, (f + h) / s),
        ((d - b) / s, (c + g) / s, (f + h) / s, s / 4.0),
    )[largest]
    return (w, x, y, z) if w >= 0.0 else (-w, -x, -y, -z)
