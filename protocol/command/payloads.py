"""Messages of the command protocol that need no schema: answers, results, telemetry.

Law of this file: any payload gives a value or CommandError. Written on msgpack alone: the
typed messages of requests take a quarter of what a status from the shell may last to
be loaded, and neither a request without parameters nor its answer has need of them.
"""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import msgpack

from linemate.protocol.command.frame_codec import MAX_PAGES, MAX_RESULT_BYTES, CommandError

BARE: Final = frozenset({"status", "scene", "save", "arm", "start", "ack", "stop", "retreat"})
"""The operations that take no parameters."""

MAX_TIME_MS: Final = 2**63 - 1


class Reply(NamedTuple):
    """An answer as it stands on the wire; what has its default is left out there.

    Attributes:
        t: the server's clock at the answer [ms].
        r: the result, msgpack; with ``n`` above 1 the part numbered ``i`` of its bytes.
        e: if refused, why, in one word for programs.
        why: the same for a person.
        i: number of this part, from 0.
        n: how many parts the result has.
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
_MOST: Final = {"r": MAX_RESULT_BYTES, "e": 32, "why": 900}
"""Bytes or characters that a field of a reply may have."""


def pack(value: object) -> bytes:
    """Return ``value`` as msgpack.

    Raises:
        CommandError: a type or a number that msgpack does not know, or too deep.
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
    """Return the payload of a request without parameters; see requests.

    Raises:
        CommandError: an operation that is unknown or takes parameters.
    """
    if op not in BARE:
        raise CommandError("unknown", f"no operation {op!r} without parameters")
    return pack({"op": op, "t": max(0, deadline_ms)})


def encode_reply(reply: Reply) -> bytes:
    """Return the payload of a reply."""
    said: dict[str, Any] = {"ok": reply.ok, "t": reply.t}
    for name in _OPTIONAL:
        value = getattr(reply, name)
        if value != getattr(_DEFAULTS, name):
            said[name] = value
    return pack(said)


def decode_reply(payload: bytes) -> Reply:
    """Read the payload of an authenticated reply.

    Raises:
        CommandError: not a reply.
    """
    said = _map(payload)
    if not {"ok", "t"} <= said.keys() <= set(Reply._fields):
        raise CommandError("malformed", f"the fields of a reply are not {sorted(said)}")
    reply = Reply(**said)
    for name, value in said.items():
        if type(value) is not type(getattr(_DEFAULTS, name)):
            raise CommandError("malformed", f"{name} of a reply: {type(value).__name__}")
        if name in _MOST and len(value) > _MOST[name]:
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
    """Return a result as bytes, to travel whole or in parts.

    Raises:
        CommandError: a type that msgpack does not know, or above MAX_RESULT_BYTES.
    """
    packed = pack(dict(result))
    if len(packed) > MAX_RESULT_BYTES:
        raise CommandError("too_long", f"result of {len(packed)} bytes")
    return packed


def decode_result(packed: bytes) -> dict[str, Any]:
    """Read a result that has come whole.

    Raises:
        CommandError: not a map with string keys.
    """
    return _map(packed) if packed else {}


def encode_event(now_ms: int, data: bytes) -> bytes:
    """Return the payload of one telemetry event.

    Args:
        now_ms: the server's clock [ms].
        data: a result, as encode_result made it, so that one serves all subscribers.
    """
    return b"\x82\xa1t" + pack(now_ms) + b"\xa1d" + data


def decode_event(payload: bytes) -> tuple[int, dict[str, Any]]:
    """Read a telemetry event: the server's clock [ms] and the data.

    Raises:
        CommandError: not an event.
    """
    said = _map(payload)
    data = said.get("d")
    if said.keys() != {"t", "d"} or type(data) is not dict:
        raise CommandError("malformed", "not an event")
    if any(type(name) is not str for name in data):
        raise CommandError("malformed", "an event's data have names")
    return _time(said["t"]), data
