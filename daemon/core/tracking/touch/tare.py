"""Tare of the force-torque sensor before contact, and sag of the mount under the payload.

While the tool hangs free its mean wrench is weight and bias. In contact that is taken off. The
weight bends the mount as well: the elastic tcp is the rigid one and the sag.

Invariants:
- The tare is taken in the approach only, and frozen before the tool can touch.
- Without a configured payload a wrench that is no bias is a weight: it is along gravity and large.
- A tool that was zeroed and measured with its part on hangs otherwise as soon as it is turned. By
  what its force changes as gravity turns in it the weight is estimated, whatever the bias.
- What the wheel weighed is gone when it is released. A hub that holds it takes over what would bend
  the mount by more than ``LARGEST_SPRING``: a tool springs up by twice the sag as a clamp opens.
- A weight that the sensor shows counts, if it is clearly more than the configured one.
- A part of known weight is taken over whole, wherever sensor and tcp were zeroed: the target is
  lowered by what the mount springs up without it, as far as the overload allows.
- A sensor may have been zeroed with the payload on: the mean of the free tool shows whether it was.
- After the release the reading of the empty tool is not known: a sensor that was zeroed with the
  wheel on shows its weight with the other sign then. An overload counts from the mean since.
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
from linemate.daemon.core.tracking.touch import contact
from linemate.daemon.core.tracking.touch.touch_profile import TIPS_RESERVE
from linemate.protocol.stamped_samples import Vector3

GRAVITY = 9.80665  # [m/s^2]
MEAN_S = 0.5  # time constant of the mean wrench [s]; the tool rings at 4 Hz or more
LEAST_N = 1.5  # a smaller tare is noise, and is not taken off [N]
WEIGHT_N = 30.0  # along gravity: less may be a bias of the sensor [N]
MISJUDGED = 0.15  # share by which a payload weighs other than known
SHARE = 0.8  # of a weight's force that is along gravity; a bias has any direction
LARGEST_SAG = 0.1  # of the mount under a free tool: more is no weight [m, rad]
UNLOADING_S = 0.4  # in which the hub takes weight over from the mount [s]
HANDING_S = 2.0  # in which it takes over a part of known weight: a soft carrier sinks by 20 mm [s]
HANDED = 0.8  # share of the overload that it takes over at most
LARGEST_SPRING = 0.004  # sag with which the clamp may open: the tool springs up by twice that [m]
RELEASED_S = 0.5  # time constant with which a released wheel's sag leaves the target [s]
TURNED_N = 5.0  # sigma of a moving tool's mean force: it accelerates [N]
USUAL_N = 300.0  # sigma of a weight before the tool has turned [N]
SPRUNG_S = 1.0  # over which the reading of the empty tool is averaged: several swings of 4 Hz [s]


class Turning(Struct, frozen=True):
    """What a free tool's force and the direction of gravity in it have in common, in the tcp.

    Attributes:
        count: of the means over ``MEAN_S`` that have entered.
        force: mean of the force [N].
        turn: mean of gravity's direction off that of the nominal orientation.
        product: sum of the products of their deviations from these means [N].
        square: sum of the squared deviations of the direction.
    """

    count: float = 0.0
    force: Vector3 = (0.0, 0.0, 0.0)
    turn: Vector3 = (0.0, 0.0, 0.0)
    product: float = 0.0
    square: float = 0.0


UNTURNED = Turning()


class Tare(Struct, frozen=True, eq=False):
    """State of the tare, in the tcp.

    Attributes:
        wrench: (6,) mean of the free tool [N, Nm], None before the first one.
        sag: (6,) static deflection of the mount [m, rad].
        unloading: time since the hub began to take the weight over [s]; None before.
        share: of the sag that the target still has.
        borne: share of the weight that the mount still carries; the motion is late.
        part: (6,) deflection of the mount by the part that the object keeps [m, rad], None if its
            weight is not known. ``share`` and ``borne`` are of that, then.
        turning: of the tool in its approach.
        shown: mean force along gravity in it [N].
        known: weight that is configured [N]; 0 for none.
        is_turned: the sag is of a weight that turned alone, not of the whole weight.
        empty: (3,) mean force of the tool since it released the wheel [N], None before.
        emptied: time since then [s].
    """

    wrench: Array | None = None
    sag: Array | None = None
    unloading: float | None = None
    share: float = 1.0
    borne: float = 1.0
    empty: Array | None = None
    emptied: float = 0.0
    part: Array | None = None
    turning: Turning = UNTURNED
    shown: float = 0.0
    known: float = 0.0
    is_turned: bool = False


NO_TARE = Tare()


def frozen_within(clearance: float, bolts: float) -> float:
    """Return the distance before the object from which the tare is frozen [m].

    A tare that goes on there takes off the force with which the bolts' tips press on the object.

    Args:
        clearance: of the guarded approach [m].
        bolts: their length from the face [m]; 0 for none.
    """
    return max(contact.reach(clearance), bolts + TIPS_RESERVE)


def updated(
    tare: Tare,
    wrench: Wrench,
    down: Vector3,
    nominal: Vector3,
    payload: PayloadSettings,
    mount: TactileNoise,
    dt: float,
) -> Tare:
    """Return the tare of a free tool one step later.

    Args:
        wrench: raw, of this step.
        down: unit vector of gravity in the tcp.
        nominal: the same in the nominal orientation, in which the tcp was measured.
    """
    raw = (*wrench.force.tolist(), *wrench.torque.tolist())
    stiffness = (*mount.stiffness, *mount.rotational_stiffness)
    for each, stiff in zip(raw, stiffness, strict=True):
        if not abs(each) < LARGEST_SAG * stiff:
            return tare
    mean = np.array(raw)
    if tare.wrench is not None:
        mean = tare.wrench + (dt / MEAN_S) * (mean - tare.wrench)
    x, y, z = (a - b for a, b in zip(down, nominal, strict=True))
    turning = turned(tare.turning, (raw[0], raw[1], raw[2]), (x, y, z), dt / MEAN_S)
    along = raw[0] * down[0] + raw[1] * down[1] + raw[2] * down[2]
    shown = tare.shown + dt / (MEAN_S * turning.count) * (along - tare.shown)
    sag, part = _sag(mean, shown, down, payload, stiffness), _part(down, payload, mount)
    if sag is not None:
        known = payload.mass * GRAVITY
        return Tare(mean, sag, part=part, turning=turning, shown=shown, known=known)
    weight = min(turned_weight(turning), mount.overload_force)
    sag = _turned_sag(weight, (x, y, z), stiffness)
    return Tare(mean, sag, part=part, turning=turning, is_turned=sag is not None)


def turned(before: Turning, force: Vector3, turn: Vector3, share: float) -> Turning:
    """Return the moments of force and direction with one more sample.

    Args:
        force: on the free tool [N].
        turn: gravity's direction off that of the nominal orientation.
        share: of a mean over ``MEAN_S`` that the sample is.
    """
    count = before.count + share
    gain = share / count
    more = [a - b for a, b in zip(force, before.force, strict=True)]
    way = [a - b for a, b in zip(turn, before.turn, strict=True)]
    a, b, c = (mean + gain * each for mean, each in zip(before.force, more, strict=True))
    x, y, z = (mean + gain * each for mean, each in zip(before.turn, way, strict=True))
    left = share * (1.0 - gain)
    product = before.product + left * sum(p * q for p, q in zip(more, way, strict=True))
    square = before.square + left * sum(q * q for q in way)
    return Turning(count, (a, b, c), (x, y, z), product, square)


def turned_weight(turning: Turning) -> float:
    """Return the weight that turns with the tool [N]; 0 for less than a sensor's bias.

    Least squares of ``F = b + m g d`` over the approach, with a prior of the weight alone.
    """
    weight = turning.product / (turning.square + (TURNED_N / USUAL_N) ** 2)
    return weight if weight > WEIGHT_N else 0.0


def _turned_sag(weight: float, turn: Vector3, stiffness: Sequence[float]) -> Array | None:
    """Return the deflection (6,) by a weight whose direction turned [m, rad], None without it."""
    if weight == 0.0:
        return None
    bent = [weight * each / k for each, k in zip(turn, stiffness[:3], strict=True)]
    return np.array((*bent, 0.0, 0.0, 0.0))


def _part(down: Vector3, payload: PayloadSettings, mount: TactileNoise) -> Array | None:
    """Return the deflection (6,) by the part that the object keeps [m, rad], None if not known."""
    if payload.part_mass <= 0.0:
        return None
    weight = min(payload.part_mass * GRAVITY, HANDED * mount.overload_force)
    bent = [weight * each / k for each, k in zip(down, mount.stiffness, strict=True)]
    return np.array((*bent, 0.0, 0.0, 0.0))


def _sag(
    mean: Array, shown: float, down: Vector3, payload: PayloadSettings, stiffness: Sequence[float]
) -> Array | None:
    """Return the static deflection (6,) [m, rad], None without a weight.

    Args:
        shown: mean force along gravity [N]. A sensor that was zeroed with the payload on, or with a
            part of it, shows less than its weight. One that was never zeroed shows the empty tool
            as well: from twice the known weight on it says nothing of the payload.
    """
    if payload.mass > 0.0:
        known = payload.mass * GRAVITY
        is_weight = shown > SHARE * math.hypot(*mean[:3].tolist())
        more = shown - known if is_weight else 0.0
        # Without a step: the mean moves across a limit, and the target would with it.
        more = max(min(more, 2.0 * (more - WEIGHT_N), 2.0 * (known - more)), 0.0)
        x, y, z = ((known + more) * each for each in down)
        a, b, c = payload.centre
        weight = (x, y, z, b * z - c * y, c * x - a * z, a * y - b * x)
        sag: Array = np.array(weight) / np.array(stiffness)
        return sag
    x, y, z = mean[:3].tolist()
    along = x * down[0] + y * down[1] + z * down[2]
    if along < WEIGHT_N or along < SHARE * math.hypot(x, y, z):
        return None
    return np.asarray(mean / np.array(stiffness))


def shows_weight(tare: Tare, mount: TactileNoise) -> bool:
    """Return whether the free tool's mean force was its weight: the sensor has the right sign."""
    return shown_weight(tare, mount) is not None


