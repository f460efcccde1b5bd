"""Algebra of poses as (n, 7) arrays for the judge.

Invariants:
    Position [m] and unit quaternion w x y z, row by row; NaN stays NaN.
    It shares no code with the daemon's transforms nor with the plants'.
"""

import numpy as np

from linemate.simulators.judge.rows import Floats


def multiply(left: Floats, right: Floats) -> Floats:
    """Quaternion product, (n, 4) each."""
    w, x, y, z = left.T
    a, b, c, d = right.T
    return np.stack(
        (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ),
        axis=1,
    )


def rotate(quaternion: Floats, vector: Floats) -> Floats:
    """Vectors (n, 3) turned by quaternions (n, 4)."""
    w, u = quaternion[:, :1], quaternion[:, 1:]
    t = 2.0 * np.cross(u, vector)
    turned: Floats = vector + w * t + np.cross(u, t)
    return turned


def conjugate(quaternion: Floats) -> Floats:
    """Inverse rotation of unit quaternions (n, 4)."""
    inverse: Floats = quaternion * np.array([1.0, -1.0, -1.0, -1.0])
    return inverse


def compose(left: Floats, right: Floats) -> Floats:
    """``a_in_c = b_in_c * a_in_b``, (n, 7) each."""
    position = left[:, :3] + rotate(left[:, 3:], right[:, :3])
    return np.concatenate((position, multiply(left[:, 3:], right[:, 3:])), axis=1)


def relative(origin: Floats, pose: Floats) -> Floats:
    """``origin^-1 * pose``, (n, 7) each."""
    back = conjugate(origin[:, 3:])
    position = rotate(back, pose[:, :3] - origin[:, :3])
    return np.concatenate((position, multiply(back, pose[:, 3:])), axis=1)


def distance(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """How far two poses are apart.

    Returns:
        Distance [m] and angle of the rotation between them [rad], (n,) each.
    """
    turn = multiply(conjugate(a[:, 3:]), b[:, 3:])
    # atan2 keeps its precision for the microradians that arccos(w) would lose.
    angle = 2.0 * np.arctan2(np.linalg.norm(turn[:, 1:], axis=1), np.abs(turn[:, 0]))
    return np.linalg.norm(a[:, :3] - b[:, :3], axis=1), angle
