"""ABB Externally Guided Motion: codec of EgmRobot and EgmSensor in joint mode.

Invariants:
    Pure: bytes in, values out, and the reverse. Either end uses it.
    Any bytes give a message or EgmError, any message gives bytes or EgmError.
    ``measuredForce`` field 1 is a double in RobotWare 6 and a bool in RobotWare 7. The wire type
    shows which.

Reference: egm.proto of RobotWare 6 (ros-industrial/abb_libegm) and of RobotWare 7.
"""

from collections.abc import Iterable
from typing import Literal

from linemate.protocol.egm.message_fields import (
    JOINT_SCALES,
    Fields,
    enumerated,
    external_scales,
    finite,
    part,
    read_external,
    read_header,
    read_joints,
    read_position,
    real,
    reals,
    require_size,
    single_fields,
    write_axes,
    write_header,
    write_position,
)
from linemate.protocol.egm.messages import (
    Axes,
    CorrectionMessage,
    EgmPosition,
    GuidanceState,
    MessageType,
    MotorState,
    RapidState,
    RobotMessage,
)
from linemate.protocol.egm.protobuf_wire import (
    FIXED64,
    LENGTH,
    VARINT,
    EgmError,
    bytes_field,
    double_field,
    doubles_field,
    number_field,
    read_fields,
)

ROBOTWARE_VERSIONS = (6, 7)
MAX_FORCES = 6  # Fx Fy Fz [N], Mx My Mz [Nm]
MAX_RAPID_DATA = 40  # numbers to or from the RAPID program

Robotware = Literal[6, 7]

# Wire type of each field that is read.
_ROBOT = {1: LENGTH, 2: LENGTH, 3: LENGTH, 4: LENGTH, 5: LENGTH, 6: VARINT, 8: LENGTH, 9: LENGTH,
          10: FIXED64, 11: VARINT, 12: LENGTH, 13: LENGTH, 14: LENGTH}  # fmt: skip
_ROBOTWARE_7_FIELDS = (11, 12, 13, 14)  # moveIndex, CollisionInfo, RAPIDfromRobot, torqueRef
_SENSOR = {1: LENGTH, 2: LENGTH, 3: LENGTH, 4: LENGTH}
_PLANNED = {1: LENGTH, 2: LENGTH, 3: LENGTH, 4: LENGTH}


