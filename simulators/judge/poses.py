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


def from_matrices(matrices: Floats) -> Floats:
    """Homogeneous transforms (n, 4, 4) as seven numbers (n, 7), w >= 0; NaN rows stay NaN."""
    m = matrices[:, :3, :3]
    poses = np.full((len(matrices), 7), np.nan)
    poses[:, :3] = matrices[:, :3, 3]
    known = np.isfinite(m).all(axis=(1, 2))
    m = m[known]
    # Each column is the quaternion scaled by one of its own components: the largest is used.
    diagonal = np.diagonal(m, axis1=1, axis2=2)
    trace = diagonal.sum(axis=1)
    q = np.empty((len(m), 4, 4))
    q[:, 0, 0] = 1.0 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        q[:, i + 1, i + 1] = 1.0 + 2.0 * diagonal[:, i] - trace
        q[:, 0, i + 1] = q[:, i + 1, 0] = m[:, k, j] - m[:, j, k]
        q[:, j + 1, k + 1] = q[:, k + 1, j + 1] = m[:, j, k] + m[:, k, j]
    largest = np.argmax(np.diagonal(q, axis1=1, axis2=2), axis=1)
    chosen = q[np.arange(len(m)), largest]
    chosen /= np.linalg.norm(chosen, axis=1, keepdims=True)
    poses[known, 3:] = np.where(chosen[:, :1] < 0.0, -chosen, chosen)
    return poses
