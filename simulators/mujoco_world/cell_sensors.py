"""Readings of the three sensors, at instants of their own.

Invariants:
    Instants are multiples of the simulation's time step.
    Each sensor has a random generator of its own.
    Emissions keep their order.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from linemate.simulators.mujoco_world.frame_poses import Array, Vec, quaternion_of, turn_of
from linemate.simulators.mujoco_world.mujoco_cell import MujocoCell, Three, known

CAMERA_IN_TCP: Three = (-0.10, 0.0, -0.15)


class MujocoDistance(NamedTuple):
    """A reading of the distance sensor; see ``devices.station``."""

    time_s: float
    exposure_s: float
    position: float
    strength: float


class MujocoPose(NamedTuple):
    """A pose of the hub in the camera's frame; see ``devices.station``."""

    time_s: float
    exposure_s: float
    position: Vec
    quaternion: tuple[float, float, float, float]
    covariance: tuple[float, ...] | None


class MujocoWrench(NamedTuple):
    """A force and a torque on the mount, in the rigid tcp's frame; see ``devices.station``."""

    time_s: float
    exposure_s: float
    force: Vec
    torque: Vec


class ConveyorEncoder:
    """Measuring wheel on the conveyor."""

    def __init__(self, cell: MujocoCell, seed: int) -> None:
        self._sensors = cell.sensors
        self._draw = np.random.default_rng((seed, 0xD15))
        self.due: deque[MujocoDistance] = deque()

    def measure(self, t: float, position: float) -> None:
        """Read the conveyor's position [m]."""
        sensors = self._sensors
        read = position * (1.0 + known(sensors.distance_scale))
        read += sensors.distance_sigma * float(self._draw.standard_normal())
        read = sensors.distance_step * round(read / sensors.distance_step)
        self.due.append(MujocoDistance(t + sensors.distance_delay_s, t, read, 300.0))


class HubCamera:
    """Camera on the robot's side of the mount: it sees the hub."""

    def __init__(self, cell: MujocoCell, seed: int) -> None:
        self._sensors = sensors = cell.sensors
        self._draw = np.random.default_rng((seed, 0xCA3))
        self._place = np.array(CAMERA_IN_TCP) + known(sensors.hand_eye)
        self._turn = turn_of(known(sensors.hand_eye_angle))
        self._kept = math.exp(-sensors.camera_period_s / sensors.camera_wander_s)
        self._wander = sensors.camera_wander * self._draw.standard_normal(3)
        self._last_s = -math.inf
        self.due: deque[MujocoPose] = deque()

    def measure(self, t: float, rigid: tuple[Array, Array], hub: tuple[Array, Array]) -> None:
        """Take an image.

        Args:
            rigid: tcp as the flange holds it: position (3,) and rotation (3, 3) in base.
        """
        sensors, draw = self._sensors, self._draw
        noise, chance = draw.standard_normal(9), draw.uniform(-1.0, 1.0, 2)
        spread = sensors.camera_wander * math.sqrt(1.0 - self._kept**2)
        self._wander = self._kept * self._wander + spread * noise[6:]
        due_s = t + sensors.camera_delay_s + sensors.camera_jitter_s * float(chance[0])
        self._last_s = due_s = max(due_s, self._last_s)
        away = rigid[1].T @ (hub[0] - rigid[0])
        distance = float(np.linalg.norm(away))
        if distance < sensors.camera_blind or chance[1] < 2.0 * sensors.camera_dropout - 1.0:
            return
        seen = self._turn.T @ (away - self._place)
        lateral = sensors.camera_sigma + sensors.camera_sigma_per_metre * distance
        sigma = np.array((lateral, lateral, 2.0 * lateral))
        seen = seen + sigma * noise[:3] + self._wander
        seen[2] += known(sensors.camera_range_bias) * distance
        turned = turn_of((sensors.camera_angle * noise[3:6]).tolist())
        quaternion = quaternion_of(turned @ self._turn.T @ rigid[1].T @ hub[1])
        x, y, z = seen.tolist()
        self.due.append(
            MujocoPose(
                due_s, t + known(sensors.camera_stamp_s), (x, y, z), quaternion,
                _covariance(sigma, sensors.camera_angle),
            )
        )  # fmt: skip


def _covariance(sigma: Array, angle: float) -> tuple[float, ...]:
    """Return the upper triangle, row by row, of what the camera says of its white noise."""
    variances = [*(sigma**2).tolist(), *([angle**2] * 3)]
    return tuple(variances[r] if r == c else 0.0 for r in range(6) for c in range(r, 6))


class MountSensor:
    """Force and torque in the mount, zeroed before the run with tool and wheel on it."""

    def __init__(self, cell: MujocoCell, seed: int) -> None:
        self._sensors = cell.sensors
        self._draw = np.random.default_rng((seed, 0xF0C))
        self._begin_s: float | None = None
        self.due: deque[MujocoWrench] = deque()

    def measure(self, t: float, wrench: Array) -> None:
        """Read the wrench of the mount, (6,) [N, Nm]."""
        sensors = self._sensors
        if self._begin_s is None:
            self._begin_s = t
        noise = self._draw.standard_normal(6)
        drift = known(sensors.force_drift) * (t - self._begin_s)
        fx, fy, fz = (wrench[:3] + sensors.force_sigma * noise[:3] + drift).tolist()
        tx, ty, tz = (wrench[3:] + sensors.torque_sigma * noise[3:]).tolist()
        self.due.append(MujocoWrench(t + 0.001, t, (fx, fy, fz), (tx, ty, tz)))
