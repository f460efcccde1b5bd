"""Frames and messages of the command protocol: the bytes, and what they mean.

Law of this file: a frame is cut by fixed offsets and its tag compared before one byte of
its payload is looked at; a payload is decoded into a typed message or refused. Any bytes
give a value or CommandError. No key material, no session, no time is kept here; those
live in command_keys, command_rules and command_session. `docs/command-protocol.md` is
the specification, with vectors made by another implementation of BLAKE2b.
"""

import math
import struct
from collections.abc import Mapping
from enum import IntEnum, StrEnum
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeAlias

import msgspec
from msgspec import UNSET, Meta, Raw, Struct, UnsetType

from linemate.protocol.errors import ProtocolError

MAGIC: Final = b"LM"
VERSION: Final = 1
HEADER: Final = struct.Struct(">2sBBHQQ")
TAG_BYTES: Final = 16
MAX_FRAME_BYTES: Final = 1200  # one datagram, never fragmented on an Ethernet
COOKIE_BYTES: Final = 16
HANDSHAKE_BYTES: Final = HEADER.size + COOKIE_BYTES + TAG_BYTES
ROOM_BYTES: Final = MAX_FRAME_BYTES - HEADER.size - TAG_BYTES
"""What is left for a payload in one authenticated frame."""

MAX_RESULT_BYTES: Final = 65536  # what one answer may hold in all its pages
PAGE_BYTES: Final = 1024
MAX_PAGES: Final = MAX_RESULT_BYTES // PAGE_BYTES
MAX_AHEAD_MS: Final = 5000  # a command that may wait longer is a command nobody watches


class CommandError(ProtocolError):
    """Bytes that the command protocol refuses, or a message that it cannot carry.

    Attributes:
        kind: short name of the reason, the name of its counter.
        detail: evidence for a person.
    """

    def __init__(self, kind: str, detail: str = "") -> None:
        super().__init__(f"{kind}: {detail}" if detail else kind)
        self.kind = kind
        self.detail = detail


class FrameType(IntEnum):
    """What a frame is for; the direction belongs to the type."""

    HELLO = 1  # client: I hold this key, give me a fresh cookie
    COOKIE = 2  # server: here it is, and my clock
    REQUEST = 3  # client
    REPLY = 4  # server, the sequence of its request
    EVENT = 5  # server, unasked after a subscription, a sequence of its own
    CLOSE = 6  # client: forget this session


class Role(StrEnum):
    """What the holder of a key may do."""

    VIEW = "view"
    OPERATE = "operate"


class Frame(NamedTuple):
    """A frame cut at its offsets, not yet authenticated.

    Attributes:
        type: what it is for.
        key_id: id of the key it claims.
        session: the client's random number, 64 bit.
        sequence: 64 bit; a COOKIE carries the server's clock here [ms].
        body: header and payload, what the tag is over.
        payload: as on the wire.
        tag: 16 bytes; empty on a local socket.
    """

    type: FrameType
    key_id: int
    session: int
    sequence: int
    body: bytes
    payload: bytes
    tag: bytes


class Tagger:
    """Keyed BLAKE2b-128 over a frame's body, with its key schedule done once."""

    __slots__ = ("_is_same", "_prepared")

    def __init__(self, key: bytes, person: bytes = b"") -> None:
        # Loaded with the first key: the local socket has none, and a status shall cost little.
        import hashlib
        import hmac

        self._is_same = hmac.compare_digest
        self._prepared = hashlib.blake2b(key=key, digest_size=TAG_BYTES, person=person)

    def tag(self, body: bytes) -> bytes:
        """Return the 16-byte tag of ``body``."""
        digest = self._prepared.copy()
        digest.update(body)
        return digest.digest()

    def seal(self, body: bytes) -> bytes:
        """Return ``body`` with its tag behind it."""
        return body + self.tag(body)

    def genuine(self, frame: Frame) -> bool:
        """Tell in constant time whether ``frame`` was sealed with this key."""
        return self._is_same(self.tag(frame.body), frame.tag)


