"""Elastically suspended tool: six independent modes along the axes of the tool frame.

x'' + 2 zeta w (x' - r') + w^2 (x - r) = 0 for each axis; x elastic tcp, r rigid tcp.
The input r is a straight line within a step (first order hold) and the step is exact.

Invariants:
    State: deflection d = x - r and the tool's velocity, both in the rigid tcp's frame.
    After each step the state is expressed in the new frame.
"""

import math

from linemate.simulators.plants import rotation
from linemate.simulators.plants.forces.weight import new_weight
from linemate.simulators.plants.oscillator import transition
from linemate.simulators.plants.rotation import Pose, Rot
from linemate.simulators.plants.scenario import Effector

Six = tuple[float, float, float, float, float, float]
ZERO: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class EffectorPlant:
    """Deflection of the tool behind the robot."""

    def __init__(self, effector: Effector, step: float) -> None:
        self._step = step
        self._weight = new_weight(effector.load, effector.stiffness)
        self._modes = tuple(
            (math.tau * f, zeta)
            for f, zeta in zip(effector.frequency_hz, effector.damping, strict=True)
        )
        self._phis = tuple(transition(omega, zeta, step) for omega, zeta in self._modes)
        self.deflection: Six = ZERO
        self._velocity: Six = ZERO
        self._held: tuple[Pose, Pose, Six] | None = None

    def rest(self, rigid: Pose) -> None:
        """Let the tool hang still at its weight."""
        self.deflection = self.sag(rigid)

    def sag(self, rigid: Pose) -> Six:
        """Deflection under the weight alone, in the rigid tcp's frame."""
        return ZERO if self._weight is None else self._weight.sag(rigid)

    def drop_wheel(self) -> None:
        """Go on without the wheel's weight and mass."""
        if self._weight is None:
            return
        faster = self._weight.lightened
        self._weight.drop_wheel()
        self._modes = tuple((omega * faster, zeta) for omega, zeta in self._modes)
        self._phis = tuple(transition(omega, zeta, self._step) for omega, zeta in self._modes)

    @property
    def velocity(self) -> Six:
        """Velocity of the tool in base, along and about the axes of the rigid tcp."""
        return self._velocity

    def swing_free(self, before: Pose, after: Pose) -> None:
        """One step in free space while the rigid tcp moves from `before` to `after`."""
        if self._held is not None:
            self._let_go(*self._held)
        turned, drive = _motion(before, after)
        if self._weight is not None:
            self.deflection, drive = self._hang(before, after, turned, drive)
        step = self._step
        r0, r1, r2, r3, r4, r5 = drive
        d0, d1, d2, d3, d4, d5 = self.deflection
        w0, w1, w2, w3, w4, w5 = self._velocity
        a0, a1, a2, a3, a4, a5 = self._phis
        r0, r1, r2, r3, r4, r5 = r0 / step, r1 / step, r2 / step, r3 / step, r4 / step, r5 / step
        w0, w1, w2, w3, w4, w5 = w0 - r0, w1 - r1, w2 - r2, w3 - r3, w4 - r4, w5 - r5
        p, q, s, u = a0
        d0, w0 = p * d0 + q * w0, s * d0 + u * w0 + r0
        p, q, s, u = a1
        d1, w1 = p * d1 + q * w1, s * d1 + u * w1 + r1
        p, q, s, u = a2
        d2, w2 = p * d2 + q * w2, s * d2 + u * w2 + r2
        p, q, s, u = a3
        d3, w3 = p * d3 + q * w3, s * d3 + u * w3 + r3
        p, q, s, u = a4
        d4, w4 = p * d4 + q * w4, s * d4 + u * w4 + r4
        p, q, s, u = a5
        d5, w5 = p * d5 + q * w5, s * d5 + u * w5 + r5
        self.deflection = _expressed(turned, d0, d1, d2, d3, d4, d5)
        self._velocity = _expressed(turned, w0, w1, w2, w3, w4, w5)
        if self._weight is not None:
            self.deflection = _plus(self.deflection, self._weight.sag(after))

    def _hang(self, before: Pose, after: Pose, turned: Rot, drive: Six) -> tuple[Six, Six]:
        """Return the deflection from where the tool would hang, and the motion of that point."""
        old, new = self.sag(before), _in_old_frame(turned, self.sag(after))
        return _plus(self.deflection, old, -1.0), _plus(drive, _plus(new, old, -1.0))

    def strike(self, before: Pose, after: Pose, deflection: Six, velocity: Six) -> None:
        """One step with contact forces: take its result, given in the axes of `before`."""
        turned, _ = _motion(before, after)
        self.deflection = _expressed(turned, *deflection)
        self._velocity = _expressed(turned, *velocity)
        self._held = None

    def hold(self, before: Pose, after: Pose, deflection: Six) -> None:
        """One step in contact: the tool is where it is held, the mount takes the difference."""
        # How fast the tool moves is of interest only when it is let go.
        self._held = before, after, self.deflection
        self.deflection = deflection

    def _let_go(self, before: Pose, after: Pose, deflection: Six) -> None:
        """Work out the tool's velocity in the last step in contact, from its deflection before."""
        turned, drive = _motion(before, after)
        v0, v1, v2, v3, v4, v5 = (
            (r + new - old) / self._step
            for r, new, old in zip(drive, self.deflection, deflection, strict=True)
        )
        self._velocity = _expressed(turned, v0, v1, v2, v3, v4, v5)
        self._held = None

    def peek(self, before: Pose, after: Pose, dt: float) -> Six:
        """Deflection `dt` later, when the rigid tcp is at `after`, without advancing."""
        if self._held is not None:
            self._let_go(*self._held)
        turned, drive = _motion(before, after)
        hanging = self.deflection
        if self._weight is not None:
            hanging, drive = self._hang(before, after, turned, drive)
        deflection = []
        for (omega, zeta), d, w, r in zip(self._modes, hanging, self._velocity, drive, strict=True):
            p11, p12, _, _ = transition(omega, zeta, dt)
            deflection.append(p11 * d + p12 * (w - r / dt))
        bent = _expressed(turned, *deflection)
        return bent if self._weight is None else _plus(bent, self._weight.sag(after))


