"""Start and stop of Stream Motion: the daemon speaks first.

Invariants:
    Pure: stamps and bytes in, bytes out.
    STOP, then CAPABILITY, then START. A stream that falls silent is asked for again.
    A controller of another version or period gets no START, and ``refusal`` names both.
"""

from enum import StrEnum
from typing import Final

from linemate.protocol.fanuc.packets import (
    STATUS_SIZES,
    CapabilityPacket,
    FanucError,
    PacketKind,
    kind_of,
    read_capability,
    write_capability,
    write_short,
)

ASK_EVERY_NS: Final = 500_000_000
REFUSED_EVERY_NS: Final = 2_000_000_000  # a refused controller may be set up in the meantime
SILENT_NS: Final = 500_000_000  # a stream without a packet for so long has ended

_LAST_AT = 12  # offset of is_last in a command


class StreamState(StrEnum):
    """State of the stream."""

    CLOSED = "not asked for"
    ASKED = "CAPABILITY sent, no answer. Check fanuc.peer, its port and the controller's option."
    REFUSED = "the controller does not fit the configuration"
    STARTED = "START sent, no status packet. Check that no other program has the stream."
    STREAMING = "status packets come"
    ENDING = "the next command is the last one"
    ENDED = "the last command is out"


class FanucHandshake:
    """The daemon's side.

    Attributes:
        refusal: why the controller gets no START, None if it fits or is not known.
    """

    def __init__(self, version: int, cycle_ms: float) -> None:
        """Begin without a stream.

        Args:
            version: configured version of the protocol.
            cycle_ms: period that the controller should have [ms].
        """
        self.state = StreamState.CLOSED
        self.refusal: str | None = None
        self.starts = 0
        self._version = version
        self._cycle_ms = cycle_ms
        self._heard_ns = 0
        self._next_ns = 0
        self._outbox: list[bytes] = []

    @property
    def is_ended(self) -> bool:
        """The last command is out, or no stream was there to be ended."""
        return self.state is StreamState.ENDED

    @property
    def waits_for(self) -> str:
        """What is asked for and does not come, and what to do; empty while packets come."""
        return self.state.value if self.state in {StreamState.ASKED, StreamState.STARTED} else ""

    def due(self, now_ns: int) -> list[bytes]:
        """Return the packets to send now [ns]."""
        outbox, self._outbox = self._outbox, []
        if outbox or self.state in {StreamState.ENDING, StreamState.ENDED}:
            return outbox
        if self.state in {StreamState.STARTED, StreamState.STREAMING}:
            if now_ns - self._heard_ns < SILENT_NS:
                return []
            self.state, self._next_ns = StreamState.CLOSED, now_ns
        if now_ns < self._next_ns:
            return []
        is_refused = self.state is StreamState.REFUSED
        self._next_ns = now_ns + (REFUSED_EVERY_NS if is_refused else ASK_EVERY_NS)
        if not is_refused:
            self.state = StreamState.ASKED
        # A stream of a daemon that was killed may still run.
        return [
            write_short(PacketKind.STOP, self._version),
            write_capability(CapabilityPacket(self._version)),
        ]

    def on_datagram(self, data: bytes, now_ns: int) -> bool:
        """Note a packet of the controller, and return whether it is no status packet [ns]."""
        kind = kind_of(data)
        if kind in STATUS_SIZES:
            if self.state is StreamState.STARTED:
                self.state = StreamState.STREAMING
            if self.state in {StreamState.STREAMING, StreamState.ENDING}:
                self._heard_ns = now_ns
                return False
            return True  # of a stream that was not asked for, or is being stopped
        if kind == PacketKind.CAPABILITY:
            if self.state in {StreamState.ASKED, StreamState.REFUSED}:
                self._read_answer(data, now_ns)
            return True
        return False

    def _read_answer(self, data: bytes, now_ns: int) -> None:
        try:
            answer = read_capability(data)
        except FanucError as error:
            self.refusal = str(error)
            return
        if answer.available_version != self._version:
            self.refusal = (
                f"the controller speaks version {answer.available_version} of Stream Motion, "
                f"configured {self._version}. Set fanuc.version: {answer.available_version}."
            )
        elif answer.sampling_rate_ms != self._cycle_ms:
            self.refusal = (
                f"the controller's period is {answer.sampling_rate_ms} ms, configured "
                f"{self._cycle_ms:g} ms. Set fanuc.cycle_ms: {answer.sampling_rate_ms}."
            )
        else:
            self.refusal = None
        if self.refusal is not None:
            self.state = StreamState.REFUSED
            return
        self.state, self._heard_ns = StreamState.STARTED, now_ns
        self._outbox = [write_short(PacketKind.START, self._version)]
        self.starts += 1

    def outgoing(self, reply: bytes) -> bytes:
        """Return a command as it goes out, marked if it is the last one."""
        if self.state is not StreamState.ENDING or kind_of(reply) != PacketKind.COMMAND:
            return reply
        self.state = StreamState.ENDED
        return reply[:_LAST_AT] + b"\x01" + reply[_LAST_AT + 1 :]

    def end(self) -> None:
        """End the stream with the next command."""
        is_streaming = self.state is StreamState.STREAMING
        self.state = StreamState.ENDING if is_streaming else StreamState.ENDED

    def farewell(self) -> list[bytes]:
        """Return the packet that ends the stream."""
        self.state = StreamState.ENDED
        return [write_short(PacketKind.STOP, self._version)]
