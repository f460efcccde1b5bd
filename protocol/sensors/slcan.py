r"""slcan: CAN frames and adapter commands as ASCII lines, both directions.

Invariants:
    A line ends with CR.
    A decoder never raises and keeps at most one line. A line that is no command is of kind
    ``INVALID``, to be answered with BEL.

Reference: Lawicel CAN232 manual, as python-can and the Linux kernel implement it.
"""

from dataclasses import dataclass
from enum import Enum

from msgspec import Struct
from msgspec.structs import force_setattr

from linemate.protocol.errors import ProtocolError

OK = b"\r"  # answer to an executed command
REFUSED = b"\a"  # answer to a refused command
SENT = b"z\r"  # answer to ``t`` and ``r``
SENT_EXTENDED = b"Z\r"  # answer to ``T`` and ``R``

# Bit rates of S0..S8 [bit/s].
BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)

MAX_LINE_BYTES = 30  # T, 8 digits, length, 16 digits, 4 digits of stamp

_HEX = frozenset(b"0123456789abcdefABCDEF")
_STANDARD_LIMIT = 1 << 11
_EXTENDED_LIMIT = 1 << 29


class SlcanError(ProtocolError):
    """A line that is no frame, or a frame that is out of range.

    Attributes:
        has_wrong_length: a frame with more or less data than it says.
    """

    def __init__(self, what: str, line: bytes = b"", *, has_wrong_length: bool = False) -> None:
        super().__init__(f"slcan: {what}: {line[:32]!r}")
        self.line = line
        self.has_wrong_length = has_wrong_length


class CanFrame(Struct, frozen=True):
    """One classic CAN frame.

    Attributes:
        data: payload, at most 8 bytes; empty in a remote frame.
        extended: the identifier has 29 bits.
        remote: remote frame, a request for data.
        length: data length code; in a remote frame, of the requested data.
    """

    can_id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    length: int = -1

    def __post_init__(self) -> None:
        """Set the length and check the ranges.

        Raises:
            SlcanError: identifier, length or payload out of range.
        """
        if self.length < 0:
            force_setattr(self, "length", len(self.data))
        limit = _EXTENDED_LIMIT if self.extended else _STANDARD_LIMIT
        if not 0 <= self.can_id < limit:
            raise SlcanError(f"identifier {self.can_id:#x} is out of range", self.data)
        if self.length > 8 or len(self.data) != (0 if self.remote else self.length):
            raise SlcanError(f"length {self.length} does not fit the data", self.data)


def format_frame(frame: CanFrame, stamp_ms: int | None = None) -> bytes:
    """Return a frame as a line with its CR; the same in both directions.

    Args:
        stamp_ms: the adapter's clock [ms], written modulo one minute, after ``Z1`` only.
    """
    letter = "tTrR"[frame.extended + 2 * frame.remote]
    identifier = f"{frame.can_id:08X}" if frame.extended else f"{frame.can_id:03X}"
    stamp = "" if stamp_ms is None else f"{stamp_ms % 60_000:04X}"
    return f"{letter}{identifier}{frame.length}{frame.data.hex().upper()}{stamp}\r".encode()


def parse_frame(line: bytes) -> CanFrame:
    """Return the frame of a line without its CR; a stamp after the data is ignored.

    Raises:
        SlcanError: no frame.
    """
    letter, digits = line[:1], line[1:]
    if letter not in (b"t", b"T", b"r", b"R") or not _HEX.issuperset(digits):
        raise SlcanError("no frame", line)
    extended, remote = letter in b"TR", letter in b"rR"
    start = 8 if extended else 3
    if len(digits) <= start or not digits[start : start + 1].isdigit():
        raise SlcanError("no length", line)
    length = int(digits[start : start + 1])
    rest = digits[start + 1 :]
    size = 0 if remote else 2 * length
    if len(rest) not in (size, size + 4):
        what = f"{len(rest)} digits of data instead of {size}"
        raise SlcanError(what, line, has_wrong_length=True)
    data = bytes.fromhex(rest[:size].decode())
    return CanFrame(int(digits[:start], 16), data, extended, remote, length)


