"""Camera pose in the tcp from postures of the tool about a fixed object: AX = XB.

    T_i X Z_i = Y

T_i: tcp in base, Z_i: object in the camera, X: camera in the tcp, Y: object in base. The closed
form for X is that of Park and Martin (1994), "Robot sensor calibration: solving AX = XB on the
Euclidean group", IEEE Transactions on Robotics and Automation 10(5), 717-721. Least squares over X
and Y with all postures follow, from which covariance and residuals come.

Invariants:
- Pure. Too few postures, rotations about one axis alone, and postures that contradict each other
  are refused.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from linemate.daemon.commissioning.postures import SeenObject, StandingPosture
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.trace import Kinematics
from linemate.protocol.stamped_samples import AXES

LEAST_POSTURES = 15
LEAST_TURN = 0.10  # rotation about the second axis of the motion, root mean square [rad]
POSITION_MISFIT = 0.003  # root mean square of the residuals [m]
ANGLE_MISFIT = 0.010  # [rad]
POSITION_DEVIATION = 0.0015  # of an accepted position [m]
ANGLE_DEVIATION = 0.003  # [rad]
DROPPED = 0.2  # largest share of postures left out as outliers
GATE = 4.0  # of an outlier, in robust deviations
LEAST_MOVING = 40  # images while the tool moves
LEAST_SPEED = 0.03  # of the object in the camera in such an image [m/s]
SPAN_S = 0.03  # to either side of a time, for the speed
BETTER = 4.0  # misfit over that with an axis mirrored, to name the axis


@dataclass(frozen=True, slots=True, eq=False)
class CameraMount:
    """Camera in the tcp.

    Attributes:
        position, rotation: X, (3,) [m] and (3, 3).
        deviations: (6,) of X, along the tcp's axes [m] and about the camera's [rad].
        object_position: of Y, (3,) [m].
        residuals: (n, 6) of the used postures, in the object's axes [m, rad].
        turn: rotation about the second axis of the motion [rad].
    """

    position: Array
    rotation: Array
    deviations: Array
    object_position: Array
    residuals: Array
    turn: float
    used: int
    given: int

    @property
    def misfit(self) -> tuple[float, float]:
        """Root mean square of the residuals [m], [rad]."""
        position, angle = self.residuals[:, :3], self.residuals[:, 3:]
        return float(np.sqrt((position**2).mean())), float(np.sqrt((angle**2).mean()))


def find_mount(
    postures: Sequence[StandingPosture], kinematics: Kinematics | None = None
) -> CameraMount | Refusal:
    """Return the camera's pose in the tcp, or why the postures do not give it.

    Args:
        postures: without repetitions; those without images are left out.
        kinematics: to find out whether an axis of the arm turns the other way than in the URDF.
    """
    seen = [posture for posture in postures if posture.seen is not None]
    if len(seen) < LEAST_POSTURES:
        return Refusal(
            f"{len(seen)} postures with images, at least {LEAST_POSTURES} are needed. "
            "Stand still for 2 s in each"
        )
    turn = second_turn([posture.rotation for posture in seen])
    if turn < LEAST_TURN:
        return Refusal(
            f"the tool turns by {turn:.3f} rad about a second axis, at least {LEAST_TURN:.2f} rad "
            "are needed. Turn it about two axes that are not parallel"
        )
    mount = _fitted(seen)
    if _is_consistent(mount):
        return _judged(mount)
    where, angle = mount.misfit
    reason = (
        f"the postures contradict each other by {1e3 * where:.1f} mm and {1e3 * angle:.1f} mrad, "
        f"at most {1e3 * POSITION_MISFIT:.0f} mm and {1e3 * ANGLE_MISFIT:.0f} mrad"
    )
    axis = None if kinematics is None else _mirrored_axis(seen, kinematics, mount)
    if axis is not None:
        return Refusal(
            f"{reason}. They agree if {AXES[axis]} turns the other way than in the URDF. "
            "Correct the URDF or the controller; do not move the robot by the daemon"
        )
    return Refusal(f"{reason}. Check the URDF, the axes' signs, and that the object stands still")


def second_turn(turns: Sequence[Array]) -> float:
    """Return the root mean square rotation about the second axis of a motion [rad]."""
    vectors = np.array([rotations.log(turns[0].T @ each) for each in turns])
    vectors -= vectors.mean(axis=0)
    return float(np.linalg.svd(vectors, compute_uv=False)[1] / np.sqrt(len(vectors)))


def _is_consistent(mount: CameraMount) -> bool:
    where, angle = mount.misfit
    kept = mount.used >= (1.0 - DROPPED) * mount.given
    return kept and where <= POSITION_MISFIT and angle <= ANGLE_MISFIT


def _judged(mount: CameraMount) -> CameraMount | Refusal:
    """Return a mount whose deviations are small enough to use."""
    where, angle = float(mount.deviations[:3].max()), float(mount.deviations[3:].max())
    if where <= POSITION_DEVIATION and angle <= ANGLE_DEVIATION:
        return mount
    return Refusal(
        f"the camera is known to +-{1e3 * where:.2f} mm and +-{1e3 * angle:.2f} mrad, at most "
        f"{1e3 * POSITION_DEVIATION:.1f} mm and {1e3 * ANGLE_DEVIATION:.0f} mrad. "
        "Turn the tool further, about all axes"
    )


def _mirrored_axis(
    seen: Sequence[StandingPosture], kinematics: Kinematics, mount: CameraMount
) -> int | None:
    """Return the axis whose mirrored reading makes the postures agree."""
    best: tuple[float, int] | None = None
    for axis in range(len(seen[0].joints)):
        signs = np.ones(len(seen[0].joints))
        signs[axis] = -1.0
        poses = [kinematics(posture.joints * signs) for posture in seen]
        fit = _fitted(seen, [p for p, _ in poses], [R for _, R in poses])
        if _is_consistent(fit) and (best is None or _badness(fit) < best[0]):
            best = _badness(fit), axis
    if best is None or best[0] * BETTER > _badness(mount):
        return None
    return best[1]


def _badness(mount: CameraMount) -> float:
    where, angle = mount.misfit
    return max(where / POSITION_MISFIT, angle / ANGLE_MISFIT)


def _fitted(
    seen: Sequence[StandingPosture],
    positions: Sequence[Array] | None = None,
    turns: Sequence[Array] | None = None,
) -> CameraMount:
    """Return the best mount, without outliers among the postures."""
    p = np.array([x.position for x in seen] if positions is None else positions)
    R = np.array([x.rotation for x in seen] if turns is None else turns)
    views = [posture.seen for posture in seen if posture.seen is not None]
    z = np.array([view.position for view in views])
    Z = np.array([view.rotation for view in views])
    weights = np.repeat(_typical(views), 3)
    kept = np.ones(len(seen), dtype=bool)
    x = _closed_form(p, R, z, Z)
    for _ in range(3):
        problem = _problem(p[kept], R[kept], z[kept], Z[kept], weights)
        solved = least_squares(problem, x, method="lm", x_scale="jac")
        x = solved.x
        everything = _problem(p, R, z, Z, weights)(x).reshape(-1, 6)
        sizes = np.sqrt((everything**2).mean(axis=1))
        limit = GATE * max(1.4826 * float(np.median(sizes)), 1e-9)
        again = sizes <= limit
        if again.sum() < max(4, (1.0 - DROPPED) * len(seen)) or (again == kept).all():
            break
        kept = again
    residuals = everything[kept] * weights
    J = np.asarray(solved.jac, dtype=float)
    freedom = max(1, J.shape[0] - 12)
    covariance = np.linalg.pinv(J.T @ J, hermitian=True) * float(2.0 * solved.cost / freedom)
    deviations = np.sqrt(np.maximum(covariance.diagonal()[:6], 0.0))
    return CameraMount(
        x[:3],
        rotations.exp(x[3:6]),
        deviations,
        x[6:9],
        residuals,
        second_turn([posture.rotation for posture in seen]),
        int(kept.sum()),
        len(seen),
    )


def _typical(views: Sequence[SeenObject]) -> Array:
    """Return the typical deviation of a mean position [m] and turn [rad]."""
    spreads = np.array([view.spread for view in views])
    images = np.sqrt(np.array([view.images for view in views]))
    where = float(np.median(np.sqrt((spreads[:, :3] ** 2).mean(axis=1)) / images))
    angle = float(np.median(np.sqrt((spreads[:, 3:] ** 2).mean(axis=1)) / images))
    return np.array((max(where, 1e-5), max(angle, 1e-5)))


def _problem(p: Array, R: Array, z: Array, Z: Array, weights: Array) -> Callable[[Array], Array]:
    """Return the residuals of T_i X Z_i against Y, weighed, for (12,) of X and Y."""

    def residuals(x: Array) -> Array:
        X, Y = rotations.exp(x[3:6]), rotations.exp(x[9:])
        there = p + np.einsum("nij,nj->ni", R, x[:3] + z @ X.T)
        turned = Y.T @ (R @ X @ Z)
        off = np.hstack(((there - x[6:9]) @ Y, rotations.log_many(turned)))
        return np.asarray((off / weights).ravel())

    return residuals


def _closed_form(p: Array, R: Array, z: Array, Z: Array) -> Array:
    """Return X and Y (12,) from all pairs of postures with the first (Park and Martin)."""
    pairs = [(i, j) for i in range(len(p)) for j in range(i)]
    alpha = np.array([rotations.log(R[j].T @ R[i]) for i, j in pairs])
    beta = np.array([rotations.log(Z[j] @ Z[i].T) for i, j in pairs])
    # alpha = X beta: the nearest rotation (Kabsch), which is Park and Martin's root without its
    # singular case.
    u, _, v = np.linalg.svd(alpha.T @ beta)
    X = u @ np.diag((1.0, 1.0, float(np.sign(np.linalg.det(u @ v))))) @ v
    # (R_A - 1) t = X t_B - t_A over the same pairs.
    rows, wanted = [], []
    for i, j in pairs:
        RA, tA = R[j].T @ R[i], R[j].T @ (p[i] - p[j])
        RB = Z[j] @ Z[i].T
        tB = z[j] - RB @ z[i]
        rows.append(RA - np.eye(3))
        wanted.append(X @ tB - tA)
    t = np.linalg.lstsq(np.vstack(rows), np.concatenate(wanted), rcond=None)[0]
    there = p + np.einsum("nij,nj->ni", R, t + z @ X.T)
    Y = R[0] @ X @ Z[0]
    return np.concatenate((t, rotations.log(X), np.median(there, axis=0), rotations.log(Y)))


def stamp_error(
    recordings: Sequence[Sequence[Inputs]], mount: CameraMount, kinematics: Kinematics, axes: int
) -> Outcome:
    """Return by how much exposure stamps are late [s], from images of a moving tool.

    A stamp that is late by d shows the fixed object off its place by d times its speed in base.

    Args:
        recordings: inputs of all steps, one sequence a recording.
    """
    errors, speeds = [], []
    for inputs in recordings:
        for off, speed in _moving_images(inputs, mount, kinematics, axes):
            errors.append(off)
            speeds.append(speed)
    if len(errors) < LEAST_MOVING:
        return Refusal(
            f"{len(errors)} images while the tool moves, at least {LEAST_MOVING} are needed"
        )
    e, v = np.array(errors), np.array(speeds)
    kept = np.ones(len(e), dtype=bool)
    late = 0.0
    for _ in range(4):
        late = float(np.sum(v[kept] * e[kept]) / np.sum(v[kept] ** 2))
        left = np.linalg.norm(e - late * v, axis=1)
        kept = left <= GATE * max(1.4826 * float(np.median(left)), 1e-6)
    spread = float((left[kept] ** 2).mean() / 3.0) ** 0.5
    sigma = spread / float(np.sum(v[kept] ** 2)) ** 0.5
    return Estimate(late, sigma, f"{int(kept.sum())} images of a moving tool")


def _moving_images(
    inputs: Sequence[Inputs], mount: CameraMount, kinematics: Kinematics, axes: int
) -> Iterator[tuple[Array, Array]]:
    """Yield where the object seems to be off its place [m], and its speed there [m/s]."""
    robots = [each.robot for each in inputs if each.robot is not None]
    if len(robots) < 3:
        return
    epoch = inputs[0].stamp_ns
    times = np.array([robot.stamp_ns - epoch for robot in robots]) * 1e-9
    joints = np.array([(*robot.joints, *robot.external)[:axes] for robot in robots])

    def shown(t: float, seen: Array) -> Array:
        q = np.array([np.interp(t, times, column) for column in joints.T])
        position, rotation = kinematics(q)
        return position + rotation @ (mount.position + mount.rotation @ seen)

    for each in inputs:
        for image in each.camera:
            t, seen = (image.exposure_ns - epoch) * 1e-9, np.array(image.position)
            if not times[0] + SPAN_S < t < times[-1] - SPAN_S:
                continue
            speed = (shown(t + SPAN_S, seen) - shown(t - SPAN_S, seen)) / (2.0 * SPAN_S)
            if float(np.linalg.norm(speed)) > LEAST_SPEED:
                yield shown(t, seen) - mount.object_position, speed
