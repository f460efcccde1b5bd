"""Poses between MuJoCo's arrays and plain tuples.

Invariants:
    Pure. Rotations are numpy (3, 3); a pose is (position, row-major rotation) as devices take it.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vec = tuple[float, float, float]
Rot = tuple[float, float, float, float, float, float, float, float, float]
Pose = tuple[Vec, Rot]


def pose(position: Array, rotation: Array) -> Pose:
    """Return a pose as tuples from a position (3,) and a rotation (3, 3) or (9,)."""
    x, y, z = position.tolist()
    a, b, c, d, e, f, g, h, i = rotation.ravel().tolist()
    return (x, y, z), (a, b, c, d, e, f, g, h, i)


def turn_of(vector: Sequence[float]) -> Array:
    """Return the rotation (3, 3) of a rotation vector [rad]."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return np.eye(3)
    cross = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))) / angle
    # Euler-Rodrigues: one minus cosine, and sine, of the turn about a unit axis.
    turned: Array = np.eye(3) + math.sin(angle) * cross
    turned += (1.0 - math.cos(angle)) * (cross @ cross)
    return turned


def vector_of(rotation: Array) -> Vec:
    """Return the rotation vector [rad] of a rotation (3, 3) of less than half a turn."""
    w, x, y, z = quaternion_of(rotation)
    sine = math.sqrt(x * x + y * y + z * z)
    share = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return (share * x, share * y, share * z)


def quaternion_of(rotation: Array) -> tuple[float, float, float, float]:
    """Return the unit quaternion w x y z, w not negative (Bar-Itzhack's eigenvector method)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    symmetric = np.array(
        (
            (a - e - i, d + b, g + c, h - f),
            (d + b, e - a - i, h + f, c - g),
            (g + c, h + f, i - a - e, d - b),
            (h - f, c - g, d - b, a + e + i),
        )
    )
    x, y, z, w = np.linalg.eigh(symmetric)[1][:, -1].tolist()
    sign = -1.0 if w < 0.0 else 1.0
    return (sign * w, sign * x, sign * y, sign * z)


def matrix_of(position: Array, rotation: Array) -> Array:
    """Return the homogeneous matrix (4, 4)."""
    whole = np.eye(4)
    whole[:3, 3] = position
    whole[:3, :3] = rotation
    return whole
