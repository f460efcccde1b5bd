"""Controller link: what the daemon needs of a robot controller's wire, whatever the family.

A family is one package with one class that satisfies ``ControllerLink``: a codec between bytes and
values, and the rules of its exchange. The counter's rules are in ``exchange``.

Invariants:
    Pure: bytes and stamps are arguments, values and bytes are return values.
    Joints and linear axes are in SI units, in the order A1..A6, E1.
    A reply is written before its telegram comes, but for the counter.
"""

from collections.abc import Callable, Hashable
from enum import StrEnum
from typing import NamedTuple, Protocol

from msgspec import Struct

from linemate.protocol.errors import ProtocolError
from linemate.protocol.stamped_samples import RobotSample, Vector6

# Jitter and a controller that was stalled for a moment leave less unaccounted than this [s].
ACCOUNTED_S = 0.08

IsLost = Callable[[tuple[float, ...]], bool]
"""Whether the last setpoint did not arrive, by where the controller sends its servos [rad, m]."""


class SetpointKind(StrEnum):
    """What the setpoint in a reply counts from."""

    OFFSETS = "the position at which the controller's program started"
    INCREMENTS = "the setpoint before"
    POSITIONS = "zero of each axis: setpoints are positions"


class ExchangeRules(Struct, frozen=True):
    """Rules of a family's exchange.

    Attributes:
        setpoints: what a setpoint counts from.
        accounted_s: after a longer silence it is unknown which setpoint is in force [s].
        coasts: in a cycle without a reply the controller goes on at the speed of its last two
            setpoints. Else it holds the last one.
        newest_acts: a late reply acts in the next cycle unless a newer one comes, and no telegram
            shows it.
    """

    setpoints: SetpointKind = SetpointKind.OFFSETS
    accounted_s: float = ACCOUNTED_S
    coasts: bool = False
    newest_acts: bool = False


class ControllerError(ProtocolError):
    """Bytes that are no telegram of this controller, or a reply that it cannot be sent."""

    @property
    def counter(self) -> tuple[int, bytes] | None:
        """The telegram's counter and its bytes, if it could be read."""
        return None


class ControllerTelegram(NamedTuple):
    """One telegram of a controller.

    Attributes:
        counter: number of the cycle.
        echo: the counter's bytes as a reply repeats them.
        programmed: position of the axes without corrections [rad, m], None if not in the telegram.
        unready: why the controller takes no setpoint now and what to do, None if it takes them.
        sent_to: where the controller sends its servos [rad, m], None if not in the telegram.
    """

    counter: int
    echo: bytes
    robot: RobotSample
    programmed: tuple[float, ...] | None = None
    unready: str | None = None
    sent_to: tuple[float, ...] | None = None


class PreparedReply(Struct, frozen=True):
    """Reply without its counter, made before its telegram arrives."""

    head: bytes
    tail: bytes

    def with_counter(self, echo: bytes) -> bytes:
        """Return the reply's bytes with the counter of the telegram that it answers."""
        return self.head + echo + self.tail


class TelegramPattern(Protocol):
    """The one telegram that is expected next."""

    def matches(self, data: bytes) -> bool:
        """Return whether a datagram is the telegram."""


class ReadyReply(NamedTuple):
    """A reply that is made before its telegram.

    Attributes:
        telegram: the only one that it answers.
        peer: the controller that must send it.
        until_ns: latest arrival [ns]. A later telegram needs a proof in the ordinary way.
        data: bytes of the reply.
    """

    telegram: TelegramPattern
    peer: Hashable
    until_ns: int
    data: bytes


class Handshake(Protocol):
    """Start and stop of a stream that the daemon must ask for, on the telegrams' socket.

    Attributes:
        refusal: why there can be no stream and what to do, None if there can.
    """

    refusal: str | None
    starts: int

    @property
    def is_ended(self) -> bool:
        """The last reply of the stream is out, or there is none."""

    @property
    def waits_for(self) -> str:
        """What is asked for and does not come, and what to do; empty while telegrams come."""

    def due(self, now_ns: int) -> list[bytes]:
        """Return the datagrams to send now [ns]."""

    def on_datagram(self, data: bytes, now_ns: int) -> bool:
        """Note a datagram of the controller, and return whether it is no telegram [ns]."""

    def outgoing(self, reply: bytes) -> bytes:
        """Return a reply as it goes out: the last one of a stream may be marked."""

    def end(self) -> None:
        """End the stream with the next reply."""

    def farewell(self) -> list[bytes]:
        """Return the datagrams that end the stream."""


class ControllerLink(Protocol):
    """Codec of a family and the rules of its exchange.

    Attributes:
        rules: what a setpoint counts from, and how long a silence may be.
    """

    rules: ExchangeRules

    def read(self, data: bytes, stamp_ns: int) -> ControllerTelegram:
        """Return the telegram in a datagram.

        Args:
            stamp_ns: its arrival on the monotonic clock [ns].

        Raises:
            ControllerError: it is none of this controller, or lacks an axis of the arm.
        """

    def expect(
        self,
        counter: int,
        delay: int | None,
        joints: Vector6,
        reach: float,
        is_lost: IsLost | None = None,
    ) -> tuple[TelegramPattern, bytes] | None:
        """Return the telegram to expect next and the echo of its counter, None if unknown.

        Every telegram that the pattern accepts, ``read`` accepts as well, and it is not unready.

        Args:
            delay: bad cycles that it will have counted, None if it counts none.
            joints: the last measured joints [rad].
            reach: how far from there a joint may be [rad].
            is_lost: the last setpoint, by where the controller sends its servos.
        """

    def prepare(
        self, command: tuple[float, ...], origin: tuple[float, ...], digital_out: int
    ) -> PreparedReply:
        """Return the reply with a setpoint, but for the counter.

        Args:
            command: where the axes shall be [rad, m].
            origin: where offsets or increments count from [rad, m].

        Raises:
            ControllerError: the wire cannot carry it.
        """

    def without_setpoint(
        self, digital_out: int, *, writes_zero: bool = False
    ) -> PreparedReply | None:
        """Return the reply that leaves the robot as it is, None if silence does so.

        Args:
            digital_out: signals to the tool; 0 is not written, they stay as they were.
            writes_zero: 0 is written too.
        """
