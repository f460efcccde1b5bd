"""Sag of the mount: the tcp of the elastic tool for that of the rigid one, and back."""

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.touch import tare
from linemate.daemon.core.tracking.tracker_state import TrackerState


def elastic(state: TrackerState, pose: Array) -> Array:
    """Return the elastic tcp (6,) of a rigid one that hangs still."""
    sag = tare.mounted(state.tare)
    if sag is None:
        return pose
    x, y, z, *at = pose.tolist()
    dx, dy, dz, *bend = sag.tolist()
    a, b, c, d, e, f, g, h, i = rotations.exp_rows(*at)
    place = x + a * dx + b * dy + c * dz, y + d * dx + e * dy + f * dz, z + g * dx + h * dy + i * dz
    turned = rotations.multiply(rotations.exp_quaternion(*at), rotations.exp_quaternion(*bend))
    return np.array((*place, *rotations.log_quaternion(turned).tolist()))


def sagging(state: TrackerState, target: Array) -> Array:
    """Return the target (m, 6) of the rigid tcp for one of the elastic tcp.

    Args:
        target: (m, 6), stays as it is.
    """
    sag = tare.commanded(state.tare)
    if sag is None:
        return target
    back = -sag
    vectors, arms = rotations.turned_many(target[:, 3:], back[3:], back[:3])
    rigid = np.empty_like(target)
    np.add(target[:, :3], arms, out=rigid[:, :3])
    rigid[:, 3:] = vectors
    return rigid
