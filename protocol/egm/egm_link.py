"""ABB's EGM behind the seam of controllers: setpoints are positions, speeds are fed forward.

Invariants:
    Pure. Everything but the header is written beforehand.
    The reply's sequence number is that of the message that it answers.
    Silence leaves the robot as it is: the last setpoint holds until CommTimeout.
    Motors off, RAPID stopped or EGM not running: no setpoint.
"""

from typing import cast

from linemate.protocol.controller_family import refusal
from linemate.protocol.controller_link import (
    ControllerError,
    ControllerTelegram,
    ExchangeRules,
    IsLost,
    PreparedReply,
    SetpointKind,
)
from linemate.protocol.egm import messages
from linemate.protocol.egm.egm_codec import EgmCodec
from linemate.protocol.egm.protobuf_wire import EgmError
from linemate.protocol.stamped_samples import RobotSample, Vector6

MAX_SIGNALS = 255


class EgmLink:
    """Reads messages and writes corrections of one robot."""

    __slots__ = ("_codec", "_cycle_s", "_has_signals", "_is_on_rail", "rules")

    def __init__(
        self, codec: EgmCodec, cycle_s: float, *, on_rail: bool = False, signals: bool = True
    ) -> None:
        """Keep the codec and the settings of the replies.

        Args:
            cycle_s: period of the controller [s].
            on_rail: the arm stands on a linear axis, E1.
            signals: the tool's signals are the first number of RAPIDtoRobot and RAPIDfromRobot.
        """
        self._codec = codec
        self._cycle_s = cycle_s
        self._is_on_rail = on_rail
        self._has_signals = signals
        self.rules = ExchangeRules(SetpointKind.POSITIONS, newest_acts=True)

    def read(self, data: bytes, stamp_ns: int) -> ControllerTelegram:
        """Return the telegram in a datagram.

        Raises:
            ControllerError: it is none, or has no linear axis that the arm has.
        """
        try:
            message = self._codec.parse_robot(data)
        except EgmError as error:
            raise refusal(error, data, "egm") from None
        feedback = message.feedback
        if self._is_on_rail and not feedback.external:
            raise EgmError(
                "EgmRobot without feedBack.externalJoints: the task's arm has a linear axis. "
                "Add the axis to the robot's EGM set-up."
            )
        robot = RobotSample(
            stamp_ns=stamp_ns,
            counter=message.sequence,
            joints=cast(Vector6, feedback.joints),
            external=feedback.external,
            digital_in=self._signals(message),
        )
        return ControllerTelegram(
            message.sequence,
            self._codec.correction_header(message.sequence),
            robot,
            unready=unready(message),
            sent_to=self._sent_to(message.planned),
        )

    def expect(
        self,
        counter: int,
        delay: int | None,
        joints: Vector6,
        reach: float,
        is_lost: IsLost | None = None,
    ) -> "tuple[ExpectedMessage, bytes] | None":
        """Return the message to expect next and its reply's header; EGM counts no bad cycles."""
        del delay
        if not 0 <= counter < 2**32:
            return None
        expected = ExpectedMessage(self, counter, joints, reach, is_lost)
        return expected, self._codec.correction_header(counter)

    def prepare(
        self, command: tuple[float, ...], origin: tuple[float, ...], digital_out: int
    ) -> PreparedReply:
        """Return the reply with a setpoint, but for the header.

        Args:
            command: where the axes shall be [rad, m].
            origin: setpoint of the cycle before [rad, m]; the difference gives the speed.

        Raises:
            EgmError: the wire cannot carry it.
        """
        speeds: tuple[float, ...] = (0.0,) * len(command)
        if len(origin) == len(command):
            speeds = tuple([(c - o) / self._cycle_s for c, o in zip(command, origin, strict=True)])
        message = messages.CorrectionMessage(
            0,
            joints=cast(Vector6, command[:6]),
            external=command[6:],
            joint_speeds=cast(Vector6, speeds[:6]),
            external_speeds=speeds[6:],
            rapid_data=(float(digital_out),) if self._has_signals else (),
        )
        return PreparedReply(b"", self._codec.correction_body(message))

    def without_setpoint(
        self, digital_out: int, *, writes_zero: bool = False
    ) -> PreparedReply | None:
        """Return None: the last setpoint holds, and silence leaves it."""
        del digital_out, writes_zero
        return None

    def _sent_to(self, planned: messages.EgmPosition) -> tuple[float, ...] | None:
        """Return the position planned by the controller, as far as the arm has its axes."""
        if planned.joints is None or (self._is_on_rail and not planned.external):
            return None
        return (*planned.joints, *planned.external[: self._is_on_rail])

    def _signals(self, message: messages.RobotMessage) -> int:
        if not self._has_signals or not message.rapid_data:
            return 0
        value = message.rapid_data[0]
        if value != int(value) or not 0 <= value <= MAX_SIGNALS:
            raise EgmError(
                f"RAPIDfromRobot.dnum 1 is {value:g}: the tool's signals are 0..{MAX_SIGNALS}. "
                "Check the RAPID program, or set egm.signals to false."
            )
        return int(value)


class ExpectedMessage:
    """The one message that is expected next.

    It is read whole: a controller may write a number in more bytes than before.
    """

    __slots__ = ("_counter", "_is_lost", "_joints", "_link", "_reach")

    def __init__(
        self,
        link: EgmLink,
        counter: int,
        joints: Vector6,
        reach: float,
        is_lost: IsLost | None = None,
    ) -> None:
        """Keep the expected values.

        Args:
            joints: the last measured joints [rad].
            reach: how far from there a joint may be [rad].
            is_lost: the last setpoint, by where the controller sends its servos.
        """
        self._link, self._counter, self._is_lost = link, counter, is_lost
        self._joints, self._reach = joints, reach

    def matches(self, data: bytes) -> bool:
        """Return whether a datagram is the message."""
        try:
            telegram = self._link.read(data, 0)
        except ControllerError:
            return False
        if telegram.counter != self._counter or telegram.unready is not None:
            return False
        if self._is_lost and telegram.sent_to is not None and self._is_lost(telegram.sent_to):
            return False
        ways = zip(telegram.robot.joints, self._joints, strict=True)
        return all(abs(now - before) <= self._reach for now, before in ways)


def unready(message: messages.RobotMessage) -> str | None:
    """Return why the controller takes no setpoint now, None if it takes them."""
    if message.motors is not messages.MotorState.ON:
        return f"the motors are not on: motorState {message.motors.name}. Switch the motors on."
    if message.rapid is not messages.RapidState.RUNNING:
        return f"RAPID does not run: rapidExecState {message.rapid.name}. Start the program."
    if message.guidance is messages.GuidanceState.STOPPED and message.is_converged:
        return (
            "EGM does not run: mciState STOPPED, mciConvergenceMet. EGMRunJoint ended because the "
            "robot stood within its ranges. Give it a longer CondTime and execute it again."
        )
    if message.guidance is not messages.GuidanceState.RUNNING:
        return f"EGM does not run: mciState {message.guidance.name}. Execute EGMRunJoint."
    return None
