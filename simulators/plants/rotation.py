"""Rotations and poses in plain floats, which are faster here than small arrays.

Invariants:
    Pure functions on tuples.
    A rotation is (r11, r12, r13, r21, ..., r33); a pose is (position, rotation).
"""

import math

import numpy as np
from numpy.typing import NDArray

Vec = tuple[float, float, float]
Rot = tuple[float, float, float, float, float, float, float, float, float]
Pose = tuple[Vec, Rot]

IDENTITY: Rot = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def apply(r: Rot, v: Vec) -> Vec:
    """R v."""
    x, y, z = v
    return (
        r[0] * x + r[1] * y + r[2] * z,
        r[3] * x + r[4] * y + r[5] * z,
        r[6] * x + r[7] * y + r[8] * z,
    )


def unapply(r: Rot, v: Vec) -> Vec:
    """R' v."""
    x, y, z = v
    return (
        r[0] * x + r[3] * y + r[6] * z,
        r[1] * x + r[4] * y + r[7] * z,
        r[2] * x + r[5] * y + r[8] * z,
    )


def compose(a: Rot, b: Rot) -> Rot:
    """A B."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return (
        a0 * b0 + a1 * b3 + a2 * b6,
        a0 * b1 + a1 * b4 + a2 * b7,
        a0 * b2 + a1 * b5 + a2 * b8,
        a3 * b0 + a4 * b3 + a5 * b6,
        a3 * b1 + a4 * b4 + a5 * b7,
        a3 * b2 + a4 * b5 + a5 * b8,
        a6 * b0 + a7 * b3 + a8 * b6,
        a6 * b1 + a7 * b4 + a8 * b7,
        a6 * b2 + a7 * b5 + a8 * b8,
    )


def transpose(r: Rot) -> Rot:
    """R'."""
    return (r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8])


def between(a: Rot, b: Rot) -> Rot:
    """A' B: b seen from a."""
    return compose(transpose(a), b)


def exp(v: Vec) -> Rot:
    """Rodrigues: the rotation of a rotation vector [rad]."""
    x, y, z = v
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-12:
        s, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    xy, xz, yz = c * x * y, c * x * z, c * y * z
    sx, sy, sz = s * x, s * y, s * z
    return (
        1.0 - c * (y * y + z * z),
        xy - sz,
        xz + sy,
        xy + sz,
        1.0 - c * (x * x + z * z),
        yz - sx,
        xz - sy,
        yz + sx,
        1.0 - c * (x * x + y * y),
    )


def log(r: Rot) -> Vec:
    """The rotation vector of a rotation of less than a half turn [rad]."""
    x, y, z = 0.5 * (r[7] - r[5]), 0.5 * (r[2] - r[6]), 0.5 * (r[3] - r[1])
    sine2 = x * x + y * y + z * z
    cosine = 0.5 * (r[0] + r[4] + r[8] - 1.0)
    if sine2 < 1e-14:
        if cosine < 0.0:
            raise ValueError(f"a rotation by half a turn has no unique rotation vector: {r}")
        return (x, y, z)
    sine = math.sqrt(sine2)
    scale = math.atan2(sine, cosine) / sine
    return (x * scale, y * scale, z * scale)


def vector(r: Rot) -> Vec:
    """The rotation vector of any rotation, of a half turn one of its two [rad]."""
    if angle(r) < 3.0:
        return log(r)
    w, x, y, z = quaternion(r)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(sine, w) / sine
    return (x * scale, y * scale, z * scale)


def angle(r: Rot) -> float:
    """The angle of a rotation, 0..pi [rad]."""
    x, y, z = 0.5 * (r[7] - r[5]), 0.5 * (r[2] - r[6]), 0.5 * (r[3] - r[1])
    return math.atan2(math.sqrt(x * x + y * y + z * z), 0.5 * (r[0] + r[4] + r[8] - 1.0))


def quaternion(r: Rot) -> tuple[float, float, float, float]:
    """Unit quaternion w x y z, w >= 0 (Shepperd: the largest component first)."""
    r11, r12, r13, r21, r22, r23, r31, r32, r33 = r
    trace = r11 + r22 + r33
    if trace >= max(r11, r22, r33):
        w, x, y, z = 1.0 + trace, r32 - r23, r13 - r31, r21 - r12
    elif r11 >= r22 and r11 >= r33:
        w, x, y, z = r32 - r23, 1.0 + r11 - r22 - r33, r12 + r21, r13 + r31
    elif r22 >= r33:
        w, x, y, z = r13 - r31, r12 + r21, 1.0 - r11 + r22 - r33, r23 + r32
    else:
        w, x, y, z = r21 - r12, r13 + r31, r23 + r32, 1.0 - r11 - r22 + r33
    scale = math.copysign(1.0 / math.sqrt(w * w + x * x + y * y + z * z), w)
    return (w * scale, x * scale, y * scale, z * scale)


def multiply(a: Pose, b: Pose) -> Pose:
    """A B for poses: b, given in a's frame, in the frame of a."""
    (px, py, pz), r = a
    x, y, z = apply(r, b[0])
    return (px + x, py + y, pz + z), compose(r, b[1])


def relative(a: Pose, b: Pose) -> Pose:
    """A^-1 B for poses: b seen from a."""
    # The busiest of them all, so it is written out: unapply and between in one.
    (ax, ay, az), (a0, a1, a2, a3, a4, a5, a6, a7, a8) = a
    (x, y, z), (b0, b1, b2, b3, b4, b5, b6, b7, b8) = b
    x, y, z = x - ax, y - ay, z - az
    return (
        (a0 * x + a3 * y + a6 * z, a1 * x + a4 * y + a7 * z, a2 * x + a5 * y + a8 * z),
        (
            a0 * b0 + a3 * b3 + a6 * b6,
            a0 * b1 + a3 * b4 + a6 * b7,
            a0 * b2 + a3 * b5 + a6 * b8,
            a1 * b0 + a4 * b3 + a7 * b6,
            a1 * b1 + a4 * b4 + a7 * b7,
            a1 * b2 + a4 * b5 + a7 * b8,
            a2 * b0 + a5 * b3 + a8 * b6,
            a2 * b1 + a5 * b4 + a8 * b7,
            a2 * b2 + a5 * b5 + a8 * b8,
        ),
    )


def matrix(pose: Pose) -> NDArray[np.float64]:
    """The 4x4 homogeneous matrix of a pose."""
    (x, y, z), r = pose
    return np.array(
        ((r[0], r[1], r[2], x), (r[3], r[4], r[5], y), (r[6], r[7], r[8], z), (0.0, 0.0, 0.0, 1.0))
    )


def add(a: Vec, b: Vec) -> Vec:
    """Sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def norm(v: Vec) -> float:
    """Length of a vector."""
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
