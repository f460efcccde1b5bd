"""Smoothing of the desired trajectory, (13)-(16): an impedance law as an off-line filter."""

import numpy as np

from linemate.daemon.core.control.settings import SmoothingSettings
from linemate.daemon.core.horizon import Array


def smoothing_taps(settings: SmoothingSettings, cycle_s: float) -> Array:
    """Return the taps r_j, j = 0..n_imp, of (16): ``x_s(k) = sum_j r_j x_t(k + j)``.

    Equations (13), (14) and (15) are stacked for i = 0..n_imp with E_d = 0 and solved at once;
    the first row of ``(A'A)^-1 A'`` is the filter. Rows that (14) and (15) do not
    give at the ends are left out: the taps sum to 1 and, without damper, a ramp has no bias.
    """
    n = max(round(settings.steps_s / cycle_s), 2)
    if settings.mass == 0.0 and settings.damper == 0.0:
        return np.array((1.0,))
    position = np.eye(n + 1)
    damper = np.zeros((n - 1, n + 1))
    mass = np.zeros((n - 1, n + 1))
    for row, i in enumerate(range(1, n)):
        damper[row, i - 1], damper[row, i + 1] = -1.0, 1.0
        mass[row, i - 1 : i + 2] = 1.0, -2.0, 1.0
    damper *= settings.damper / (2.0 * cycle_s)
    mass *= settings.mass / cycle_s**2
    A = np.vstack((position, damper, mass))
    taps: Array = np.linalg.solve(A.T @ A, A.T)[0, : n + 1]
    return taps
