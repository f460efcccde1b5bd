"""Rotations, single and over whole horizons.

Rotation vectors [rad], matrices (3, 3), quaternions w first. All functions are differentiable at
zero (series below ``SMALL``).
"""

import math

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.protocol.stamped_samples import Quaternion, Vector3

SMALL = 1e-6
EYE = np.eye(3)
_NEXT, _AFTER_NEXT = np.array((1, 2, 0)), np.array((2, 0, 1))  # components of a cross product


def skew(v: Array) -> Array:
    """Return the matrix (3, 3) with ``skew(v) @ w == cross(v, w)``."""
    x, y, z = v
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))


Rows = tuple[float, float, float, float, float, float, float, float, float]
"""Matrix (3, 3) as plain floats, row by row."""


def _combined(x: float, y: float, z: float, identity: float, cross: float, outer: float) -> Rows:
    """Return ``identity I + cross skew(r) + outer r r'``, the form of all functions here.

    Plain floats cost a third of small arrays; a flat tuple becomes an array twice as fast.
    """
    ox, oy, oz = outer * x, outer * y, outer * z
    xy, xz, yz = ox * y, ox * z, oy * z
    cx, cy, cz = cross * x, cross * y, cross * z
    return (
        identity + ox * x, xy - cz, xz + cy,
        xy + cz, identity + oy * y, yz - cx,
        xz - cy, yz + cx, identity + oz * z,
    )  # fmt: skip


def exp(r: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) [rad] (Rodrigues)."""
    x, y, z = r.tolist()
    return np.array(exp_rows(x, y, z)).reshape(3, 3)


def exp_rows(x: float, y: float, z: float) -> Rows:
    """Return the rotation matrix of a rotation vector's components [rad] (Rodrigues)."""
    angle2 = x * x + y * y + z * z
    if angle2 < SMALL * SMALL:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    return _combined(x, y, z, 1.0 - b * angle2, a, b)


def log(R: Array) -> Array:
    """Return the rotation vector (3,) [rad] of a rotation matrix; unique below pi.

    By the quaternion, which is accurate for small and for large angles.
    """
    return log_quaternion(quaternion(R))


def quaternion(R: Array) -> Quaternion:
    """Return the unit quaternion, w first and >= 0, of a rotation matrix (Shepperd)."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    trace = a + e + i
    if trace > 0.0:
        s = 2.0 * math.sqrt(trace + 1.0)
        q = (0.25 * s, (h - f) / s, (c - g) / s, (d - b) / s)
    elif a >= e and a >= i:
        s = 2.0 * math.sqrt(max(1.0 + a - e - i, 0.0))
        q = ((h - f) / s, 0.25 * s, (b + d) / s, (c + g) / s)
    elif e >= i:
        s = 2.0 * math.sqrt(max(1.0 + e - a - i, 0.0))
        q = ((c - g) / s, (b + d) / s, 0.25 * s, (f + h) / s)
    else:
        s = 2.0 * math.sqrt(max(1.0 + i - a - e, 0.0))
        q = ((d - b) / s, (c + g) / s, (f + h) / s, 0.25 * s)
    return q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])


def log_quaternion(q: Quaternion) -> Array:
    """Return the rotation vector (3,) [rad] of a unit quaternion, w first."""
    w, x, y, z = q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    n = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 / w if n < SMALL else 2.0 * math.atan2(n, w) / n
    return np.array((scale * x, scale * y, scale * z))


def matrix(q: Quaternion) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion, w first, normalised here."""
    w, x, y, z = q
    n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * n, x * n, y * n, z * n
    first = (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y))
    second = (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x))
    third = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    return np.array(first + second + third).reshape(3, 3)


def left_jacobian_inverse(r: Array) -> Array:
    """Return J_l^-1(r), so that ``log(exp(d) @ exp(r)) = r + J_l^-1(r) d`` for small d."""
    x, y, z = r.tolist()
    return np.array(_left_jacobian_inverse(x, y, z)).reshape(3, 3)