def shown_weight(tare: Tare, mount: TactileNoise) -> tuple[float, float] | None:
    """Return the weight by the sensor and the known one [N], None if the sensor shows none."""
    # The whole weight of a tool that was zeroed with it on is not shown.
    if tare.wrench is None or tare.sag is None or tare.is_turned:
        return None
    force, weight = tare.wrench[:3], tare.sag[:3] * np.array(mount.stiffness)
    size, sagging = float(np.linalg.norm(force)), float(np.linalg.norm(weight))
    along = float(force.dot(weight)) / sagging
    if size <= WEIGHT_N or along <= SHARE * size:
        return None
    return along, tare.known or sagging


def carried(tare: Tare, mount: TactileNoise) -> Vector3:
    """Return the weight on the mount as the sensor states it, in the tcp [N]; 0 if not known.

    Of a tool that released its wheel it is the mean reading. A tool that springs up swings about it
    by what the wheel weighed, so this counts as no more than the wheel did.
    """
    if tare.empty is not None:
        x, y, z = tare.empty.tolist()
        return (x, y, z)
    sag = mounted(tare)
    if tare.wrench is None or sag is None:
        return (0.0, 0.0, 0.0)
    if tare.sag is not None:
        whole = tare.sag[:3] * np.array(mount.stiffness)
        if 2.0 * float(tare.wrench[:3].dot(whole)) < float(whole.dot(whole)):
            # Nearer to nothing than to the weight: the sensor was zeroed with it on.
            sag = sag - tare.sag
    x, y, z = (bend * k for bend, k in zip(sag[:3].tolist(), mount.stiffness, strict=True))
    return (x, y, z)


