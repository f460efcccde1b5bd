"""Windup of the axes from images: the camera rides on the arm and sees what encoders do not.

Linear least squares about a fitted scene (``scene_fit``), for depths and scene together. Without
the depths the scene takes a windup for swings and for an error of the hand-eye pose.

    link = motor - depth w,   dw = (sgn(dq) - w) |dq| / travel                      (Dahl)

Invariants:
- The windup at the beginning of a recording is unknown and fitted with it.
- Errors that are correlated over time, and range biases of the camera, are in the deviations.
- Weak priors keep the fit regular. An axis whose depth they determine is refused.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linemate.daemon.core.control.settings import AxisWindup
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification import scene_fit as scenes
from linemate.daemon.identification import swing
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.scene_fit import Camera, SceneFit, Views
from linemate.daemon.identification.trace import Kinematics, Mask, Trace, tcp_path, tcp_poses

TRAVELS = (0.5e-3, 1e-3, 1.5e-3, 2.2e-3, 3.3e-3, 5e-3, 7.5e-3, 11e-3, 16e-3)
ROUNDS = 2
PRIOR = 0.5e-3  # of a depth and of the windup at the beginning [rad]
LEAST_DEPTH = 0.03e-3  # [rad]
LARGEST_DEVIATION = 0.1e-3  # of an accepted depth [rad]
STEP = 1e-4  # of the numeric derivatives [rad]
MOST_AXES = 6  # the linear axis has no gear at the end of a lever

Look = Callable[[Trace], list[Views]]
"""From a trace to its images with poses."""


@dataclass(frozen=True, slots=True)
class ArmWindup:
    """Result of all axes.

    Attributes:
        axes: settings of each axis; empty if none winds up.
        depths: outcome of each axis [rad].
    """

    axes: tuple[AxisWindup, ...]
    depths: tuple[Outcome, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Recording:
    """A trace with its images, and how its tcp moves with each axis (axes, m, 6)."""

    trace: Trace
    views: list[Views]
    slopes: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Images about a scene, weighed.

    Attributes:
        jacobian, residuals: of all images, with priors at the end.
        biases: (rows, 3) what each range bias of the camera adds to the images.
        times: (m,) of the images of each view [s].
    """

    jacobian: Array
    residuals: Array
    biases: Array
    times: list[Array]


def bent_trace(trace: Trace, axes: Sequence[AxisWindup], kinematics: Kinematics,
               nominal: Array) -> Trace:  # fmt: skip
    """Return a trace whose tcp follows the links instead of the motors."""
    links = trace.motors.copy()
    for axis, each in enumerate(axes):
        if each.depth > 0.0:
            links[:, axis] -= each.depth * dahl(trace.motors[:, axis], each.travel)
    return replace(trace, tcp=tcp_poses(links, kinematics, nominal))


def identify_arm_windup(
    traces: Sequence[Trace], look: Look, camera: Camera, kinematics: Kinematics, nominal: Array
) -> ArmWindup:
    """Return the windup of each axis.

    Args:
        look: images of a trace with poses.
        kinematics: from links to the tcp in base.
        nominal: (3, 3) C, the nominal object's axes in base.
    """
    count = min(traces[0].motors.shape[1], MOST_AXES) if traces else 0
    turned = max((float(np.ptp(t.motors[:, :count], axis=0).max()) for t in traces), default=0.0)
    if turned < TRAVELS[0]:
        return ArmWindup((), (Refusal("no axis turned: a robot at rest winds nothing up"),) * count)
    recordings = [
        _Recording(trace, look(trace), _slopes(trace, count, kinematics, nominal))
        for trace in traces
    ]
    images = sum(len(view.times) for recording in recordings for view in recording.views)
    axes: tuple[AxisWindup, ...] = ()
    depths = deviations = np.zeros(count)
    for _ in range(ROUNDS):
        bent = [bent_trace(trace, axes, kinematics, nominal) for trace in traces]
        seen = [view for trace in bent for view in look(trace)]
        scene = swing.find_swings(seen, camera) if images else None
        if scene is None:
            refusal = Refusal("too few images of the object in free space")
            return ArmWindup((), (refusal,) * count)
        travel, depths, deviations = _best_fit(scene, seen, recordings, camera)
        axes = tuple(AxisWindup(min(max(d, 0.0), 0.005), travel) for d in depths.tolist())
    return _judged(axes, depths, deviations, images)