def frame_body(
    kind: FrameType, key_id: int, session: int, sequence: int, payload: bytes = b""
) -> bytes:
    """Return header and payload, what a tag is computed over.

    Raises:
        CommandError: the payload does not fit a frame, or a number its field.
    """
    if len(payload) > ROOM_BYTES:
        raise CommandError("too_long", f"payload of {len(payload)} bytes, room for {ROOM_BYTES}")
    return local_body(kind, key_id, session, sequence, payload)


def local_body(
    kind: FrameType, key_id: int, session: int, sequence: int, payload: bytes = b""
) -> bytes:
    """Return a message of the local socket: the same header, no tag, no limit but its own.

    Raises:
        CommandError: a number does not fit its field.
    """
    try:
        return HEADER.pack(MAGIC, VERSION, kind, key_id, session, sequence) + payload
    except struct.error as error:
        raise CommandError("header", str(error)) from error


def cut_frame(data: bytes) -> Frame:
    """Cut a datagram into a frame. Looks at the header alone.

    Raises:
        CommandError: length, magic, version or type.
    """
    if not HEADER.size + TAG_BYTES <= len(data) <= MAX_FRAME_BYTES:
        raise CommandError("length", f"{len(data)} bytes")
    body = data[:-TAG_BYTES]
    return _cut(body, data[-TAG_BYTES:])


def cut_local(data: bytes, limit: int = MAX_FRAME_BYTES) -> Frame:
    """Cut a message of the local socket, which has no tag.

    Raises:
        CommandError: length, magic, version or type.
    """
    if not HEADER.size <= len(data) <= limit:
        raise CommandError("length", f"{len(data)} bytes")
    return _cut(data, b"")


def _cut(body: bytes, tag: bytes) -> Frame:
    magic, version, kind, key_id, session, sequence = HEADER.unpack_from(body)
    if magic != MAGIC:
        raise CommandError("magic", magic.hex())
    if version != VERSION:
        raise CommandError("version", str(version))
    if kind not in _TYPES:
        raise CommandError("type", str(kind))
    return Frame(_TYPES[kind], key_id, session, sequence, body, body[HEADER.size :], tag)


_TYPES: Final = {int(kind): kind for kind in FrameType}


# --- messages -----------------------------------------------------------------------------

Name: TypeAlias = Annotated[str, Meta(min_length=1, max_length=96)]
Scalar: TypeAlias = bool | int | float | Annotated[str, Meta(max_length=512)] | None
Value: TypeAlias = Scalar | Annotated[list[bool | int | float | str], Meta(max_length=64)]
"""What a parameter can be set to."""


