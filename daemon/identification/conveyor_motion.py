"""Motion of the conveyor from the readings of the distance sensor."""

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter, rts_smoother

from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.trace import Mask

WINDOW = 0.15  # of distance readings to either side of an exposure [s]
REACH = 3  # neighbours on either side
JUMP = 0.015  # distance of an outlier from the median of its neighbours [m]
LEAST_READINGS = 6
JERK_DENSITY = 0.2  # of the conveyor, as white noise [m^2/s^5]
READING = 0.0004  # deviation of a distance reading, with its resolution [m]


def conveyor(distances: Array, times: Array) -> tuple[Array, Array, Mask]:
    """Return the conveyor's position and speed, and whether they are known, at times (m,).

    A Rauch-Tung-Striebel smoother of the readings, with constant acceleration between them.
    """
    clean = distances[~find_outliers(distances[:, 1])] if len(distances) else distances
    begin, end = np.searchsorted(clean[:, 0], np.array((times - WINDOW, times + WINDOW)))
    known: Mask = end - begin >= LEAST_READINGS
    if not known.any():
        return np.zeros(len(times)), np.zeros(len(times)), known
    known &= (times >= clean[0, 0]) & (times <= clean[-1, 0])
    before = np.clip(np.searchsorted(clean[:, 0], times) - 1, 0, len(clean) - 1)
    position, speed, acceleration = _smooth(clean)[before].T
    u = np.clip(times - clean[before, 0], 0.0, WINDOW)
    return position + u * (speed + 0.5 * u * acceleration), speed + u * acceleration, known


def _smooth(readings: Array) -> Array:
    """Return position, speed and acceleration (n, 3) at the readings (n, 2)."""
    spans = np.diff(readings[:, 0])
    identity, nothing = np.eye(3), np.zeros((3, 3))
    F = [np.array(((1.0, dt, 0.5 * dt * dt), (0.0, 1.0, dt), (0.0, 0.0, 1.0))) for dt in spans]
    Q = [Q_continuous_white_noise(3, dt, JERK_DENSITY) for dt in spans]
    kalman = KalmanFilter(dim_x=3, dim_z=1)
    kalman.x = np.array(((readings[0, 1],), (0.0,), (0.0,)))
    kalman.P = np.diag((READING**2, 1.0, 1.0))
    kalman.H = np.array(((1.0, 0.0, 0.0),))
    kalman.R = np.array(((READING**2,),))
    # A filter's F and Q lead to its reading, a smoother's lead away from it.
    x, P, _, _ = kalman.batch_filter(readings[:, 1], Fs=[identity, *F], Qs=[nothing, *Q])
    smoothed: Array = rts_smoother(x, P, [*F, identity], [*Q, nothing])[0][:, :, 0]
    return smoothed


def find_outliers(readings: Array) -> Mask:
    """Return which readings (n,) lie far from the median of their neighbours."""
    if len(readings) < 2 * REACH + 1:
        return np.zeros(len(readings), dtype=bool)
    padded = np.pad(readings, REACH, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * REACH + 1)
    far: Mask = np.abs(readings - np.median(windows, axis=1)) > JUMP
    return far
