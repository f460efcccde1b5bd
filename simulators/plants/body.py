"""Car body on its hanger: pose of the hub for a position of the conveyor.

Invariants:
    A function of time alone, with exact rotations.
    The hub is off nominal, swings about its suspension, and may get impulses.
    Conveyor frame c: x down, y travel, z to the car.
"""

import math

import numpy as np
from numpy.typing import NDArray

from linemate.simulators.plants import rotation
from linemate.simulators.plants.rotation import Pose, Rot, Vec
from linemate.simulators.plants.scenario import Body, Jerk, Swing

C_IN_BASE: Rot = (0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0)
"""Orientation of the conveyor frame c in base: columns -Z, Y, X."""

Array = NDArray[np.float64]


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

    def hubs(self, positions: Array, times: Array) -> list[Pose]:
        """Poses of the hub at many times at once; the same law as `hub`.

        Args:
            positions: of the conveyor unit, shape (n,) [m].
            times: scenario times, shape (n,) [s].

        Returns:
            One pose a time.
        """
        turned = np.broadcast_to(np.eye(3), (len(times), 3, 3))
        for swing in self._swings:
            turned = turned @ swing.at_many(times)
        lever = np.array(self._lever)
        in_c = np.array(self._offset) + turned @ lever - lever
        for jerk in self._jerks:
            ages = np.maximum(times - jerk.onset_s, 0.0)
            in_c = in_c + np.outer(_damped_sine(jerk, ages), jerk.displacement)
        c_in_base = np.array(C_IN_BASE).reshape(3, 3)
        place = np.array(self._nominal) + in_c @ c_in_base.T
        place[:, 1] += positions
        turn = c_in_base @ turned @ np.array(self._rotation).reshape(3, 3)
        vectors = map(tuple, place.tolist())
        rotations = map(tuple, turn.reshape(-1, 9).tolist())
        return list(zip(vectors, rotations, strict=True))


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
        """Rotation at one time."""
        angle = self._amplitude * math.exp(-self._decay * t)
        angle *= math.cos(self._omega * t + self._phase)
        x, y, z = self._axis
        return rotation.exp((x * angle, y * angle, z * angle))

    def at_many(self, times: Array) -> Array:
        """Rotations at many times, shape (n, 3, 3)."""
        angles = self._amplitude * np.exp(-self._decay * times)
        angles *= np.cos(self._omega * times + self._phase)
        x, y, z = self._axis
        cross = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
        sine, versine = np.sin(angles), 2.0 * np.sin(0.5 * angles) ** 2
        rotations = np.eye(3) + sine[:, None, None] * cross
        return np.asarray(rotations + versine[:, None, None] * (cross @ cross))


def _push(jerk: Jerk, t: float) -> Vec:
    share = float(_damped_sine(jerk, np.array([t - jerk.onset_s]))[0])
    x, y, z = jerk.displacement
    return (share * x, share * y, share * z)


def _damped_sine(jerk: Jerk, ages: Array) -> Array:
    omega = math.tau * jerk.frequency_hz
    return np.asarray(np.exp(-jerk.damping * omega * ages) * np.sin(omega * ages))
