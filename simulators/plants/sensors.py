"""Sensors: instants, delay, noise, resolution, outliers and blindness.

Invariants:
    A sensor is asked at its own instants, in order.
    Each kind of draw has its own stream and advances alike at every instant.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from linemate.simulators.plants import rotation
from linemate.simulators.plants.effector import Six
from linemate.simulators.plants.effects.sensor_errors import (
    CameraEffects,
    CameraErrors,
    DistanceEffects,
    DistanceErrors,
)
from linemate.simulators.plants.forces.gauge import new_gauge
from linemate.simulators.plants.rotation import Pose, Vec
from linemate.simulators.plants.scenario import Camera, DistanceSensor, Effector, ForceTorque
from linemate.simulators.plants.streams import Draws, stream


class DistanceEmission(NamedTuple):
    """A reading of the distance sensor.

    Attributes:
        time_s: when it leaves the sensor [s].
    """

    time_s: float
    exposure_s: float
    position: float
    strength: float
    outlier: bool


class CameraEmission(NamedTuple):
    """A pose of the hub in the camera's frame.

    Attributes:
        exposure_s: middle of the exposure, as the camera states it [s].
        position: hub in camera [m].
        quaternion: hub in camera, w x y z.
        covariance: upper triangle row by row, x y z rx ry rz in the camera's frame, or None.
    """

    time_s: float
    exposure_s: float
    position: Vec
    quaternion: tuple[float, float, float, float]
    covariance: tuple[float, ...] | None
    outlier: bool


class WrenchEmission(NamedTuple):
    """A reading of the force-torque sensor, in the rigid tcp frame.

    Attributes:
        time_s: when it leaves the sensor [s].
    """

    time_s: float
    exposure_s: float
    force: Vec
    torque: Vec


_READINGS = 64
"""Of the force-torque sensor, whose noise is drawn at once."""


class _Clock:
    """Instants of measuring, and delays that keep the order of emission."""

    __slots__ = ("_delay", "_draws", "_first", "_index", "_jitter", "_last", "_period", "next_s")

    def __init__(
        self, draws: Draws, start: float, period: float, phase: float, delay: float, jitter: float
    ) -> None:
        self._draws = draws
        self._first = start + phase * period
        self._period, self._delay, self._jitter = period, delay, jitter
        self._index = 0
        self._last = -math.inf
        self.next_s = self._first

    def upcoming(self, count: int) -> NDArray[np.float64]:
        """The next `count` instants [s]."""
        numbers = np.arange(self._index, self._index + count)
        return np.asarray(self._first + self._period * numbers)

    def tick(self) -> float:
        """Pass on to the next instant; returns the time of emission of this one."""
        due = self.next_s + self._delay
        if self._jitter:
            due = self._last = max(
                due + self._jitter * (2.0 * self._draws.next_number() - 1.0), self._last
            )
        self._index += 1
        self.next_s = self._first + self._index * self._period
        return due


class DistanceSensorPlant:
    """Reads the position of the conveyor unit."""

    def __init__(self, sensor: DistanceSensor, seed: int, start_s: float, cycle_s: float) -> None:
        self._sensor = sensor
        self.clock = _Clock(
            Draws.uniform(seed, "distance.delay"),
            start_s,
            cycle_s if sensor.period_s is None else sensor.period_s,
            sensor.phase,
            sensor.delay_s,
            sensor.jitter_s,
        )
        self._noise = Draws.normal(seed, "distance.noise")
        self._chance = Draws.uniform(seed, "distance.outlier")
        self._dropout = Draws.uniform(seed, "distance.dropout")
        period = cycle_s if sensor.period_s is None else sensor.period_s
        effects = sensor.effects
        self._errors = (
            None if effects == DistanceEffects() else DistanceErrors(effects, period, seed)
        )
        self.due: deque[DistanceEmission] = deque()

    def measure(self, position: float) -> None:
        """Measure now.

        Args:
            position: of the unit [m].
        """
        sensor = self._sensor
        exposure = self.clock.next_s
        due = self.clock.tick()
        if self._errors is not None:
            position = self._errors.disturb(position)
        chance, where = self._chance.next_numbers(2)
        value = position + sensor.offset + sensor.sigma * self._noise.next_number()
        if sensor.dropout_rate and self._dropout.next_number() < sensor.dropout_rate:
            return
        outlier = chance < sensor.outlier_rate
        if outlier:
            value += sensor.outlier_range * (2.0 * where - 1.0)
        if sensor.quantisation > 0.0:
            value = round(value / sensor.quantisation) * sensor.quantisation
        strength = 30.0 if outlier else 300.0
        self.due.append(DistanceEmission(due, exposure, value, strength, outlier))


class CameraPlant:
    """Sees the hub relative to the rigid tool."""

    def __init__(self, camera: Camera, seed: int, start_s: float) -> None:
        self._camera = camera
        self.clock = _Clock(
            Draws.uniform(seed, "camera.delay"),
            start_s,
            camera.period_s,
            camera.phase,
            camera.delay_s,
            camera.jitter_s,
        )
        self._mount: Pose = (camera.position_in_tcp, rotation.exp(camera.rotation_in_tcp))
        self._errors = _camera_errors(camera, seed)
        if self._errors is not None:
            self._mount = self._errors.mount(self._mount)
        self._noise = Draws.normal(seed, "camera.noise")
        self._chance = Draws.uniform(seed, "camera.outlier")
        self._dropout = Draws.uniform(seed, "camera.dropout")
        self.due: deque[CameraEmission] = deque()

    def measure(self, rigid: Pose, hub: Pose) -> None:
        """Take an image now.

        Args:
            rigid: rigid tcp in base.
        """
        camera = self._camera
        exposure = self.clock.next_s
        due = self.clock.tick()
        chance, *where = self._chance.next_numbers(4)
        noise = self._noise.next_numbers(6)
        dropped = self._dropout.next_number() < camera.dropout_rate
        hub_in_tcp = rotation.relative(rigid, hub)
        distance = rotation.norm(hub_in_tcp[0])
        seen = rotation.relative(self._mount, hub_in_tcp)
        if self._errors is not None:
            hidden = self._errors.is_hidden(exposure, seen, distance)
            dropped = dropped or hidden
            seen = self._errors.disturb(seen, distance)
            exposure = self._errors.stamp(exposure)
        if dropped or not camera.blind_below <= distance <= camera.blind_beyond:
            return
        (x, y, z), turned = seen
        lateral = camera.sigma + camera.sigma_per_metre * distance
        depth = camera.depth_factor * lateral
        twist = camera.sigma_rotation + camera.sigma_rotation_per_metre * distance
        x, y, z = x + lateral * noise[0], y + lateral * noise[1], z + depth * noise[2]
        outlier = chance < camera.outlier_rate
        if outlier:
            a, b, c = (camera.outlier_range * (2.0 * w - 1.0) for w in where)
            x, y, z = x + a, y + b, z + c
        # The error turns the seen frame about the camera's axes, as the covariance says.
        error = rotation.exp((twist * noise[3], twist * noise[4], twist * noise[5]))
        quaternion = rotation.quaternion(rotation.compose(error, turned))
        covariance = self._covariance(lateral, depth, twist) if camera.covariance else None
        self.due.append(CameraEmission(due, exposure, (x, y, z), quaternion, covariance, outlier))

    def _covariance(self, lateral: float, depth: float, twist: float) -> tuple[float, ...]:
        honesty = self._camera.covariance_honesty
        p, q, r = (honesty * lateral) ** 2, (honesty * depth) ** 2, (honesty * twist) ** 2
        o = 0.0
        return (p, o, o, o, o, o, p, o, o, o, o, q, o, o, o, r, o, o, r, o, r)


def _camera_errors(camera: Camera, seed: int) -> CameraErrors | None:
    if camera.effects == CameraEffects():
        return None
    return CameraErrors(camera.effects, camera.period_s, camera.depth_factor, seed)


class ForceTorquePlant:
    """Measures the deflection of the mount as a wrench."""

    def __init__(self, sensor: ForceTorque, effector: Effector, seed: int, start_s: float) -> None:
        self._sensor = sensor
        self._stiffness = effector.stiffness
        spread = np.repeat((sensor.sigma_translation, sensor.sigma_rotation), 3)
        self._noise_gain = spread * effector.stiffness
        self._bias = np.array(sensor.bias) * effector.stiffness
        self._gauge = new_gauge(sensor.effects, seed, start_s)
        place, turn = sensor.position_in_tcp, sensor.rotation_in_tcp
        self._is_elsewhere = any(place) or any(turn) or sensor.sign != 1
        self._place, self._turn = place, rotation.exp(turn)
        self._errors: list[list[float]] = []
        self.clock = _Clock(
            Draws.uniform(seed, "force_torque.delay"),
            start_s,
            sensor.period_s,
            sensor.phase,
            sensor.delay_s,
            sensor.jitter_s,
        )
        self._noise = stream(seed, "force_torque.noise")
        self._dropout = Draws.uniform(seed, "force_torque.dropout")
        self.due: deque[WrenchEmission] = deque()

    def measure(self, deflection: Six) -> None:
        """Measure now.

        Args:
            deflection: of the mount, in the rigid tcp frame [m, rad].
        """
        sensor = self._sensor
        exposure = self.clock.next_s
        due = self.clock.tick()
        if not self._errors:
            self._errors = self._draw_errors()
        e0, e1, e2, e3, e4, e5 = self._errors.pop()
        if sensor.dropout_rate and self._dropout.next_number() < sensor.dropout_rate:
            return
        d0, d1, d2, d3, d4, d5 = deflection
        k0, k1, k2, k3, k4, k5 = self._stiffness
        if self._gauge is not None:
            g0, g1, g2, g3, g4, g5 = self._gauge.at(exposure)
            e0, e1, e2, e3, e4, e5 = e0 + g0, e1 + g1, e2 + g2, e3 + g3, e4 + g4, e5 + g5
        force, torque = (k0 * d0, k1 * d1, k2 * d2), (k3 * d3, k4 * d4, k5 * d5)
        if self._is_elsewhere:
            force, torque = self._in_sensor(force, torque)
        force = (force[0] + e0, force[1] + e1, force[2] + e2)
        torque = (torque[0] + e3, torque[1] + e4, torque[2] + e5)
        self.due.append(WrenchEmission(due, exposure, force, torque))

    def _in_sensor(self, force: Vec, torque: Vec) -> tuple[Vec, Vec]:
        """Wrench of the mount in and about the sensor's own frame, with its sign."""
        (x, y, z), (fx, fy, fz), sign = self._place, force, self._sensor.sign
        lever = (y * fz - z * fy, z * fx - x * fz, x * fy - y * fx)
        about = (torque[0] - lever[0], torque[1] - lever[1], torque[2] - lever[2])
        a, b, c = rotation.unapply(self._turn, force)
        d, e, f = rotation.unapply(self._turn, about)
        return (sign * a, sign * b, sign * c), (sign * d, sign * e, sign * f)

    def _draw_errors(self) -> list[list[float]]:
        """Bias and noise of the next readings as wrenches, the last one first."""
        noise = self._noise.standard_normal((_READINGS, 6))
        errors: list[list[float]] = (self._bias + self._noise_gain * noise)[::-1].tolist()
        return errors
