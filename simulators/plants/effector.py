"""The elastically suspended tool: six independent modes along the axes of the tool frame.

Law of this file: x'' + 2 zeta w (x' - r') + w^2 (x - r) = 0 for each axis, x the elastic and r
the rigid tcp; r is a straight line within a step (first order hold) and the step is exact.
State: the deflection d = x - r and the tool's own velocity, both in the rigid tcp's frame, which
turns with the robot: after each step they are expressed in the new frame.
"""

import math

from linemate.simulators.plants import rotation
from linemate.simulators.plants.oscillator import transition
from linemate.simulators.plants.rotation import Pose, Vec
from linemate.simulators.plants.scenario import Effector

Six = tuple[float, float, float, float, float, float]
ZERO: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class EffectorPlant:
    """Deflection of the tool behind the robot."""

    def __init__(self, effector: Effector, step: float) -> None:
        self._step = step
        self._modes = tuple(
            (math.tau * f, zeta)
            for f, zeta in zip(effector.frequency_hz, effector.damping, strict=True)
        )
        self._phis = tuple(transition(omega, zeta, step) for omega, zeta in self._modes)
        self.deflection: Six = ZERO
        self._velocity: Six = ZERO

    def swing_free(self, before: Pose, after: Pose) -> None:
        """One step in free space while the rigid tcp moves from `before` to `after`."""
        step = self._step
        move = rotation.relative(before, after)
        drive = _six(move[0], rotation.log(move[1]))
        deflection, velocity = [], []
        for (p11, p12, p21, p22), d, w, r in zip(
            self._phis, self.deflection, self._velocity, drive, strict=True
        ):
            rate = r / step
            slip = w - rate
            deflection.append(p11 * d + p12 * slip)
            velocity.append(p21 * d + p22 * slip + rate)
        self._express(move, deflection, velocity)

    def hold(self, before: Pose, after: Pose, deflection: Six) -> None:
        """One step in contact: the tool is where it is held, the mount takes the difference."""
        move = rotation.relative(before, after)
        drive = _six(move[0], rotation.log(move[1]))
        velocity = [
            (r + new - old) / self._step
            for r, new, old in zip(drive, deflection, self.deflection, strict=True)
        ]
        self._express(move, list(deflection), velocity)
        self.deflection = deflection

    def peek(self, before: Pose, after: Pose, dt: float) -> Six:
        """Deflection `dt` later, when the rigid tcp is at `after`, without advancing."""
        move = rotation.relative(before, after)
        drive = _six(move[0], rotation.log(move[1]))
        deflection = []
        for (omega, zeta), d, w, r in zip(
            self._modes, self.deflection, self._velocity, drive, strict=True
        ):
            p11, p12, _, _ = transition(omega, zeta, dt)
            deflection.append(p11 * d + p12 * (w - r / dt))
        turned = move[1]
        return _six(
            rotation.unapply(turned, (deflection[0], deflection[1], deflection[2])),
            rotation.unapply(turned, (deflection[3], deflection[4], deflection[5])),
        )

    def _express(self, move: Pose, deflection: list[float], velocity: list[float]) -> None:
        turned = move[1]
        dx, dy, dz, da, db, dc = deflection
        vx, vy, vz, va, vb, vc = velocity
        self.deflection = _six(
            rotation.unapply(turned, (dx, dy, dz)), rotation.unapply(turned, (da, db, dc))
        )
        self._velocity = _six(
            rotation.unapply(turned, (vx, vy, vz)), rotation.unapply(turned, (va, vb, vc))
        )


def _six(a: Vec, b: Vec) -> Six:
    return (a[0], a[1], a[2], b[0], b[1], b[2])


def deflected(rigid: Pose, deflection: Six) -> Pose:
    """The elastic tcp: p = p_rigid + R d, R = R_rigid Exp(d_r)."""
    x, y, z, a, b, c = deflection
    return rotation.multiply(rigid, ((x, y, z), rotation.exp((a, b, c))))


def deflection_between(rigid: Pose, tcp: Pose) -> Six:
    """The deflection that puts the tcp there; the inverse of `deflected`."""
    p, r = rotation.relative(rigid, tcp)
    return _six(p, rotation.log(r))
