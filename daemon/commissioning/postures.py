"""Postures of a standing robot in a recording: joints, gravity, images and wrenches of each.

Invariants:
- Pure. A posture begins when the tool has come to rest and ends before the robot moves again.
- Samples belong to a posture by the time of their exposure or arrival.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.identification.trace import Kinematics

STILL = 0.5e-3  # largest change of a joint over the window of a standing robot [rad, m]
WINDOW_S = 0.2
SETTLING_S = 0.6  # left out at the begin of a posture: the tool swings [s]
SHORTEST_S = 0.6  # rest of a posture that is used [s]
SAME = 5e-3  # joints that differ by less are the same posture [rad, m]
LEAST_IMAGES = 5
LEAST_WRENCHES = 20
OUTLIER = 5.0  # in robust deviations


@dataclass(frozen=True, slots=True, eq=False)
class SeenObject:
    """Mean pose of the object in the camera over a posture.

    Attributes:
        spread: (6,) deviation of a single image along and about the camera's axes [m, rad].
    """

    position: Array
    rotation: Array
    spread: Array
    images: int


@dataclass(frozen=True, slots=True, eq=False)
class StandingPosture:
    """A robot at rest.

    Attributes:
        begin_s, end_s: since the first step [s].
        joints: (axes,) mean [rad, m].
        position, rotation: undeflected tcp in base (3,) [m], (3, 3).
        seen: object in the camera, None with too few images.
        wrench: (6,) mean in the sensor's frame [N, Nm], None with too few readings.
        wrench_spread: (6,) deviation of a single reading.
    """

    begin_s: float
    end_s: float
    joints: Array
    position: Array
    rotation: Array
    seen: SeenObject | None
    wrench: Array | None
    wrench_spread: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class _Rest:
    begin_s: float
    end_s: float
    joints: Array


def find_postures(
    inputs: Sequence[Inputs], kinematics: Kinematics, axes: int
) -> list[StandingPosture]:
    """Return the postures of a recording in their order.

    Args:
        kinematics: from joints to the undeflected tcp in base.
    """
    rests = _rests(inputs, axes)
    if not rests:
        return []
    epoch = inputs[0].stamp_ns
    images = [image for each in inputs for image in each.camera]
    exposures = _seconds([image.exposure_ns for image in images], epoch)
    wrenches = [wrench for each in inputs for wrench in each.wrench]
    arrivals = _seconds([wrench.stamp_ns for wrench in wrenches], epoch)
    values = np.array([(*w.force, *w.torque) for w in wrenches]).reshape(-1, 6)
    postures = []
    for rest in rests:
        inside = np.flatnonzero((exposures >= rest.begin_s) & (exposures <= rest.end_s))
        seen = [(images[i].position, images[i].quaternion) for i in inside]
        felt = values[(arrivals >= rest.begin_s) & (arrivals <= rest.end_s)]
        position, rotation = kinematics(rest.joints)
        is_felt = len(felt) >= LEAST_WRENCHES
        postures.append(
            StandingPosture(
                rest.begin_s,
                rest.end_s,
                rest.joints,
                position,
                rotation,
                _mean_pose(seen),
                felt.mean(axis=0) if is_felt else None,
                felt.std(axis=0) if is_felt else None,
            )
        )
    return postures


def distinct(postures: Sequence[StandingPosture]) -> list[StandingPosture]:
    """Return the postures without those at which the robot stood before."""
    kept: list[StandingPosture] = []
    for posture in postures:
        if all(float(np.abs(posture.joints - other.joints).max()) > SAME for other in kept):
            kept.append(posture)
    return kept


def _rests(inputs: Sequence[Inputs], axes: int) -> list[_Rest]:
    """Return the stretches in which no joint moves."""
    robots = [each.robot for each in inputs if each.robot is not None]
    if len(robots) < 20:
        return []
    times = _seconds([robot.stamp_ns for robot in robots], inputs[0].stamp_ns)
    joints = np.array([(*robot.joints, *robot.external)[:axes] for robot in robots])
    size = max(3, round(WINDOW_S / float(np.median(np.diff(times)))) | 1)
    spans = maximum_filter1d(joints, size, axis=0) - minimum_filter1d(joints, size, axis=0)
    still = (spans < STILL).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(int)))
    rests = []
    for begin, end in edges.reshape(-1, 2).tolist():
        first, last = float(times[begin]) + SETTLING_S, float(times[end - 1])
        if last - first >= SHORTEST_S:
            inside = (times >= first) & (times <= last)
            rests.append(_Rest(first, last, joints[inside].mean(axis=0)))
    return rests


def _seconds(stamps_ns: Sequence[int], epoch_ns: int) -> Array:
    return np.array([stamp - epoch_ns for stamp in stamps_ns], dtype=float) * 1e-9


def _mean_pose(
    seen: Sequence[tuple[tuple[float, float, float], tuple[float, float, float, float]]],
) -> SeenObject | None:
    """Return the mean pose of images without outliers, None with too few."""
    if len(seen) < LEAST_IMAGES:
        return None
    positions = np.array([position for position, _ in seen])
    turns = np.array([rotations.matrix(quaternion) for _, quaternion in seen])
    middle = np.median(positions, axis=0)
    first = turns[int(np.argmin(np.linalg.norm(positions - middle, axis=1)))]
    off = np.hstack((positions - middle, rotations.log_many(first.T @ turns)))
    off -= np.median(off, axis=0)
    scale = np.maximum(1.4826 * np.median(np.abs(off), axis=0), 1e-7)
    kept = (np.abs(off) <= OUTLIER * scale).all(axis=1)
    if int(kept.sum()) < LEAST_IMAGES:
        return None
    turn = rotations.log_many(first.T @ turns[kept])
    mean = first @ rotations.exp(turn.mean(axis=0))
    spread = np.concatenate((positions[kept].std(axis=0), turn.std(axis=0)))
    return SeenObject(positions[kept].mean(axis=0), mean, spread, int(kept.sum()))
