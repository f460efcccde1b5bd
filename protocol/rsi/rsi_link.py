"""RSI behind the seam of controllers: a step's command as corrections or increments.

Invariants:
- Pure. Everything but the IPOC is written beforehand.
- A correction without an element in the configuration is refused by the codec, never dropped.
- External axes that the arm does not have stay where they are.
"""

from typing import cast

from linemate.protocol.controller_family import refusal
from linemate.protocol.controller_link import (
    ControllerTelegram,
    ExchangeRules,
    IsLost,
    PreparedReply,
    SetpointKind,
)
from linemate.protocol.rsi.codec import RsiCodec, RsiError, SensorTelegram
from linemate.protocol.rsi.telegram_layout import EXTERNAL_AXES
from linemate.protocol.rsi.telegram_reader import ExpectedTelegram
from linemate.protocol.stamped_samples import RobotSample, Vector6


class RsiLink:
    """Reads telegrams and writes replies of one configuration.

    Attributes:
        rules: setpoints are offsets or increments, and the controller holds.
        bare: a reply of the constants alone: the controller keeps the corrections that it has.
    """

    __slots__ = (
        "_codec",
        "_external_axes",
        "_is_on_rail",
        "_reader",
        "_writes_signals",
        "bare",
        "rules",
    )

    def __init__(self, codec: RsiCodec, *, absolute: bool = True, on_rail: bool = False) -> None:
        """Look up what the configuration has elements for.

        Args:
            absolute: corrections are offsets from the start (#ABSOLUTE), else increments.
            on_rail: the arm stands on a linear axis, E1.
        """
        self._codec, self._reader = codec, codec.robot_reader
        self._is_on_rail = on_rail
        kind = SetpointKind.OFFSETS if absolute else SetpointKind.INCREMENTS
        self.rules = ExchangeRules(kind)
        tags = {element.tag for element in codec.config.receive}
        external = [tag.partition(".")[2] for tag in tags if tag.startswith(("EK.", "EKorr."))]
        self._external_axes = max((1 + EXTERNAL_AXES.index(axis) for axis in external), default=0)
        self._writes_signals = "DiO" in tags
        self.bare = codec.bare_sensor()

    def read(self, data: bytes, stamp_ns: int) -> ControllerTelegram:
        """Return the telegram in a datagram.

        Raises:
            ControllerError: it is none, or the configuration sends no joints, or no linear axis
                that the arm has.
        """
        try:
            telegram = self._reader.parse(data)
        except RsiError as error:
            raise refusal(error, data, "rsi") from None
        if telegram.joints is None:
            raise RsiError(
                "the telegram has no AIPos: the daemon needs the joints",
                ipoc_text=telegram.ipoc_text,
            )
        external = telegram.external or ()
        if self._is_on_rail and not external:
            raise RsiError(
                "the telegram has no EIPos: the task's arm has a linear axis",
                ipoc_text=telegram.ipoc_text,
            )
        signals = telegram.channels.get("DiL", 0)
        robot = RobotSample(
            stamp_ns=stamp_ns,
            counter=telegram.ipoc,
            joints=telegram.joints,
            external=external,
            delay=telegram.delay,
            digital_in=int(signals) if isinstance(signals, (int, float)) else 0,
        )
        programmed: tuple[float, ...] | None = telegram.joint_setpoints
        if programmed is not None and self._is_on_rail:
            rail = telegram.external_setpoints
            programmed = (*programmed, rail[0]) if rail else None
        return ControllerTelegram(telegram.ipoc, telegram.ipoc_text, robot, programmed)

    def expect(
        self,
        counter: int,
        delay: int | None,
        joints: Vector6,
        reach: float,
        is_lost: IsLost | None = None,
    ) -> tuple[ExpectedTelegram, bytes] | None:
        """Return the telegram to expect next and its digits, None without AIPos or its Delay.

        A lost setpoint shows in ``delay``, not in where the servos are sent.
        """
        del is_lost
        telegram = self._reader.expect(counter, delay, joints, reach)
        return None if telegram is None else (telegram, b"%d" % counter)

    def without_setpoint(self, digital_out: int, *, writes_zero: bool = False) -> PreparedReply:
        """Return a reply that leaves the robot where it is, with the tool's signals.

        Args:
            digital_out: the tool's signals; 0 is not written, they stay as they were.
            writes_zero: 0 is written too.
        """
        if not (digital_out or writes_zero) or not self._writes_signals:
            return self.bare
        signals = f"<DiO>{digital_out}</DiO><IPOC>".encode()
        return PreparedReply(self.bare.head.replace(b"<IPOC>", signals), self.bare.tail)

    def prepare(
        self, command: tuple[float, ...], origin: tuple[float, ...], digital_out: int
    ) -> PreparedReply:
        """Return the reply but for the IPOC.

        Args:
            command: where the axes shall be [rad, m].
            origin: where corrections count from [rad, m].

        Raises:
            RsiError: the wire cannot carry it.
        """
        offsets = tuple([c - o for c, o in zip(command, origin, strict=True)])
        external = offsets[6:] + (0.0,) * (6 + self._external_axes - len(offsets))
        return self._codec.prepare_sensor(
            SensorTelegram(
                ipoc=0,
                joints=cast(Vector6, offsets[:6]),
                external=external if self._external_axes else None,
                channels={"DiO": digital_out} if self._writes_signals else {},
            )
        )
