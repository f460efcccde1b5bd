"""Packets of FANUC Stream Motion: big-endian, without padding.

Source: FANUC-CORPORATION/fanuc_driver, ``stream_motion/packets.hpp`` (Apache-2.0), as described by
the PyPI package airo-fanuc 0.1.0.

Invariants:
    Any bytes give a packet or FanucError; any packet gives bytes or FanucError.
    Values are those of the wire: degrees, and millimetres of a linear axis.
    A command is written with ``JOINT_STYLE`` alone. Style 0 would be read as a Cartesian pose.
"""

import math
import struct
from enum import IntEnum
from typing import Final

from msgspec import Struct

from linemate.protocol.controller_link import ControllerError

AXES: Final = 9
IO_BYTES: Final = 256
JOINT_STYLE: Final = 0xFFFF

Axes9 = tuple[float, ...]
"""Nine values of the wire [deg, mm]."""

_COMMON = struct.Struct(">II")
_SEQUENCE = struct.Struct(">I")
_CAPABILITY = struct.Struct(">7I")
_COMMAND = struct.Struct(f">IIIBBH{AXES}d{IO_BYTES}s")
_HEAD = f">IIIBBBBI{AXES}f{AXES}f{AXES}ff"
_STATUS = {3: struct.Struct(f"{_HEAD}{IO_BYTES}s"), 4: struct.Struct(f"{_HEAD}6fI{IO_BYTES}s")}
NO_IO: Final = bytes(IO_BYTES)


class PacketKind(IntEnum):
    """First word of a packet."""

    STOP = 2
    CAPABILITY = 7
    START = 200
    COMMAND = 201
    STATUS_V3 = 202
    STATUS_V4 = 204


VERSION_OF: Final = {PacketKind.STATUS_V3: 3, PacketKind.STATUS_V4: 4}
_KIND_OF = {3: PacketKind.STATUS_V3, 4: PacketKind.STATUS_V4}
STATUS_SIZES: Final = {_KIND_OF[version]: layout.size for version, layout in _STATUS.items()}


class FanucError(ControllerError):
    """Bytes that are no packet, or a value that a packet cannot carry.

    Attributes:
        sequence: number of the status packet, None if it could not be read.
    """

    def __init__(self, what: str, sequence: int | None = None) -> None:
        super().__init__(what)
        self.sequence = sequence

    @property
    def counter(self) -> tuple[int, bytes] | None:
        """The packet's number and its bytes, if it could be read."""
        return None if self.sequence is None else (self.sequence, echo(self.sequence))


class StatusPacket(Struct, frozen=True):
    """What the controller sends each cycle.

    Attributes:
        motion_bits: bit 0 the controller takes commands, bit 3 the robot moves.
        fault_bits: bit 0 error, bit 1 teach pendant enabled, bit 2 emergency stop.
        contact_stop: state of a collaborative robot's contact stop.
        time_ms: the controller's clock [ms].
        pose: x, y, z [mm], w, p, r [deg], external axes.
        joints: J1..J9 [deg], linear axes [mm].
        safety_scale: share of the speed that a safety function leaves.
        wrench: force [N] and torque [Nm], None in version 3.
        force_sensor: type of the force sensor, None in version 3.
    """

    version: int
    sequence: int
    motion_bits: int
    fault_bits: int
    joints: Axes9
    pose: Axes9 = (0.0,) * AXES
    current: Axes9 = (0.0,) * AXES
    time_ms: int = 0
    contact_stop: int = 0
    safety_scale: float = 1.0
    wrench: tuple[float, ...] | None = None
    force_sensor: int | None = None
    io: bytes = NO_IO


class CommandPacket(Struct, frozen=True):
    """What the daemon answers.

    Attributes:
        sequence: of the status packet that it answers.
        joints: J1..J9 [deg], linear axes [mm].
        is_last: the stream ends with it.
        moves: False for inputs and outputs alone.
        style: ``JOINT_STYLE``; anything else is not written by ``write_command``.
    """

    version: int
    sequence: int
    joints: Axes9
    is_last: bool = False
    moves: bool = True
    style: int = JOINT_STYLE
    io: bytes = NO_IO


class CapabilityPacket(Struct, frozen=True):
    """Request for the controller's capability, and its answer.

    Attributes:
        version: of the protocol that the sender speaks.
        sampling_rate_ms: period of the status packets [ms], 0 in a request.
        start_move: commands that the controller queues before it moves.
        available_version: version that the controller speaks, 0 in a request.
        uses_tcp: the pose is that of the tcp.
    """

    version: int
    sampling_rate_ms: int = 0
    start_move: int = 0
    available_version: int = 0
    uses_tcp: int = 0


def packed(layout: struct.Struct, name: str, *values: object) -> bytes:
    """Return the bytes of a packet.

    Raises:
        FanucError: a value that the wire cannot carry.
    """
    try:
        return layout.pack(*values)
    except (struct.error, OverflowError) as error:
        raise FanucError(f"{name} packet: {error}") from error


def require_size(data: bytes, layout: struct.Struct, name: str) -> None:
    """Refuse a packet of another size.

    Raises:
        FanucError: it has another size.
    """
    if len(data) != layout.size:
        raise FanucError(f"{name} packet: {len(data)} bytes, not {layout.size}")


