"""Frame of the force-torque sensor in the tool, its bias, and the payload behind it.

A tool at rest weighs on its sensor. With gravity g_i in the tcp, posture by posture,

    f_i = s R^T m g_i + b,   m_i = c x s R^T m g_i + d

R: sensor in the tcp, s: its sign, m: mass, c: centre of gravity in the sensor, b, d: bias. The
three by three matrix of the first equation is linear in its unknowns. Its determinant has the
sign, its nearest rotation is R^T (Kabsch 1976, "A solution for the best rotation to relate two
sets of vectors", Acta Crystallographica A32, 922-923). Least squares over all unknowns follow.

Invariants:
- Pure. Gravity along -z of base.
- The place of the sensor is not observable without a known centre of gravity: it is not estimated.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from linemate.daemon.commissioning.postures import StandingPosture
from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.outcome import Refusal

GRAVITY = 9.80665  # standard gravity [m/s^2]
LEAST_POSTURES = 6
LEAST_SPAN = 0.15  # of gravity's directions along the least known one, root mean square
SIGNIFICANT = 8.0  # least weight, in deviations of a mean force
SHARE_MISFIT = 0.10  # of the weight that the model may leave unexplained
NOT_A_ROTATION = 0.15  # largest difference of the matrix' singular values, as a share
ANGLE_DEVIATION = 0.02  # of an accepted rotation [rad]
FORCE_FLOOR, TORQUE_FLOOR = 0.05, 0.005  # least deviation of a mean force [N], torque [Nm]


@dataclass(frozen=True, slots=True, eq=False)
class SensorMount:
    """Sensor in the tool, and what hangs on it.

    Attributes:
        rotation: R, sensor in the tcp (3, 3).
        sign: s, 1 or -1.
        mass: of what hangs on the sensor [kg].
        centre: its centre of gravity in the sensor [m].
        force_bias, torque_bias: of the sensor (3,) [N], (3,) [Nm].
        deviations: of rotation (3) [rad], mass, centre (3), force bias (3), torque bias (3).
        misfit: root mean square of the residuals [N], [Nm].
    """

    rotation: Array
    sign: int
    mass: float
    centre: Array
    force_bias: Array
    torque_bias: Array
    deviations: Array
    misfit: tuple[float, float]
    postures: int


def find_sensor(postures: Sequence[StandingPosture]) -> SensorMount | Refusal:
    """Return the sensor's frame and payload, or why the postures do not give them.

    Args:
        postures: without repetitions; those without wrenches are left out.
    """
    felt = [posture for posture in postures if posture.wrench is not None]
    if len(felt) < LEAST_POSTURES:
        return Refusal(
            f"{len(felt)} postures with wrenches, at least {LEAST_POSTURES} are needed. "
            "Stand still for 2 s in each"
        )
    g = np.array([posture.rotation.T @ (0.0, 0.0, -GRAVITY) for posture in felt])
    w = np.array([posture.wrench for posture in felt])
    span = float(np.linalg.svd((g - g.mean(axis=0)) / GRAVITY, compute_uv=False)[2])
    span /= np.sqrt(len(g))
    if span < LEAST_SPAN:
        return Refusal(
            f"gravity turns in the tool by {span:.2f} about its least known axis, at least "
            f"{LEAST_SPAN:.2f} are needed. Tilt the tool forwards, backwards and to both sides"
        )
    M, bias = _linear(g, w[:, :3])
    sizes = np.linalg.svd(M, compute_uv=False)
    noise = _noise(felt)
    if float(sizes.mean()) * GRAVITY < SIGNIFICANT * noise[0]:
        return Refusal(
            f"the tool weighs {float(sizes.mean()) * GRAVITY:.2f} N on the sensor, at least "
            f"{SIGNIFICANT * noise[0]:.2f} N are needed. Check that the tool hangs on the sensor"
        )
    if float(sizes[0] - sizes[2]) > NOT_A_ROTATION * float(sizes.mean()):
        x, y, z = sizes.tolist()
        return Refusal(
            f"the sensor's axes weigh the tool as {x:.1f}, {y:.1f} and {z:.1f} kg, which should "
            "be equal. Check its calibration, its cables, and the URDF"
        )
    return _refined(g, w, M, bias, noise)


def _linear(g: Array, forces: Array) -> tuple[Array, Array]:
    """Return the matrix from gravity in the tcp to the force (3, 3), and the bias (3,)."""
    A = np.column_stack((g, np.ones(len(g))))
    solved = np.linalg.lstsq(A, forces, rcond=None)[0]
    return np.asarray(solved[:3].T), np.asarray(solved[3])


def _noise(felt: Sequence[StandingPosture]) -> tuple[float, float]:
    """Return the typical deviation of a mean force [N] and torque [Nm].

    A tenth of a single reading's: the mean of a hundred; a slow swing of the tool is in it.
    """
    spreads = np.array([posture.wrench_spread for posture in felt])
    force, torque = np.median(spreads[:, :3]), np.median(spreads[:, 3:])
    return max(0.1 * float(force), FORCE_FLOOR), max(0.1 * float(torque), TORQUE_FLOOR)


def _refined(
    g: Array, w: Array, M: Array, bias: Array, noise: tuple[float, float]
) -> SensorMount | Refusal:
    """Return the least squares solution from the linear one."""
    sign = 1 if float(np.linalg.det(M)) > 0.0 else -1
    u, sizes, v = np.linalg.svd(sign * M)
    turned = np.asarray((u @ v).T)  # R from R^T
    mass = float(sizes.mean())
    weights = np.repeat(noise, 3)
    start = np.concatenate((rotations.log(turned), (mass, 0.0, 0.0, 0.0), bias, np.zeros(3)))
    problem = _problem(g, w, sign, weights)
    solved = least_squares(problem, start, method="lm", x_scale="jac")
    J = np.asarray(solved.jac, dtype=float)
    freedom = max(1, J.shape[0] - len(start))
    scale = max(1.0, 2.0 * float(solved.cost) / freedom)
    deviations = np.sqrt(
        np.maximum(np.linalg.pinv(J.T @ J, hermitian=True).diagonal() * scale, 0.0)
    )
    left = problem(solved.x).reshape(-1, 6) * weights
    misfit = tuple(float(np.sqrt((part**2).mean())) for part in (left[:, :3], left[:, 3:]))
    x, weight = solved.x, float(solved.x[3]) * GRAVITY
    if misfit[0] > SHARE_MISFIT * weight:
        return Refusal(
            f"a weight of {weight:.1f} N leaves {misfit[0]:.1f} N unexplained. Check that nothing "
            "but the tool touches the sensor, and the URDF"
        )
    if float(deviations[:3].max()) > ANGLE_DEVIATION:
        return Refusal(
            f"the sensor's frame is known to +-{1e3 * float(deviations[:3].max()):.0f} mrad, at "
            f"most {1e3 * ANGLE_DEVIATION:.0f} mrad. Use more postures, further tilted"
        )
    return SensorMount(
        rotations.exp(x[:3]),
        sign,
        float(x[3]),
        x[4:7],
        x[7:10],
        x[10:],
        deviations,
        (misfit[0], misfit[1]),
        len(g),
    )


def _problem(g: Array, w: Array, sign: int, weights: Array) -> Callable[[Array], Array]:
    """Return the residuals, weighed, for rotation, mass, centre and both biases (13,)."""

    def residuals(x: Array) -> Array:
        weight = sign * float(x[3]) * (g @ rotations.exp(x[:3]))
        wanted = np.hstack((weight + x[7:10], np.cross(x[4:7], weight) + x[10:]))
        return np.asarray(((wanted - w) / weights).ravel())

    return residuals
