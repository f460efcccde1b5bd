"""The border between the wires' millimetres and degrees and the SI inside.

Law of this file: the only place with 1e-3 and pi/180. KUKA's A, B, C are intrinsic rotations
about Z, then Y', then X'': R = Rz(A) Ry(B) Rx(C). Every function is pure and total on finite
numbers.
"""

import math

MM = 1e-3
"""One millimetre [m]."""

DEG = math.pi / 180.0
"""One degree [rad]."""

Position = tuple[float, float, float]
"""x, y, z [m]."""

Row = tuple[float, float, float]
Rotation = tuple[Row, Row, Row]
"""Rotation matrix, row by row."""


def from_mm(length_mm: float) -> float:
    """Millimetres to metres."""
    return length_mm * MM


def to_mm(length: float) -> float:
    """Metres to millimetres."""
    return length / MM


def from_deg(angle_deg: float) -> float:
    """Degrees to radians."""
    return angle_deg * DEG


def to_deg(angle: float) -> float:
    """Radians to degrees."""
    return angle / DEG


def abc_to_rotation(a: float, b: float, c: float) -> Rotation:
    """Rotation matrix Rz(a) Ry(b) Rx(c).

    Args:
        a: about Z [rad].
        b: about Y' [rad].
        c: about X'' [rad].
    """
    ca, sa, cb, sb, cc, sc = (f(v) for v in (a, b, c) for f in (math.cos, math.sin))
    return (
        (ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc),
        (sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc),
        (-sb, cb * sc, cb * cc),
    )


def rotation_to_abc(rotation: Rotation) -> tuple[float, float, float]:
    """Angles a, b, c [rad] of a rotation matrix, b within +-pi/2.

    At b = +-pi/2 only a -+ c is defined; c is then taken as zero, so that
    :func:`abc_to_rotation` still gives the same matrix back.
    """
    (r11, r12, _), (r21, r22, _), (r31, r32, r33) = rotation
    cos_b = math.hypot(r11, r21)
    b = math.atan2(-r31, cos_b)
    if cos_b < 1e-9:
        return math.atan2(-r12, r22), b, 0.0
    return math.atan2(r21, r11), b, math.atan2(r32, r33)


def xyzabc_to_pose(
    x_mm: float, y_mm: float, z_mm: float, a_deg: float, b_deg: float, c_deg: float
) -> tuple[Position, Rotation]:
    """KUKA's X Y Z A B C to a position [m] and a rotation matrix."""
    position = (x_mm * MM, y_mm * MM, z_mm * MM)
    return position, abc_to_rotation(a_deg * DEG, b_deg * DEG, c_deg * DEG)


def pose_to_xyzabc(
    position: Position, rotation: Rotation
) -> tuple[float, float, float, float, float, float]:
    """A position [m] and a rotation matrix to KUKA's X Y Z [mm] A B C [deg]."""
    x, y, z = position
    a, b, c = rotation_to_abc(rotation)
    return x / MM, y / MM, z / MM, a / DEG, b / DEG, c / DEG