def _left_jacobian_inverse(x: float, y: float, z: float) -> Rows:
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-8:
        c = 1.0 / 12.0
    else:
        half = 0.5 * math.sqrt(angle2)
        c = (1.0 - half / math.tan(half)) / angle2
    return _combined(x, y, z, 1.0 - c * angle2, -0.5, c)


def left_jacobian(r: Array) -> Array:
    """Return J_l(r), so that ``exp(r + e) = exp(J_l(r) e) @ exp(r)`` for small e."""
    x, y, z = r.tolist()
    return np.array(_left_jacobian(x, y, z)).reshape(3, 3)


def _left_jacobian(x: float, y: float, z: float) -> Rows:
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-8:
        a, b = 0.5, 1.0 / 6.0
    else:
        angle = math.sqrt(angle2)
        a, b = (1.0 - math.cos(angle)) / angle2, (angle - math.sin(angle)) / (angle2 * angle)
    return _combined(x, y, z, 1.0 - b * angle2, a, b)


def in_own_axes(r: Array) -> Array:
    """Return T (6, 6) of a pose with rotation vector r, for its small changes as rows (m, 6).

    A change ``c`` of position and rotation vector is the twist ``c @ T`` in the pose's own axes:
    ``T = diag(Exp(r), J_l(r))``, since the right Jacobian is the transpose of the left one.
    """
    x, y, z = r.tolist()
    return _block_diagonal(exp_rows(x, y, z), _left_jacobian(x, y, z))


def _block_diagonal(upper: Rows, lower: Rows) -> Array:
    """Return the matrix (6, 6) of two blocks; one array costs less than its parts."""
    a, b, c, d, e, f, g, h, i = upper
    k, m, n, o, p, q, r, s, t = lower
    return np.array((
        a, b, c, 0.0, 0.0, 0.0, d, e, f, 0.0, 0.0, 0.0, g, h, i, 0.0, 0.0, 0.0,
        0.0, 0.0, 0.0, k, m, n, 0.0, 0.0, 0.0, o, p, q, 0.0, 0.0, 0.0, r, s, t,
    )).reshape(6, 6)  # fmt: skip


def in_own_axes_and_back(r: Array) -> tuple[Array, Array]:
    """Return T of ``in_own_axes`` and its inverse ``diag(Exp(r)', J_l^-1(r))``."""
    x, y, z = r.tolist()
    turned = a, b, c, d, e, f, g, h, i = exp_rows(x, y, z)
    into = _block_diagonal(turned, _left_jacobian(x, y, z))
    return into, _block_diagonal((a, d, g, b, e, h, c, f, i), _left_jacobian_inverse(x, y, z))


def exp_many(r: Array) -> Array:
    """Return rotation matrices (m, 3, 3) of rotation vectors (m, 3)."""
    angle2 = np.einsum("ij,ij->i", r, r)
    small = angle2 < SMALL * SMALL
    safe = np.where(small, 1.0, angle2)
    angle = np.sqrt(safe)
    a = np.where(small, 1.0 - angle2 / 6.0, np.sin(angle) / angle)
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(angle)) / safe)
    W = np.zeros((len(r), 3, 3))
    W[:, 0, 1], W[:, 0, 2] = -r[:, 2], r[:, 1]
    W[:, 1, 0], W[:, 1, 2] = r[:, 2], -r[:, 0]
    W[:, 2, 0], W[:, 2, 1] = -r[:, 1], r[:, 0]
    return EYE + a[:, None, None] * W + b[:, None, None] * (W @ W)


def log_many(R: Array) -> Array:
    """Return rotation vectors (m, 3) of rotation matrices (m, 3, 3), angles below pi.

    As ``log``, bit for bit: the branch of small traces is left to it.
    """
    trace = R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2]
    if not bool((trace > 0.0).all()):
        return np.array([log(each) for each in R])
    s = 2.0 * np.sqrt(trace + 1.0)
    vector = R[:, (2, 0, 1), (1, 2, 0)] - R[:, (1, 2, 0), (2, 0, 1)]
    vector /= s[:, None]
    return _log_quaternions(0.25 * s, vector)


