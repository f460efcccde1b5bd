"""Wrench of the force-torque sensor, expressed in the tcp.

    f_tcp = s R f,   m_tcp = s R m + p x f_tcp

p, R: place and turn of the sensor in the tcp; s: its sign.

Invariants:
- Pure. Samples are recorded in the sensor's frame; each reader transforms them with the task.
"""

from collections.abc import Sequence

from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.task import ArmFile, PoseFile
from linemate.protocol.stamped_samples import Vector3, WrenchSample

Row = tuple[float, float, float]


class WrenchFrame(Struct, frozen=True):
    """Frame of the force-torque sensor in the tcp.

    Attributes:
        rows: of the rotation from the sensor to the tcp, with the sensor's sign.
        place: of the sensor in the tcp [m].
    """

    rows: tuple[Row, Row, Row]
    place: Vector3


def of_arm(arm: ArmFile) -> WrenchFrame | None:
    """Return the frame of a task's sensor, None if the sensor states the tcp's wrench itself."""
    if arm.sensor_in_tcp == PoseFile((0.0, 0.0, 0.0)) and arm.sensor_sign == 1:
        return None
    signed = arm.sensor_sign * rotations.matrix(arm.sensor_in_tcp.quaternion)
    (a, b, c), (d, e, f), (g, h, i) = signed.tolist()
    return WrenchFrame(((a, b, c), (d, e, f), (g, h, i)), arm.sensor_in_tcp.position)


def at_tcp(frame: WrenchFrame, sample: WrenchSample) -> WrenchSample:
    """Return a sample with force [N] and torque [Nm] in and about the tcp."""
    fx, fy, fz = _turned(frame.rows, sample.force)
    mx, my, mz = _turned(frame.rows, sample.torque)
    x, y, z = frame.place
    torque = (mx + y * fz - z * fy, my + z * fx - x * fz, mz + x * fy - y * fx)
    return replace(sample, force=(fx, fy, fz), torque=torque)


def each_at_tcp(
    frame: WrenchFrame | None, samples: Sequence[WrenchSample]
) -> tuple[WrenchSample, ...]:
    """Return samples with force [N] and torque [Nm] in and about the tcp.

    Args:
        frame: None if the sensor states the tcp's wrench itself.
    """
    return tuple(samples if frame is None else [at_tcp(frame, sample) for sample in samples])


def force_in_sensor(frame: WrenchFrame, force: Vector3) -> Vector3:
    """Return a force of the tcp [N] as the sensor states it."""
    x, y, z = force
    (a, b, c), (d, e, f), (g, h, i) = frame.rows
    return (a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z)


def _turned(rows: tuple[Row, Row, Row], vector: Vector3) -> Vector3:
    x, y, z = vector
    (a, b, c), (d, e, f), (g, h, i) = rows
    return (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)
