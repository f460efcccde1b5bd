"""The car body on its hanger: where the hub is, given where the conveyor unit is.

Law of this file: a function of time alone, exact rotations. The hub sits off nominal, swings
about its suspension, and may be pushed. Conveyor frame c: x down, y travel, z towards the car.
"""

import math

from linemate.simulators.plants import rotation
from linemate.simulators.plants.rotation import Pose, Rot, Vec
from linemate.simulators.plants.scenario import Body, Jerk, Swing

C_IN_BASE: Rot = (0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0)
"""Orientation of the conveyor frame c in base: columns -Z, Y, X."""


class BodyPlant:
    """Pose of the hub in base for a position of the unit and a time."""

    def __init__(self, body: Body) -> None:
        if body.offset is None or body.rotation is None:
            raise ValueError("the body's offset or rotation is open: sample the scenario first")
        self._nominal = body.nominal
        self._offset = body.offset
        self._rotation = rotation.exp(body.rotation)
        self._lever = body.suspension_to_hub
        self._swings = tuple(_Swing(swing) for swing in body.swings)
        self._jerks = body.jerks

    def swing(self, t: float) -> Rot:
        """Rotation of the body about its suspension, in c."""
        turned = rotation.IDENTITY
        for swing in self._swings:
            turned = rotation.compose(turned, swing.at(t))
        return turned

    def hub(self, position: float, t: float) -> Pose:
        """Pose of the hub in base.

        Args:
            position: of the conveyor unit [m].
            t: scenario time [s].

        Returns:
            Hub in base, without the step of the screws.
        """
        turned = self.swing(t)
        lx, ly, lz = self._lever
        rx, ry, rz = rotation.apply(turned, self._lever)
        ox, oy, oz = self._offset
        x, y, z = ox + rx - lx, oy + ry - ly, oz + rz - lz
        for jerk in self._jerks:
            if t > jerk.onset_s:
                jx, jy, jz = _push(jerk, t)
                x, y, z = x + jx, y + jy, z + jz
        px, py, pz = self._nominal
        return (
            (px + z, py + position + y, pz - x),
            rotation.compose(C_IN_BASE, rotation.compose(turned, self._rotation)),
        )


class _Swing:
    """One oscillation, ready for evaluation."""

    __slots__ = ("_amplitude", "_axis", "_decay", "_omega", "_phase")

    def __init__(self, swing: Swing) -> None:
        if swing.amplitude is None or swing.phase is None:
            raise ValueError("a swing's amplitude or phase is open: sample the scenario first")
        x, y, z = swing.axis
        length = rotation.norm(swing.axis)
        self._axis = (x / length, y / length, z / length)
        self._amplitude = swing.amplitude
        self._phase = swing.phase
        # The given frequency is the one observed, that of the damped oscillation.
        self._omega = math.tau * swing.frequency_hz
        self._decay = self._omega * swing.damping

    def at(self, t: float) -> Rot:
        angle = self._amplitude * math.exp(-self._decay * t)
        angle *= math.cos(self._omega * t + self._phase)
        x, y, z = self._axis
        return rotation.exp((x * angle, y * angle, z * angle))


def _push(jerk: Jerk, t: float) -> Vec:
    age = t - jerk.onset_s
    omega = math.tau * jerk.frequency_hz
    share = math.exp(-jerk.damping * omega * age) * math.sin(omega * age)
    x, y, z = jerk.displacement
    return (share * x, share * y, share * z)
