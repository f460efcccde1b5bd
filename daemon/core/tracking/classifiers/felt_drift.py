"""Deflection of the clamped tool that grows to one side, seen before a class of the conveyor is.

A stop in contact is confirmed 0.2 s after its onset, with 100 N in the mount. What is commanded
goes on for another 0.1 s, with 200 N at its end. So the force that will be there then decides: the
deflection and the way that it drifts until then.

Invariants:
- A body that swings draws nothing: followed with a lead, it would be driven. Each quarter of a
  swing is shorter than ``GROWN_S``, or the deflection has been to both sides of late.
- A deflection that is small and will be draws nothing.
"""

import math

from msgspec import Struct
from msgspec.structs import replace

AHEAD_S = 0.12  # in which a decision shows in the force: dead time, merge and servos [s]
FARTHEST_AHEAD = 0.002  # of a deflection then: 100 N on a mount of 50 N/mm [m]
BAND = 0.001  # beyond it, after which the deflection is taken up whole [m]
SMOOTHING_S = 0.024  # time constant of the drift [s]
MEAN_S = 0.1  # time constant of the mean of one that swings quickly: 6 Hz leave a quarter [s]
GROWN_S = 0.09  # for which it has drifted away: a quarter of a period of 2.8 Hz [s]
SWING_M = 0.0003  # to each side; less is noise [m]
QUICK_HALF_S = 0.25  # half a period that is no longer than twice the delay of what follows it [s]
SWUNG_S = 1.0  # after which a change of side is forgotten: a period of 0.5 Hz is longer [s]


class FeltDrift(Struct, frozen=True):
    """What is known of a deflection from the guide.

    Attributes:
        off: the last one [m]; None before the first one.
        mean: of it, smoothed [m].
        speed: of it, smoothed [m/s].
        grows_s: for which it has grown to one side [s].
        side: of the last one beyond ``SWING_M``: 1 or -1, 0 before the first one.
        kept_s: since it changed its side [s].
        half_s: for which it was on the side before [s].
        peak: farthest on its side, and ``reach`` on the side before [m].
        drawn: by which it has drawn the guide after it, forgotten within ``SWUNG_S`` [m].
    """

    off: float | None = None
    mean: float = 0.0
    speed: float = 0.0
    grows_s: float = 0.0
    side: int = 0
    kept_s: float = math.inf
    half_s: float = math.inf
    peak: float = 0.0
    reach: float = math.inf
    drawn: float = 0.0

    @property
    def is_quick(self) -> bool:
        """Whether it swings so quickly that a target which followed it would drive it."""
        return self.half_s < QUICK_HALF_S and self.kept_s < QUICK_HALF_S


UNFELT = FeltDrift()


def observed(before: FeltDrift, off: float, dt: float) -> FeltDrift:
    """Return what is known with one more deflection.

    Args:
        off: from the guide [m].
        dt: since the one before [s].
    """
    if before.off is None:
        return replace(before, off=off, mean=off)
    gain = 1.0 - math.exp(-dt / SMOOTHING_S)
    speed = before.speed + gain * ((off - before.off) / dt - before.speed)
    grows = speed * before.speed > 0.0 and speed * off > 0.0
    side, kept_s, half_s = before.side, before.kept_s + dt, before.half_s
    peak, reach = max(before.peak, side * off), before.reach
    if abs(off) > SWING_M and side * off <= 0.0:
        kept_s, half_s, reach = (0.0, kept_s, peak) if side else (kept_s, half_s, reach)
        side, peak = 1 if off > 0.0 else -1, abs(off)
    mean = before.mean + (1.0 - math.exp(-dt / MEAN_S)) * (off - before.mean)
    grows_s, drawn = before.grows_s + dt if grows else 0.0, before.drawn * math.exp(-dt / SWUNG_S)
    return FeltDrift(off, mean, speed, grows_s, side, kept_s, half_s, peak, reach, drawn)


def share_taken(felt: FeltDrift) -> float:
    """Return the share of a deflection and of its drift that the guide takes up, 0 to 1."""
    if felt.off is None or felt.grows_s < GROWN_S or felt.kept_s < SWUNG_S:
        return 0.0
    ahead = abs(felt.off + AHEAD_S * felt.speed)
    return min(max(ahead - FARTHEST_AHEAD, 0.0) / BAND, 1.0)


def drift_ahead(felt: FeltDrift) -> float:
    """Return by how much a deflection drifts until a decision shows in the force [m].

    Nothing for one that is not on the side of its mean: the tool rings on its mount.
    """
    return AHEAD_S * felt.speed if (felt.off or 0.0) * felt.mean > 0.0 else 0.0


def taken(felt: FeltDrift, share: float) -> FeltDrift:
    """Return what is left after the guide has taken up a share."""
    if felt.off is None or not share:
        return felt
    left, drawn = 1.0 - share, felt.drawn + share * felt.off
    off, mean, speed = left * felt.off, left * felt.mean, left * felt.speed
    return replace(felt, off=off, mean=mean, speed=speed, drawn=drawn)


def moved(felt: FeltDrift) -> FeltDrift:
    """Return what is left as the guide changes its class: the side to which it was."""
    return FeltDrift(side=felt.side, kept_s=felt.kept_s, half_s=felt.half_s)
