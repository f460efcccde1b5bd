"""Errors of real sensors: camera bias, correlated noise, occlusion, stamps; slip and drift.

Invariants:
    Every effect is 0 by default; a sensor without effects draws no number here.
    An effect is evaluated at every instant of its sensor, in order, each draw from a stream
        of its own.
"""

import math
from dataclasses import dataclass

from linemate.simulators.plants import rotation
from linemate.simulators.plants.rotation import Pose, Vec
from linemate.simulators.plants.streams import Draws

Vector3 = tuple[float, float, float]

FARTHER_M = 0.1
"""The hub is in sight again for a new approach when it is this much farther away [m]."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A time in which a sensor sees nothing.

    Attributes:
        begin_s: scenario time of the first instant without sight [s].
        end_s: scenario time of the first instant with sight again [s].
    """

    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class CameraEffects:
    """What a real camera adds to white noise, delay and loss.

    Attributes:
        depth_bias: error of the depth per distance tcp - hub [m/m].
        lateral_bias: error along x and y of the camera per distance [m/m].
        correlated_sigma: Gauss-Markov error of the position at distance 0 [m].
        correlated_sigma_per_metre: its growth with the distance [m/m].
        correlated_rotation: Gauss-Markov error of the orientation, each axis [rad].
        correlation_s: correlation time of both [s].
        occlusions: times in which something stands between camera and hub.
        blind_before_contact_s: the wheel hides the hub this long before it would be reached [s].
        view_limit: angle between line of sight and hub axis at which no image gives a pose
            [rad]; the share of lost images grows with its square; 0 for none.
        stamp_bias_s: stamp minus true instant of exposure [s].
        stamp_jitter_s: half width of the stamp's uniform error [s].
        exposure_time_s: time over which an image is smeared [s].
        mount_offset: true mount of the camera off the one stated, in the tcp frame [m].
        mount_rotation: the same as rotation vector [rad].
    """

    depth_bias: float = 0.0
    lateral_bias: tuple[float, float] = (0.0, 0.0)
    correlated_sigma: float = 0.0
    correlated_sigma_per_metre: float = 0.0
    correlated_rotation: float = 0.0
    correlation_s: float = 0.5
    occlusions: tuple[Interval, ...] = ()
    blind_before_contact_s: float = 0.0
    view_limit: float = 0.0
    stamp_bias_s: float = 0.0
    stamp_jitter_s: float = 0.0
    exposure_time_s: float = 0.0
    mount_offset: Vector3 = (0.0, 0.0, 0.0)
    mount_rotation: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class DistanceEffects:
    """What a real distance sensor adds to white noise and quantisation.

    Attributes:
        slip: share of the travel that a slipping measuring wheel does not count.
        drift: random walk of the reading [m/sqrt(s)].
    """

    slip: float = 0.0
    drift: float = 0.0


class CameraErrors:
    """Errors of one camera over its run."""

    def __init__(self, effects: CameraEffects, period_s: float, depth: float, seed: int) -> None:
        """Begin in the stationary distribution.

        Args:
            depth: how much noisier the depth is than the other axes.
        """
        self._effects, self._period, self._depth = effects, period_s, depth
        self._decay = math.exp(-period_s / effects.correlation_s)
        self._noise = Draws.normal(seed, "camera.correlated")
        self._blur = Draws.normal(seed, "camera.blur")
        self._stamp = Draws.uniform(seed, "camera.stamp")
        self._view = Draws.uniform(seed, "camera.view")
        self._walk = self._noise.next_numbers(6)
        self._place: Vec | None = None
        self._distance = -math.inf
        # Instant and distance at which the wheel began to hide the hub.
        self._covered: tuple[float, float] | None = None

    def mount(self, stated: Pose) -> Pose:
        """Return the true mount in the rigid tcp frame."""
        effects = self._effects
        place, turn = stated
        shifted = rotation.add(place, effects.mount_offset)
        return shifted, rotation.compose(rotation.exp(effects.mount_rotation), turn)

    def stamp(self, exposure_s: float) -> float:
        """Return the instant that the camera states for an exposure."""
        effects = self._effects
        jitter = effects.stamp_jitter_s * (2.0 * self._stamp.next_number() - 1.0)
        return exposure_s + effects.stamp_bias_s + jitter

    def is_hidden(self, exposure_s: float, seen: Pose, distance: float) -> bool:
        """Whether this image gives no pose.

        Args:
            seen: hub in the true camera.
            distance: tcp to hub [m].
        """
        effects, chance = self._effects, self._view.next_number()
        if any(each.begin_s <= exposure_s < each.end_s for each in effects.occlusions):
            return True
        if effects.blind_before_contact_s and self._is_covered(exposure_s, distance):
            return True
        return effects.view_limit > 0.0 and chance < (view_angle(seen) / effects.view_limit) ** 2

    def disturb(self, seen: Pose, distance: float) -> Pose:
        """Return a hub in the camera with bias, correlated noise and blur; once an exposure."""
        effects, decay = self._effects, self._decay
        spread = math.sqrt(1.0 - decay * decay)
        draws = self._noise.next_numbers(6)
        self._walk = [decay * w + spread * d for w, d in zip(self._walk, draws, strict=True)]
        a, b, c, *twist = self._walk
        size = effects.correlated_sigma + effects.correlated_sigma_per_metre * distance
        place, turn = seen
        smear = self._smear(place)
        x, y = (bias * distance for bias in effects.lateral_bias)
        z = effects.depth_bias * distance
        error = (x + size * a, y + size * b, z + self._depth * size * c)
        p, q, r = (effects.correlated_rotation * t for t in twist)
        turned = rotation.compose(rotation.exp((p, q, r)), turn)
        return rotation.add(rotation.add(place, error), smear), turned

    def _smear(self, place: Vec) -> Vec:
        """Spread of the mean of a smeared image, uniform over the way during the exposure."""
        before, self._place = self._place or place, place
        share = self._effects.exposure_time_s / self._period / math.sqrt(12.0)
        x, y, z = (
            share * draw * (now - old)
            for draw, now, old in zip(self._blur.next_numbers(3), place, before, strict=True)
        )
        return (x, y, z)

    def _is_covered(self, exposure_s: float, distance: float) -> bool:
        """Whether the wheel hides the hub: from some time before contact on, for that time."""
        before, self._distance = self._distance, distance
        length = self._effects.blind_before_contact_s
        if self._covered is None:
            closing = (before - distance) / self._period
            if closing > 0.0 and distance < closing * length:
                self._covered = (exposure_s, distance)
        elif distance > self._covered[1] + FARTHER_M:
            self._covered = None
        return self._covered is not None and exposure_s < self._covered[0] + length


def view_angle(seen: Pose) -> float:
    """Angle between the line of sight and the hub's axis [rad]."""
    place, turn = seen
    along = (turn[2], turn[5], turn[8])
    cosine = sum(p * a for p, a in zip(place, along, strict=True)) / rotation.norm(place)
    return math.acos(min(1.0, max(-1.0, cosine)))


class DistanceErrors:
    """Errors of one distance sensor over its run."""

    def __init__(self, effects: DistanceEffects, period_s: float, seed: int) -> None:
        self._effects = effects
        self._step = effects.drift * math.sqrt(period_s)
        self._noise = Draws.normal(seed, "distance.drift")
        self._drift = 0.0

    def disturb(self, position: float) -> float:
        """Return a position as the sensor measures it; once an instant."""
        if self._step:
            self._drift += self._step * self._noise.next_number()
        return position * (1.0 - self._effects.slip) + self._drift