class EgmCodec:
    """Reads and writes the messages of one robot.

    Example::

        codec = EgmCodec()
        message = codec.parse_robot(datagram)
        datagram = codec.format_correction(CorrectionMessage(1, joints=message.feedback.joints))
    """

    def __init__(
        self, linear_external: Iterable[str] = ("E1",), robotware: Robotware | None = None
    ) -> None:
        """Choose the units of the external axes and the RobotWare generation.

        Args:
            linear_external: external axes that are linear (mm on the wire), others in degrees.
            robotware: refuse messages of the other generation; None: read both.

        Raises:
            EgmError: an axis or a generation that is not known.
        """
        if robotware is not None and robotware not in ROBOTWARE_VERSIONS:
            raise EgmError(f"RobotWare {robotware} unknown: 6 and 7 are read. Set one of them.")
        self._scales = external_scales(linear_external)
        self._robotware = robotware

    def parse_robot(self, data: bytes) -> RobotMessage:
        """Read the controller's message.

        Raises:
            EgmError: not an EgmRobot message with a header and six measured joints.
        """
        require_size(data)
        fields = single_fields(data, "EgmRobot", _ROBOT)
        sequence, time_ms = read_header(part(fields, 1), "EgmRobot", MessageType.DATA)
        feedback = read_position(part(fields, 2), "feedBack", self._scales)
        if feedback.joints is None:
            raise EgmError("EgmRobot without feedBack.joints. Check the robot's EGM set-up.")
        force, active, robotware = _force(part(fields, 9))
        converged = fields.get(6)
        return RobotMessage(
            sequence,
            time_ms,
            feedback,
            read_position(part(fields, 3), "planned", self._scales),
            enumerated(part(fields, 4), MotorState, "motorState"),
            enumerated(part(fields, 5), GuidanceState, "mciState"),
            enumerated(part(fields, 8), RapidState, "rapidExecState"),
            None if converged is None else bool(converged),
            real(fields, 10, "utilizationRate"),
            force,
            active,
            self._generation(fields, robotware),
            _rapid_data(part(fields, 13), "RAPIDfromRobot"),
        )

    def parse_correction(self, data: bytes) -> CorrectionMessage:
        """Read the sensor's message in joint mode.

        Raises:
            EgmError: not an EgmSensor message, or a Cartesian setpoint.
        """
        require_size(data)
        fields = single_fields(data, "EgmSensor", _SENSOR)
        sequence, time_ms = read_header(part(fields, 1), "EgmSensor", MessageType.CORRECTION)
        planned = single_fields(part(fields, 2) or b"", "planned", _PLANNED)
        speeds = single_fields(part(fields, 3) or b"", "speedRef", _PLANNED)
        if 2 in planned or 2 in speeds:
            raise EgmError("EgmSensor with a Cartesian setpoint: joint mode is read. Send joints.")
        return CorrectionMessage(
            sequence,
            time_ms,
            read_joints(part(planned, 1), "planned.joints"),
            read_external(part(planned, 3), "planned.externalJoints", self._scales),
            read_joints(part(speeds, 1), "speedRef.joints"),
            read_external(part(speeds, 3), "speedRef.externalJoints", self._scales),
            _rapid_data(part(fields, 4), "RAPIDtoRobot"),
        )

    def format_robot(self, message: RobotMessage) -> bytes:
        """Write the controller's message; the force as ``message.robotware`` has it, 6 if None.

        Raises:
            EgmError: a value that the wire cannot carry.
        """
        out = write_header(message.sequence, message.time_ms, MessageType.DATA)
        out += write_position(2, message.feedback, "feedBack", self._scales)
        out += write_position(3, message.planned, "planned", self._scales)
        out += bytes_field(4, number_field(1, message.motors.value))
        out += bytes_field(5, number_field(1, message.guidance.value))
        if message.is_converged is not None:
            out += number_field(6, int(message.is_converged))
        out += bytes_field(8, number_field(1, message.rapid.value))
        out += _force_field(message)
        if message.utilization is not None:
            out += double_field(10, message.utilization)
        return out + _rapid_field(13, message.rapid_data, "RAPIDfromRobot")

    def format_correction(self, message: CorrectionMessage) -> bytes:
        """Write the sensor's message.

        Raises:
            EgmError: a value that the wire cannot carry, or a speed without its position.
        """
        return self.correction_header(message.sequence, message.time_ms) + self.correction_body(
            message
        )

    @staticmethod
    def correction_header(sequence: int, time_ms: int = 0) -> bytes:
        """Write the first field of the sensor's message.

        Raises:
            EgmError: a number beyond 32 bits.
        """
        return write_header(sequence, time_ms, MessageType.CORRECTION)

    def correction_body(self, message: CorrectionMessage) -> bytes:
        """Write the sensor's message without its header.

        Raises:
            EgmError: a value that the wire cannot carry, or a speed without its position.
        """
        if (message.joint_speeds and not message.joints) or (
            len(message.external_speeds) > len(message.external)
        ):
            raise EgmError("EgmSensor with a speed without its setpoint. Send both.")
        planned = EgmPosition(message.joints, message.external)
        out = write_position(2, planned, "planned", self._scales)
        speeds = write_axes(1, message.joint_speeds or (), JOINT_SCALES, "speedRef.joints")
        speeds += write_axes(3, message.external_speeds, self._scales, "speedRef.externalJoints")
        out += bytes_field(3, speeds) if speeds else b""
        return out + _rapid_field(4, message.rapid_data, "RAPIDtoRobot")

    def _generation(self, fields: Fields, robotware: int | None) -> int | None:
        """Return the RobotWare generation that the message shows."""
        if any(number in fields for number in _ROBOTWARE_7_FIELDS):
            if robotware == 6:
                raise EgmError(
                    "EgmRobot mixes RobotWare 6 and 7: measuredForce of 6, later fields of 7. "
                    "Check the sender."
                )
            robotware = 7
        if None not in {self._robotware, robotware} and robotware != self._robotware:
            raise EgmError(
                f"EgmRobot of RobotWare {robotware}: configured is {self._robotware}. "
                "Set the controller's generation."
            )
        return robotware


def _force(data: bytes | None) -> tuple[Axes | None, bool | None, int | None]:
    """Return measured force, whether force control is active, and the RobotWare generation.

    Field 1 is a list of doubles in RobotWare 6. In RobotWare 7 field 1 is a bool (a varint), field
    2 the list. The wire type of field 1 distinguishes them.
    """
    if data is None:
        return None, None, None
    kinds = {(number, wire_type == VARINT) for number, wire_type, _ in read_fields(data)}
    is_old, is_new = (1, False) in kinds, bool({(1, True), (2, False), (2, True)} & kinds)
    if is_old and is_new:
        raise EgmError("measuredForce mixes RobotWare 6 and 7. Check the sender.")
    if is_old:
        return reals(data, "measuredForce.force", 1, MAX_FORCES), None, 6
    if not is_new:
        return None, None, None
    active = single_fields(data, "measuredForce", {1: VARINT}).get(1)
    force = reals(data, "measuredForce.force", 2, MAX_FORCES)
    return force or None, None if active is None else bool(active), 7


def _force_field(message: RobotMessage) -> bytes:
    if message.force is None and message.is_force_active is None:
        return b""
    if message.robotware != 7:
        return bytes_field(9, doubles_field(1, message.force or ()))
    active = message.is_force_active
    head = b"" if active is None else number_field(1, int(active))
    return bytes_field(9, head + doubles_field(2, message.force or ()))


def _rapid_data(data: bytes | None, name: str) -> Axes:
    """Return the numbers of an EgmRAPIDdata message; its digital value is skipped."""
    return () if data is None else reals(data, f"{name}.dnum", 2, MAX_RAPID_DATA)


def _rapid_field(number: int, values: Axes, name: str) -> bytes:
    if len(values) > MAX_RAPID_DATA:
        raise EgmError(f"{name} has {len(values)} values: limit {MAX_RAPID_DATA}. Send fewer.")
    body = doubles_field(2, [finite(value, f"{name}.dnum") for value in values])
    return bytes_field(number, body) if values else b""
