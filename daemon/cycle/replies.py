"""Replies: a step's command as corrections or increments, written before the telegram comes.

Invariants:
- Pure. Everything but the IPOC is written beforehand.
- A correction without an element in the configuration is refused by the codec, never dropped.
- External axes that the arm does not have stay where they are.
"""

from typing import cast

from linemate.protocol.rsi.codec import PreparedReply, RsiCodec, SensorTelegram
from linemate.protocol.rsi.telegram_layout import EXTERNAL_AXES
from linemate.protocol.stamped_samples import Vector6


class Replies:
    """Writes replies.

    Attributes:
        absolute: corrections are offsets from the start (#ABSOLUTE), else increments.
        bare: a reply of the constants alone: the controller keeps the corrections that it has.
    """

    __slots__ = ("_axes", "_codec", "_writes_signals", "absolute", "bare")

    def __init__(self, codec: RsiCodec, *, absolute: bool) -> None:
        """Look up what the configuration has elements for."""
        self._codec = codec
        self.absolute = absolute
        tags = {element.tag for element in codec.config.receive}
        external = [tag.partition(".")[2] for tag in tags if tag.startswith(("EK.", "EKorr."))]
        self._axes = max((1 + EXTERNAL_AXES.index(axis) for axis in external), default=0)
        self._writes_signals = "DiO" in tags
        self.bare = codec.bare_sensor()

    def without_corrections(self, digital_out: int) -> PreparedReply:
        """Return a reply that leaves the robot where it is and tells the tool what to do.

        Args:
            digital_out: the tool's signals; 0 is not written, they stay as they were.
        """
        if not digital_out or not self._writes_signals:
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
        external = offsets[6:] + (0.0,) * (6 + self._axes - len(offsets))
        return self._codec.prepare_sensor(
            SensorTelegram(
                ipoc=0,
                joints=cast(Vector6, offsets[:6]),
                external=external if self._axes else None,
                channels={"DiO": digital_out} if self._writes_signals else {},
            )
        )
