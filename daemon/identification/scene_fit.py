"""Scene fit: rest pose, swings, hand-eye offset and stamp error from all images at once.

One weighted least-squares fit over all recordings. Poses are in c.

Invariants:
- Pose at rest, amplitude and phase belong to a recording. Frequency, damping, axis and levers of a
  swing, the hand-eye offset and the stamp error belong to the cell.
- Weak priors keep the fit regular. What they alone determine is not observable.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.settings import CameraNoise
from linemate.daemon.identification.conveyor_motion import conveyor
from linemate.daemon.identification.trace import Images, Mask, TcpPath, Trace, tcp_path

# Prior deviations of hand-eye position [m], hand-eye rotation [rad], stamp error and lateness [s].
PRIORS = np.array((0.05, 0.05, 0.05, 0.1, 0.1, 0.1, 0.05, 0.02))
SHARED = len(PRIORS)

GATE = 5.0
CONTACT_MARGIN = 0.1  # around a contact, without images [s]
ITERATIONS = 15
SETTLED = 1e-7  # least gain of a further step, as a share of the cost
LEAST_IMAGES = 40
ALONG = 0.0003  # deviation of the conveyor's position by the distance sensor [m]
RANGE_BIAS = (0.0005, 0.0005, 0.002)  # of a camera, unknown: 1 to 5 mm a metre in depth [m/m]
BLOCK_S = 2.0  # errors of images this far apart are independent: a camera's are for 0.1 to 1 s [s]


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Images of one stretch of a recording, with the poses of the tcp.

    Attributes:
        times: (m,) exposures since the recording's begin [s].
        positions, rotations: (m, 3), (m, 3, 3) object in the camera.
        along, speed: (m,) position and speed of the conveyor by the distance sensor [m, m/s].
        deviations: (m, 6) of position and rotation in the camera [m, rad].
        middle: time to which phases refer [s].
        ranges: (m,) distance from tcp to object [m].
    """

    times: Array
    positions: Array
    rotations: Array
    along: Array
    speed: Array
    tcp_path: TcpPath
    deviations: Array
    middle: float
    ranges: Array


@dataclass(frozen=True, slots=True)
class Mode:
    """One swing as it is fitted.

    Attributes:
        axis: 0..2, the axis of c about which it turns most.
        direction: (3,) turn for each radian about ``axis``.
        levers: (3,) displacement for each radian about ``axis`` [m/rad].
    """

    axis: int
    frequency_hz: float
    damping: float
    direction: tuple[float, float, float]
    levers: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """The object in one recording.

    Attributes:
        position: (3,) at rest, the conveyor's reading taken out [m].
        rotation: (3, 3) at rest.
        amplitudes: (modes, 2) cosine and sine part at the middle [rad].
    """

    position: Array
    rotation: Array
    amplitudes: Array


@dataclass(frozen=True, slots=True, eq=False)
class SceneFit:
    """Everything that is fitted.

    Attributes:
        hand_eye: (6,) what must be added to the hand-eye pose: position in the tcp [m] and a turn
            about the camera's axes [rad].
        stamp_error: what must be added to the exposures' stamps [s].
        late: of the distance sensor, beyond its stated delay [s].
        covariance: of the shared parameters: for each mode frequency, damping, two directions,
            three levers; then hand-eye, stamp error and lateness. Empty before a fit.
        rest_deviations: (recordings, 6) deviations of position and rotation at rest [m, rad].
        chi2: of an average residual, 1 where the stated deviations are honest.
    """

    modes: tuple[Mode, ...]
    rests: tuple[Rest, ...]
    hand_eye: Array
    stamp_error: float
    late: float
    covariance: Array
    rest_deviations: Array
    chi2: float

    @property
    def of_cell(self) -> Array:
        """Hand-eye, stamp error and lateness (8,) [m, rad, s]."""
        return np.concatenate((self.hand_eye, (self.stamp_error, self.late)))


# Configured position (3,) and rotation (3, 3) of the camera in the tcp.
Camera = tuple[Array, Array]


