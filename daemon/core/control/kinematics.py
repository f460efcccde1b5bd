"""Forward and inverse kinematics of the arm, from its URDF.

Joint vectors are A1..A6 [rad], then E1 [m] where there is a linear axis. Poses are in base.

Invariants:
- The only module that imports pinocchio, whose values are untyped.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from linemate.daemon.core import rotations
from linemate.daemon.core.control.settings import AxisGeometry, AxisLoad
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.lapack import dgesv as _solve

_LOCAL = pin.ReferenceFrame.LOCAL
_RAIL_FIRST = np.array((6, 0, 1, 2, 3, 4, 5))
_RAIL_LAST = np.array((1, 2, 3, 4, 5, 6, 0))
_ORIGIN = np.zeros(3)
LARGEST_CHANGE = 1e-3  # of a pose, beyond which errors of a whole list are computed [m, rad]
LARGEST_ERROR = 0.01  # of a guess, beyond which one Newton step is not enough [m, rad]
MOST_ITERATIONS = 50  # for a single pose
MOST_IN_CYCLE = 12  # for a pose of a list, 30 us each; a pose 1 rad away takes eight


class KinematicsError(ValueError):
    """The URDF does not describe the task's arm; the message names what is missing."""


class UnreachableError(ValueError):
    """A pose that the arm does not reach.

    Attributes:
        residual: error after the last iteration [m, rad].
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
        levers: (m,) upper bound of the tcp's speed for a unit of each axis' speed in any pose: the
            length of the chain behind a turning axis [m], 1 for E1.
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

    def axis_frames(self) -> list[tuple[Array, Array, Array]]:
        """Return A1..A6 at 0: position and rotation in the frame of the axis before, direction."""
        first = 1 + int(self.linear_axis)
        places = self.model.jointPlacements
        return [
            (places[i].translation.copy(), places[i].rotation.copy(), self.data.joints[i].S[3:])
            for i in range(first, first + 6)
        ]

    def tcp_jacobian(self, joints: Array) -> Array:
        """Return the Jacobian (3, axes) of the tcp's position, in the tcp's own axes."""
        q = self._order(joints)
        J: Array = pin.computeFrameJacobian(self.model, self.data, q, self.tcp, _LOCAL)[:3]
        return J.take(_RAIL_LAST, axis=1) if self.linear_axis else J

    def gravity(self, joints: Array) -> Array:
        """Return the moments (axes,) that the motors hold against the loads' weight [Nm], [N]."""
        q = self._order(joints)
        moments: Array = pin.computeGeneralizedGravity(self.model, self.data, q)
        return moments.take(_RAIL_LAST) if self.linear_axis else moments.copy()

    def tcp_in(self, nominal: Array, joints: Array) -> Array:
        """Return the undeflected tcp (6,), position and rotation vector, in a frame c.

        Args:
            nominal: (3, 3) C, the axes of c in base.
        """
        pose = self._placed(self._order(joints))
        seen = np.dot(nominal.T, pose.homogeneous[:3])
        vector = np.empty(6)
        vector[:3] = seen[:, 3]
        vector[3:] = pin.log3(seen[:, :3])
        return vector

    def _placed(self, q: Array) -> Any:
        """Return the tcp's placement; the next call overwrites it."""
        pin.forwardKinematics(self.model, self.data, q)
        return pin.updateFramePlacement(self.model, self.data, self.tcp)

    def solve(
        self,
        guess: Array,
        position: Array,
        rotation: Array,
        *,
        tolerance: float = 1e-9,
        most: int = MOST_ITERATIONS,
    ) -> Array:
        """Return the joints near ``guess`` that bring the tcp to a pose; Newton on SE(3).

        The linear axis keeps its position in ``guess``.

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
                break  # the pose is not finite; least squares would raise another error
            J = pin.computeFrameJacobian(self.model, self.data, q, self.tcp, _LOCAL)[:, arm]
            step = np.linalg.lstsq(J, error, rcond=1e-6)[0]
            q[arm] += step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
        raise UnreachableError(residual)

    def stand_in(self, joints: Array, missing: float) -> Array:
        """Return the change of A1..A6 (6,) [rad] that moves the tcp as the linear axis would.

        To first order; the error is 0.05 mm and 0.1 mrad at 10 mm.

        Args:
            joints: (axes,), of an arm with a linear axis.
            missing: way of the linear axis [m].

        Raises:
            UnreachableError: the arm is singular there.
        """
        q = self._order(joints)
        J = pin.computeFrameJacobian(self.model, self.data, q, self.tcp, _LOCAL)
        _, _, change, singular = _solve(J[:, self._inner], J[:, 0] * missing, True, False)
        if singular:
            raise UnreachableError(math.inf)
        return np.asarray(change)

    def follow(
        self,
        guesses: Array,
        poses: Array,
        nominal: Array,
        before: Array | None = None,
        into: Array | None = None,
        tolerance: float = 2e-5,
    ) -> Array:
        """Return the joints (m, axes) for m neighbouring poses: one Newton step from warm guesses.

        One Jacobian J serves all poses. Of an error e it leaves (1 - J_i J^-1) e: the guesses are
        the last step's results, off by micrometres, so that this is of second order. With
        ``before``, only the errors of the first and the last pose are computed exactly. The others
        are corrected once their pose is the first of the list, before it is committed.

        Args:
            guesses: (m, axes), m >= 2; the linear axis keeps their positions.
            poses: (m, 6) of the tcp in a frame c, position [m] and rotation vector [rad].
            nominal: (3, 3) C, the axes of c in base.
            before: (m, 6) poses of which the guesses are the solutions, or None.
            into: (6, 6) ``rotations.in_own_axes`` near these poses, if it is known.
            tolerance: of a pose that is solved by itself [m, rad].

        Raises:
            UnreachableError: a pose that no iteration reaches.
        """
        base = pin.SE3(nominal, _ORIGIN)
        q, last = self._order(guesses), len(guesses) - 1
        errors = np.empty((last + 1, 6)) if before is None else _moved(poses, before, into)
        computed = range(last + 1)
        if before is not None and _is_within(errors[:-1], LARGEST_CHANGE):
            computed = range(0, last + 1, max(1, last))
        for i in computed:
            target = base.act(pin.SE3(pin.exp3(poses[i, 3:]), poses[i, :3]))
            errors[i] = pin.log6(self._placed(q[i]).actInv(target)).vector
        if _is_within(errors, LARGEST_ERROR):
            return self._corrected(guesses, q[len(q) // 2], errors)
        if not np.isfinite(errors).all():
            raise UnreachableError(float(np.abs(errors).max()))
        return self._one_by_one(guesses, poses, nominal, tolerance)

    def _corrected(self, guesses: Array, q: Array, errors: Array) -> Array:
        """Return the joints (m, axes) after one Newton step, all by the Jacobian at q.

        Args:
            q: (axes,) where the Jacobian is taken, in the URDF's order.
            errors: (m, 6) remaining twists of the tcp [m, rad]; overwritten.
        """
        J = pin.computeFrameJacobian(self.model, self.data, q, self.tcp, _LOCAL)
        # LAPACK directly: numpy's wrapper costs six times as much for six rows.
        _, _, steps, singular = _solve(J[:, self._inner], errors.T, True, True)
        if singular:
            raise UnreachableError(math.inf)
        joints = guesses.copy()
        arm = joints[:, :6]
        arm += steps.T
        return joints

    def _one_by_one(self, guesses: Array, poses: Array, nominal: Array, tolerance: float) -> Array:
        """Return the joints (m, axes) for poses that are far from the guesses, pose by pose.

        A robot that cannot follow needs this in every cycle, so that it must be short. The far end
        is the first to be out of reach and is solved first. The correction of a guess is the first
        guess of its neighbour's.
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


