"""From samples to pose measurements of the object in the nominal frame c.

Invariants:
- The robot's pose is interpolated between telegrams: a delay need not be a whole number of steps.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise
from operator import itemgetter, truediv

import numpy as np
from msgspec import Struct

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.settings import CameraNoise, TactileNoise
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample

MOST_DISTANCES = 4  # readings of the distance sensor a step that enter the filter one by one
DATED_POSES = 8  # newest poses whose dates are compared with the controller's cycle
EVEN_S = 0.001  # sum of what their dates may differ by without being uneven [s]
OUTLIER_RANGE = 0.005  # range of some readings beyond which one of them is an outlier [m]

_diagonal = itemgetter(0, 6, 11, 15, 18, 20)  # of the upper triangle of a covariance (6, 6)


class History(Struct, frozen=True, eq=False):
    """Past poses of the undeflected tcp in c, newest last.

    Attributes:
        poses: m poses (6,), position [m] and rotation vector [rad].
    """

    stamps_ns: tuple[int, ...]
    poses: tuple[Array, ...]


def remember(history: History | None, stamp_ns: int, pose: Array, length: int) -> History:
    """Return the history with one pose more and at most ``length`` of them."""
    if history is None:
        return History((stamp_ns,), (pose.copy(),))
    if stamp_ns <= history.stamps_ns[-1]:
        return history
    keep = slice(-(length - 1), None)
    return History(history.stamps_ns[keep] + (stamp_ns,), history.poses[keep] + (pose.copy(),))


def pose_at(history: History, stamp_ns: int, reach: float) -> Array | None:
    """Return the tcp's pose (6,) at a stamp, or None where it is not known.

    Args:
        reach: how far the newest motion may be carried on [s].
    """
    stamps, poses = history.stamps_ns, history.poses
    if len(stamps) < 2 or stamp_ns < stamps[0] or stamp_ns > stamps[-1] + reach * 1e9:
        return None
    i = max(bisect_left(stamps, stamp_ns), 1)
    i, j = (i, i - 1) if i < len(stamps) else (-1, _motion_from(stamps))
    share = (stamp_ns - stamps[j]) / (stamps[i] - stamps[j])
    at: Array = poses[j] + share * (poses[i] - poses[j])
    return at


def rate_now(history: History) -> Array:
    """Return the speed of the tcp (6,) [m/s, rad/s], 0 with a single pose."""
    if len(history.stamps_ns) < 2:
        return np.zeros(6)
    j = _motion_from(history.stamps_ns)
    span = (history.stamps_ns[-1] - history.stamps_ns[j]) * 1e-9
    rate: Array = (history.poses[-1] - history.poses[j]) / span
    return rate


def _motion_from(stamps: Sequence[int]) -> int:
    """Return the index of the pose from which on the newest motion is taken.

    Late telegrams that come together are dated together: 0.06 ms apart they gave a speed of 23 m/s,
    and a clamped tool measured its object 0.2 m away.
    """
    last, spaces = stamps[-1], len(stamps) - 1
    least = (last - stamps[0]) / (4 * spaces)  # a quarter of the usual time between two poses
    for j in range(spaces - 1, 0, -1):
        if last - stamps[j] >= (spaces - j) * least:
            return j
    return 0


def date_error(history: History, cycle_s: float) -> float:
    """Return how far the dates of the newest poses may be off [s].

    The controller's cycle is even. Telegrams that are late for long, or come in bursts, are dated
    unevenly: by the sum of that a date may be off.
    """
    spaces = [after - before for before, after in pairwise(history.stamps_ns[-DATED_POSES:])]
    counts = [max(round(space * 1e-9 / cycle_s), 1) for space in spaces]
    periods: list[float] = sorted(map(truediv, spaces, counts))
    if not periods:
        return 0.0
    period = periods[len(periods) // 2]
    error_ns = sum([abs(space - n * period) for space, n in zip(spaces, counts, strict=True)])
    return max(error_ns * 1e-9 - EVEN_S, 0.0)


def motion_at(history: History, stamp_ns: int, span_ns: int) -> Array | None:
    """Return the speed of the tcp (6,) in c at a stamp [m/s, rad/s], None where it is not known.

    Args:
        span_ns: time over which it is averaged [ns].
    """
    before = pose_at(history, stamp_ns - span_ns // 2, 0.0)
    after = pose_at(history, stamp_ns + span_ns // 2, span_ns * 1e-9)
    if before is None or after is None:
        return None
    motion: Array = (after - before) / (span_ns * 1e-9)
    motion[3:] = rotations.left_jacobian(before[3:]).dot(motion[3:])
    return motion


class PoseMeasurement(Struct, frozen=True, eq=False):
    """One measured pose of the object in c.

    Attributes:
        rotation: (3, 3) of the object's axes in c.
        delay: tau, from the measurement to now [s].
        variance: (6,) of position and of a rotation about the axes of c [m^2, rad^2].
        sensitivity: (6, 4) change of position and rotation for a stamp that is 1 s late, and for a
            bias of 1 m for each metre of range along the camera's x, y, z. None if it has neither.
        lasting: noise that is correlated from image to image, apart from ``variance``: (3, 3) the
            position for one sigma along each axis of the camera [m], and one sigma of a rotation
            [rad]. None: each image errs by itself.
    """

    position: Array
    rotation: Array
    delay: float
    variance: Array
    sensitivity: Array | None = None
    lasting: tuple[Array, float] | None = None


def measure_camera(
    sample: CameraSample,
    tcp: Array,
    camera: tuple[Array, Array],
    noise: CameraNoise,
    now_ns: int,
    rate: Array,
    motion: Array | None = None,
) -> PoseMeasurement:
    """Return the pose measurement of a camera sample.

    Args:
        tcp: (6,) undeflected tcp in c at the exposure.
        camera: position (3,) and rotation (3, 3) of the camera in the tcp.
        noise: model of its deviations where the sample has no covariance.
        rate: (6,) of the tcp.
        motion: (6,) speed of the tcp at the exposure, in c [m/s, rad/s]; None if it is not known.
    """
    R_tcp = rotations.exp(tcp[3:])
    R_camera = R_tcp.dot(camera[1])
    in_tcp = camera[0] + camera[1].dot(sample.position)
    position = tcp[:3] + R_tcp.dot(in_tcp)
    rotation = R_camera.dot(rotations.matrix(sample.quaternion))
    if sample.covariance is not None:
        diagonal = np.array(_diagonal(sample.covariance))
    else:
        far = math.hypot(*in_tcp.tolist())
        lateral = noise.lateral + noise.lateral_slope * far
        angle = noise.angle + noise.angle_slope * far
        depth = noise.depth_factor * lateral
        diagonal = np.array((lateral, lateral, depth, angle, angle, angle)) ** 2
    variance = diagonal.reshape(2, 3).dot((R_camera * R_camera).T).reshape(6)
    variance += (noise.stamp * rate) ** 2
    sensitivity = None
    if motion is not None:
        sensitivity = np.zeros((6, 4))
        sensitivity[:, 0] = motion
        # For three floats the products by hand take a tenth of the time of numpy's.
        (a, b, c), (x, y, z) = motion[3:].tolist(), (position - tcp[:3]).tolist()
        sensitivity[:3, 0] += (b * z - c * y, c * x - a * z, a * y - b * x)
        sensitivity[:3, 1:] = math.hypot(*sample.position) * R_camera
    delay = (now_ns - sample.exposure_ns) * 1e-9
    sigmas = noise.lasting * np.sqrt(diagonal)
    turned, lasting = float(sigmas[3:].max()), None
    # A pose that is no number is left to its gate.
    if math.isfinite(turned) and math.isfinite(float(sigmas[:3].max())):
        lasting = R_camera * sigmas[:3], turned
    return PoseMeasurement(position, rotation, delay, variance, sensitivity, lasting)


def mean_distances(samples: Sequence[DistanceSample]) -> list[tuple[DistanceSample, int]]:
    """Return readings of the distance sensor, or means of some in a row, and of how many.

    A sensor of 1 kHz sends more readings than the filter can take one by one. With an outlier among
    them the middle one stands for all, and counts as one.
    """
    if len(samples) <= MOST_DISTANCES:
        return [(sample, 1) for sample in samples]
    blocks, size = [], -(-len(samples) // MOST_DISTANCES)
    for begin in range(0, len(samples), size):
        block = samples[begin : begin + size]
        count, positions = len(block), sorted([sample.position for sample in block])
        if positions[-1] - positions[0] > OUTLIER_RANGE:
            middle = sorted(block, key=_position)[count // 2]
            blocks.append((middle, 1))
            continue
        stamp = sum([sample.stamp_ns for sample in block]) // count
        mean = DistanceSample(stamp, sum(positions) / count, block[-1].strength)
        blocks.append((mean, count))
    return blocks


def _position(sample: DistanceSample) -> float:
    return sample.position


class Wrench(Struct, frozen=True, eq=False):
    """The mean of the wrenches that came since the last step.

    Attributes:
        force: (3,) [N] in the tcp.
        torque: (3,) [Nm] in the tcp.
        stamp_ns: mean of the arrivals.
    """

    force: Array
    torque: Array
    stamp_ns: int
    count: int


def mean_wrench(samples: tuple[WrenchSample, ...]) -> Wrench | None:
    """Return the mean of some wrenches, None of none."""
    if not samples:
        return None
    count = len(samples)
    stamp = sum([sample.stamp_ns for sample in samples]) // count
    # For a dozen floats sums are faster than an array.
    rows = [sample.force + sample.torque for sample in samples]
    mean = np.array([sum(column) / count for column in zip(*rows, strict=True)])
    return Wrench(mean[:3], mean[3:], stamp, count)


def measure_touch(
    wrench: Wrench,
    tcp: Array,
    noise: TactileNoise,
    now_ns: int,
    rate: Array,
    date_error: float = 0.0,
) -> PoseMeasurement:
    """Return the pose measurement of a clamped tool: the tcp, deflected by the wrench.

    Args:
        tcp: (6,) undeflected tcp in c at that moment.
        noise: stiffness of the mount and deviation of a deflection.
        rate: (6,) of the tcp.
        date_error: how far the tcp's date may be off [s].
    """
    R = rotations.exp(tcp[3:])
    shift = wrench.force / np.array(noise.stiffness)
    turn = wrench.torque / np.array(noise.rotational_stiffness)
    count = wrench.count
    place, turned = noise.deflection**2 / count, noise.angle**2 / count
    variance = np.array((place, place, place, turned, turned, turned))
    variance += ((noise.stamp + date_error) * rate) ** 2
    delay = (now_ns - wrench.stamp_ns) * 1e-9
    return PoseMeasurement(tcp[:3] + R.dot(shift), R.dot(rotations.exp(turn)), delay, variance)