def commanded(tare: Tare) -> Array | None:
    """Return the sag (6,) that the target has [m, rad], None without one."""
    return _left(tare, tare.share)


def mounted(tare: Tare) -> Array | None:
    """Return the sag (6,) of the mount now [m, rad], None without one."""
    return _left(tare, tare.borne)


def _left(tare: Tare, share: float) -> Array | None:
    """Return the sag (6,) while a share of what is handed over is still on the mount."""
    if tare.part is None or share == 1.0:
        return None if tare.sag is None else share * tare.sag
    sprung = (share - 1.0) * tare.part
    return sprung if tare.sag is None else tare.sag + sprung


def is_handed(tare: Tare) -> bool:
    """Return whether the hub takes over a part of known weight, or has."""
    return tare.part is not None and tare.unloading is not None


def is_lowering(tare: Tare) -> bool:
    """Return whether the mount still carries some of a part that the hub takes over."""
    return is_handed(tare) and tare.borne > 0.0


def without_weight(tare: Tare, force: Vector3) -> Vector3:
    """Return a force on the tool without what is left of a part's weight, in the tcp [N]."""
    if tare.part is None or not is_handed(tare):
        return force
    down = tare.part[:3] / float(np.linalg.norm(tare.part[:3]))
    x, y, z = (np.array(force) - down.dot(force) * down).tolist()
    return (x, y, z)


