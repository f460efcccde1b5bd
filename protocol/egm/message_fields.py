"""Fields that EgmRobot and EgmSensor have in common, between wire and SI units.

Invariants:
    A known single field that stands twice is refused. Unknown fields are skipped.
    Numbers are finite and at most ``MAX_MAGNITUDE`` on the wire.
"""

import struct
from collections.abc import Iterable, Sequence
from enum import IntEnum
from itertools import starmap
from operator import mul
from typing import TypeVar, cast

from linemate.protocol.egm.messages import Axes, EgmPosition, MessageType
from linemate.protocol.egm.protobuf_wire import (
    FIXED64,
    LENGTH,
    MAX_U64,
    VARINT,
    EgmError,
    bytes_field,
    double_field,
    doubles_field,
    number_field,
    read_fields,
)
from linemate.protocol.stamped_samples import Vector3, Vector6
from linemate.protocol.units import DEG, MM

MAX_MESSAGE_BYTES = 2048  # EgmRobot with every field and six forces has about 600
MAX_U32 = 2**32 - 1
MAX_MAGNITUDE = 1e6  # of a position or speed on the wire [deg, mm, deg/s, mm/s, N, Nm]
MAX_CLOCK_S = 2**40
JOINTS, EXTERNAL_AXES = 6, 6

Enum = TypeVar("Enum", bound=IntEnum)
Fields = dict[int, int | bytes]
JOINT_SCALES = (DEG,) * JOINTS

_DOUBLE = struct.Struct("<d")
_SIX_DOUBLES = struct.Struct("<" + "Bd" * JOINTS)
_DOUBLES = {count: dict.fromkeys(range(1, count + 1), FIXED64) for count in (3, 4)}
_POSITION = {1: LENGTH, 2: LENGTH, 3: LENGTH, 4: LENGTH}
_POSE = {1: LENGTH, 2: LENGTH}
_NUMBERS = {1: VARINT, 2: VARINT, 3: VARINT}
_DOUBLE_TAG = 1 << 3 | FIXED64


def external_scales(linear_external: Iterable[str]) -> tuple[float, ...]:
    """Return the unit of each external axis E1..E6: one millimetre or one degree.

    Raises:
        EgmError: a name that is not E1..E6.
    """
    linear = set(linear_external)
    names = [f"E{n}" for n in range(1, EXTERNAL_AXES + 1)]
    if unknown := sorted(linear.difference(names)):
        raise EgmError(f"linear external axis unknown: {unknown[0]}. Name one of E1..E6.")
    return tuple(MM if name in linear else DEG for name in names)


def single_fields(data: bytes, name: str, kinds: dict[int, int]) -> Fields:
    """Return the values of known single fields by number.

    Args:
        kinds: wire type of each known field.

    Raises:
        EgmError: no message, a field twice, or one of another wire type.
    """
    out: Fields = {}
    for number, wire_type, value in read_fields(data):
        kind = kinds.get(number)
        if kind is None:
            continue
        if wire_type != kind:
            raise EgmError(
                f"{name} field {number} has wire type {wire_type}: expected {kind}. "
                "Check egm.proto of the controller's RobotWare."
            )
        if number in out:
            raise EgmError(f"{name} field {number} stands twice. Check the sender.")
        out[number] = value
    return out


def part(fields: Fields, number: int) -> bytes | None:
    """Return an embedded message, None if it is not there."""
    return cast(bytes | None, fields.get(number))


def whole(fields: Fields, number: int, name: str, limit: int = MAX_U32) -> int | None:
    """Return an unsigned number, None if it is not there.

    Raises:
        EgmError: beyond the limit.
    """
    value = cast(int | None, fields.get(number))
    if value is not None and value > limit:
        raise EgmError(f"{name} out of range: {value}, limit {limit}. Check the sender.")
    return value


def finite(value: float, name: str) -> float:
    """Return the value.

    Raises:
        EgmError: not finite, or beyond ``MAX_MAGNITUDE``.
    """
    if not -MAX_MAGNITUDE <= value <= MAX_MAGNITUDE:  # NaN compares false
        raise EgmError(f"{name} out of range: {value}, limit {MAX_MAGNITUDE:g}. Check the sender.")
    return value


def real(fields: Fields, number: int, name: str) -> float | None:
    """Return a double, None if it is not there.

    Raises:
        EgmError: not finite or out of range.
    """
    value = cast(bytes | None, fields.get(number))
    return None if value is None else finite(_DOUBLE.unpack(value)[0], name)