class Empty(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of an operation that takes none."""


class ParamsOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``params``: descriptions, all or those whose names begin so."""

    prefix: Annotated[str, Meta(max_length=96)] | UnsetType = UNSET


class GetOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``get``."""

    names: Annotated[list[Name], Meta(min_length=1, max_length=32)]


class SetOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``set``: all of them or none."""

    values: Raw


class RecordOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``record``."""

    action: Literal["start", "stop"]


class SubscribeOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``subscribe``: 0 Hz ends it; it ends by itself unless renewed."""

    rate_hz: Annotated[float, Meta(ge=0.0, le=50.0)]
    duration_s: Annotated[float, Meta(gt=0.0, le=30.0)] | UnsetType = UNSET


class PageOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``page``: a further part of an answer that did not fit."""

    of: Annotated[int, Meta(ge=1, le=2**63 - 1)]
    page: Annotated[int, Meta(ge=1, lt=MAX_PAGES)]


class Rule(NamedTuple):
    """What an operation takes and what its sender must be.

    Attributes:
        params: type of its parameters.
        role: the least role.
        lease: needs the control lease.
        ordered: refused once a later operate request of the same session was carried out.
    """

    params: type[Struct]
    role: Role
    lease: bool = False
    ordered: bool = False


OPERATIONS: Final[Mapping[str, Rule]] = {
    "status": Rule(Empty, Role.VIEW),
    "params": Rule(ParamsOf, Role.VIEW),
    "get": Rule(GetOf, Role.VIEW),
    "scene": Rule(Empty, Role.VIEW),
    "subscribe": Rule(SubscribeOf, Role.VIEW),
    "page": Rule(PageOf, Role.VIEW),
    "set": Rule(SetOf, Role.OPERATE, ordered=True),
    "save": Rule(Empty, Role.OPERATE, ordered=True),
    "record": Rule(RecordOf, Role.OPERATE, ordered=True),
    "arm": Rule(Empty, Role.OPERATE, lease=True, ordered=True),
    "start": Rule(Empty, Role.OPERATE, lease=True, ordered=True),
    "ack": Rule(Empty, Role.OPERATE, lease=True, ordered=True),
    # Whoever may operate may always bring the robot to rest, in any order.
    "stop": Rule(Empty, Role.OPERATE),
    "retreat": Rule(Empty, Role.OPERATE),
}


class Request(NamedTuple):
    """A request that was understood, not yet judged.

    Attributes:
        op: one of OPERATIONS.
        deadline_ms: on the server's clock; never carried out after it.
        params: checked, plain types.
    """

    op: str
    deadline_ms: int
    params: dict[str, Any]


class _RequestWire(Struct, frozen=True, forbid_unknown_fields=True):
    op: Annotated[str, Meta(max_length=16)]
    t: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    p: Raw | UnsetType = UNSET


class Reply(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """An answer as it stands on the wire.

    Attributes:
        ok: carried out.
        t: the server's clock at the answer [ms].
        r: the result, msgpack; with ``n`` above 1 the part numbered ``i`` of its bytes.
        e: if refused, why, in one word for programs.
        why: the same for a person.
        i: number of this part, from 0.
        n: how many parts the result has.
    """

    ok: bool
    t: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    r: Annotated[bytes, Meta(max_length=MAX_RESULT_BYTES)] = b""
    e: Annotated[str, Meta(max_length=32)] = ""
    why: Annotated[str, Meta(max_length=900)] = ""
    i: Annotated[int, Meta(ge=0, lt=MAX_PAGES)] = 0
    n: Annotated[int, Meta(ge=1, le=MAX_PAGES)] = 1


class _EventWire(Struct, frozen=True, forbid_unknown_fields=True):
    t: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    d: dict[str, Any]


_REQUEST: Final = msgspec.msgpack.Decoder(_RequestWire)
_SET: Final = msgspec.msgpack.Decoder(dict[Name, Value])
_PARAMS: Final = {op: msgspec.msgpack.Decoder(rule.params) for op, rule in OPERATIONS.items()}
_REPLY: Final = msgspec.msgpack.Decoder(Reply)
_EVENT: Final = msgspec.msgpack.Decoder(_EventWire)
_RESULT: Final = msgspec.msgpack.Decoder(dict[str, Any])
_ENCODER: Final = msgspec.msgpack.Encoder()
_EMPTY_MAP: Final = b"\x80"


def _decode(decoder: msgspec.msgpack.Decoder[Any], data: bytes | Raw) -> Any:
    # RecursionError and UnicodeDecodeError are msgspec's for deep and for ill-spelt input.
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise CommandError("malformed", str(error)) from error


def _encode(value: object) -> bytes:
    try:
        return _ENCODER.encode(value)
    except (TypeError, ValueError, OverflowError, RecursionError, msgspec.MsgspecError) as error:
        raise CommandError("unencodable", str(error)) from error


def _entries(data: bytes) -> int:
    """Return how many entries the msgpack map at the head of ``data`` says it has."""
    head = data[0]
    if head & 0xF0 == 0x80:
        return head & 0x0F
    width = {0xDE: 2, 0xDF: 4}.get(head, 0)
    return int.from_bytes(data[1 : 1 + width], "big")


def _once_each(data: bytes, message: Struct) -> None:
    """Refuse a map in which a key stands twice; decoders keep the last silently."""
    present = sum(getattr(message, name) is not UNSET for name in message.__struct_fields__)
    if _entries(data) != present:
        raise CommandError("malformed", "a key stands twice")


def _finite(value: object) -> None:
    items = value if isinstance(value, list) else [value]
    for item in items:
        if isinstance(item, float) and not math.isfinite(item):
            raise CommandError("malformed", f"{item} is not a finite number")


def encode_request(op: str, params: Mapping[str, Any], deadline_ms: int) -> bytes:
    """Return the payload of a request.

    Args:
        op: one of OPERATIONS.
        params: its parameters.
        deadline_ms: on the server's clock [ms].

    Raises:
        CommandError: unknown operation, parameters it does not take, or too long.
    """
    if op not in OPERATIONS:
        raise CommandError("unknown", f"no operation {op!r}")
    packed = _encode(dict(params))
    _read_params(op, packed)
    wire: dict[str, Any] = {"op": op, "t": max(0, deadline_ms)}
    if params:
        wire["p"] = Raw(packed)
    payload = _encode(wire)
    if len(payload) > ROOM_BYTES:
        raise CommandError("too_long", f"request of {len(payload)} bytes, room for {ROOM_BYTES}")
    return payload


def decode_request(payload: bytes) -> Request:
    """Read the payload of an authenticated request.

    Raises:
        CommandError: not one map of the request's fields, a number that is not finite, a
            key that stands twice, an operation unknown, or parameters it does not take.
    """
    wire: _RequestWire = _decode(_REQUEST, payload)
    _once_each(payload, wire)
    if wire.op not in OPERATIONS:
        raise CommandError("unknown", f"no operation {wire.op!r}")
    packed = _EMPTY_MAP if isinstance(wire.p, UnsetType) else bytes(wire.p)
    return Request(wire.op, wire.t, _read_params(wire.op, packed))


def _read_params(op: str, packed: bytes) -> dict[str, Any]:
    message: Struct = _decode(_PARAMS[op], packed)
    _once_each(packed, message)
    params = {
        name: value
        for name in message.__struct_fields__
        if (value := getattr(message, name)) is not UNSET
    }
    if isinstance(message, SetOf):
        params["values"] = _read_values(bytes(message.values))
    for value in params.values():
        _finite(value)
    return params


def _read_values(packed: bytes) -> dict[str, Any]:
    values: dict[str, Any] = _decode(_SET, packed)
    if not values or _entries(packed) != len(values):
        raise CommandError("malformed", "values: empty, or a name stands twice")
    for value in values.values():
        _finite(value)
    return values


def encode_reply(reply: Reply) -> bytes:
    """Return the payload of a reply."""
    return _encode(reply)


def decode_reply(payload: bytes) -> Reply:
    """Read the payload of an authenticated reply.

    Raises:
        CommandError: not a reply.
    """
    reply: Reply = _decode(_REPLY, payload)
    if reply.i >= reply.n:
        raise CommandError("malformed", f"part {reply.i} of {reply.n}")
    return reply


def encode_result(result: Mapping[str, Any]) -> bytes:
    """Return a result as bytes, to travel whole or in parts.

    Raises:
        CommandError: a type that msgpack does not know, or above MAX_RESULT_BYTES.
    """
    packed = _encode(dict(result))
    if len(packed) > MAX_RESULT_BYTES:
        raise CommandError("too_long", f"result of {len(packed)} bytes")
    return packed


def decode_result(packed: bytes) -> dict[str, Any]:
    """Read a result that has come whole.

    Raises:
        CommandError: not a map with string keys.
    """
    result: dict[str, Any] = _decode(_RESULT, packed) if packed else {}
    return result


def encode_event(now_ms: int, data: bytes) -> bytes:
    """Return the payload of one telemetry event.

    Args:
        now_ms: the server's clock [ms].
        data: a result, as encode_result made it, so that one serves all subscribers.
    """
    return _encode({"t": now_ms, "d": Raw(data)})


def decode_event(payload: bytes) -> tuple[int, dict[str, Any]]:
    """Read a telemetry event: the server's clock [ms] and the data.

    Raises:
        CommandError: not an event.
    """
    wire: _EventWire = _decode(_EVENT, payload)
    return wire.t, wire.d