def views(
    trace: Trace, camera: Camera, noise: CameraNoise, distance_delay: float = 0.0
) -> list[Views]:
    """Return the images of a trace with known poses, one view for each stretch of free space.

    Contact may rotate the object (fixed screws do), so before and after are two scenes. A stretch
    of too few images is left out.

    Args:
        noise: noise of a camera that states none.
        distance_delay: from measuring to arrival of a distance [s].
    """
    images = trace.images
    path = tcp_path(trace)
    along, speed, is_known = conveyor(
        trace.distances - np.array((distance_delay, 0.0)), images.exposures
    )
    known = path.known(images.exposures) & is_known
    known &= ~trace.in_contact(images.exposures, CONTACT_MARGIN)
    contacts = np.searchsorted(trace.contact[:, 0], images.exposures)
    stretches = [np.flatnonzero(known & (contacts == i)) for i in range(len(trace.contact) + 1)]
    return [
        _view(images, rows, path, (along[rows], speed[rows]), camera, noise)
        for rows in stretches
        if len(rows) >= LEAST_IMAGES
    ]


def _view(
    images: Images,
    rows: NDArray[np.intp],
    path: TcpPath,
    conveyed: tuple[Array, Array],
    camera: Camera,
    noise: CameraNoise,
) -> Views:
    positions = images.positions[rows]
    ranges = np.linalg.norm(camera[0] + positions @ camera[1].T, axis=1)
    lateral = noise.lateral + noise.lateral_slope * ranges
    angle = noise.angle + noise.angle_slope * ranges
    modelled = np.column_stack(
        (lateral, lateral, noise.depth_factor * lateral, angle, angle, angle)
    )
    stated = images.deviations[rows]
    times = images.exposures[rows]
    return Views(
        times=times,
        positions=positions,
        rotations=images.rotations[rows],
        along=conveyed[0],
        speed=conveyed[1],
        tcp_path=path,
        deviations=np.where(np.isfinite(stated) & (stated > 0.0), stated, modelled),
        middle=float(times.mean()),
        ranges=ranges,
    )


def placed(view: Views, camera: Camera) -> tuple[Array, Array]:
    """Return the object's positions (m, 3), the conveyor taken out, and rotations (m, 3, 3)."""
    p, R = view.tcp_path.at(view.times)
    positions = p + np.einsum("nij,nj->ni", R, camera[0] + view.positions @ camera[1].T)
    positions[:, 1] -= view.along
    return positions, R @ camera[1] @ view.rotations


