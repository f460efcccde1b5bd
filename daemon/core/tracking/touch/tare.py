"""Tare of the force-torque sensor before contact, and sag of the mount under the payload.

While the tool hangs free its mean wrench is weight and bias. In contact that is taken off. The
weight bends the mount as well: the elastic tcp is the rigid one and the sag.

Invariants:
- The tare is taken in the approach only, and frozen before the tool can touch.
- Without a configured payload a wrench that is no bias is a weight: it is along gravity and large.
- What the wheel weighed is gone when it is released. A hub that holds it takes over what would bend
  the mount by more than ``LARGEST_SPRING``: a tool springs up by twice the sag as a clamp opens.
- A wrench that no free tool has does not enter.
"""

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.approach import smoothstep_at
from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.settings import PayloadSettings, TactileNoise
from linemate.protocol.stamped_samples import Vector3

GRAVITY = 9.80665  # [m/s^2]
MEAN_S = 0.5  # time constant of the mean wrench [s]; the tool rings at 4 Hz or more
LEAST_N = 1.5  # a smaller tare is noise, and is not taken off [N]
WEIGHT_N = 30.0  # along gravity: less may be a bias of the sensor [N]
SHARE = 0.8  # of a weight's force that is along gravity; a bias has any direction
LARGEST_SAG = 0.1  # of the mount under a free tool: more is no weight [m, rad]
UNLOADING_S = 0.4  # in which the hub takes weight over from the mount [s]
LARGEST_SPRING = 0.004  # sag with which the clamp may open: the tool springs up by twice that [m]
RELEASED_S = 0.5  # time constant with which a released wheel's sag leaves the target [s]


class Tare(Struct, frozen=True, eq=False):
    """State of the tare, in the tcp.

    Attributes:
        wrench: (6,) mean of the free tool [N, Nm], None before the first one.
        sag: (6,) static deflection of the mount [m, rad].
        unloading: time since the hub began to take the weight over [s]; None before.
        share: of the sag that the target still has.
        borne: share of the weight that the mount still carries; the motion is late.
    """

    wrench: Array | None = None
    sag: Array | None = None
    unloading: float | None = None
    share: float = 1.0
    borne: float = 1.0


NO_TARE = Tare()


def updated(
    tare: Tare,
    wrench: Wrench,
    down: Vector3,
    payload: PayloadSettings,
    mount: TactileNoise,
    dt: float,
) -> Tare:
    """Return the tare of a free tool one step later.

    Args:
        wrench: raw, of this step.
        down: unit vector of gravity in the tcp.
    """
    raw = (*wrench.force.tolist(), *wrench.torque.tolist())
    stiffness = (*mount.stiffness, *mount.rotational_stiffness)
    for each, stiff in zip(raw, stiffness, strict=True):
        if not abs(each) < LARGEST_SAG * stiff:
            return tare
    mean = np.array(raw)
    if tare.wrench is not None:
        mean = tare.wrench + (dt / MEAN_S) * (mean - tare.wrench)
    return Tare(mean, _sag(mean, down, payload, stiffness))


def _sag(
    mean: Array, down: Vector3, payload: PayloadSettings, stiffness: Sequence[float]
) -> Array | None:
    """Return the static deflection (6,) [m, rad], None without a weight."""
    if payload.mass > 0.0:
        weight = payload.mass * GRAVITY * np.array(down)
        turning = np.cross(np.array(payload.centre), weight)
        sag: Array = np.concatenate((weight, turning)) / np.array(stiffness)
        return sag
    x, y, z = mean[:3].tolist()
    along = x * down[0] + y * down[1] + z * down[2]
    if along < WEIGHT_N or along < SHARE * math.hypot(x, y, z):
        return None
    return np.asarray(mean / np.array(stiffness))


def carried(tare: Tare, mount: TactileNoise) -> Vector3:
    """Return the weight that the mount carries, in the tcp [N]; nothing while it is not known."""
    if tare.wrench is None or tare.sag is None:
        return (0.0, 0.0, 0.0)
    bent = (tare.borne * tare.sag[:3]).tolist()
    x, y, z = (bend * k for bend, k in zip(bent, mount.stiffness, strict=True))
    return (x, y, z)


def unloaded(tare: Tare, dt: float, delay: float) -> Tare:
    """Return the tare one step later, while the hub takes over a part of a large weight.

    Args:
        delay: from the target to the tool's motion [s].
    """
    if tare.sag is None:
        return tare
    size = float(np.linalg.norm(tare.sag[:3]))
    if size <= LARGEST_SPRING:
        return tare
    given = 1.0 - LARGEST_SPRING / size
    lasted = 0.0 if tare.unloading is None else tare.unloading + dt
    share = 1.0 - given * smoothstep_at(lasted / UNLOADING_S)
    borne = 1.0 - given * smoothstep_at((lasted - delay) / UNLOADING_S)
    return replace(tare, unloading=lasted, share=share, borne=borne)


def released(tare: Tare, dt: float) -> Tare:
    """Return the tare of a tool without its wheel: the sag leaves the target slowly."""
    if tare.sag is None:
        return tare if tare.wrench is None else NO_TARE
    sag = (1.0 - dt / RELEASED_S) * tare.share * tare.sag
    return Tare(None, sag if float(np.abs(sag).max()) > 1e-6 else None)


def tared(tare: Tare, wrench: Wrench | None, mount: TactileNoise) -> Wrench | None:
    """Return the wrench of the contact alone."""
    mean = tare.wrench
    if wrench is None or mean is None or math.hypot(*mean[:3].tolist()) < LEAST_N:
        return wrench
    if tare.sag is not None and tare.unloading is not None:
        stiffness = np.array((*mount.stiffness, *mount.rotational_stiffness))
        mean = mean - (1.0 - tare.borne) * tare.sag * stiffness
    return replace(wrench, force=wrench.force - mean[:3], torque=wrench.torque - mean[3:])


def bending(tare: Tare, wrench: Wrench | None, mount: TactileNoise) -> Wrench | None:
    """Return the wrench that bends the mount: that of the contact, and the weight.

    Args:
        wrench: of the contact alone.
    """
    if wrench is None or tare.sag is None:
        return wrench
    sag = tare.borne * tare.sag
    force = wrench.force + sag[:3] * np.array(mount.stiffness)
    torque = wrench.torque + sag[3:] * np.array(mount.rotational_stiffness)
    return replace(wrench, force=force, torque=torque)
