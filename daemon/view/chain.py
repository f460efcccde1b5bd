"""The arm's chain from its URDF: where its joints are, for a picture.

Law of this file: pure, plain floats, no numeric library, so that a view starts at once and costs
little. It is for the eye: the daemon's own kinematics is pinocchio's, and the tests compare.
Axes are A1..A6 [rad] and then E1 [m]; points and poses stand in base, quaternions are w first.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Pose = tuple[float, float, float, float, float, float, float]
"""Position [m] and unit quaternion, w first."""

UNIT: Final[Matrix] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
LONGEST: Final = 64  # joints of a chain
E1: Final = 6  # its place among the axes


class ChainError(ValueError):
    """A URDF that no chain to the flange can be read from; the message says why."""


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint of the chain.

    Attributes:
        origin, turn: of its frame in the one before, at zero.
        axis: in its own frame, of length one.
        slides: along the axis, instead of turning about it.
        number: which of the axes moves it, None if none does.
    """

    origin: Vector
    turn: Matrix
    axis: Vector
    slides: bool
    number: int | None


@dataclass(frozen=True, slots=True)
class Chain:
    """Joints from the base to the flange, and the tool at its end."""

    joints: tuple[Joint, ...]
    tool: Pose

    def place(self, axes: Sequence[float]) -> tuple[list[Vector], Pose]:
        """Return where the joints are, the flange and the tcp after them, and the tcp's pose.

        Args:
            axes: A1..A6 [rad] and E1 [m]; missing ones are 0.
        """
        here: Vector = (0.0, 0.0, 0.0)
        turned = UNIT
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


def read(urdf: str, flange: str, tool: Pose, *, linear_axis: bool) -> Chain:
    """Return the chain of a URDF that ends at the flange.

    Args:
        flange: name of its last link.
        tool: the tcp in the flange.
        linear_axis: the first joint that moves is E1.

    Raises:
        ChainError: no URDF, no such link, or no chain.
    """
    try:
        robot = ET.fromstring(urdf)  # noqa: S314 - of our own daemon or recording
    except ET.ParseError as error:
        raise ChainError(f"not a URDF: {error}") from error
    leading = {_name(joint, "child"): joint for joint in robot.iterfind("joint")}
    if flange not in leading:
        raise ChainError(f"the URDF has no joint that leads to {flange!r}")
    found: list[ET.Element] = []
    link = flange
    while link in leading and len(found) <= LONGEST:
        found.append(leading[link])
        link = _name(found[-1], "parent")
    if len(found) > LONGEST:
        raise ChainError("the URDF's joints lead in a circle, or are too many")
    numbers = iter((E1, *range(E1)) if linear_axis else range(E1))
    return Chain(tuple(_joint(element, numbers) for element in reversed(found)), tool)


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
    )


def _name(joint: ET.Element, end: str) -> str:
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _vector(text: str) -> Vector:
    try:
        x, y, z = (float(word) for word in text.split())
    except ValueError as error:
        raise ChainError(f"{text!r} is no vector") from error
    if not all(math.isfinite(part) for part in (x, y, z)):
        raise ChainError(f"{text!r} is no vector")
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
    made = [[r[0] * c[0] + r[1] * c[1] + r[2] * c[2] for c in columns] for r in a]
    (p, q, r), (s, t, u), (v, w, x) = made
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
    # Of the four squares the largest is divided by: no cancellation.
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
