"""Object as the bolts of a free tool show it: they press on a side of their holes.

From the tips' entry to the touch a camera that is blind near the object sees nothing for seconds.
The bolts are in their holes beyond the estimated object too, until the touch is felt.
A force across the tool's axis shows then where the object is: off the tool by the bolts' play, to
the side to which it pushes.

Invariants:
- A force along the axis beyond what bolts rub in their holes is that of tips or face: it shows no
  place.
- Depth and orientation are not measured: their variance is that of no knowledge.
"""

import math

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.settings import PayloadSettings, TactileNoise
from linemate.daemon.core.tracking.touch import bolt_search
from linemate.protocol.stamped_samples import Vector3

ENTERED = 0.003  # least way of the tips behind the object's plane: the error of its depth [m]
DEVIATION = 0.0003  # sigma of the place to which a pressed side belongs [m]
MOUNT_DEVIATION = 0.0005  # sigma of the error of a calibrated camera mount [m]
LEAST_N = 5.0  # mean force across that is one of bolts: more than a tare is wrong by [N]
MEAN_S = 0.15  # time constant of that mean: the tool rings at 4 Hz or more [s]
ALIKE_S = 0.1  # in which measurements err alike: the tool stays on a side [s]
PUSHED_S = 0.3  # for which a mean force has acted on the object: it sways on after that [s]
LIGHT_KG = 500.0  # modal mass of an object on a carrier; most are heavier [kg]
UNKNOWN = 1.0  # variance of what is not measured [m^2, rad^2]


def are_in(bolts: float, distance: float) -> bool:
    """Return whether the bolts are surely in their holes.

    Args:
        bolts: their length from the face [m].
        distance: programmed, from the tcp to the object along its z [m].
    """
    return bolts > 0.0 and ENTERED - bolts < distance < math.inf


def is_entered(payload: PayloadSettings, distance: float) -> bool:
    """Return whether the bolts are in their holes, and their play is known.

    Args:
        distance: programmed, from the tcp to the object along its z [m].
    """
    return payload.bolt_play > 0.0 and are_in(payload.bolts, distance)


def place(
    contact: Array,
    bending: Array,
    tcp: Array,
    payload: PayloadSettings,
    mount: TactileNoise,
    distance: float,
    mean: Vector3,
) -> Array | None:
    """Return the object's place (3,) in c by the force across the tool; None without one.

    Args:
        contact: force (3,) of the contact alone, in the tcp [N].
        bending: force (3,) that bends the mount: that of the contact, and the weight [N].
        tcp: (6,) undeflected, in c.
        distance: programmed, from the tcp to the object along its z [m].
        mean: force of the contact, averaged: bolts that lean on a side give less than a touch [N].
    """
    x, y, z = contact.tolist()
    across = math.hypot(x, y)
    if abs(z) > mount.contact_force + bolt_search.RUBS * across:
        return None
    if across < mount.contact_force:
        pressed = x * mean[0] + y * mean[1]
        x, y, _ = mean
        across = math.hypot(x, y)
        if across < LEAST_N or pressed < 0.5 * LEAST_N * across:
            return None
    play = payload.bolt_play / across
    off = bending / np.array(mount.stiffness) + np.array((play * x, play * y, -distance))
    in_nominal: Array = tcp[:3] + rotations.exp(tcp[3:]).dot(off)
    return in_nominal


def averaged(mean: Vector3, contact: Array, dt: float) -> Vector3:
    """Return the mean force of the contact one step later [N]."""
    gain = dt / MEAN_S
    x, y, z = (m + gain * (f - m) for m, f in zip(mean, contact.tolist(), strict=True))
    return x, y, z


def pushed(mean: Vector3, tcp: Array, axis: int) -> float:
    """Return one sigma of the speed that bolts have given the object along an axis of c [m/s].

    Args:
        mean: force of the contact, averaged [N].
        tcp: (6,) undeflected, in c.
    """
    along = float(rotations.exp(tcp[3:])[axis].dot(mean))
    return abs(along) * PUSHED_S / LIGHT_KG


def measured(place: Array, tcp: Array, delay: float, cycle_s: float) -> PoseMeasurement:
    """Return a place as a measurement.

    Args:
        delay: since the force [s].
    """
    variance = np.full(6, UNKNOWN)
    variance[:2] = DEVIATION**2 * max(ALIKE_S / cycle_s, 1.0)
    return PoseMeasurement(place, rotations.exp(tcp[3:]), delay, variance)