def _judged(axes: Sequence[AxisWindup], depths: Array, deviations: Array, images: int) -> ArmWindup:
    """Return the axes whose depth is known and more than chance."""
    outcomes: list[Outcome] = []
    kept = []
    for each, depth, deviation in zip(axes, depths.tolist(), deviations.tolist(), strict=True):
        is_known = deviation < LARGEST_DEVIATION
        if is_known:
            basis = f"{images} images, travel {1e3 * each.travel:.1f} mrad"
            outcomes.append(Estimate(depth, deviation, basis))
        else:
            outcomes.append(Refusal(f"its depth is known only to +-{1e3 * deviation:.2g} mrad"))
        # More likely than no windup at all: their Bayes factor is above 1.
        significant = math.sqrt(2.0 * math.log1p(PRIOR / deviation)) * deviation
        is_there = depth > max(significant, LEAST_DEPTH)
        kept.append(each if is_known and is_there else AxisWindup())
    windups = tuple(kept) if any(each.depth > 0.0 for each in kept) else ()
    return ArmWindup(windups, tuple(outcomes))


def _slopes(trace: Trace, count: int, kinematics: Kinematics, nominal: Array) -> Array:
    """Return how the tcp moves with each axis (axes, m, 6) [m/rad], [1]."""
    rows = []
    for axis in range(count):
        moved = trace.motors.copy()
        moved[:, axis] += STEP
        rows.append((tcp_poses(moved, kinematics, nominal) - trace.tcp) / STEP)
    return np.array(rows).reshape(count, len(trace.tcp), 6)


def _best_fit(
    scene: SceneFit, bent: Sequence[Views], recordings: Sequence[_Recording], camera: Camera
) -> tuple[float, Array, Array]:
    """Return the travel that fits best [rad], the depths and their deviations [rad].

    Args:
        scene: about which is linearised.
        bent: the images with the poses to which it was fitted.
        recordings: with the poses of the motors, to which the depths belong.
    """
    kept = [_kept(scene, i, view, camera) for i, view in enumerate(bent)]
    rows = _scene_rows(scene, recordings, camera, kept)
    slopes = _axis_rows(scene, recordings, camera, kept)
    best: tuple[float, float, Array, Array] | None = None
    for travel in TRAVELS:
        columns = _windup_rows(scene, recordings, slopes, kept, travel)
        cost, depths, deviations = _solved(rows, columns, len(recordings[0].slopes))
        if best is None or cost < best[0]:
            best = cost, travel, depths, deviations
    assert best is not None  # noqa: S101 - there are travels
    return best[1:]


def _kept(scene: SceneFit, index: int, view: Views, camera: Camera) -> Mask:
    """Return which images (m,) of a view are no outliers."""
    weighed = scenes.residuals(scene, index, view, camera) / scenes.spread(view)
    scale = 1.4826 * float(np.median(np.abs(weighed)))
    kept: Mask = np.abs(weighed).max(axis=1) < scenes.GATE * max(scale, 0.2)
    return kept


def _scene_rows(
    scene: SceneFit, recordings: Sequence[_Recording], camera: Camera, kept: Sequence[Mask]
) -> _Rows:
    """Return the rows of all images about a scene."""
    views = [view for recording in recordings for view in recording.views]
    jacobians, residuals = [], []
    for i, view in enumerate(views):
        jacobian, e = scenes.linearised(scene, i, view, camera, kept[i])
        jacobians.append(jacobian)
        residuals.append(e)
    size = jacobians[0].shape[1]
    prior = np.zeros((len(scenes.PRIORS), size))
    prior[:, size - len(scenes.PRIORS) :] = np.diag(1.0 / scenes.PRIORS)
    jacobians.append(prior)
    residuals.append(scene.of_cell / scenes.PRIORS)
    return _Rows(
        np.concatenate(jacobians),
        np.concatenate(residuals),
        np.concatenate([scenes.range_biases(*each) for each in zip(views, kept, strict=True)]),
        [view.times[used] for view, used in zip(views, kept, strict=True)],
    )


def _axis_rows(
    scene: SceneFit, recordings: Sequence[_Recording], camera: Camera, kept: Sequence[Mask]
) -> list[Array]:
    """Return how the weighed residuals of each view change with each axis (axes, m, 6) [1/rad]."""
    rows: list[Array] = []
    for recording in recordings:
        trace = recording.trace
        paths = [tcp_path(replace(trace, tcp=trace.tcp + STEP * s)) for s in recording.slopes]
        for view in recording.views:
            index = len(rows)
            e = scenes.residuals(scene, index, view, camera)
            moved = [
                scenes.residuals(scene, index, replace(view, tcp_path=path), camera)
                for path in paths
            ]
            rows.append(((np.array(moved) - e) / STEP / scenes.spread(view))[:, kept[index]])
    return rows


