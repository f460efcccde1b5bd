"""Protobuf wire format: bounded reader and writer of single fields.

Invariants:
    Any bytes give fields or EgmError.
    A group, a field number 0 and bytes beyond the end are refused.

Reference: Protocol Buffers documentation, "Encoding".
"""

import struct
from collections.abc import Sequence

from linemate.protocol.controller_link import ControllerError

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5  # wire types; 3 and 4 are groups

MAX_VARINT_BYTES = 10
MAX_U64 = 2**64 - 1
MAX_FIELD_NUMBER = 2**29 - 1
MAX_FIELDS = 256  # in one message; EgmRobot has 14

_DOUBLE = struct.Struct("<d")
_FIXED_BYTES = {FIXED64: 8, FIXED32: 4}


class EgmError(ControllerError):
    """Bytes that are no EGM message, or a value that none can carry."""


WireField = tuple[int, int, int | bytes]
"""Number, wire type, and value: the number of a varint, else the field's bytes."""


def read_varint(data: bytes, at: int) -> tuple[int, int]:
    """Return an unsigned 64-bit number and the position after it.

    Raises:
        EgmError: cut short, longer than ten bytes, or beyond 64 bits.
    """
    if at < len(data) and data[at] < 0x80:
        return data[at], at + 1
    number = 0
    for n in range(MAX_VARINT_BYTES):
        if at + n >= len(data):
            raise EgmError(f"EGM varint cut short: {n} bytes. Check the sender.")
        byte = data[at + n]
        number |= (byte & 0x7F) << (7 * n)
        if byte < 0x80:
            if number > MAX_U64:
                raise EgmError(f"EGM varint too large: {number}, limit 64 bits. Check the sender.")
            return number, at + n + 1
    raise EgmError(f"EGM varint too long: limit {MAX_VARINT_BYTES} bytes. Check the sender.")


def read_fields(data: bytes) -> list[WireField]:
    """Return all fields of one message in their order, known or not.

    Raises:
        EgmError: bytes that are no message, or more than 256 fields.
    """
    fields: list[WireField] = []
    at, end = 0, len(data)
    while at < end:
        tag = data[at]
        if tag < 0x80:  # one byte, as all fields that EGM has: saves 1 us a field
            at += 1
        else:
            tag, at = read_varint(data, at)
        number, wire_type = tag >> 3, tag & 7
        if not 0 < number <= MAX_FIELD_NUMBER:
            raise EgmError(f"EGM field number out of range: {number}. Check the sender.")
        if wire_type == VARINT:
            value, at = read_varint(data, at)
            fields.append((number, wire_type, value))
        else:
            length, at = _length(data, at, number, wire_type)
            stop = at + length
            if stop > end:
                raise EgmError(
                    f"EGM field {number} cut short: {end - at} bytes of {length}. Check the sender."
                )
            fields.append((number, wire_type, data[at:stop]))
            at = stop
        if len(fields) > MAX_FIELDS:
            raise EgmError(f"EGM message has over {MAX_FIELDS} fields. Check the sender.")
    return fields


def _length(data: bytes, at: int, number: int, wire_type: int) -> tuple[int, int]:
    if wire_type == LENGTH:
        if at < len(data) and data[at] < 0x80:
            return data[at], at + 1
        return read_varint(data, at)
    length = _FIXED_BYTES.get(wire_type)
    if length is None:
        raise EgmError(
            f"EGM field {number} has wire type {wire_type}: known are 0, 1, 2, 5. Check the sender."
        )
    return length, at


def varint(value: int) -> bytes:
    """Return an unsigned 64-bit number in its shortest form.

    Raises:
        EgmError: a negative number or one beyond 64 bits.
    """
    if not 0 <= value <= MAX_U64:
        raise EgmError(f"EGM number out of range: {value}, limit 0..2^64-1. Check the value.")
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def number_field(number: int, value: int) -> bytes:
    """Return a varint field: uint32, uint64, bool or enum."""
    return varint(number << 3 | VARINT) + varint(value)


def double_field(number: int, value: float) -> bytes:
    """Return a double field."""
    return varint(number << 3 | FIXED64) + _DOUBLE.pack(value)


def bytes_field(number: int, value: bytes) -> bytes:
    """Return a length-delimited field: an embedded message."""
    return varint(number << 3 | LENGTH) + varint(len(value)) + value


def doubles_field(number: int, values: Sequence[float]) -> bytes:
    """Return a repeated double, unpacked as protobuf 2 writes it."""
    tag = varint(number << 3 | FIXED64)
    return b"".join([tag + _DOUBLE.pack(value) for value in values])
