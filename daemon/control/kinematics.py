"""The arm from its URDF: where the tcp is, and which joints put it somewhere.

Law of this file: the only one that knows pinocchio, whose values are untyped and stop here.
Joint vectors are A1..A6 [rad] and then E1 [m] where there is a linear axis; poses stand in base.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from linemate.daemon.horizon import Array

_LOCAL = pin.ReferenceFrame.LOCAL


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
        linear_axis: the first joint of the URDF is E1.
        lower, upper: (m,) position limits of the URDF, A1..A6 then E1.
    """

    model: Any
    data: Any
    flange: int
    tcp_in_flange: Any
    flange_in_tcp: Any
    linear_axis: bool
    lower: Array
    upper: Array

    @property
    def axes(self) -> int:
        """Number of joints: 6 or 7."""
        return 7 if self.linear_axis else 6

    def _order(self, joints: Array) -> Array:
        """Return joints in the URDF's order: E1 first."""
        if self.linear_axis:
            return np.concatenate((joints[6:7], joints[:6]))
        return joints

    def tcp_in_base(self, joints: Array) -> tuple[Array, Array]:
        """Return position (3,) [m] and rotation (3, 3) of the undeflected tcp in base."""
        pin.forwardKinematics(self.model, self.data, self._order(joints))
        pose = pin.updateFramePlacement(self.model, self.data, self.flange) * self.tcp_in_flange
        return pose.translation.copy(), pose.rotation.copy()

    def solve(
        self, guess: Array, position: Array, rotation: Array, *, tolerance: float = 1e-9
    ) -> Array:
        """Return the joints near ``guess`` that put the tcp at a pose; Newton on SE(3).

        The linear axis stays where ``guess`` has it.

        Raises:
            UnreachableError: no convergence in 50 iterations.
        """
        target = pin.SE3(rotation, position) * self.flange_in_tcp
        q = self._order(guess).copy()
        arm = slice(1, 7) if self.linear_axis else slice(0, 6)
        residual = np.inf
        for _ in range(50):
            pin.computeJointJacobians(self.model, self.data, q)
            here = pin.updateFramePlacement(self.model, self.data, self.flange)
            error = pin.log6(here.actInv(target)).vector
            residual = float(np.abs(error).max())
            if residual < tolerance:
                return np.concatenate((q[1:7], q[:1])) if self.linear_axis else q
            if not np.isfinite(residual):
                break  # a pose that is no number; least squares would raise something else
            J = pin.getFrameJacobian(self.model, self.data, self.flange, pin.ReferenceFrame.LOCAL)[
                :, arm
            ]
            step = np.linalg.lstsq(J, error, rcond=1e-6)[0]
            q[arm] += step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
        raise UnreachableError(residual)

    def follow(
        self, guesses: Array, positions: Array, rotations: Array, tolerance: float = 2e-5
    ) -> tuple[Array, float]:
        """Return the joints (m, axes) for m neighbouring poses, each from its own warm guess.

        One Jacobian serves all poses: the guesses are last step's answers, off by micrometres,
        so that its change over the horizon is of second order. A pose that is left off by more
        than ``tolerance`` is solved alone.

        Returns:
            The joints, and the largest correction that was made [m, rad].

        Raises:
            UnreachableError: a pose that no iteration reaches.
        """
        model, data, flange = self.model, self.data, self.flange
        off = self.flange_in_tcp
        arm = slice(1, 7) if self.linear_axis else slice(0, 6)
        q = np.column_stack((guesses[:, 6], guesses[:, :6])) if self.linear_axis else guesses
        targets = rotations @ off.rotation
        places = positions + rotations @ off.translation
        errors = np.empty((len(q), 6))
        middle = len(q) // 2
        for i in range(len(q)):
            if i == middle:
                pin.computeJointJacobians(model, data, q[i])
                here = pin.updateFramePlacement(model, data, flange)
                J = pin.getFrameJacobian(model, data, flange, _LOCAL)[:, arm]
            else:
                pin.framesForwardKinematics(model, data, q[i])
                here = data.oMf[flange]
            errors[i] = pin.log6(here.actInv(pin.SE3(targets[i], places[i]))).vector
        joints = guesses.copy()
        try:
            joints[:, :6] += np.linalg.solve(J, errors.T).T
        except np.linalg.LinAlgError:
            raise UnreachableError(float("inf")) from None
        largest = float(np.abs(errors).max())
        # The one Jacobian leaves a share of the correction that grows with its square.
        if not largest < 0.01:
            for i in range(len(q)):
                joints[i] = self.solve(joints[i], positions[i], rotations[i], tolerance=tolerance)
        return joints, largest


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
    if linear_axis:
        lower = np.concatenate((lower[1:], lower[:1]))
        upper = np.concatenate((upper[1:], upper[:1]))
    return Arm(
        model,
        model.createData(),
        model.getFrameId(flange),
        pin.SE3(rotation, position),
        pin.SE3(rotation, position).inverse(),
        linear_axis,
        np.array(lower),
        np.array(upper),
    )