def _windup_rows(
    scene: SceneFit,
    recordings: Sequence[_Recording],
    slopes: Sequence[Array],
    kept: Sequence[Mask],
    travel: float,
) -> Array:
    """Return how the residuals change with each depth, then with each windup at the beginning."""
    count = len(recordings[0].slopes)
    blocks: list[Array] = []
    for r, recording in enumerate(recordings):
        shares = _shares(recording, travel)
        for view in recording.views:
            index = len(blocks)
            t = view.times[kept[index]] + scene.stamp_error
            block = np.zeros((6 * len(t), count * (1 + len(recordings))))
            for n, share in enumerate(shares):
                at = np.interp(t, recording.trace.robot_times, share)
                column = n if n < count else n + r * count
                block[:, column] = -(at[:, None] * slopes[index][n % count]).ravel()
            blocks.append(block)
    return np.concatenate(blocks)


def _shares(recording: _Recording, travel: float) -> list[Array]:
    """Return the windup (m,) of each axis of depth 1, then what is left of its beginning."""
    motors = recording.trace.motors[:, : len(recording.slopes)]
    ways = np.cumsum(np.abs(np.diff(motors, axis=0, prepend=motors[:1])), axis=0)
    return [*(dahl(motor, travel) for motor in motors.T), *np.exp(-ways.T / travel)]


def _solved(rows: _Rows, columns: Array, count: int) -> tuple[float, Array, Array]:
    """Return the cost, the depths (count,) and their deviations [rad]."""
    base, images = rows.jacobian, len(columns)
    size, width = base.shape[1], columns.shape[1]
    others = np.append(np.full(width, PRIOR), np.ones(rows.biases.shape[1]))
    X = np.zeros((len(base) + len(others), size + len(others)))
    X[: len(base), :size] = base
    X[:images, size:] = np.hstack((columns, rows.biases))
    X[len(base) :, size:] = np.diag(1.0 / others)
    y = -np.append(rows.residuals, np.zeros(len(others)))
    scale = np.maximum(np.sqrt(np.sum(X * X, axis=0)), 1e-12)
    X /= scale
    inverse = np.linalg.pinv(X.T @ X, rcond=1e-12, hermitian=True)
    values = inverse @ (X.T @ y)
    left = y - X @ values
    chi2 = max(float((1.4826 * np.median(np.abs(left[:images]))) ** 2), 0.1)
    chi2 *= _growth(rows.times, X[:images], inverse, left[:images])
    deviations = np.sqrt(np.maximum(inverse.diagonal() * chi2, 0.0)) / scale
    part = slice(size, size + count)
    return float(left @ left), (values / scale)[part], deviations[part]


def _growth(times: Sequence[Array], X: Array, inverse: Array, left: Array) -> float:
    """Return how much larger a covariance is than if each image had errors of its own.

    It is the spread of blocks' sums over what independent errors would leave of it after the fit.

    Args:
        times: (m,) of the images of each view [s].
        X: (rows, n) of all images.
        inverse: (n, n) covariance of the fit with errors of deviation 1.
        left: (rows,) residuals after it.
    """
    begin, together, taken = 0, 0.0, 0.0
    for t in times:
        part = slice(begin, begin + 6 * len(t))
        together += float(np.sum(scenes.block_sums(t, left[part].reshape(-1, 6)) ** 2))
        summed = scenes.block_sums(t, X[part].reshape(len(t), -1)).reshape(-1, X.shape[1])
        taken += float(np.sum((summed @ inverse) * summed))
        begin = part.stop
    free, alone = len(X) - X.shape[1], float(left @ left)
    growth: float = together / max(len(X) - taken, 1.0) * free / max(alone, 1e-12)
    return max(growth, 1.0)


def dahl(motor: Array, travel: float) -> Array:
    """Return Dahl's hysteresis (n,) of depth 1, exact for a way in one direction a sample."""
    way = np.diff(motor)
    signs, shares = np.sign(way).tolist(), np.exp(-np.abs(way) / travel).tolist()
    w, rows = 0.0, [0.0]
    for sign, share in zip(signs, shares, strict=True):
        w = sign + (w - sign) * share
        rows.append(w)
    return np.array(rows)
