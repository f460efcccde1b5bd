"""Payloads of the command protocol that need no schema: replies, results, telemetry.

They use msgpack only. Loading the typed messages of ``requests`` takes a quarter of the time that
a status may take.

Invariants:
    Any payload gives a value or CommandError.
"""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import msgpack

from linemate.protocol.command.frame_codec import MAX_PAGES, MAX_RESULT_BYTES, CommandError

# Operations without parameters.
BARE: Final = frozenset(
    {"status", "scene", "sensors", "save", "arm", "start", "ack", "home", "stop", "retreat"}
    | {"queue", "next", "hold"}
)

MAX_TIME_MS: Final = 2**63 - 1


class Reply(NamedTuple):
    """Reply with the names of the wire; fields with their default are left out there.

    Attributes:
        t: the server's clock at the reply [ms].
        r: the result in msgpack; with ``n`` above 1 part ``i`` of its bytes.
        e: reason of a refusal, one word for programs.
        why: the same as a sentence for the operator.
        i: number of this part, from 0.
        n: number of parts of the result.
    """

    ok: bool
    t: int
    r: bytes = b""
    e: str = ""
    why: str = ""
    i: int = 0
    n: int = 1


_DEFAULTS: Final = Reply(ok=False, t=0)
_OPTIONAL: Final = Reply._fields[2:]
_MAX_LENGTH: Final = {"r": MAX_RESULT_BYTES, "e": 32, "why": 900}  # bytes or characters


def pack(value: object) -> bytes:
    """Return ``value`` as msgpack.

    Raises:
        CommandError: a type or number that msgpack does not have, or nested too deeply.
    """
    try:
        packed: bytes = msgpack.packb(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise CommandError("unencodable", str(error)) from error
    return packed


def _map(packed: bytes) -> dict[str, Any]:
    try:
        value = msgpack.unpackb(packed)
    except (msgpack.UnpackException, ValueError, RecursionError) as error:
        raise CommandError("malformed", str(error) or type(error).__name__) from error
    if type(value) is not dict or any(type(name) is not str for name in value):
        raise CommandError("malformed", "not a map with names")
    return value


def encode_bare(op: str, deadline_ms: int) -> bytes:
    """Return the payload of a request without parameters.

    Raises:
        CommandError: an operation that is unknown or takes parameters.
    """
    if op not in BARE:
        raise CommandError("unknown", f"no operation {op!r} without parameters")
    return pack({"op": op, "t": max(0, deadline_ms)})


def encode_reply(reply: Reply) -> bytes:
    """Return the payload of a reply."""
    fields: dict[str, Any] = {"ok": reply.ok, "t": reply.t}
    for name in _OPTIONAL:
        value = getattr(reply, name)
        if value != getattr(_DEFAULTS, name):
            fields[name] = value
    return pack(fields)


def decode_reply(payload: bytes) -> Reply:
    """Read the payload of an authenticated reply.

    Raises:
        CommandError: not a reply.
    """
    fields = _map(payload)
    if not {"ok", "t"} <= fields.keys() <= set(Reply._fields):
        raise CommandError("malformed", f"the fields of a reply are not {sorted(fields)}")
    reply = Reply(**fields)
    for name, value in fields.items():
        if type(value) is not type(getattr(_DEFAULTS, name)):
            raise CommandError("malformed", f"{name} of a reply: {type(value).__name__}")
        if name in _MAX_LENGTH and len(value) > _MAX_LENGTH[name]:
            raise CommandError("malformed", f"{name} of a reply: {len(value)} long")
    _time(reply.t)
    if not 0 <= reply.i < reply.n <= MAX_PAGES:
        raise CommandError("malformed", f"part {reply.i} of {reply.n}")
    return reply


def _time(value: object) -> int:
    if type(value) is int and 0 <= value <= MAX_TIME_MS:
        return value
    raise CommandError("malformed", f"t is {value!r:.80}")


def encode_result(result: Mapping[str, Any]) -> bytes:
    """Return a result as bytes, to be sent whole or in parts.

    Raises:
        CommandError: a type that msgpack does not have, or above MAX_RESULT_BYTES.
    """
    packed = pack(dict(result))
    if len(packed) > MAX_RESULT_BYTES:
        raise CommandError("too_long", f"result of {len(packed)} bytes")
    return packed


def decode_result(packed: bytes) -> dict[str, Any]:
    """Return a complete result.

    Raises:
        CommandError: not a map with string keys.
    """
    return _map(packed) if packed else {}


def encode_event(now_ms: int, data: bytes) -> bytes:
    """Return the payload of one telemetry event.

    Args:
        now_ms: time on the server's clock [ms].
        data: a result from encode_result, the same one for all subscribers.
    """
    return b"\x82\xa1t" + pack(now_ms) + b"\xa1d" + data


def decode_event(payload: bytes) -> tuple[int, dict[str, Any]]:
    """Return the server's clock [ms] and the data of a telemetry event.

    Raises:
        CommandError: not an event.
    """
    fields = _map(payload)
    data = fields.get("d")
    if fields.keys() != {"t", "d"} or type(data) is not dict:
        raise CommandError("malformed", "not an event")
    if any(type(name) is not str for name in data):
        raise CommandError("malformed", "an event's data have names")
    return _time(fields["t"]), data
