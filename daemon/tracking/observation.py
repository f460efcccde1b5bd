"""From samples to measurements in the nominal frame c: where the object was, and when.

Law of this file: what a sensor saw, joined with where the robot was at that moment. The robot's
pose is interpolated between telegrams, so that a delay need not be a whole number of steps.
"""

from dataclasses import dataclass

import numpy as np

from linemate.daemon import rotations
from linemate.daemon.horizon import Array
from linemate.daemon.tracking.settings import CameraNoise, TactileNoise
from linemate.protocol.samples import CameraSample, WrenchSample


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Where the undeflected tcp was, in c, newest last.

    Attributes:
        stamps: (m,) [s] since ``epoch_ns``.
        poses: (m, 6) position [m] and rotation vector [rad].
        epoch_ns: origin of the stamps; floats keep nanoseconds near it.
    """

    stamps: Array
    poses: Array
    epoch_ns: int


def remember(history: History | None, stamp_ns: int, pose: Array, length: int) -> History:
    """Return the history with one pose more and at most ``length`` of them."""
    if history is None:
        return History(np.zeros(1), pose[None].copy(), stamp_ns)
    stamp = (stamp_ns - history.epoch_ns) * 1e-9
    if stamp <= history.stamps[-1]:
        return history
    keep = slice(-(length - 1), None)
    return History(
        np.append(history.stamps[keep], stamp),
        np.vstack((history.poses[keep], pose)),
        history.epoch_ns,
    )


def pose_at(history: History, stamp_ns: int, reach: float) -> Array | None:
    """Return the tcp's pose (6,) at a stamp, or None where it is not known.

    Args:
        history: of poses.
        stamp_ns: when.
        reach: how far the newest motion may be carried on [s].
    """
    stamps = history.stamps
    t = (stamp_ns - history.epoch_ns) * 1e-9
    if len(stamps) < 2 or t < stamps[0] or t > stamps[-1] + reach:
        return None
    i = min(max(int(np.searchsorted(stamps, t)), 1), len(stamps) - 1)
    share = (t - stamps[i - 1]) / (stamps[i] - stamps[i - 1])
    at: Array = history.poses[i - 1] + share * (history.poses[i] - history.poses[i - 1])
    return at


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One measured pose of the object in c.

    Attributes:
        position: (3,) [m].
        rotation: (3, 3) of the object's axes in c.
        delay: tau, from the measurement to now [s].
        variance: (6,) of position and of a rotation about the axes of c [m^2, rad^2].
    """

    position: Array
    rotation: Array
    delay: float
    variance: Array


def _turned(variances: Array, R: Array) -> Array:
    """Return the diagonal of ``R diag(variances) R'``: variances about other axes."""
    turned: Array = (R * R) @ variances
    return turned


def sight(
    sample: CameraSample,
    tcp: Array,
    camera: tuple[Array, Array],
    noise: CameraNoise,
    now_ns: int,
) -> Sighting:
    """Return what a camera saw.

    Args:
        sample: object in camera.
        tcp: (6,) undeflected tcp in c at the exposure.
        camera: position (3,) and rotation (3, 3) of the camera in the tcp.
        noise: model of its deviations where the sample has no covariance.
        now_ns: time of the step.
    """
    R_tcp = rotations.exp(tcp[3:])
    R_camera = R_tcp @ camera[1]
    in_camera = np.array(sample.position)
    position = tcp[:3] + R_tcp @ (camera[0] + camera[1] @ in_camera)
    rotation = R_camera @ rotations.matrix(sample.quaternion)
    if sample.covariance is not None:
        diagonal = np.array([sample.covariance[i] for i in (0, 6, 11, 15, 18, 20)])
    else:
        far = float(np.linalg.norm(camera[0] + camera[1] @ in_camera))
        lateral = noise.lateral + noise.lateral_slope * far
        angle = noise.angle + noise.angle_slope * far
        depth = noise.depth_factor * lateral
        diagonal = np.array((lateral, lateral, depth, angle, angle, angle)) ** 2
    variance = np.concatenate((_turned(diagonal[:3], R_camera), _turned(diagonal[3:], R_camera)))
    return Sighting(position, rotation, (now_ns - sample.exposure_ns) * 1e-9, variance)


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """The mean of the wrenches that came since the last step.

    Attributes:
        force: (3,) [N] in the tcp.
        torque: (3,) [Nm] in the tcp.
        stamp_ns: mean of the arrivals.
        count: samples in it.
    """

    force: Array
    torque: Array
    stamp_ns: int
    count: int


def mean_wrench(samples: tuple[WrenchSample, ...]) -> Wrench | None:
    """Return the mean of some wrenches, None of none."""
    if not samples:
        return None
    rows = np.array([(*sample.force, *sample.torque) for sample in samples])
    first = samples[0].stamp_ns
    stamp = first + sum(sample.stamp_ns - first for sample in samples) // len(samples)
    mean = rows.sum(axis=0) / len(samples)
    return Wrench(mean[:3], mean[3:], stamp, len(samples))


def touch(wrench: Wrench, tcp: Array, noise: TactileNoise, now_ns: int) -> Sighting:
    """Return where the object holds the clamped tool: the tcp, deflected by the wrench.

    Args:
        wrench: in the tcp.
        tcp: (6,) undeflected tcp in c at that moment.
        noise: stiffness of the mount and deviation of a deflection.
        now_ns: time of the step.
    """
    R = rotations.exp(tcp[3:])
    shift = wrench.force / np.array(noise.stiffness)
    turn = wrench.torque / np.array(noise.rotational_stiffness)
    count = wrench.count
    variance = np.repeat((noise.deflection**2 / count, noise.angle**2 / count), 3)
    delay = (now_ns - wrench.stamp_ns) * 1e-9
    return Sighting(tcp[:3] + R @ shift, R @ rotations.exp(turn), delay, variance)