def _motion(before: Pose, after: Pose) -> tuple[Rot, Six]:
    """How the rigid tcp moves, seen from where it was: rotation, and displacement with its log."""
    (x, y, z), turned = rotation.relative(before, after)
    a, b, c = rotation.log(turned)
    return turned, (x, y, z, a, b, c)


def _plus(a: Six, b: Six, share: float = 1.0) -> Six:
    """Return a + share b."""
    a0, a1, a2, a3, a4, a5 = a
    b0, b1, b2, b3, b4, b5 = b
    return (
        a0 + share * b0,
        a1 + share * b1,
        a2 + share * b2,
        a3 + share * b3,
        a4 + share * b4,
        a5 + share * b5,
    )


def _in_old_frame(turned: Rot, values: Six) -> Six:
    """Two vectors of the frame that has turned, in the one before."""
    x, y, z, a, b, c = values
    return _expressed(rotation.transpose(turned), x, y, z, a, b, c)


def _expressed(turned: Rot, x: float, y: float, z: float, a: float, b: float, c: float) -> Six:
    """Two vectors in the frame that has turned."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = turned
    return (
        r0 * x + r3 * y + r6 * z,
        r1 * x + r4 * y + r7 * z,
        r2 * x + r5 * y + r8 * z,
        r0 * a + r3 * b + r6 * c,
        r1 * a + r4 * b + r7 * c,
        r2 * a + r5 * b + r8 * c,
    )


def deflected(rigid: Pose, deflection: Six) -> Pose:
    """The elastic tcp: p = p_rigid + R d, R = R_rigid Exp(d_r)."""
    x, y, z, a, b, c = deflection
    return rotation.multiply(rigid, ((x, y, z), rotation.exp((a, b, c))))


def deflection_between(rigid: Pose, tcp: Pose) -> Six:
    """The deflection that puts the tcp there; the inverse of `deflected`."""
    return _motion(rigid, tcp)[1]