class CommandKind(Enum):
    """Commands of a host, by their letter."""

    OPEN = "O"
    LISTEN = "L"
    CLOSE = "C"
    BITRATE = "S"
    BIT_TIMING = "s"
    TRANSMIT = "t"
    VERSION = "V"
    SERIAL = "N"
    FLAGS = "F"
    STAMPS = "Z"
    ACCEPTANCE_CODE = "M"
    ACCEPTANCE_MASK = "m"
    EMPTY = ""
    INVALID = "?"


@dataclass(frozen=True, slots=True)
class Command:
    """One line from the host.

    Attributes:
        line: the line without its CR, cut to ``MAX_LINE_BYTES``.
        value: the number after the letter (bit rate code 0..8, stamps 0 or 1, registers), or None.
        frame: the frame to send, for ``TRANSMIT``.
    """

    kind: CommandKind
    line: bytes
    value: int | None = None
    frame: CanFrame | None = None


_BARE = {
    b"": CommandKind.EMPTY,
    b"O": CommandKind.OPEN,
    b"L": CommandKind.LISTEN,
    b"C": CommandKind.CLOSE,
    b"V": CommandKind.VERSION,
    b"v": CommandKind.VERSION,
    b"N": CommandKind.SERIAL,
    b"F": CommandKind.FLAGS,
}
# Kind, hexadecimal digits, and the first value that is too large.
_VALUED = {
    b"S": (CommandKind.BITRATE, 1, len(BITRATES)),
    b"s": (CommandKind.BIT_TIMING, 4, 1 << 16),
    b"Z": (CommandKind.STAMPS, 1, 2),
    b"M": (CommandKind.ACCEPTANCE_CODE, 8, 1 << 32),
    b"m": (CommandKind.ACCEPTANCE_MASK, 8, 1 << 32),
}


def parse_command(line: bytes) -> Command:
    """Return the command of a line without its CR; an unreadable one is ``INVALID``."""
    letter, rest = line[:1], line[1:]
    if not rest and letter in _BARE:
        return Command(_BARE[letter], line)
    if letter in _VALUED:
        kind, digits, limit = _VALUED[letter]
        if len(rest) == digits and _HEX.issuperset(rest) and int(rest, 16) < limit:
            return Command(kind, line, value=int(rest, 16))
    try:
        return Command(CommandKind.TRANSMIT, line, frame=parse_frame(line))
    except SlcanError:
        return Command(CommandKind.INVALID, line)


class LineDecoder:
    """Cuts a byte stream into lines.

    Attributes:
        overlong: lines that were longer than ``MAX_LINE_BYTES``, cut.
    """

    __slots__ = ("_buffer", "overlong")

    def __init__(self) -> None:
        self._buffer = b""
        self.overlong = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the complete lines without their CR; line feeds between lines are ignored.

        An overlong line is cut one byte after ``MAX_LINE_BYTES``, so that it cannot be read.
        """
        *lines, rest = (self._buffer + data).split(b"\r")
        self._buffer = rest.lstrip(b"\n")[: MAX_LINE_BYTES + 1]
        return [self._cut(line) for line in lines]

    def _cut(self, line: bytes) -> bytes:
        line = line.lstrip(b"\n")
        if len(line) > MAX_LINE_BYTES:
            self.overlong += 1
        return line[: MAX_LINE_BYTES + 1]


class CommandDecoder:
    """Decodes the commands in a host's byte stream.

    Attributes:
        invalid: lines that are no command.
    """

    __slots__ = ("_lines", "invalid")

    def __init__(self) -> None:
        self._lines = LineDecoder()
        self.invalid = 0

    def feed(self, data: bytes) -> list[Command]:
        """Return the complete commands in order, ``INVALID`` ones included."""
        commands = [parse_command(line) for line in self._lines.feed(data)]
        self.invalid += sum(command.kind is CommandKind.INVALID for command in commands)
        return commands
