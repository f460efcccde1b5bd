"""Cubic spline through poses, at rest or without acceleration at its begin.

``scipy.interpolate`` would be a quarter of each start of the daemon: 0.3 s, and 60 MiB that stay
locked.
"""

import numpy as np
from msgspec import Struct

from linemate.daemon.core import lapack
from linemate.daemon.core.horizon import Array

# Factors of (t - t_i)^3, ^2, ^1 and 1 after so many derivatives.
_FACTORS = (
    np.array((1.0, 1.0, 1.0, 1.0)),
    np.array((3.0, 2.0, 1.0, 0.0)),
    np.array((6.0, 2.0, 0.0, 0.0)),
)


class CubicSpline(Struct, frozen=True):
    """Piecewise cubic polynomial with two continuous derivatives.

    Attributes:
        knots: (n,) ascending times [s].
        coefficients: (4, n-1, m) of (t - knots[i])^3, ^2, ^1 and 1 in each interval.
    """

    knots: Array
    coefficients: Array

    def __call__(self, at: float | Array, order: int = 0) -> Array:
        """Return the values, or the first or second derivative, at some times.

        The first and the last cubic go on outside the knots.

        Args:
            at: time or (k,) times [s].
            order: 0, 1 or 2.

        Returns:
            (m,) or (k, m).
        """
        piece = np.searchsorted(self.knots[1:-1], at, side="right")
        since = np.asarray(at - self.knots[piece])[..., None]
        cubic, square, linear, constant = (
            factor * part
            for factor, part in zip(_FACTORS[order], self.coefficients[:, piece], strict=True)
        )
        if order == 0:
            value: Array = ((cubic * since + square) * since + linear) * since + constant
        elif order == 1:
            value = (cubic * since + square) * since + linear
        else:
            value = cubic * since + square
        return value


def through(knots: Array, values: Array, *, begins_at_rest: bool) -> CubicSpline:
    """Return the spline through some values. It ends without acceleration.

    The unknowns are the speeds at the knots. Continuous accelerations give a tridiagonal system.

    Args:
        knots: (n,) ascending times of the (n, m) values [s], n >= 2.
        begins_at_rest: the first speed is zero, else the first acceleration is.

    Raises:
        ValueError: fewer than two knots, or knots that do not ascend.

    References:
        C. de Boor, A Practical Guide to Splines, chapter IV.
    """
    lengths = np.diff(knots)
    if not len(lengths) or not (lengths > 0.0).all():
        raise ValueError(f"a spline needs two or more ascending knots: {knots}")
    slopes = np.diff(values, axis=0) / lengths[:, None]
    # h[i] v[i-1] + 2 (h[i-1] + h[i]) v[i] + h[i-1] v[i+1] = 3 (h[i] s[i-1] + h[i-1] s[i])
    below = np.append(lengths[1:], 1.0)
    above = np.append(0.0 if begins_at_rest else 1.0, lengths[:-1])
    diagonal = np.full(len(knots), 2.0)
    diagonal[1:-1] *= lengths[:-1] + lengths[1:]
    right = np.empty(values.shape)
    right[1:-1] = 3.0 * (lengths[1:, None] * slopes[:-1] + lengths[:-1, None] * slopes[1:])
    right[0] = 0.0 if begins_at_rest else 3.0 * slopes[0]
    right[-1] = 3.0 * slopes[-1]
    speeds = lapack.dgtsv(below, diagonal, above, right)[3]
    bend = (speeds[:-1] + speeds[1:] - 2.0 * slopes) / lengths[:, None]
    square = (slopes - speeds[:-1]) / lengths[:, None] - bend
    cubic = bend / lengths[:, None]
    return CubicSpline(knots, np.array((cubic, square, speeds[:-1], values[:-1])))
