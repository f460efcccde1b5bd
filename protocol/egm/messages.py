"""Values of EgmRobot and EgmSensor in SI units.

Reference: egm.proto V1.1 (RobotWare 6) and its extension in RobotWare 7.
"""

from enum import IntEnum

from msgspec import Struct

from linemate.protocol.stamped_samples import Quaternion, Vector3, Vector6

Axes = tuple[float, ...]  # external axes, at most six [rad, or m where linear]


class MessageType(IntEnum):
    """EgmHeader.mtype."""

    UNDEFINED = 0
    COMMAND = 1
    DATA = 2
    CORRECTION = 3
    PATH_CORRECTION = 4


class MotorState(IntEnum):
    """EgmMotorState.state."""

    UNDEFINED = 0
    ON = 1
    OFF = 2


class GuidanceState(IntEnum):
    """EgmMCIState.state: whether the controller follows setpoints."""

    UNDEFINED = 0
    ERROR = 1
    STOPPED = 2
    RUNNING = 3


class RapidState(IntEnum):
    """EgmRapidCtrlExecState.state: whether the RAPID program executes."""

    UNDEFINED = 0
    STOPPED = 1
    RUNNING = 2


class EgmPosition(Struct, frozen=True):
    """Measured or planned position: EgmFeedBack, EgmPlanned.

    Attributes:
        joints: axes 1 to 6 [rad], None if they are not in the message.
        external: external axes [rad, m], as many as the message has.
        tcp_position: of the tool in the correction frame [m], None without.
        tcp_quaternion: orientation of the tool there, w first, None without.
        clock_us: the controller's clock since 1970 [us], None without.
    """

    joints: Vector6 | None = None
    external: Axes = ()
    tcp_position: Vector3 | None = None
    tcp_quaternion: Quaternion | None = None
    clock_us: int | None = None


class RobotMessage(Struct, frozen=True):
    """Message of the controller in one cycle: EgmRobot.

    Attributes:
        time_ms: the controller's time stamp [ms].
        is_converged: the position is within the ranges of EGMRunJoint; None without.
        utilization: of the speed and acceleration that EGM allows [%], None without.
        force: measured force [N] and torque [Nm], None without.
        is_force_active: force control is active, None without (RobotWare 6 never has it).
        robotware: 6 or 7 where a field shows it, None where both write the same bytes.
        rapid_data: numbers of the RAPID program (RAPIDfromRobot.dnum, RobotWare 7).
    """

    sequence: int
    time_ms: int
    feedback: EgmPosition
    planned: EgmPosition = EgmPosition()
    motors: MotorState = MotorState.UNDEFINED
    guidance: GuidanceState = GuidanceState.UNDEFINED
    rapid: RapidState = RapidState.UNDEFINED
    is_converged: bool | None = None
    utilization: float | None = None
    force: Axes | None = None
    is_force_active: bool | None = None
    robotware: int | None = None
    rapid_data: Axes = ()


class CorrectionMessage(Struct, frozen=True):
    """Message of the daemon in one cycle: EgmSensor in joint mode.

    Attributes:
        time_ms: the sender's time stamp [ms].
        joints: setpoints of axes 1 to 6 [rad]; None: a message without setpoints.
        external: setpoints of the external axes [rad, m].
        joint_speeds: feed-forward [rad/s], None without.
        external_speeds: feed-forward of the external axes [rad/s, m/s].
        rapid_data: numbers for the RAPID program (RAPIDtoRobot.dnum, RobotWare 7).
    """

    sequence: int
    time_ms: int = 0
    joints: Vector6 | None = None
    external: Axes = ()
    joint_speeds: Vector6 | None = None
    external_speeds: Axes = ()
    rapid_data: Axes = ()
