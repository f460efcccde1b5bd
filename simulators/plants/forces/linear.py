"""Exact step of a linear system whose input is a straight line within the step.

Invariants:
    M x'' + C x' + K x = u(t); the state is (x, x').
    No energy comes from the integration, whatever the step.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TERMS = 14
"""Of the exponential's series; enough for 1e-16 at a norm of 0.5."""


class Step(NamedTuple):
    """x(t + dt) = state x(t) + start u(t) + end u(t + dt).

    Attributes:
        steady: start + end, for an input that does not change.
    """

    state: Array
    start: Array
    end: Array
    steady: Array


def step(mass: Array, damping: Array, stiffness: Array, dt: float) -> Step:
    """Compute the exact step (first order hold).

    Args:
        mass: M, shape (n, n), regular; ``damping`` and ``stiffness`` have its shape.
        dt: length of the step [s], not negative.

    Returns:
        The matrices (2n, 2n), and (2n, n) each.
    """
    n = len(mass)
    whole = np.zeros((4 * n, 4 * n))
    whole[:n, n : 2 * n] = np.eye(n)
    whole[n : 2 * n, :n] = -np.linalg.solve(mass, stiffness)
    whole[n : 2 * n, n : 2 * n] = -np.linalg.solve(mass, damping)
    whole[n : 2 * n, 2 * n : 3 * n] = np.linalg.inv(mass)
    whole[2 * n : 3 * n, 3 * n :] = np.eye(n) / dt if dt > 0.0 else 0.0
    grown = exponential(whole * dt)[: 2 * n]
    # The last block belongs to the input's rise u(t + dt) - u(t).
    end = grown[:, 3 * n :]
    start = grown[:, 2 * n : 3 * n] - end
    return Step(grown[:, : 2 * n], start, end, start + end)


def for_both(axes: Array) -> Array:
    """Return axes (3, 3) for vectors of six, once for each half, (6, 6)."""
    # Not ``kron``, which takes fifteen times as long.
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = axes
    return both


def exponential(matrix: Array) -> Array:
    """Matrix exponential, by scaling, series and squaring."""
    norm = float(np.abs(matrix).sum(axis=1).max())
    halvings = max(0, int(np.ceil(np.log2(norm / 0.5)))) if norm > 0.0 else 0
    small = matrix / 2.0**halvings
    total = term = np.eye(len(matrix))
    for k in range(1, _TERMS):
        term = term @ small / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)