def at_rest(view: Views, camera: Camera) -> Rest:
    """Return a first guess of an object that does not swing."""
    positions, turned = placed(view, camera)
    first = turned[len(turned) // 2]
    turn = np.median(turns(turned @ first.T), axis=0)
    return Rest(np.median(positions, axis=0), rotations.exp(turn) @ first, np.zeros((0, 2)))


def swing(mode: Mode, amplitude: Array, t: Array) -> Array:
    """Return the angle (m,) of one swing at times since the middle."""
    w = 2.0 * math.pi * mode.frequency_hz
    decay = np.exp(-mode.damping * w * t)
    angle: Array = decay * (amplitude[0] * np.cos(w * t) + amplitude[1] * np.sin(w * t))
    return angle


def residuals(scene: SceneFit, index: int, view: Views, camera: Camera) -> Array:
    """Return the residuals of one recording's images (m, 6), in the camera [m, rad]."""
    rest = scene.rests[index]
    t = view.times + scene.stamp_error
    p, R = view.tcp_path.at(t)
    camera_R = R @ (camera[1] @ rotations.exp(scene.hand_eye[3:]))
    camera_p = p + R @ (camera[0] + scene.hand_eye[:3])
    place = np.tile(rest.position, (len(t), 1))
    place[:, 1] += view.along + view.speed * (scene.stamp_error + scene.late)
    turned = np.broadcast_to(rest.rotation, (len(t), 3, 3))
    for mode, amplitude in zip(scene.modes, rest.amplitudes, strict=True):
        phi = swing(mode, amplitude, t - view.middle)
        direction, levers = np.array(mode.direction), np.array(mode.levers)
        place += phi[:, None] * levers
        place += (0.5 * phi * phi)[:, None] * np.cross(direction, levers)
        turned = rotations.exp_many(phi[:, None] * direction) @ turned
    seen = np.einsum("nji,nj->ni", camera_R, place - camera_p)
    expected = np.swapaxes(camera_R, 1, 2) @ turned
    e = np.empty((len(t), 6))
    e[:, :3] = view.positions - seen
    e[:, 3:] = turns(view.rotations @ np.swapaxes(expected, 1, 2))
    return e


def fit(
    scene: SceneFit, seen: Sequence[Views], camera: Camera, *, shared: bool = True
) -> tuple[SceneFit, tuple[Mask, ...]]:
    """Return the best scene near a guess, and which images (m,) of each recording were used.

    Args:
        shared: fit hand-eye offset and stamp error too.
    """
    kept = [np.ones(len(view.times), dtype=bool) for view in seen]
    for round_ in range(3):
        scene = _descend(scene, seen, camera, kept, shared)
        if round_ == 2:
            break
        scale = math.sqrt(_chi2(scene, seen, camera, kept))
        for i, view in enumerate(seen):
            weighed = residuals(scene, i, view, camera) / spread(view)
            kept[i] = np.abs(weighed).max(axis=1) < GATE * max(scale, 0.2)
    A, _ = _normal(scene, seen, camera, kept, shared)
    chi2 = _chi2(scene, seen, camera, kept)
    inverse = np.linalg.pinv(A, hermitian=True)
    correlated = _growth(weighed_images(scene, seen, camera, kept), _size(scene))
    scale = max(chi2 * correlated, 1e-12)
    covariance = inverse * scale
    if shared:
        covariance = _covariance(inverse, scale)
        covariance += _considered(scene, seen, camera, kept, inverse)
    first = _size(scene) - _shared_size(scene)
    deviations = np.sqrt(np.maximum(covariance.diagonal()[:first], 0.0))
    rest_deviations = deviations.reshape(len(scene.rests), -1)[:, :6]
    shared_part = covariance[first:, first:]
    return replace(
        scene, covariance=shared_part, rest_deviations=rest_deviations, chi2=chi2
    ), tuple(kept)


def _covariance(inverse: Array, scale: float) -> Array:
    """Return the covariance where the images' errors have ``scale`` times the stated variance.

    The priors keep theirs: what they alone have is no better known in quiet images.
    """
    of_priors = inverse[:, -SHARED:] / PRIORS**2 @ inverse[-SHARED:]
    covariance: Array = inverse * scale + max(1.0 - scale, 0.0) * of_priors
    return covariance


def spread(view: Views) -> Array:
    """Return the deviations (m, 6) of an image against the scene, the conveyor's own included."""
    deviations = view.deviations.copy()
    deviations[:, :3] = np.hypot(deviations[:, :3], ALONG)
    return deviations


def _chi2(scene: SceneFit, seen: Sequence[Views], camera: Camera, kept: list[Mask]) -> float:
    weighed = [e for _, e in weighed_images(scene, seen, camera, kept)]
    return max(float((1.4826 * np.median(np.abs(np.concatenate(weighed)))) ** 2), 1e-12)


def _descend(
    scene: SceneFit, seen: Sequence[Views], camera: Camera, kept: list[Mask], shared: bool
) -> SceneFit:
    """Return the scene after Gauss-Newton steps, halved where they overshoot."""
    cost = _cost(scene, seen, camera, kept)
    for _ in range(ITERATIONS):
        A, g = _normal(scene, seen, camera, kept, shared)
        scale = np.sqrt(np.maximum(A.diagonal(), 1e-300))
        step = -np.linalg.lstsq(A / np.outer(scale, scale), g / scale, rcond=1e-12)[0] / scale
        for _ in range(8):
            trial = _moved(scene, step)
            cost_trial = _cost(trial, seen, camera, kept)
            if cost_trial <= cost:
                break
            step = 0.5 * step
        else:
            return scene
        gain, scene, cost = cost - cost_trial, trial, cost_trial
        if gain < SETTLED * cost:
            break
    return scene


def _cost(scene: SceneFit, seen: Sequence[Views], camera: Camera, kept: list[Mask]) -> float:
    prior = scene.of_cell / PRIORS
    total = float(prior @ prior)
    for _, e in weighed_images(scene, seen, camera, kept):
        total += float(np.sum(e * e))
    return total


def _shared_size(scene: SceneFit) -> int:
    return 7 * len(scene.modes) + SHARED


def _size(scene: SceneFit) -> int:
    return len(scene.rests) * (6 + 2 * len(scene.modes)) + _shared_size(scene)


def _steps(scene: SceneFit) -> Array:
    """Return the steps of the numeric derivatives."""
    own = np.tile((1e-5,) * 6 + (1e-6,) * 2 * len(scene.modes), len(scene.rests))
    mode = (1e-5, 1e-5, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4)
    return np.concatenate((own, np.tile(mode, len(scene.modes)), (1e-5,) * SHARED))


def linearised(
    scene: SceneFit, index: int, view: Views, camera: Camera, kept: Mask
) -> tuple[Array, Array]:
    """Return the jacobian by all parameters and the residuals of one view, both weighed."""
    columns, narrow, e = _derivatives(scene, index, view, camera, kept)
    jacobian = np.zeros((len(e), _size(scene)))
    jacobian[:, columns] = narrow
    return jacobian, e


def _derivatives(
    scene: SceneFit, index: int, view: Views, camera: Camera, kept: Mask
) -> tuple[list[int], Array, Array]:
    """Return which parameters one view depends on, its jacobian by them, and its residuals."""
    size, own, steps = _size(scene), 6 + 2 * len(scene.modes), _steps(scene)
    columns = [*range(index * own, (index + 1) * own), *range(len(scene.rests) * own, size)]
    deviations = spread(view)
    e = (residuals(scene, index, view, camera) / deviations)[kept].ravel()
    jacobian = np.empty((len(e), len(columns)))
    for j, column in enumerate(columns):
        shift = np.zeros(size)
        shift[column] = steps[column]
        moved = residuals(_moved(scene, shift), index, view, camera) / deviations
        jacobian[:, j] = (moved[kept].ravel() - e) / steps[column]
    return columns, jacobian, e


def _normal(
    scene: SceneFit, seen: Sequence[Views], camera: Camera, kept: list[Mask], shared: bool
) -> tuple[Array, Array]:
    """Return the normal matrix and the gradient of the cost."""
    size = _size(scene)
    A, g = np.zeros((size, size)), np.zeros(size)
    for i, view in enumerate(seen):
        columns, jacobian, e = _derivatives(scene, i, view, camera, kept[i])
        A[np.ix_(columns, columns)] += jacobian.T @ jacobian
        g[columns] += jacobian.T @ e
    first = size - SHARED
    A[np.arange(first, size), np.arange(first, size)] += PRIORS**-2.0
    g[first:] += scene.of_cell / PRIORS**2
    if not shared:
        A[first:, :], A[:, first:] = 0.0, 0.0
        A[np.arange(first, size), np.arange(first, size)] = 1.0
        g[first:] = 0.0
    return A, g


def weighed_images(
    scene: SceneFit, seen: Sequence[Views], camera: Camera, kept: Sequence[Mask]
) -> list[tuple[Array, Array]]:
    """Return the times (m,) and the weighed residuals (m, 6) of each recording's used images."""
    return [
        (view.times[used], (residuals(scene, i, view, camera) / spread(view))[used])
        for i, (view, used) in enumerate(zip(seen, kept, strict=True))
    ]


def _growth(weighed: Sequence[tuple[Array, Array]], parameters: int) -> float:
    """Return how much larger a covariance is than if each image had errors of its own.

    It is the spread of blocks' sums over that of independent residuals. A fit takes its parameters'
    share out of the sums.
    """
    sums = np.concatenate([block_sums(times, e).ravel() for times, e in weighed])
    alone = sum(float(np.sum(e**2)) for _, e in weighed)
    free = max(sums.size - parameters, 1)
    return max(float(np.sum(sums**2)) / max(alone, 1e-12) * sums.size / free, 1.0)


def block_sums(times: Array, rows: Array) -> Array:
    """Return the sums (blocks, n) of rows (m, n) at times (m,), over ``BLOCK_S`` each."""
    blocks = ((times - times.min(initial=np.inf)) / BLOCK_S).astype(int)
    sums = np.zeros((int(blocks.max(initial=0)) + 1, rows.shape[1]))
    np.add.at(sums, blocks, rows)
    return sums


def range_biases(view: Views, kept: Mask) -> Array:
    """Return what each bias that grows with the range adds to the weighed residuals (6m, 3).

    Biases are not fitted, but considered (Bierman, 1977): each moves the result by its gradient.
    """
    ranges = np.linalg.norm(view.positions, axis=1)
    moved = np.zeros((len(RANGE_BIAS), len(ranges), 6))
    for axis, bias in enumerate(RANGE_BIAS):
        moved[axis, :, axis] = bias * ranges
    return (moved / spread(view))[:, kept].reshape(len(RANGE_BIAS), -1).T


def _considered(
    scene: SceneFit, seen: Sequence[Views], camera: Camera, kept: list[Mask], inverse: Array
) -> Array:
    """Return what the range biases add to the covariance."""
    gradients = np.zeros((_size(scene), len(RANGE_BIAS)))
    for i, view in enumerate(seen):
        jacobian, _ = linearised(scene, i, view, camera, kept[i])
        gradients += jacobian.T @ range_biases(view, kept[i])
    moves: Array = inverse @ gradients
    return moves @ moves.T


def _moved(scene: SceneFit, step: Array) -> SceneFit:
    """Return the scene a step away; a rotation moves by a turn about the axes of c."""
    own = 6 + 2 * len(scene.modes)
    rests = []
    for i, rest in enumerate(scene.rests):
        part = step[i * own : (i + 1) * own]
        rests.append(
            Rest(
                rest.position + part[:3],
                rotations.exp(part[3:6]) @ rest.rotation,
                rest.amplitudes + part[6:].reshape(-1, 2),
            )
        )
    modes = []
    for m, mode in enumerate(scene.modes):
        begin = len(scene.rests) * own + 7 * m
        modes.append(_moved_mode(mode, step[begin : begin + 7]))
    return replace(
        scene,
        modes=tuple(modes),
        rests=tuple(rests),
        hand_eye=scene.hand_eye + step[-SHARED:-2],
        stamp_error=scene.stamp_error + float(step[-2]),
        late=scene.late + float(step[-1]),
    )


def _moved_mode(mode: Mode, step: Array) -> Mode:
    direction = list(mode.direction)
    for value, i in zip(step[2:4].tolist(), others(mode.axis), strict=True):
        direction[i] += value
    levers = (np.array(mode.levers) + step[4:7]).tolist()
    return replace(
        mode,
        frequency_hz=mode.frequency_hz + float(step[0]),
        damping=mode.damping + float(step[1]),
        direction=(direction[0], direction[1], direction[2]),
        levers=(levers[0], levers[1], levers[2]),
    )


def turns(R: Array) -> Array:
    """Return rotation vectors (m, 3) of rotation matrices (m, 3, 3), well below half a turn.

    All at once: `rotations.log_many` is exact up to half a turn, one after another.
    """
    sine = 0.5 * np.stack(
        (R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]), axis=1
    )
    length = np.linalg.norm(sine, axis=1)
    angle = np.arctan2(length, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    stretch = np.where(length < 1e-9, 1.0, angle / np.maximum(length, 1e-9))
    vectors: Array = sine * stretch[:, None]
    return vectors


def others(axis: int) -> tuple[int, int]:
    """Return the two other axes."""
    rest = [i for i in range(3) if i != axis]
    return rest[0], rest[1]
