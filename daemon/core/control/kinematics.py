"""The arm from its URDF: where the tcp is, and which joints put it somewhere.

Law of this file: the only one that knows pinocchio, whose values are untyped and stop here.
Joint vectors are A1..A6 [rad] and then E1 [m] where there is a linear axis; poses stand in base.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dgesv as _solve

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array

_LOCAL = pin.ReferenceFrame.LOCAL
_RAIL_FIRST = np.array((6, 0, 1, 2, 3, 4, 5))
_RAIL_LAST = np.array((1, 2, 3, 4, 5, 6, 0))
_ORIGIN = np.zeros(3)
CHANGED = 1e-3  # of a pose, beyond which a list is looked at whole [m, rad]
FAR = 0.01  # of a guess, beyond which one step is not enough [m, rad]
MOST = 50  # iterations for a pose by itself
MOST_IN_CYCLE = 12  # and in a list, at 30 us each; what a radian away is reached takes eight


class KinematicsError(ValueError):
    """A URDF that this arm cannot be: the message says what is missing."""


class UnreachableError(ValueError):
    """A pose that the arm does not reach.

    Attributes:
        residual: what was left after the last iteration [m, rad].
    """

    def __init__(self, residual: float) -> None:
        super().__init__(f"the arm does not reach the pose: {residual:.2g} m or rad are left")
        self.residual = residual


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """A six-axis arm, with or without a linear axis in front of it.

    Attributes:
        tcp: the undeflected tcp's frame in the model.
        linear_axis: the first joint of the URDF is E1.
        lower, upper: (m,) position limits of the URDF, A1..A6 then E1.
        levers: (m,) upper bound of the tcp's speed for a unit of each axis' speed, whatever the
            pose: the length of the chain behind a turning axis [m], 1 for E1.
    """

    model: Any
    data: Any
    flange: int
    tcp: int
    linear_axis: bool
    lower: Array
    upper: Array
    levers: Array

    @property
    def axes(self) -> int:
        """Number of joints: 6 or 7."""
        return 7 if self.linear_axis else 6

    @property
    def _inner(self) -> slice:
        """Columns of the six axes in the URDF's order."""
        return slice(1, 7) if self.linear_axis else slice(0, 6)

    def _order(self, joints: Array) -> Array:
        """Return joints (..., axes) in the URDF's order: E1 first."""
        return joints.take(_RAIL_FIRST, axis=-1) if self.linear_axis else joints

    def tcp_in_base(self, joints: Array) -> tuple[Array, Array]:
        """Return position (3,) [m] and rotation (3, 3) of the undeflected tcp in base."""
        pose = self._placed(self._order(joints))
        return pose.translation.copy(), pose.rotation.copy()

    def tcp_jacobian(self, joints: Array) -> Array:
        """Return the Jacobian (3, axes) of the tcp's position, in the tcp's own axes."""
        q = self._order(joints)
        J: Array = pin.computeFrameJacobian(self.model, self.data, q, self.tcp, _LOCAL)[:3]
        return J.take(_RAIL_LAST, axis=1) if self.linear_axis else J

    def tcp_in(self, nominal: Array, joints: Array) -> Array:
        """Return the undeflected tcp (6,), position and rotation vector, in a frame c.

        Args:
            nominal: (3, 3) C, the axes of c in base.
        """
        pose = self._placed(self._order(joints))
        seen = np.dot(nominal.T, pose.homogeneous[:3])
        found = np.empty(6)
        found[:3] = seen[:, 3]
        found[3:] = pin.log3(seen[:, :3])
        return found

    def _placed(self, q: Array) -> Any:
        """Return the tcp's placement; of data that the next call writes over."""
        pin.forwardKinematics(self.model, self.data, q)
        return pin.updateFramePlacement(self.model, self.data, self.tcp)

    def solve(
        self,
        guess: Array,
        position: Array,
        rotation: Array,
        *,
        tolerance: float = 1e-9,
        most: int = MOST,
    ) -> Array:
        """Return the joints near ``guess`` that put the tcp at a pose; Newton on SE(3).

        The linear axis stays where ``guess`` has it.

        Raises:
            UnreachableError: no convergence in ``most`` iterations.
        """
        target = pin.SE3(rotation, position)
        q = self._order(guess).copy()
        arm = self._inner
        residual = np.inf
        for _ in range(most):
            error = pin.log6(self._placed(q).actInv(target)).vector
            residual = float(np.abs(error).max())
            if residual < tolerance:
                return np.concatenate((q[1:7], q[:1])) if self.linear_axis else q
            if not np.isfinite(residual):
                break  # a pose that is no number; least squares would raise something else
            J = pin.computeFrameJacobian(self.model, self.data, q, self.tcp, _LOCAL)[:, arm]
            step = np.linalg.lstsq(J, error, rcond=1e-6)[0]
            q[arm] += step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
        raise UnreachableError(residual)

    def stand_in(self, joints: Array, short: float) -> Array:
        """Return the change of A1..A6 (6,) [rad] that moves the tcp as the linear axis would.

        To first order: off by some 0.05 mm and 0.1 mrad at 10 mm.

        Args:
            joints: (axes,), of an arm with a linear axis.
            short: way of the linear axis that is missing [m].

        Raises:
            UnreachableError: the arm is singular there.
        """
        q = self._order(joints)
        J = pin.computeFrameJacobian(self.model, self.data, q, self.tcp, _LOCAL)
        _, _, change, singular = _solve(J[:, self._inner], J[:, 0] * short, True, False)
        if singular:
            raise UnreachableError(math.inf)
        return np.asarray(change)

    def follow(
        self,
        guesses: Array,
        poses: Array,
        nominal: Array,
        before: Array | None = None,
        tolerance: float = 2e-5,
    ) -> Array:
        """Return the joints (m, axes) for m neighbouring poses, each from its own warm guess.

        One Jacobian serves all poses: the guesses are last step's answers, off by micrometres,
        so that its change over the list is of second order. Where it is known for which poses
        they were the answers, the first and the last alone are looked at exactly; what is left
        off in between is put right when a pose has come to the front, before it is committed.

        Args:
            guesses: (m, axes), m >= 2; the linear axis stays where they have it.
            poses: (m, 6) of the tcp in a frame c, position [m] and rotation vector [rad].
            nominal: (3, 3) C, the axes of c in base.
            before: (m, 6) for which the guesses were found, or None.
            tolerance: of a pose that is solved alone [m, rad].

        Returns:
            The joints.

        Raises:
            UnreachableError: a pose that no iteration reaches.
        """
        base = pin.SE3(nominal, _ORIGIN)
        q, last = self._order(guesses), len(guesses) - 1
        errors = np.empty((last + 1, 6)) if before is None else _moved(poses, before)
        looked_at = range(last + 1)
        if before is not None and _is_within(errors[:-1], CHANGED):
            looked_at = range(0, last + 1, max(1, last))
        for i in looked_at:
            target = base.act(pin.SE3(pin.exp3(poses[i, 3:]), poses[i, :3]))
            errors[i] = pin.log6(self._placed(q[i]).actInv(target)).vector
        # The one Jacobian leaves a share of the correction that grows with its square.
        if _is_within(errors, FAR):
            return self._corrected(guesses, q[len(q) // 2], errors)
        if not np.isfinite(errors).all():
            raise UnreachableError(float(np.abs(errors).max()))
        return self._one_by_one(guesses, poses, nominal, tolerance)

    def _corrected(self, guesses: Array, q: Array, errors: Array) -> Array:
        """Return the joints (m, axes) after one Newton step, all by the Jacobian at q.

        Args:
            q: (axes,) where the Jacobian is taken, in the URDF's order.
            errors: (m, 6) twists of the tcp that are left [m, rad]; written over.
        """
        J = pin.computeFrameJacobian(self.model, self.data, q, self.tcp, _LOCAL)
        # LAPACK itself: numpy's wrapper costs six times what these six rows do.
        _, _, steps, singular = _solve(J[:, self._inner], errors.T, True, True)
        if singular:
            raise UnreachableError(math.inf)
        joints = guesses.copy()
        arm = joints[:, :6]
        arm += steps.T
        return joints

    def _one_by_one(self, guesses: Array, poses: Array, nominal: Array, tolerance: float) -> Array:
        """Return the joints (m, axes) for poses that are far from where the guesses are.

        A robot that cannot follow asks for this in every cycle, so that it must not take one: the
        far end is the first to be out of reach and is tried first, and by how much a guess was
        off tells it of its neighbour's.
        """
        joints, off = np.empty_like(guesses), np.zeros(self.axes)
        last = len(poses) - 1
        for i in (last, *range(last)):
            there, turned = nominal @ poses[i, :3], nominal @ pin.exp3(poses[i, 3:])
            joints[i] = self.solve(
                guesses[i] + off, there, turned, tolerance=tolerance, most=MOST_IN_CYCLE
            )
            off = joints[i] - guesses[i]
        return joints


def _moved(poses: Array, before: Array) -> Array:
    """Return by how much poses (m, 6) have changed, as small twists (m, 6) of the tcp."""
    moved: Array = np.dot(poses - before, rotations.in_own_axes(poses[0, 3:]))
    return moved


def _is_within(errors: Array, bound: float) -> bool:
    """Tell whether all are smaller than a bound; what is no number is not.

    So are all whose squares sum up to less than its own, which is told in a fifth of the time.
    """
    return bool(np.vdot(errors, errors) < bound * bound or np.abs(errors).max() < bound)


def load(urdf: str, flange: str, position: Array, rotation: Array, *, linear_axis: bool) -> Arm:
    """Return the arm of a URDF text with its tool.

    Args:
        urdf: the text, not a path.
        flange: name of the flange's frame.
        position: of the undeflected tcp in the flange (3,) [m].
        rotation: of the undeflected tcp in the flange (3, 3).
        linear_axis: the first joint is prismatic and is E1.

    Raises:
        KinematicsError: no URDF, no such frame, or not six revolute joints.
    """
    try:
        model = pin.buildModelFromXML(urdf)
    except (ValueError, RuntimeError) as error:
        raise KinematicsError(f"not a URDF: {error}") from error
    wanted = 7 if linear_axis else 6
    if model.nv != wanted or model.nq != wanted:
        raise KinematicsError(f"the URDF has {model.nv} joints, the task's arm has {wanted}")
    if not model.existFrame(flange):
        names = ", ".join(frame.name for frame in model.frames)
        raise KinematicsError(f"the URDF has no frame {flange!r}; it has {names}")
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    at = model.getFrameId(flange)
    place = model.frames[at].placement * pin.SE3(rotation, position)
    kind = pin.FrameType.OP_FRAME
    tcp = model.addFrame(pin.Frame("linemate tcp", model.frames[at].parentJoint, at, place, kind))
    levers = _levers(model, place)
    if linear_axis:
        lower, upper, levers = (row.take(_RAIL_LAST) for row in (lower, upper, levers))
        levers[6] = 1.0
    data = model.createData()
    return Arm(model, data, at, tcp, linear_axis, np.array(lower), np.array(upper), levers)


def _levers(model: Any, tcp: Any) -> Array:
    """Return the length of the chain from each joint to the tcp (joints,) [m]."""
    steps = [float(np.linalg.norm(place.translation)) for place in model.jointPlacements]
    # The first placement is the universe's, the second leads to the first joint.
    behind = [*steps[2:], float(np.linalg.norm(tcp.translation))]
    return np.cumsum(behind[::-1])[::-1].copy()
