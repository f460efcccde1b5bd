"""Packets of the older Stream Motion (option J519, versions 1 and 2): big-endian, without padding.

The types are START and status 0, command 1 (32-bit) and 5 (64-bit), STOP 2, limits 3,
commanded position 4, version 6.
Source: the PyPI package fanuc-ucl 2.0.2 (``src/stmo/proto.rs``).

Invariants:
    Any bytes give a packet or FanucError; any packet gives bytes or FanucError.
    Values are those of the wire: degrees, and millimetres of a linear axis.
    A status has no bits for faults. A command has one word of outputs, which is not used.
"""

import math
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import Final

from msgspec import Struct

from linemate.protocol.fanuc.packets import (
    AXES,
    JOINT_STYLE,
    CommandPacket,
    FanucError,
    StatusPacket,
    packed,
    require_joints,
    require_size,
)

LIMITS: Final = 20  # entries of a table: at 1/20, 2/20 .. of the greatest speed of the tcp
VERSIONS: Final = (1, 2)

_SHORT = struct.Struct(">II")
_STATUS = struct.Struct(f">IIIBBHHHI{AXES}f{AXES}f{AXES}f")
_COMMANDS = {
    1: struct.Struct(f">IIIBBHHBBHHHH{AXES}f"),
    5: struct.Struct(f">IIIBBHHBBHHHHHH{AXES}d"),
}
_ASKED = struct.Struct(">IIII")
_TABLE = struct.Struct(f">IIIIII{LIMITS}f{LIMITS}f")
_POSITION = struct.Struct(f">III{AXES}f{AXES}f")
_FILL = {1: (0xFFFF,), 5: (0xFFFF, 0x3333, 0x3333)}


class ClassicKind(IntEnum):
    """First word of a packet; START and a status share one."""

    START = 0
    COMMAND_SINGLE = 1
    STOP = 2
    LIMITS = 3
    POSITION = 4
    COMMAND_DOUBLE = 5
    VERSION = 6


class LimitKind(IntEnum):
    """What a table of limits is about."""

    SPEED = 0
    ACCELERATION = 1
    JERK = 2


class LimitRequest(Struct, frozen=True):
    """Request for the limits of one axis: 1 for J1."""

    version: int
    axis: int
    kind: LimitKind


def write_short(kind: ClassicKind, version: int) -> bytes:
    """Write START, STOP, or a request or answer of the version."""
    return _SHORT.pack(kind, version)


def read_short(data: bytes) -> tuple[int, int]:
    """Return type and version of a packet without further values.

    Raises:
        FanucError: it is none.
    """
    if len(data) != _SHORT.size:
        raise FanucError(f"{len(data)} bytes, not {_SHORT.size}")
    kind, version = _SHORT.unpack(data)
    return int(kind), int(version)


def write_status(packet: StatusPacket) -> bytes:
    """Write a status; faults, inputs and forces have no place in it.

    Raises:
        FanucError: a value is out of range.
    """
    return packed(
        _STATUS,
        "status",
        ClassicKind.START,
        packet.version,
        packet.sequence,
        packet.motion_bits,
        *(0, 0, 0, 0),
        packet.time_ms,
        *packet.pose,
        *packet.joints,
        *packet.current,
    )


def write_position(packet: StatusPacket) -> bytes:
    """Write pose and joints of the newest command, as an answer.

    Raises:
        FanucError: a value is out of range.
    """
    kind, version = ClassicKind.POSITION, packet.version
    return packed(
        _POSITION, "POSITION", kind, version, packet.time_ms, *packet.pose, *packet.joints
    )


def read_status(data: bytes) -> StatusPacket:
    """Read a status.

    Raises:
        FanucError: it is none, or a joint is not finite.
    """
    require_size(data, _STATUS, "status")
    kind, version, sequence, bits, _, _, _, _, time_ms, *values = _STATUS.unpack(data)
    if kind != ClassicKind.START:
        raise FanucError(f"packet type {kind}, not {ClassicKind.START.value} (status)")
    pose, joints, current = (tuple(values[AXES * i : AXES * (i + 1)]) for i in range(3))
    if not all(map(math.isfinite, joints)):
        raise FanucError("a joint is not finite", sequence)
    return StatusPacket(version, sequence, bits, 0, joints, pose, current, time_ms)


def write_command(packet: CommandPacket) -> bytes:
    """Write a command of joints: 32-bit numbers in version 1, 64-bit ones in version 2.

    Raises:
        FanucError: another style, a joint that is not finite, a value that is out of range.
    """
    require_joints(packet)
    single = packet.version < 2
    kind = ClassicKind.COMMAND_SINGLE if single else ClassicKind.COMMAND_DOUBLE
    return packed(
        _COMMANDS[kind],
        "COMMAND",
        kind,
        packet.version,
        packet.sequence,
        packet.is_last,
        *(0, 0, 0),
        True,
        *(0, 0, 0, 0),
        *_FILL[kind],
        *packet.joints,
    )


def read_command(data: bytes) -> CommandPacket:
    """Read a command; a pose has style 0, which is for the controller to refuse.

    Raises:
        FanucError: it is none.
    """
    kind = _SHORT.unpack_from(data)[0] if len(data) >= _SHORT.size else -1
    layout = _COMMANDS.get(kind)
    if layout is None or len(data) != layout.size:
        raise FanucError(f"no COMMAND packet: type {kind}, {len(data)} bytes")
    _, version, sequence, is_last, _, _, _, is_joints, *rest = layout.unpack(data)
    style = JOINT_STYLE if is_joints else 0
    return CommandPacket(version, sequence, tuple(rest[-AXES:]), bool(is_last), style=style)


def read_limit_request(data: bytes) -> LimitRequest:
    """Read a request for the limits of an axis.

    Raises:
        FanucError: it is none.
    """
    require_size(data, _ASKED, "LIMITS")
    kind, version, axis, limit = _ASKED.unpack(data)
    if kind != ClassicKind.LIMITS or limit not in list(LimitKind) or not 1 <= axis <= AXES:
        raise FanucError(f"LIMITS packet: type {kind}, axis {axis}, limit {limit}")
    return LimitRequest(version, axis, LimitKind(limit))


def write_limits(
    request: LimitRequest, fastest_mm_s: int, check_ms: int, values: Sequence[float]
) -> bytes:
    """Write an axis' table, the same with and without payload.

    Args:
        fastest_mm_s: greatest speed of the tcp [mm/s].
        check_ms: period of the check [ms].
        values: ``LIMITS`` limits by speed of the tcp [deg and s].

    Raises:
        FanucError: a value is out of range.
    """
    return packed(
        _TABLE,
        "LIMITS",
        ClassicKind.LIMITS,
        request.version,
        request.axis,
        request.kind,
        fastest_mm_s,
        check_ms,
        *values,
        *values,
    )