def _log_quaternions(w: Array, vector: Array) -> Array:
    """Return rotation vectors (m, 3) of unit quaternions, w (m,) > 0 and vector (m, 3)."""
    x, y, z = vector.T
    n = np.sqrt(x * x + y * y + z * z)
    # math's arc tangent, for numpy's depends on the processor in its last bit.
    angles = np.array(list(map(math.atan2, n.tolist(), w.tolist())))
    if _is_above(n, SMALL):
        scale = 2.0 * angles / n
    else:
        small = n < SMALL
        scale = 2.0 * np.where(small, 1.0, angles) / np.where(small, w, n)
    logs: Array = vector * scale[:, None]
    return logs


def _is_above(values: Array, bound: float) -> bool:
    """Return whether all values reach a bound; NaN does not. argmin costs a third of min."""
    return bool(values[values.argmin()] >= bound)


def turned_many(r: Array, turn: Array, arm: Array) -> tuple[Array, Array]:
    """Return rotation vectors (m, 3) of ``exp(r) @ exp(turn)``, and an arm turned by them (m, 3).

    By quaternions, which take a third to half of the time of matrices. Angles are below pi.

    Args:
        r: rotation vectors (m, 3) [rad].
        turn, arm: (3,), the same for all.
    """
    half = 0.5 * np.sqrt(np.einsum("ij,ij->i", r, r))
    if _is_above(half, SMALL):
        scale = 0.5 * (np.sin(half) / half)
    else:
        small = half < SMALL
        sine = np.sin(half) / np.where(small, 1.0, half)
        scale = 0.5 * np.where(small, 1.0 - half * half / 6.0, sine)
    w, x, y, z = exp_quaternion(*turn.tolist())
    q = np.concatenate((np.cos(half)[:, None], scale[:, None] * r), axis=1).dot(
        np.array((w, x, y, z, -x, w, -z, y, -y, z, w, -x, -z, -y, x, w)).reshape(4, 4)
    )
    scalar, vector = q[:, 0], q[:, 1:]
    if not _is_above(scalar, 0.0):
        q *= np.where(scalar < 0.0, -1.0, 1.0)[:, None]
    # u + w t + v x t with t = 2 v x u is u turned by (w, v).
    a, b, c = (2.0 * arm).tolist()
    t = vector.dot(np.array((0.0, -c, b, c, 0.0, -a, -b, a, 0.0)).reshape(3, 3))
    across = vector.take(_NEXT, axis=1) * t.take(_AFTER_NEXT, axis=1)
    across -= vector.take(_AFTER_NEXT, axis=1) * t.take(_NEXT, axis=1)
    return _log_quaternions(scalar, vector), arm + scalar[:, None] * t + across


def exp_quaternion(x: float, y: float, z: float) -> Quaternion:
    """Return the unit quaternion, w first, of a rotation vector's components [rad]."""
    angle = math.sqrt(x * x + y * y + z * z)
    scale = 0.5 - angle * angle / 48.0 if angle < SMALL else math.sin(0.5 * angle) / angle
    return (math.cos(0.5 * angle), scale * x, scale * y, scale * z)


def between(a: Vector3, b: Vector3) -> Quaternion:
    """Return the shortest rotation from a unit vector to another; none for opposite ones."""
    (ax, ay, az), (bx, by, bz) = a, b
    w = 1.0 + ax * bx + ay * by + az * bz
    if w < SMALL:
        return (1.0, 0.0, 0.0, 0.0)
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return (w * n, x * n, y * n, z * n)


def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return the quaternion of rotation p after rotation q, w >= 0."""
    a, b, c, d = p
    w, x, y, z = q
    product = (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )
    if product[0] >= 0.0:
        return product
    return (-product[0], -product[1], -product[2], -product[3])
