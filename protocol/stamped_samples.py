"""Stamped samples of the sensors and the robot, in SI units.

Invariants:
    A sample is made where a wire is decoded, and does not change up to the recording.
    Stamps are arrivals on the local monotonic clock [ns]; a sensor's own delay is not in them.
"""

from msgspec import Struct

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
Quaternion = tuple[float, float, float, float]  # unit quaternion, w first

AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")  # of the arm, then the linear axis


class DistanceSample(Struct, frozen=True):
    """One reading of the distance sensor at the conveyor.

    Attributes:
        position: distance [m], before offset and direction of the mounting.
        strength: signal strength where the device gives one, else None.
    """

    stamp_ns: int
    position: float
    strength: float | None = None


class CameraSample(Struct, frozen=True):
    """One pose of an object from a camera.

    Attributes:
        exposure_ns: middle of the exposure on the local monotonic clock [ns].
        position: of the object in ``frame`` [m].
        quaternion: orientation of the object in ``frame``, w x y z.
        covariance: upper triangle row by row, order x y z rx ry rz [m, rad], or None.
        reset: counter of the tracker's restarts.
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
    """One reading of the force-torque sensor: force [N], torque [Nm] in the sensor's frame.

    Attributes:
        status: the device's status word, 0 if it has none.
        device_us: the device's own clock [us], or None.
        temperature: of the sensor [deg C], or None.
    """

    stamp_ns: int
    force: Vector3
    torque: Vector3
    status: int = 0
    device_us: int | None = None
    temperature: float | None = None


class RobotSample(Struct, frozen=True):
    """State of the robot in one telegram.

    Attributes:
        joints: measured joint angles A1..A6 [rad].
        external: measured external axes [m] (linear) or [rad] (rotary), E1 first.
        delay: the controller's count of late replies, None if not configured.
        digital_in: the tool's signals (bit 0 screws fixed, bit 1 wheel released).
    """

    stamp_ns: int
    counter: int
    joints: Vector6
    external: tuple[float, ...]
    delay: int | None = None
    digital_in: int = 0
