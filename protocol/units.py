"""Convert between the millimetres and degrees of a wire and SI units.

Invariants:
    KUKA's A, B, C are intrinsic rotations about Z, then Y', then X'': R = Rz(A) Ry(B) Rx(C).
"""

import math

MM = 1e-3  # one millimetre [m]
DEG = math.pi / 180.0  # one degree [rad]

Row = tuple[float, float, float]
Rotation = tuple[Row, Row, Row]  # rotation matrix, row by row


def rotation_to_abc(rotation: Rotation) -> tuple[float, float, float]:
    """Return the angles a, b, c [rad] of a rotation matrix, b within +-pi/2.

    At b = +-pi/2 only a -+ c is defined: c is zero there.
    """
    (r11, r12, _), (r21, r22, _), (r31, r32, r33) = rotation
    cos_b = math.hypot(r11, r21)
    b = math.atan2(-r31, cos_b)
    if cos_b < 1e-9:
        return math.atan2(-r12, r22), b, 0.0
    return math.atan2(r21, r11), b, math.atan2(r32, r33)
