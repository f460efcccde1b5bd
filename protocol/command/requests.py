"""Requests of the command protocol: operations, their parameters and who may send them.

Invariants:
    A payload is decoded into a typed message or refused with CommandError.
    Both ends use the same types: the client sends nothing that the server cannot decode.
    ``conversation`` decides whether an operation may be executed now.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeAlias

import msgspec
from msgspec import UNSET, Meta, Raw, Struct, UnsetType

from linemate.protocol.command.frame_codec import MAX_PAGES, PAYLOAD_BYTES, CommandError, Role
from linemate.protocol.command.payloads import pack

Name: TypeAlias = Annotated[str, Meta(min_length=1, max_length=96)]
Scalar: TypeAlias = bool | int | float | Annotated[str, Meta(max_length=512)] | None
# Values of a parameter.
Value: TypeAlias = Scalar | Annotated[list[bool | int | float | str], Meta(max_length=64)]


class Empty(Struct, frozen=True, forbid_unknown_fields=True):
    """No parameters."""


class ParamsOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``params``: descriptions of all, or of names with a prefix."""

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
    """Parameters of ``subscribe``: 0 Hz ends it; it must be renewed before its end."""

    rate_hz: Annotated[float, Meta(ge=0.0, le=50.0)]
    duration_s: Annotated[float, Meta(gt=0.0, le=30.0)] | UnsetType = UNSET


class AnnounceOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``announce``: a part, and the distance sensor's reading as it was announced.

    Without ``distance`` the newest reading counts.
    """

    part: Annotated[str, Meta(min_length=1, max_length=64)]
    variant: Annotated[str, Meta(min_length=1, max_length=32)]
    distance: float | UnsetType = UNSET


class SkipOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``skip``: the part that is let go, or the next one."""

    part: Annotated[str, Meta(min_length=1, max_length=64)] | UnsetType = UNSET


PoseRow: TypeAlias = Annotated[list[float], Meta(min_length=8, max_length=8)]


class FollowOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``follow``: target poses of the tcp with times.

    ``begin_ns`` is on the daemon's monotonic clock. A row is the time from there [s], the position
    in base [m], and the unit quaternion, w first. Without rows the daemon answers its time.
    """

    begin_ns: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    poses: Annotated[list[PoseRow], Meta(max_length=12)]


class PageOf(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of ``page``: a further part of a long answer."""

    of: Annotated[int, Meta(ge=1, le=2**63 - 1)]
    page: Annotated[int, Meta(ge=1, lt=MAX_PAGES)]


class OperationRule(NamedTuple):
    """Parameters of an operation and conditions of its execution.

    Attributes:
        lease: needs the control lease.
        ordered: refused after a later operate request of the same session was executed.
    """

    params: type[Struct]
    role: Role
    lease: bool = False
    ordered: bool = False


OPERATIONS: Final[Mapping[str, OperationRule]] = {
    "status": OperationRule(Empty, Role.VIEW),
    "params": OperationRule(ParamsOf, Role.VIEW),
    "get": OperationRule(GetOf, Role.VIEW),
    "scene": OperationRule(Empty, Role.VIEW),
    "sensors": OperationRule(Empty, Role.VIEW),
    "subscribe": OperationRule(SubscribeOf, Role.VIEW),
    "page": OperationRule(PageOf, Role.VIEW),
    "set": OperationRule(SetOf, Role.OPERATE, ordered=True),
    "save": OperationRule(Empty, Role.OPERATE, ordered=True),
    "record": OperationRule(RecordOf, Role.OPERATE, ordered=True),
    "arm": OperationRule(Empty, Role.OPERATE, lease=True, ordered=True),
    "start": OperationRule(Empty, Role.OPERATE, lease=True, ordered=True),
    "ack": OperationRule(Empty, Role.OPERATE, lease=True, ordered=True),
    "home": OperationRule(Empty, Role.OPERATE, lease=True, ordered=True),
    "follow": OperationRule(FollowOf, Role.OPERATE, lease=True, ordered=True),
    "queue": OperationRule(Empty, Role.VIEW),
    "announce": OperationRule(AnnounceOf, Role.OPERATE, ordered=True),
    "skip": OperationRule(SkipOf, Role.OPERATE, ordered=True),
    "next": OperationRule(Empty, Role.OPERATE, lease=True, ordered=True),
    "hold": OperationRule(Empty, Role.OPERATE),
    # An operator can always stop the robot, in any order.
    "stop": OperationRule(Empty, Role.OPERATE),
    "retreat": OperationRule(Empty, Role.OPERATE),
}


