"""Merge of a new goal into the horizon without a jump.

Behind the commit point the deviation ``e = x_t - x_f`` decays along the closed loop of a linear
quadratic regulator. It is of fifth order: servo and elastic mode together need a bounded fourth
derivative.

Invariants:
- Committed steps are kept bit for bit.
- Matrices are computed at start-up; a merge is one product.
"""

import math

import numpy as np
from scipy.linalg import solve_discrete_are

from linemate.daemon.core.horizon import Array

ORDER = 5
ALONG = 1  # column of a pose along the conveyor

CORNER_S = 0.00566  # one sigma of the rounding of corners [s]: 1.4 steps of 4 ms, half of 12 ms


def commit_steps(dead_time: float, cycle_s: float) -> int:
    """Return nc, the last step of the list that can no longer be changed.

    The longest dead time, one cycle of interpolation, and one more. One step less costs 0.4 mm.
    """
    return math.ceil((dead_time + cycle_s) / cycle_s - 1e-9) + 1


def merge_matrix(tau: float, cycle_s: float, steps: int) -> Array:
    """Return M (steps, 5): the deviation after the commit point from the last five before it.

    Row i is e at nc + 1 + i for the history ``e(nc), e(nc-1), ..., e(nc-4)``, under the feedback
    that minimises ``sum e^2 + (tau/T0)^10 (fifth difference of e)^2``.
    """
    binomial = np.array([math.comb(ORDER, j) * (-1.0) ** j for j in range(ORDER + 1)])
    A = np.zeros((ORDER, ORDER))
    A[0] = -binomial[1:]  # e(i+1) = u + 5 e(i) - 10 e(i-1) + ...
    A[1:, :-1] = np.eye(ORDER - 1)
    B = np.zeros((ORDER, 1))
    B[0] = 1.0
    Q = np.zeros((ORDER, ORDER))
    Q[0, 0] = 1.0
    R = np.array(((max(tau / cycle_s, 0.2) ** (2 * ORDER),),))
    P = solve_discrete_are(A, B, Q, R)
    gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    loop = A - B @ gain
    rows = np.empty((steps, ORDER))
    state = np.eye(ORDER)
    for i in range(steps):
        state = loop @ state
        rows[i] = state[0]
    return rows


def delay(matrix: Array) -> int:
    """Return how many steps behind the commit point the merge takes up a goal, in the mean."""
    return round(float(matrix.sum()))


def rounding(cycle_s: float, commit: int) -> Array:
    """Return a kernel (2 h + 1,) that rounds the corners of a goal over its steps, h <= nc - 4.

    Where a ramp ends, the speed of the goal has a corner. A merge over five steps of 4 ms amplifies
    it by (tau/T0)^4 and overshoots by millimetres. A binomial kernel of sigma 5.7 ms leaves a
    thirtieth of it and moves the goal by less than 2 um; at 12 ms the kernel is 1.
    """
    half = min(int(2.0 * (CORNER_S / cycle_s) ** 2 + 1e-9), commit + 1 - ORDER)
    taps = np.array([math.comb(2 * half, i) for i in range(2 * half + 1)], dtype=float)
    kernel: Array = taps / taps.sum()
    return kernel


def rounded(goal: Array, kernel: Array) -> Array:
    """Return a goal (m, d), corners along the conveyor rounded but for half a kernel at its ends.

    The merge does not read the beginning; the end is a horizon away.
    """
    half = len(kernel) // 2
    if half == 0:
        return goal
    smooth = goal.copy()
    smooth[half:-half, ALONG] = np.convolve(goal[:, ALONG], kernel, "valid")
    return smooth


def merge(old: Array, goal: Array, matrices: Array, commit: int) -> Array:
    """Return the new list x_t (n+1, d) from the old one and the goal x_f.

    Args:
        old: last step's list (n+1, d).
        goal: where the list should be (n+1, d).
        matrices: (d, n - commit, 5), one merge matrix a column.
        commit: nc; steps 0..nc are the old list's 1..nc+1, unchanged.
    """
    merged = np.empty_like(goal)
    merged[: commit + 1] = old[1 : commit + 2]
    first = commit + 1 - ORDER
    history = (merged[first : commit + 1] - goal[first : commit + 1])[::-1]  # (5, d)
    # In order in memory the product costs a quarter less.
    late = matrices @ np.ascontiguousarray(history.T)[:, :, None]
    np.add(goal[commit + 1 :], late[:, :, 0].T, out=merged[commit + 1 :])
    return merged
