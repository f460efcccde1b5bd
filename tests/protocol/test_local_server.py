"""The local socket's frames: any bytes give silence or an answer, and roles hold."""

from collections import Counter
from typing import Any

import pytest
from command_ends import MS, START_NS
from hypothesis import given
from hypothesis import strategies as st

from linemate.protocol.command.client_core import Answer
from linemate.protocol.command.conversation import CommandOrder, ControlLease
from linemate.protocol.command.frame_codec import FrameType, Role, cut_local, local_body
from linemate.protocol.command.local_client import LocalClient
from linemate.protocol.command.local_server import LocalAccess, LocalServer
from linemate.protocol.command.payloads import decode_reply
from linemate.protocol.command.requests import OPERATIONS, encode_request


def server_of(role: Role = Role.OPERATE) -> LocalServer:
    return LocalServer("uid:1", role, ControlLease(), Counter())


def test_a_conversation_runs_without_a_key() -> None:
    server, client = server_of(), LocalClient()
    cookie = server.on_message(client.hello(0), START_NS)
    assert isinstance(cookie, bytes)
    client.on_datagram(cookie, 0)
    order = server.on_message(client.request("arm", {}, 500 * MS).frame, START_NS)
    assert order == CommandOrder("arm", {}, 1, Role.OPERATE, "uid:1")
    assert isinstance(order, CommandOrder)
    answer = client.on_datagram(server.reply(order, {"a": bytes(60000)}, START_NS), 0)
    assert isinstance(answer, Answer)
    assert answer.result == {"a": bytes(60000)}
    assert client.close() is None


@given(st.binary(max_size=1300))
def test_any_message_gets_silence_or_an_answer(data: bytes) -> None:
    server, client = server_of(), LocalClient()
    answer = server.on_message(data, START_NS)
    assert answer is None or isinstance(answer, bytes)
    client.on_datagram(data, 0)


@given(st.binary(max_size=1100), st.sampled_from(FrameType), st.integers(0, 2**64 - 1))
def test_any_payload_gets_silence_or_an_answer(
    payload: bytes, kind: FrameType, sequence: int
) -> None:
    answer = server_of().on_message(local_body(kind, 0, 0, sequence, payload), START_NS)
    if kind is FrameType.REQUEST and sequence:
        assert isinstance(answer, bytes)
        assert cut_local(answer).sequence == sequence
    elif kind is not FrameType.HELLO:
        assert answer is None


@pytest.mark.parametrize("kind", [FrameType.HELLO, FrameType.REQUEST, FrameType.CLOSE])
def test_a_client_believes_nothing_that_a_client_sends(kind: FrameType) -> None:
    client = LocalClient()
    assert client.on_datagram(local_body(kind, 0, 0, 1), 0) is None
    assert client.counters["dropped_direction"] == 1


OPERATING = [op for op, rule in OPERATIONS.items() if rule.role is Role.OPERATE]
PARAMS: dict[str, dict[str, Any]] = {
    "set": {"values": {"a": 1}},
    "record": {"action": "stop"},
    "announce": {"part": "1", "variant": "left"},
    "follow": {"begin_ns": 7, "poses": [[0.0, 1.0, 2.0, 0.5, 1.0, 0.0, 0.0, 0.0]]},
}


@pytest.mark.parametrize("op", OPERATING)
def test_a_viewer_cannot_operate(op: str) -> None:
    params = PARAMS.get(op, {})
    payload = encode_request(op, params, START_NS // MS)
    answer = server_of(Role.VIEW).on_message(
        local_body(FrameType.REQUEST, 0, 0, 1, payload), START_NS
    )
    assert isinstance(answer, bytes)
    assert decode_reply(cut_local(answer).payload).e == "role"


def test_telemetry_that_cannot_be_made_is_counted() -> None:
    counters: Counter[str] = Counter()
    server = LocalServer("uid:1", Role.VIEW, ControlLease(), counters)
    payload = encode_request("subscribe", {"rate_hz": 50.0}, START_NS // MS)
    server.on_message(local_body(FrameType.REQUEST, 0, 0, 1, payload), START_NS)
    assert server.event(START_NS, lambda: {"a": object()}) is None
    assert server.event(START_NS + 20 * MS, lambda: {"a": bytes(70000)}) is None
    assert server.event(START_NS + 40 * MS, lambda: {"a": 1}) is not None
    assert counters["events_unencodable"] == 1
    assert counters["events_too_long"] == 1


def test_access_is_by_user_then_group_then_none() -> None:
    access = LocalAccess(frozenset({0, 7}), frozenset({100}), frozenset({200}))
    assert access.role(7, frozenset()) is Role.OPERATE
    assert access.role(8, frozenset({5, 100})) is Role.OPERATE
    assert access.role(8, frozenset({200})) is Role.VIEW
    assert access.role(8, frozenset({200, 100})) is Role.OPERATE
    assert access.role(8, frozenset({5})) is None
    assert LocalAccess().role(0, frozenset({0})) is None