def enumerated(data: bytes | None, kind: type[Enum], name: str) -> Enum:
    """Return the state of a message that holds one enum; an unknown number is undefined.

    Raises:
        EgmError: no message, or one without its state.
    """
    if data is None:
        return kind(0)
    value = whole(single_fields(data, name, {1: VARINT}), 1, name, MAX_U64)
    if value is None:
        raise EgmError(f"{name} without its state. Check the sender.")
    return kind(value) if value in kind._value2member_map_ else kind(0)


def reals(data: bytes, name: str, number: int, limit: int) -> Axes:
    """Return a repeated double of one message, packed or not.

    Raises:
        EgmError: no message, another wire type, more values than the limit, or none finite.
    """
    out: list[float] = []
    for given, wire_type, value in read_fields(data):
        if given != number:
            continue
        if wire_type not in {FIXED64, LENGTH} or (wire_type == LENGTH and len(_raw(value)) % 8):
            raise EgmError(f"{name} is no list of doubles. Check the sender.")
        raw = _raw(value)
        out += struct.unpack(f"<{len(raw) // 8}d", raw)
        if len(out) > limit:
            raise EgmError(f"{name} has {len(out)} values: limit {limit}. Check the robot.")
    return tuple(finite(value, name) for value in out)


def _raw(value: int | bytes) -> bytes:
    return cast(bytes, value)


def scaled(values: Sequence[float], scales: Sequence[float]) -> Axes:
    """Return values on the wire in SI units; there may be fewer than scales."""
    return tuple(map(mul, values, scales))


def read_joints(data: bytes | None, name: str) -> Vector6 | None:
    """Return six joints [rad] or joint speeds [rad/s] from an EgmJoints message.

    Raises:
        EgmError: no message, or another number of values than six.
    """
    if data is None:
        return None
    values: Sequence[float]
    if len(data) == _SIX_DOUBLES.size and data[::9] == bytes((_DOUBLE_TAG,)) * JOINTS:
        values = _SIX_DOUBLES.unpack(data)[1::2]  # as every protobuf 2 writer puts it
        for value in values:
            finite(value, name)
    else:
        values = reals(data, name, 1, JOINTS)
        if len(values) != JOINTS:
            raise EgmError(
                f"{name} has {len(values)} values: {JOINTS} are needed. "
                "A seventh axis stands in externalJoints."
            )
    return cast(Vector6, scaled(values, JOINT_SCALES))


def read_external(data: bytes | None, name: str, scales: Sequence[float]) -> Axes:
    """Return external axes [rad, m] or their speeds from an EgmJoints message.

    Raises:
        EgmError: no message, or more than six values.
    """
    return () if data is None else scaled(reals(data, name, 1, EXTERNAL_AXES), scales)


def read_position(data: bytes | None, name: str, scales: Sequence[float]) -> EgmPosition:
    """Return an EgmFeedBack or EgmPlanned message.

    Raises:
        EgmError: no message, or a value that does not fit.
    """
    if data is None:
        return EgmPosition()
    fields = single_fields(data, name, _POSITION)
    position, quaternion = _read_pose(part(fields, 2), name)
    return EgmPosition(
        read_joints(part(fields, 1), f"{name}.joints"),
        read_external(part(fields, 3), f"{name}.externalJoints", scales),
        position,
        quaternion,
        _read_clock(part(fields, 4), name),
    )


def _read_pose(
    data: bytes | None, name: str
) -> tuple[Vector3 | None, tuple[float, float, float, float] | None]:
    """Return position [m] and quaternion; Euler angles are skipped."""
    if data is None:
        return None, None
    fields = single_fields(data, f"{name}.cartesian", _POSE)
    place = _read_required(part(fields, 1), f"{name}.cartesian.pos", 3)
    turn = _read_required(part(fields, 2), f"{name}.cartesian.orient", 4)
    position = None if place is None else (place[0] * MM, place[1] * MM, place[2] * MM)
    return position, None if turn is None else (turn[0], turn[1], turn[2], turn[3])


def _read_required(data: bytes | None, name: str, count: int) -> list[float] | None:
    """Return fields 1..count, all of them required doubles."""
    if data is None:
        return None
    fields = single_fields(data, name, _DOUBLES[count])
    values = [real(fields, n, name) for n in range(1, count + 1)]
    known = [value for value in values if value is not None]
    if len(known) != count:
        raise EgmError(f"{name} has {len(known)} values: {count} are needed. Check the sender.")
    return known