class Request(NamedTuple):
    """A decoded request.

    Attributes:
        deadline_ms: on the server's clock; not executed after it.
    """

    op: str
    deadline_ms: int
    params: dict[str, Any]


class _RequestWire(Struct, frozen=True, forbid_unknown_fields=True):
    op: Annotated[str, Meta(max_length=16)]
    t: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    p: Raw | UnsetType = UNSET


_REQUEST: Final = msgspec.msgpack.Decoder(_RequestWire)
_SET: Final = msgspec.msgpack.Decoder(dict[Name, Value])
_PARAMS: Final = {op: msgspec.msgpack.Decoder(rule.params) for op, rule in OPERATIONS.items()}
_EMPTY_MAP: Final = b"\x80"


def _decode(decoder: msgspec.msgpack.Decoder[Any], data: bytes | Raw) -> Any:
    # msgspec raises RecursionError for deep input and UnicodeDecodeError for wrong text.
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise CommandError("malformed", str(error)) from error


def _entries(data: bytes) -> int:
    """Return the number of entries in the header of a msgpack map."""
    head = data[0]
    if head & 0xF0 == 0x80:
        return head & 0x0F
    width = {0xDE: 2, 0xDF: 4}.get(head, 0)
    return int.from_bytes(data[1 : 1 + width], "big")


def _refuse_duplicates(data: bytes, message: Struct) -> None:
    """Refuse a map with a key twice; decoders keep the last one."""
    present = sum(getattr(message, name) is not UNSET for name in message.__struct_fields__)
    if _entries(data) != present:
        raise CommandError("malformed", "a key stands twice")


def _refuse_non_finite(value: object) -> None:
    items = value if isinstance(value, list) else [value]
    for item in items:
        if isinstance(item, list):
            _refuse_non_finite(item)
        if isinstance(item, float) and not math.isfinite(item):
            raise CommandError("malformed", f"{item} is not a finite number")


def encode_request(op: str, params: Mapping[str, Any], deadline_ms: int) -> bytes:
    """Return the payload of a request.

    Args:
        deadline_ms: deadline on the server's clock [ms].

    Raises:
        CommandError: unknown operation or parameters, or too long.
    """
    if op not in OPERATIONS:
        raise CommandError("unknown", f"no operation {op!r}")
    _read_params(op, pack(dict(params)))
    wire: dict[str, Any] = {"op": op, "t": max(0, deadline_ms)}
    if params:
        wire["p"] = dict(params)
    payload = pack(wire)
    if len(payload) > PAYLOAD_BYTES:
        raise CommandError("too_long", f"request of {len(payload)} bytes, at most {PAYLOAD_BYTES}")
    return payload


def decode_request(payload: bytes) -> Request:
    """Read the payload of an authenticated request.

    Raises:
        CommandError: not one map of the request's fields, a number that is not finite, a key
            twice, unknown operation or parameters.
    """
    wire: _RequestWire = _decode(_REQUEST, payload)
    _refuse_duplicates(payload, wire)
    if wire.op not in OPERATIONS:
        raise CommandError("unknown", f"no operation {wire.op!r}")
    packed = _EMPTY_MAP if isinstance(wire.p, UnsetType) else bytes(wire.p)
    return Request(wire.op, wire.t, _read_params(wire.op, packed))


def _read_params(op: str, packed: bytes) -> dict[str, Any]:
    message: Struct = _decode(_PARAMS[op], packed)
    _refuse_duplicates(packed, message)
    params = {
        name: value
        for name in message.__struct_fields__
        if (value := getattr(message, name)) is not UNSET
    }
    if isinstance(message, SetOf):
        params["values"] = _read_values(bytes(message.values))
    for value in params.values():
        _refuse_non_finite(value)
    return params


def _read_values(packed: bytes) -> dict[str, Any]:
    values: dict[str, Any] = _decode(_SET, packed)
    if not values or _entries(packed) != len(values):
        raise CommandError("malformed", "values: empty, or a name stands twice")
    for value in values.values():
        _refuse_non_finite(value)
    return values
