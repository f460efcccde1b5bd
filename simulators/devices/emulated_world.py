"""What the devices need of a world, whichever solves it, and the worlds that there are.

Invariants:
    A world knows no wire; a device knows no plant.
    Worlds share this interface and nothing else.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Vec = tuple[float, float, float]
Rot = tuple[float, float, float, float, float, float, float, float, float]
Pose = tuple[Vec, Rot]
Six = tuple[float, float, float, float, float, float]


class Reading(Protocol):
    """A reading: when it leaves the sensor and when it was measured, scenario time [s]."""

    @property
    def time_s(self) -> float:
        """When it leaves the sensor, or happened [s]."""

    @property
    def exposure_s(self) -> float:
        """When it was measured [s]."""


class DistanceReading(Reading, Protocol):
    """Position of the conveyor [m] and strength of the signal."""

    @property
    def position(self) -> float:
        """Position [m]."""

    @property
    def strength(self) -> float:
        """Strength of the signal."""


class CameraReading(Reading, Protocol):
    """Hub in the camera's frame [m], w x y z, and the covariance's upper triangle or None."""

    @property
    def position(self) -> Vec:
        """Position [m]."""

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Orientation, w x y z."""

    @property
    def covariance(self) -> tuple[float, ...] | None:
        """Upper triangle row by row, or None."""


class WrenchReading(Reading, Protocol):
    """Force [N] and torque [Nm] in the rigid tcp's frame."""

    @property
    def force(self) -> Vec:
        """Force [N]."""

    @property
    def torque(self) -> Vec:
        """Torque [Nm]."""


class CollisionRecord(Protocol):
    """What went wrong, and when [s]."""

    @property
    def time_s(self) -> float:
        """When it leaves the sensor, or happened [s]."""

    @property
    def reason(self) -> str:
        """What went wrong, with figures."""


class ImpactRecord(Protocol):
    """First touch of tool and hub: when [s], and the closing speed [m/s]."""

    @property
    def time_s(self) -> float:
        """When it leaves the sensor, or happened [s]."""

    @property
    def speed(self) -> float:
        """Closing speed [m/s]."""


class EmulatedWorld(Protocol):
    """Conveyor, object, robot, tool and sensors of one run.

    Poses are in base: position [m] and rotation row by row. Axes are A1..A6 [rad], E1 [m].
    """

    @property
    def seed(self) -> int:
        """Seed of the run."""

    @property
    def lead_in_s(self) -> float:
        """The run starts this long before scenario time 0 [s]."""

    @property
    def start(self) -> tuple[float, ...]:
        """Axes at the beginning."""

    @property
    def look_ahead_s(self) -> float:
        """No axis moves on a setpoint before this time has passed [s]."""

    @property
    def mount_stiffness(self) -> tuple[float, ...]:
        """True stiffness of the mount: along [N/m] and about [Nm/rad] the tcp's axes."""

    @property
    def time_s(self) -> float:
        """Scenario time reached [s]."""

    def cycle_start(self, cycle: int) -> float:
        """Scenario time at which a controller cycle begins [s]."""

    def advance(self, t: float) -> None:
        """Go on to scenario time t [s]."""

    def command(self, setpoints: tuple[float, ...], cycle: int | None = None) -> None:
        """Command the setpoints that the controller moves to during a cycle."""

    def digital_out(self, bits: int) -> None:
        """Set the signals to the tool: bit 0 fix the screws, bit 1 release the wheel."""

    def digital_in(self) -> int:
        """Signals of the tool: bit 0 screws fixed, bit 1 wheel released."""

    def encoders(self) -> tuple[float, ...]:
        """What the encoders say now."""

    def take_distance(self) -> Sequence[DistanceReading]:
        """Readings of the distance sensor that became due since the last call."""

    def take_camera(self) -> Sequence[CameraReading]:
        """Poses of the camera that became due since the last call."""

    def take_wrench(self) -> Sequence[WrenchReading]:
        """Readings of the force-torque sensor that became due since the last call."""

    def reported(self) -> Pose:
        """Tcp as the controller computes it from its encoders."""

    def rigid(self) -> Pose:
        """True tcp without the mount's deflection."""

    def hub(self) -> Pose:
        """True hub."""

    def deflection(self) -> Six:
        """Elastic tcp relative to the rigid one, in the rigid tcp's frame [m, rad]."""

    def sag(self) -> Six:
        """Part of the deflection that is no contact: the weight of tool and wheel [m, rad]."""

    def sway(self) -> Six:
        """Displacement [m] and rotation [rad] of the hub by the carrier's modes, in c."""

    def energy(self) -> float:
        """Work that the robot has done on the car in contact, relative to the conveyor [J]."""

    def hub_pose(self, t: float | None = None) -> Floats:
        """True hub, 4x4, now; at another time if this world knows its future."""

    def tcp_pose(self) -> Floats:
        """True, elastic tcp, 4x4."""

    def unit_position(self) -> float:
        """True position of the conveyor [m]."""

    def unit_speed(self) -> float:
        """True speed of the conveyor [m/s]."""

    def unit_motion(self, times: Floats) -> tuple[Floats, Floats]:
        """True positions [m] and speeds [m/s] of the conveyor at ascending times, (n,)."""

    @property
    def contact(self) -> str:
        """Free, clamped or released."""

    @property
    def impact(self) -> ImpactRecord | None:
        """First touch of tool and hub."""

    @property
    def collision(self) -> CollisionRecord | None:
        """First collision, if any."""

    @property
    def screws_fixed_s(self) -> float | None:
        """When the screws were tight [s]."""

    @property
    def released_s(self) -> float | None:
        """When the tool let go of the wheel [s]."""