def _moved(poses: Array, before: Array, into: Array | None) -> Array:
    """Return by how much poses (m, 6) have changed, as small twists (m, 6) of the tcp."""
    into = rotations.in_own_axes(poses[0, 3:]) if into is None else into
    moved: Array = np.dot(poses - before, into)
    return moved


def _is_within(errors: Array, bound: float) -> bool:
    """Return whether all are smaller than a bound; NaN is not.

    The sum of squares below the bound's is sufficient and costs a fifth of the maximum.
    """
    return bool(np.vdot(errors, errors) < bound * bound or np.abs(errors).max() < bound)


def load(
    urdf: str,
    flange: str,
    position: Array,
    rotation: Array,
    *,
    linear_axis: bool,
    loads: Sequence[AxisLoad] = (),
    geometry: Sequence[AxisGeometry] = (),
) -> Arm:
    """Return the arm of a URDF text with its tool.

    Args:
        urdf: the text, not a path.
        flange: name of the flange's frame.
        position: of the undeflected tcp in the flange (3,) [m].
        rotation: of the undeflected tcp in the flange (3, 3).
        linear_axis: the first joint is prismatic and is E1.
        loads: weights; those of the URDF do not count.
        geometry: measured frames of A1..A6, seen from those of the URDF.

    Raises:
        KinematicsError: no URDF, no such frame, or not six revolute joints.
    """
    try:
        model = pin.buildModelFromXML(urdf)
    except (ValueError, RuntimeError) as error:
        raise KinematicsError(f"not a URDF: {error}") from error
    wanted = ("P",) * linear_axis + ("R",) * 6
    if model.njoints - 1 != len(wanted):
        names = ", ".join(list(model.names)[1:]) or "none"
        raise KinematicsError(
            f"the URDF has {model.njoints - 1} joints, the task's arm has {len(wanted)}; "
            f"what moves are {names}"
        )
    joints = zip(list(model.names)[1:], list(model.joints)[1:], wanted, strict=True)
    for name, joint, kind in joints:
        if not joint.shortname().startswith(f"JointModel{kind}") or joint.nq != 1:
            text = "prismatic" if kind == "P" else "revolute, with limits"
            raise KinematicsError(f"joint {name} of the URDF should be {text}")
    if not model.existFrame(flange):
        names = ", ".join(frame.name for frame in model.frames)
        raise KinematicsError(f"the URDF has no frame {flange!r}; it has {names}")
    for joint, frame in enumerate(geometry, start=1 + int(linear_axis)):
        measured = pin.SE3(pin.exp3(np.array(frame.turn)), np.array(frame.shift))
        model.jointPlacements[joint] = model.jointPlacements[joint] * measured
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    at = model.getFrameId(flange)
    place = model.frames[at].placement * pin.SE3(rotation, position)
    kind = pin.FrameType.OP_FRAME
    tcp = model.addFrame(pin.Frame("linemate tcp", model.frames[at].parentJoint, at, place, kind))
    levers = _levers(model, place)
    if linear_axis:
        lower, upper, levers = (row.take(_RAIL_LAST) for row in (lower, upper, levers))
        levers[6] = 1.0
    for body in range(len(model.inertias)):
        model.inertias[body] = pin.Inertia.Zero()
    for part in loads:
        weight = pin.Inertia(part.mass, np.array(part.centre), np.zeros((3, 3)))
        model.appendBodyToJoint(part.axis + int(linear_axis), weight, pin.SE3.Identity())
    data = model.createData()
    return Arm(model, data, at, tcp, linear_axis, np.array(lower), np.array(upper), levers)


def _levers(model: Any, tcp: Any) -> Array:
    """Return the length of the chain from each joint to the tcp (joints,) [m]."""
    steps = [float(np.linalg.norm(place.translation)) for place in model.jointPlacements]
    # The first placement is the universe's, the second leads to the first joint.
    behind = [*steps[2:], float(np.linalg.norm(tcp.translation))]
    return np.cumsum(behind[::-1])[::-1].copy()