def _read_clock(data: bytes | None, name: str) -> int | None:
    if data is None:
        return None
    fields = single_fields(data, f"{name}.time", _NUMBERS)
    seconds = whole(fields, 1, f"{name}.time.sec", MAX_CLOCK_S)
    micros = whole(fields, 2, f"{name}.time.usec", MAX_U64)
    if seconds is None or micros is None:
        raise EgmError(f"{name}.time without sec or usec. Check the sender.")
    return seconds * 1_000_000 + micros


def read_header(data: bytes | None, name: str, expected: MessageType) -> tuple[int, int]:
    """Return sequence number and time stamp [ms] of a message of the expected type.

    Raises:
        EgmError: no header, no sequence number, or another type.
    """
    if data is None:
        raise EgmError(f"{name} without a header. Check that the sender speaks EGM.")
    fields = single_fields(data, f"{name}.header", _NUMBERS)
    sequence = whole(fields, 1, f"{name}.header.seqno")
    if sequence is None:
        raise EgmError(f"{name}.header without seqno. Check the sender.")
    kind = whole(fields, 3, f"{name}.header.mtype", MAX_U64) or 0
    if kind != expected:
        raise EgmError(
            f"{name}.header.mtype is {kind}: expected {expected.value} ({expected.name}). "
            "Check which end sends to this port."
        )
    return sequence, whole(fields, 2, f"{name}.header.tm") or 0


def write_header(sequence: int, time_ms: int, kind: MessageType) -> bytes:
    """Return field 1 of a message: its header.

    Raises:
        EgmError: a number beyond 32 bits.
    """
    for name, value in (("seqno", sequence), ("tm", time_ms)):
        if not 0 <= value <= MAX_U32:
            raise EgmError(f"header.{name} out of range: {value}, limit {MAX_U32}. Wrap it.")
    return bytes_field(
        1, number_field(1, sequence) + number_field(2, time_ms) + number_field(3, kind.value)
    )


def write_axes(number: int, values: Sequence[float], scales: Sequence[float], name: str) -> bytes:
    """Return an EgmJoints field in the wire's units, no bytes without values.

    Raises:
        EgmError: more values than axes, a value not finite or out of range.
    """
    if not values:
        return b""
    if len(values) > len(scales):
        raise EgmError(f"{name} has {len(values)} values: limit {len(scales)}. Check the axes.")
    wire = [finite(value / scale, name) for value, scale in zip(values, scales, strict=False)]
    return bytes_field(number, doubles_field(1, wire))


def write_position(number: int, position: EgmPosition, name: str, scales: Sequence[float]) -> bytes:
    """Return an EgmFeedBack or EgmPlanned field, no bytes if it is empty.

    Raises:
        EgmError: a value that the wire cannot carry.
    """
    body = write_axes(1, position.joints or (), JOINT_SCALES, f"{name}.joints")
    body += _write_pose(position, name)
    body += write_axes(3, position.external, scales, f"{name}.externalJoints")
    if position.clock_us is not None:
        seconds, micros = divmod(position.clock_us, 1_000_000)
        body += bytes_field(4, number_field(1, seconds) + number_field(2, micros))
    return bytes_field(number, body) if body else b""


def _write_pose(position: EgmPosition, name: str) -> bytes:
    if position.tcp_position is None or position.tcp_quaternion is None:
        return b""
    place = [finite(value / MM, f"{name}.cartesian") for value in position.tcp_position]
    turn = [finite(value, f"{name}.cartesian") for value in position.tcp_quaternion]
    pos, orient = (
        b"".join(starmap(double_field, enumerate(values, 1))) for values in (place, turn)
    )
    return bytes_field(2, bytes_field(1, pos) + bytes_field(2, orient))


def require_size(data: bytes) -> None:
    """Refuse a datagram that is empty or too long, before anything is read.

    Raises:
        EgmError: no bytes, or more than ``MAX_MESSAGE_BYTES``.
    """
    if not 0 < len(data) <= MAX_MESSAGE_BYTES:
        raise EgmError(
            f"EGM message has {len(data)} bytes: limit 1..{MAX_MESSAGE_BYTES}. Check the sender."
        )
