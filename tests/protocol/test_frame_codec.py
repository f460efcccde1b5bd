"""Frames and messages: the documented vectors, and what every other byte string gets."""

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import pytest
from command_ends import MS, World, client_address
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.protocol.command import frame_codec
from linemate.protocol.command.authenticated import CommandClient, CommandServer
from linemate.protocol.command.frame_codec import (
    CommandError,
    CommandFrame,
    FrameType,
    Role,
    cut_frame,
    cut_local,
    frame_body,
)
from linemate.protocol.command.payloads import (
    BARE,
    Reply,
    decode_event,
    decode_reply,
    decode_result,
    encode_bare,
    encode_reply,
    encode_result,
)
from linemate.protocol.command.preshared_keys import cookie, hello_tagger, make_key, session_keys
from linemate.protocol.command.requests import OPERATIONS, Empty, decode_request, encode_request

DOCUMENT = Path(__file__).parents[2] / "docs" / "command-protocol.md"


@pytest.fixture(scope="module")
def vectors() -> dict[str, bytes]:
    block = re.search(r"```vectors\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    assert block is not None
    # A line that begins with a space continues the one before.
    lines = [line.split() for line in re.sub(r"\n +", "", block[1]).splitlines()]
    return {name: bytes.fromhex(value) for name, value in lines}


@pytest.fixture(scope="module")
def meanings() -> dict[str, Any]:
    block = re.search(r"```json\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    assert block is not None
    meanings: dict[str, Any] = json.loads(block[1])
    return meanings


def refusal(call: Callable[..., object], *args: object) -> str | None:
    """The kind of the one error that ``call`` may raise, None if it raised nothing."""
    try:
        call(*args)
    except CommandError as error:
        return error.kind
    return None


# --- the documented vectors ---------------------------------------------------------------


def test_the_documented_keys_are_derived_alike(vectors: dict[str, bytes]) -> None:
    key = make_key("v", Role.OPERATE, vectors["psk"])
    session = int.from_bytes(vectors["session"], "big")
    assert key.id == int.from_bytes(vectors["id"], "big")
    assert cookie(vectors["secret"], key.id, session) == vectors["proof"]
    keys = session_keys(key, session, vectors["proof"])
    assert keys.to_server.is_genuine(cut_frame(vectors["arm"]))
    assert keys.to_server.is_genuine(cut_frame(vectors["close"]))
    assert keys.to_client.is_genuine(cut_frame(vectors["armed"]))
    assert not keys.to_client.is_genuine(cut_frame(vectors["arm"]))
    assert hello_tagger(key).is_genuine(cut_frame(vectors["hello"]))


def test_the_documented_session_runs_on_the_server(vectors: dict[str, bytes]) -> None:
    key = make_key("v", Role.OPERATE, vectors["psk"])
    server = CommandServer([key], lambda: vectors["secret"])
    at = 123456 * MS
    assert server.on_datagram(vectors["hello"], 1, at).replies == (vectors["cookie"],)
    arm = server.on_datagram(vectors["arm"], 1, at + 2 * MS)
    assert arm.request is not None
    assert arm.request.order.op == "arm"
    assert server.reply(arm.request, {"state": "armed"}, at + 4 * MS) == vectors["armed"]
    change = server.on_datagram(vectors["set"], 1, at + 4 * MS)
    assert change.request is not None
    assert change.request.order.params == {"values": {"speed": 0.25, "axis": 3}}
    refusal = {"refused": "speed: at most 0.2"}
    assert server.reply(change.request, refusal, at + 5 * MS) == vectors["refused"]
    server.on_datagram(vectors["close"], 1, at + 6 * MS)
    assert server.sessions == 0


def test_the_documented_session_runs_on_the_client(
    vectors: dict[str, bytes], meanings: dict[str, Any]
) -> None:
    key = make_key("v", Role.OPERATE, vectors["psk"])
    client = CommandClient(key, int.from_bytes(vectors["session"], "big"))
    assert client.hello(0) == vectors["hello"]
    client.on_datagram(vectors["cookie"], 0)
    assert client.request("arm", {}, 500 * MS).frame == vectors["arm"]
    armed = client.on_datagram(vectors["armed"], 4 * MS)
    assert armed is not None
    assert getattr(armed, "result", None) == meanings["armed"]["r"]
    params = meanings["set"]["p"]
    assert client.request("set", params, 501 * MS).frame == vectors["set"]
    refused = client.on_datagram(vectors["refused"], 5 * MS)
    assert getattr(refused, "reason", None) == meanings["refused"]["why"]
    event = client.on_datagram(vectors["event"], 14 * MS)
    assert getattr(event, "data", None) == meanings["event"]["d"]
    assert client.close() == vectors["close"]


def test_the_documented_payloads_are_decoded_as_documented(
    vectors: dict[str, bytes], meanings: dict[str, Any]
) -> None:
    for name, meaning in meanings.items():
        payload = cut_frame(vectors[name]).payload
        read = msgpack.unpackb(payload)
        if "r" in read:
            read["r"] = msgpack.unpackb(read["r"])
        assert read == meaning


# --- frames -------------------------------------------------------------------------------


@given(st.binary(max_size=1400))
def test_any_bytes_are_cut_or_refused(data: bytes) -> None:
    for cut in (cut_frame, cut_local):
        assert refusal(cut, data) in {None, "length", "magic", "version", "type"}


@given(
    st.sampled_from(FrameType),
    st.integers(0, 2**16 - 1),
    st.integers(0, 2**64 - 1),
    st.integers(0, 2**64 - 1),
    st.binary(max_size=frame_codec.PAYLOAD_BYTES),
)
def test_a_frame_is_cut_into_what_it_was_made_of(
    kind: FrameType, key_id: int, session: int, sequence: int, payload: bytes
) -> None:
    body = frame_body(kind, key_id, session, sequence, payload)
    frame = cut_frame(body + bytes(16))
    assert frame == CommandFrame(kind, key_id, session, sequence, body, payload, bytes(16))


@pytest.mark.parametrize("too_big", [2**64, -1])
def test_a_number_that_does_not_fit_its_field_is_refused(too_big: int) -> None:
    with pytest.raises(CommandError, match="header"):
        frame_body(FrameType.REQUEST, 1, too_big, 1)


def test_a_payload_that_does_not_fit_is_refused() -> None:
    with pytest.raises(CommandError, match="too_long"):
        frame_body(FrameType.REQUEST, 1, 1, 1, bytes(frame_codec.PAYLOAD_BYTES + 1))


@pytest.mark.parametrize("op", ["stop", "set"])
def test_every_flipped_bit_of_a_request_is_refused_in_silence(op: str) -> None:
    world = World()
    client = world.client()
    params = {"values": {"speed": 0.1}} if op == "set" else {}
    sent = client.request(op, params, world.now_ns + 500 * MS)
    good = sent.frame
    where = client_address(client)
    for bit in range(len(good) * 8):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        assert world.deliver(bytes(bad), where) == []
    assert world.done == []
    assert world.server.sessions == 0
    assert len(world.deliver(good, where)) == 1
    for bit in range(len(good) * 8):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        assert world.deliver(bytes(bad), where) == []
    assert world.done == [(op, "alice")]


def test_every_truncation_and_extension_of_a_request_is_refused_in_silence() -> None:
    world = World()
    client = world.client()
    where = client_address(client)
    first = client.request("stop", {}, world.now_ns + 500 * MS).frame
    assert len(world.deliver(first, where)) == 1
    good = client.request("retreat", {}, world.now_ns + 500 * MS).frame
    for length in range(len(good)):
        assert world.deliver(good[:length], where) == []
    for extra in (b"\x00", b"\x80", good, bytes(1200)):
        assert world.deliver(good + extra, where) == []
        assert world.deliver(extra + good, where) == []
    assert world.done == [("stop", "alice")]
    assert len(world.deliver(good, where)) == 1


def test_every_flipped_bit_of_a_hello_is_refused_in_silence() -> None:
    world = World()
    client = world.client(ready=False)
    good = client.hello(0)
    for bit in range(len(good) * 8):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        assert world.deliver(bytes(bad)) == []
    assert len(world.deliver(good)) == 1


# --- messages -----------------------------------------------------------------------------

BOMBS = {
    "map of 2^32": b"\xdf\xff\xff\xff\xff",
    "array of 2^32": b"\xdd\xff\xff\xff\xff",
    "string of 2^32": b"\xdb\xff\xff\xff\xff",
    "deep arrays": b"\x91" * 1100,
    "deep maps": b"\x81\xa1p" * 380,
    "deep in p": msgpack.packb({"op": "get", "t": 1})[:-1] + b"\x01\xa1p" + b"\x91" * 1000,
    "deep p": b"\x83\xa2op\xa3get\xa1t\x01\xa1p" + b"\x91" * 1000,
    "deep values": b"\x83\xa2op\xa3set\xa1t\x01\xa1p\x81\xa6values" + b"\x81\xa1a" * 300,
    "int keys": msgpack.packb({i: i for i in range(300)}),
    "bin keys": msgpack.packb({b"op": "arm", b"t": 1}),
    "ext type": b"\x83\xa2op\xa3arm\xa1t\x01\xa1p\xd4\x01\x00",
    "op twice": b"\x83\xa2op\xa3arm\xa2op\xa4stop\xa1t\x01",
    "name twice": b"\x83\xa2op\xa3set\xa1t\x01\xa1p\x81\xa6values\x82\xa1a\x01\xa1a\x02",
    "names twice": b"\x83\xa2op\xa3get\xa1t\x01\xa1p\x82\xa5names\x91\xa1a\xa5names\x91\xa1b",
    "trailing byte": msgpack.packb({"op": "arm", "t": 1}) + b"\xc0",
    "unknown field": msgpack.packb({"op": "arm", "t": 1, "x": 1}),
    "unknown op": msgpack.packb({"op": "format", "t": 1}),
    "no op": msgpack.packb({"t": 1}),
    "no deadline": msgpack.packb({"op": "arm"}),
    "negative deadline": msgpack.packb({"op": "arm", "t": -1}),
    "float deadline": msgpack.packb({"op": "arm", "t": 1.5}),
    "huge deadline": msgpack.packb({"op": "arm", "t": 2**64 - 1}),
    "array": msgpack.packb(["arm", 1]),
    "p to an op without": msgpack.packb({"op": "arm", "t": 1, "p": {"x": 1}}),
    "p of another type": msgpack.packb({"op": "arm", "t": 1, "p": []}),
    "no names": msgpack.packb({"op": "get", "t": 1, "p": {"names": []}}),
    "many names": msgpack.packb({"op": "get", "t": 1, "p": {"names": ["a"] * 33}}),
    "long name": msgpack.packb({"op": "get", "t": 1, "p": {"names": ["a" * 97]}}),
    "no values": msgpack.packb({"op": "set", "t": 1, "p": {"values": {}}}),
    "nan": msgpack.packb({"op": "set", "t": 1, "p": {"values": {"a": math.nan}}}),
    "inf": msgpack.packb({"op": "set", "t": 1, "p": {"values": {"a": -math.inf}}}),
    "nan in a list": msgpack.packb({"op": "set", "t": 1, "p": {"values": {"a": [1, math.nan]}}}),
    "nested value": msgpack.packb({"op": "set", "t": 1, "p": {"values": {"a": {"b": 1}}}}),
    "nan rate": msgpack.packb({"op": "subscribe", "t": 1, "p": {"rate_hz": math.nan}}),
    "rate too high": msgpack.packb({"op": "subscribe", "t": 1, "p": {"rate_hz": 50.1}}),
    "bad utf-8": b"\x82\xa2op\xa3\xff\xfe\xfd\xa1t\x01",
    "bad record": msgpack.packb({"op": "record", "t": 1, "p": {"action": "pause"}}),
    "empty": b"",
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_payload_that_is_no_request_is_refused(name: str) -> None:
    with pytest.raises(CommandError) as caught:
        decode_request(BOMBS[name])
    assert caught.value.kind in {"malformed", "unknown"}


@given(st.binary(max_size=frame_codec.PAYLOAD_BYTES))
def test_any_payload_is_a_message_or_refused(payload: bytes) -> None:
    for decode in (decode_request, decode_reply, decode_event, decode_result):
        assert refusal(decode, payload) in {None, "malformed", "unknown"}


PACKED = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(
    st.sampled_from([*OPERATIONS, "x"]) | PACKED,
    st.integers(0, 2**63 - 1) | PACKED,
    st.dictionaries(
        st.sampled_from(["names", "values", "rate_hz", "of", "page", "action", "prefix"]), PACKED
    )
    | PACKED,
)
def test_any_map_in_the_shape_of_a_request_is_read_or_refused(op: Any, t: Any, p: Any) -> None:
    packed = msgpack.packb({"op": op, "t": t, "p": p})
    refused = refusal(decode_request, packed)
    if refused is not None:
        assert refused in {"malformed", "unknown"}
        return
    request = decode_request(packed)
    assert request.op in OPERATIONS
    assert json.dumps(request.params, allow_nan=False)


VALUE = (
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(max_size=60)
)


@given(
    st.dictionaries(
        st.text(min_size=1, max_size=40),
        st.none() | VALUE | st.lists(VALUE, max_size=5),
        min_size=1,
        max_size=4,
    ),
    st.integers(0, 2**63 - 1),
)
@settings(max_examples=60)
def test_values_of_a_set_arrive_unchanged(values: dict[str, Any], deadline_ms: int) -> None:
    items = [
        item
        for value in values.values()
        for item in (value if isinstance(value, list) else [value])
    ]
    sayable = all(item not in {math.inf, -math.inf} for item in items)
    if not sayable or len(msgpack.packb(values)) > 1100:
        assert refusal(encode_request, "set", {"values": values}, deadline_ms) is not None
        return
    payload = encode_request("set", {"values": values}, deadline_ms)
    request = decode_request(payload)
    assert (request.op, request.deadline_ms) == ("set", deadline_ms)
    assert request.params == {"values": values}


@pytest.mark.parametrize("count", [1, 15, 16, 40])
def test_as_many_values_as_fit_can_be_set_at_once(count: int) -> None:
    values = {f"p{i}": i for i in range(count)}
    assert decode_request(encode_request("set", {"values": values}, 1)).params == {"values": values}


def test_a_name_that_stands_twice_among_many_is_refused() -> None:
    twice = b"".join(msgpack.packb(f"p{i % 19}") + b"\x01" for i in range(20))
    payload = b"\x83\xa2op\xa3set\xa1t\x01\xa1p\x81\xa6values\xde\x00\x14" + twice
    with pytest.raises(CommandError, match="twice"):
        decode_request(payload)


@pytest.mark.parametrize(
    ("op", "params"),
    [
        ("format", {}),
        ("arm", {"x": 1}),
        ("set", {"values": {"a": math.nan}}),
        ("set", {"values": {"a": object()}}),
        ("set", {"values": {f"p{i}": "x" * 100 for i in range(20)}}),
        ("get", {}),
    ],
)
def test_a_client_cannot_even_make_a_wrong_request(op: str, params: dict[str, Any]) -> None:
    with pytest.raises(CommandError):
        encode_request(op, params, 1)


def test_what_takes_no_parameters_is_asked_without_its_schema() -> None:
    assert {op for op, rule in OPERATIONS.items() if rule.params is Empty} == BARE
    for op in BARE:
        assert decode_request(encode_bare(op, 7)) == (op, 7, {})
    with pytest.raises(CommandError, match="unknown"):
        encode_bare("get", 7)


@pytest.mark.parametrize(
    "message",
    [
        {"ok": True},
        {"t": 1},
        {"ok": 1, "t": 1},
        {"ok": True, "t": True},
        {"ok": True, "t": -1},
        {"ok": True, "t": 2**63},
        {"ok": True, "t": 1.0},
        {"ok": True, "t": 1, "r": "text"},
        {"ok": True, "t": 1, "e": "x" * 33},
        {"ok": True, "t": 1, "why": "x" * 901},
        {"ok": True, "t": 1, "i": -1},
        {"ok": True, "t": 1, "n": 0},
        {"ok": True, "t": 1, "n": frame_codec.MAX_PAGES + 1},
        {"ok": True, "t": 1, "x": 1},
        {1: 2},
        [True, 1],
    ],
)
def test_what_is_not_a_reply_is_refused(message: object) -> None:
    with pytest.raises(CommandError, match="malformed"):
        decode_reply(msgpack.packb(message))


@pytest.mark.parametrize(
    "message", [{"t": 1}, {"t": 1, "d": [1]}, {"t": -1, "d": {}}, {"d": {}}, 1]
)
def test_what_is_not_an_event_is_refused(message: object) -> None:
    with pytest.raises(CommandError, match="malformed"):
        decode_event(msgpack.packb(message))
    with pytest.raises(CommandError, match="malformed"):
        decode_event(msgpack.packb({"t": 1, "d": {b"x": 1}}))


def test_every_operation_of_the_interface_is_there() -> None:
    asked = {"status", "params", "get", "set", "save", "arm", "start", "stop", "retreat"}
    asked |= {"ack", "home", "record", "subscribe", "page", "scene", "sensors"}
    asked |= {"announce", "skip", "next", "hold", "queue", "follow"}
    assert set(OPERATIONS) == asked
    operating = {op for op, rule in OPERATIONS.items() if rule.role is Role.OPERATE}
    assert operating == {
        *("set", "save", "record", "arm", "start", "ack", "home", "stop", "retreat"),
        *("announce", "skip", "next", "hold", "follow"),
    }
    assert {op for op, rule in OPERATIONS.items() if rule.lease} == {
        *("arm", "start", "ack", "home", "next", "follow")
    }


@given(
    st.builds(
        Reply,
        st.booleans(),
        st.integers(0, 2**63 - 1),
        st.binary(max_size=900),
        st.text(max_size=32),
        st.text(max_size=900),
        st.integers(0, 31),
        st.integers(32, frame_codec.MAX_PAGES),
    )
)
def test_a_reply_is_read_as_it_was_written(reply: Reply) -> None:
    assert decode_reply(encode_reply(reply)) == reply


def test_a_part_beyond_the_last_is_refused() -> None:
    with pytest.raises(CommandError, match="part 2 of 2"):
        decode_reply(encode_reply(Reply(ok=True, t=1, i=2, n=2)))


def test_a_result_that_nothing_can_carry_is_refused() -> None:
    with pytest.raises(CommandError, match="too_long"):
        encode_result({"a": bytes(frame_codec.MAX_RESULT_BYTES)})
    with pytest.raises(CommandError, match="unencodable"):
        encode_result({"a": object()})