def unloaded(tare: Tare, dt: float, delay: float) -> Tare:
    """Return the tare one step later, while the hub takes over a part of the weight.

    All of a part of known weight; else what is large.

    Args:
        delay: from the target to the tool's motion [s].
    """
    given, duration = _given(tare), UNLOADING_S if tare.part is None else HANDING_S
    if given <= 0.0:
        return tare
    lasted = 0.0 if tare.unloading is None else tare.unloading + dt
    share = 1.0 - given * smoothstep_at(lasted / duration)
    borne = 1.0 - given * smoothstep_at((lasted - delay) / duration)
    return replace(tare, unloading=lasted, share=share, borne=borne)


def _given(tare: Tare) -> float:
    """Return the share of the weight that the hub takes over."""
    if tare.part is not None:
        return 1.0
    if tare.sag is None:
        return 0.0
    size = float(np.linalg.norm(tare.sag[:3]))
    return max(1.0 - LARGEST_SPRING / size, 0.0)


def is_misjudged(weight: float, known: float) -> bool:
    """Return whether a weight by the sensor [N] is not the known one, by more than a bias."""
    return abs(weight - known) > max(WEIGHT_N, MISJUDGED * known)


def released(tare: Tare, wrench: Wrench | None, dt: float, *, is_clear: bool = True) -> Tare:
    """Return the tare of a tool without its wheel: the sag leaves the target slowly.

    That of an empty tool of known weight stays until it is clear of the object.

    Args:
        wrench: raw, of this step.
    """
    sag = commanded(tare)
    if sag is not None and (is_clear or tare.part is None):
        left = (1.0 - dt / RELEASED_S) * sag
        sag = left if float(np.abs(left).max()) > 1e-6 else None
    empty, emptied = tare.empty, tare.emptied
    if wrench is not None and emptied < SPRUNG_S:
        emptied += dt
        before = wrench.force if empty is None else empty
        empty = before + (dt / emptied) * (wrench.force - before)
    if sag is None and tare.sag is None and tare.wrench is None and empty is tare.empty:
        return tare
    return Tare(None, sag, empty=empty, emptied=emptied, part=tare.part)


def tared(tare: Tare, wrench: Wrench | None, mount: TactileNoise) -> Wrench | None:
    """Return the wrench of the contact alone."""
    mean, given = tare.wrench, tare.sag if tare.part is None else tare.part
    if wrench is None or mean is None:
        return wrench
    if given is not None and tare.unloading is not None:
        stiffness = np.array((*mount.stiffness, *mount.rotational_stiffness))
        mean = mean - (1.0 - tare.borne) * given * stiffness
    elif math.hypot(*mean[:3].tolist()) < LEAST_N:
        return wrench
    return replace(wrench, force=wrench.force - mean[:3], torque=wrench.torque - mean[3:])


def bending(tare: Tare, wrench: Wrench | None, mount: TactileNoise) -> Wrench | None:
    """Return the wrench that bends the mount: that of the contact, and the weight.

    Args:
        wrench: of the contact alone.
    """
    sag = mounted(tare)
    if wrench is None or sag is None:
        return wrench
    force = wrench.force + sag[:3] * np.array(mount.stiffness)
    torque = wrench.torque + sag[3:] * np.array(mount.rotational_stiffness)
    return replace(wrench, force=force, torque=torque)
