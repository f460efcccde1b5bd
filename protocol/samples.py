"""What a sampling step may know of the world: stamped samples in SI units.

Law of this file: only frozen values, no behaviour. A sample is made once, where a wire is
decoded, and travels unchanged through the step and into a recording. Stamps are integer
nanoseconds of the local monotonic clock at *arrival*; a sensor's own delay is beside it.
"""

from typing import NewType

from msgspec import Struct

Stamp = NewType("Stamp", int)
"""Monotonic time of arrival [ns]."""

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
Quaternion = tuple[float, float, float, float]
"""Unit quaternion, w first."""


class DistanceSample(Struct, frozen=True):
    """One reading of the distance sensor at the conveyor.

    Attributes:
        stamp_ns: arrival [ns].
        position: reading [m].
        strength: signal strength where the device gives one, else None.
    """

    stamp_ns: int
    position: float
    strength: float | None = None


class CameraSample(Struct, frozen=True):
    """One pose of an object as a camera saw it.

    Attributes:
        stamp_ns: arrival [ns].
        exposure_ns: middle of the exposure on the local monotonic clock [ns].
        frame: frame the pose is given in.
        object_id: object the pose is of.
        position: object in ``frame`` [m].
        quaternion: orientation of the object in ``frame``, w x y z.
        covariance: upper triangle row by row, order x y z rx ry rz [m, rad], or None.
        reset: the tracker's restart counter.
    """

    stamp_ns: int
    exposure_ns: int
    source: str
    frame: str
    object_id: str
    sequence: int
    position: Vector3
    quaternion: Quaternion
    covariance: tuple[float, ...] | None = None
    quality: int = -1
    reset: int = 0


class WrenchSample(Struct, frozen=True):
    """One reading of the force-torque sensor, in the sensor's frame.

    Attributes:
        stamp_ns: arrival [ns].
        force: [N].
        torque: [Nm].
        status: the device's status word, 0 if it has none.
        device_us: the device's own clock [us], or None.
        temperature: [deg C], or None.
    """

    stamp_ns: int
    force: Vector3
    torque: Vector3
    status: int = 0
    device_us: int | None = None
    temperature: float | None = None


class RobotSample(Struct, frozen=True):
    """What the robot controller said of itself in one telegram.

    Attributes:
        stamp_ns: arrival [ns].
        joints: measured joint angles A1..A6 [rad].
        external: measured external axes [m] (linear) or [rad] (rotary), E1 first.
        delay: the controller's count of late replies, None if not configured.
        digital_in: the tool's signals (bit 0 screws fixed, bit 1 wheel released).
    """

    stamp_ns: int
    ipoc: int
    joints: Vector6
    external: tuple[float, ...]
    delay: int | None = None
    digital_in: int = 0
