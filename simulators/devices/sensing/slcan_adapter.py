"""Emulated CAN adapter that speaks slcan, the ASCII protocol of Lawicel.

Invariants:
    Pure: bytes in, bytes out; no port, no clock.
    Each command is answered with CR (done) or BEL (refused).
    Frames pass only while the channel is open.
    An unknown or misplaced command is refused and counted.
"""

from collections import deque
from dataclasses import dataclass, field

from linemate.protocol.sensors.slcan import (
    OK,
    REFUSED,
    SENT,
    SENT_EXTENDED,
    CanFrame,
    Command,
    CommandDecoder,
    CommandKind,
    format_frame,
)

KEEP = 16
_ANSWERS = {
    CommandKind.VERSION: b"V1013",
    CommandKind.SERIAL: b"NLM01",
    CommandKind.FLAGS: b"F00",
    CommandKind.EMPTY: b"",  # hosts clear the line with empty ones
}
_ONLY_CLOSED = {
    CommandKind.BITRATE,
    CommandKind.BIT_TIMING,
    CommandKind.ACCEPTANCE_CODE,
    CommandKind.ACCEPTANCE_MASK,
    CommandKind.STAMPS,
}


@dataclass(slots=True)
class SlcanAdapter:
    """The adapter's end of the line.

    Attributes:
        listen_only: opened with ``L``: nothing may be sent to the bus.
        bitrate_code: the digit of the last ``S``, None before any.
        stamps: frames carry the adapter's clock.
        received: the newest frames the host sent to the bus.
        refused: commands answered with BEL.
        forwarded: frames passed to the host.
        withheld: frames that met a closed channel.
    """

    is_open: bool = False
    listen_only: bool = False
    bitrate_code: int | None = None
    stamps: bool = False
    received: deque[CanFrame] = field(default_factory=lambda: deque(maxlen=KEEP))
    refused: int = 0
    forwarded: int = 0
    withheld: int = 0
    _decoder: CommandDecoder = field(default_factory=CommandDecoder)

    def feed(self, data: bytes) -> bytes:
        """Take what the host wrote, cut anywhere.

        Returns:
            The answers.
        """
        return b"".join(self._answer(command) for command in self._decoder.feed(data))

    def forward(self, frame: CanFrame, time_ms: int = 0) -> bytes:
        """A frame was on the bus: what the host gets to see of it.

        Args:
            time_ms: the adapter's clock [ms], sent if the host asked for it.

        Returns:
            Bytes for the host; none while the channel is closed.
        """
        if not self.is_open:
            self.withheld += 1
            return b""
        self.forwarded += 1
        return format_frame(frame, time_ms if self.stamps else None)

    def reset(self) -> None:
        """Power off and on: the channel is closed."""
        self.is_open = self.listen_only = self.stamps = False
        self.bitrate_code = None
        self._decoder = CommandDecoder()

    def _answer(self, command: Command) -> bytes:
        answer = self._execute(command)
        if answer is None:
            self.refused += 1
            return REFUSED
        return answer

    def _execute(self, command: Command) -> bytes | None:
        """What a command is answered, None if it is refused."""
        kind = command.kind
        if kind in _ANSWERS:
            return _ANSWERS[kind] + OK
        if kind in _ONLY_CLOSED:
            return self._set(command)
        if kind is CommandKind.TRANSMIT:
            return self._transmit(command.frame)
        if kind is CommandKind.CLOSE:
            self.is_open = False
            return OK
        if kind in {CommandKind.OPEN, CommandKind.LISTEN} and not self.is_open:
            self.is_open, self.listen_only = True, kind is CommandKind.LISTEN
            return OK
        return None

    def _set(self, command: Command) -> bytes | None:
        if self.is_open:
            return None
        if command.kind is CommandKind.BITRATE:
            self.bitrate_code = command.value
        elif command.kind is CommandKind.STAMPS:
            self.stamps = bool(command.value)
        return OK

    def _transmit(self, frame: CanFrame | None) -> bytes | None:
        if frame is None or not self.is_open or self.listen_only:
            return None
        self.received.append(frame)
        return SENT_EXTENDED if frame.extended else SENT