def require_joints(packet: CommandPacket) -> None:
    """Refuse a command that is not one of finite joints.

    Raises:
        FanucError: another style, or a joint that is not finite.
    """
    if packet.style != JOINT_STYLE:
        raise FanucError(f"data style {packet.style:#06x}: only {JOINT_STYLE:#06x} (joints)")
    if not all(map(math.isfinite, packet.joints)):
        raise FanucError("a commanded joint is not finite")


def echo(sequence: int) -> bytes:
    """Return a sequence number as it stands in a packet."""
    return _SEQUENCE.pack(sequence & 0xFFFFFFFF)


def kind_of(data: bytes) -> int | None:
    """Return the first word of a packet, None if there is none."""
    return None if len(data) < _COMMON.size else int(_COMMON.unpack_from(data)[0])


def write_short(kind: PacketKind, version: int) -> bytes:
    """Write a packet of kind and version alone: START or STOP."""
    return _COMMON.pack(kind, version)


def read_short(data: bytes, kind: PacketKind) -> int:
    """Return the version in a START or STOP packet.

    Raises:
        FanucError: it is none.
    """
    require_size(data, _COMMON, kind.name)
    sent_kind, version = _COMMON.unpack(data)
    if sent_kind != kind:
        raise FanucError(f"packet type {sent_kind}, not {kind.value} ({kind.name})")
    return int(version)


def write_capability(packet: CapabilityPacket) -> bytes:
    """Write a request or its answer.

    Raises:
        FanucError: a value is out of range.
    """
    return packed(
        _CAPABILITY,
        "CAPABILITY",
        PacketKind.CAPABILITY,
        packet.version,
        1,
        packet.sampling_rate_ms,
        packet.start_move,
        packet.available_version,
        packet.uses_tcp,
    )


def read_capability(data: bytes) -> CapabilityPacket:
    """Read a request or its answer.

    Raises:
        FanucError: it is none.
    """
    require_size(data, _CAPABILITY, "CAPABILITY")
    kind, version, _, rate, start, available, uses_tcp = _CAPABILITY.unpack(data)
    if kind != PacketKind.CAPABILITY:
        raise FanucError(f"packet type {kind}, not {PacketKind.CAPABILITY.value} (CAPABILITY)")
    return CapabilityPacket(version, rate, start, available, uses_tcp)


def read_status(data: bytes) -> StatusPacket:
    """Read a status packet of version 3 or 4.

    Raises:
        FanucError: it is none, or a joint is not finite.
    """
    kind = kind_of(data)
    version = VERSION_OF.get(PacketKind(kind)) if kind in STATUS_SIZES else None
    if version is None:
        raise FanucError(f"no status packet: type {kind}, {len(data)} bytes")
    layout = _STATUS[version]
    if len(data) != layout.size:
        raise FanucError(f"status packet of type {kind}: {len(data)} bytes, not {layout.size}")
    values = layout.unpack(data)
    written, sequence = values[1], values[2]
    if written != version:
        raise FanucError(f"version {written} in a packet of type {kind}, not {version}", sequence)
    joints = values[8 + AXES : 8 + 2 * AXES]
    if not all(map(math.isfinite, joints)):
        raise FanucError("a joint is not finite", sequence)
    rest = values[8 + 3 * AXES :]
    return StatusPacket(
        version,
        sequence,
        values[3],
        values[4],
        joints,
        values[8 : 8 + AXES],
        values[8 + 2 * AXES : 8 + 3 * AXES],
        values[7],
        values[5],
        rest[0],
        tuple(rest[1:7]) if version > 3 else None,
        rest[7] if version > 3 else None,
        rest[-1],
    )


def write_status(packet: StatusPacket) -> bytes:
    """Write a status packet.

    Raises:
        FanucError: a version that there is not, a value that is out of range.
    """
    layout = _STATUS.get(packet.version)
    if layout is None:
        raise FanucError(f"version {packet.version}: there are 3 and 4")
    force = (*(packet.wrench or (0.0,) * 6), packet.force_sensor or 0)
    return packed(
        layout,
        "status",
        _KIND_OF[packet.version],
        packet.version,
        packet.sequence,
        packet.motion_bits,
        packet.fault_bits,
        packet.contact_stop,
        0,
        packet.time_ms,
        *packet.pose,
        *packet.joints,
        *packet.current,
        packet.safety_scale,
        *(force if packet.version > 3 else ()),
        packet.io,
    )


def write_command(packet: CommandPacket) -> bytes:
    """Write a command of joints.

    Raises:
        FanucError: another style, a joint that is not finite, a value that is out of range.
    """
    require_joints(packet)
    return packed(
        _COMMAND,
        "COMMAND",
        PacketKind.COMMAND,
        packet.version,
        packet.sequence,
        packet.is_last,
        packet.moves,
        packet.style,
        *packet.joints,
        packet.io,
    )


def read_command(data: bytes) -> CommandPacket:
    """Read a command; its style, its flags and its values are for the controller to judge.

    Raises:
        FanucError: it is none.
    """
    require_size(data, _COMMAND, "COMMAND")
    kind, version, sequence, is_last, moves, style, *rest = _COMMAND.unpack(data)
    if kind != PacketKind.COMMAND:
        raise FanucError(f"packet type {kind}, not {PacketKind.COMMAND.value} (COMMAND)")
    return CommandPacket(
        version, sequence, tuple(rest[:AXES]), bool(is_last), bool(moves), style, rest[-1]
    )
