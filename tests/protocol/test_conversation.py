"""What an authenticated peer may do: roles, lease, order, deadlines, long answers."""

import itertools
from collections import Counter
from typing import Any

import pytest
from command_ends import MS, START_NS, S, World, key_of
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.protocol.command.conversation import CommandOrder, ControlLease, Conversation
from linemate.protocol.command.frame_codec import (
    MAX_AHEAD_MS,
    MAX_RESULT_BYTES,
    PAYLOAD_BYTES,
    Role,
)
from linemate.protocol.command.payloads import decode_reply
from linemate.protocol.command.requests import OPERATIONS, encode_request

ALICE = key_of("alice", Role.OPERATE, 1)
BOB = key_of("bob", Role.OPERATE, 2)
EVE = key_of("eve", Role.VIEW, 3)
SAMPLES: dict[str, dict[str, Any]] = {
    "get": {"names": ["a"]},
    "set": {"values": {"a": 1}},
    "record": {"action": "start"},
    "subscribe": {"rate_hz": 1.0},
    "announce": {"part": "1", "variant": "left"},
    "follow": {"begin_ns": 7, "poses": [[0.0, 1.0, 2.0, 0.5, 1.0, 0.0, 0.0, 0.0]]},
    "page": {"of": 1, "page": 1},
}


def conversation(role: Role = Role.OPERATE) -> Conversation:
    return Conversation("x", role, ControlLease(), PAYLOAD_BYTES, Counter())


@pytest.mark.parametrize("op", OPERATIONS)
def test_a_view_key_can_ask_and_cannot_operate(op: str) -> None:
    world = World((ALICE, EVE))
    answer = world.ask(world.client(EVE), op, SAMPLES.get(op))
    assert answer is not None
    if OPERATIONS[op].role is Role.OPERATE:
        assert (answer.ok, answer.code) == (False, "role")
        assert world.done == []
    elif op != "page":
        assert answer.ok


@pytest.mark.parametrize("op", OPERATIONS)
def test_an_operate_key_can_do_everything(op: str) -> None:
    world = World((ALICE,))
    answer = world.ask(world.client(), op, SAMPLES.get(op))
    assert answer is not None
    assert answer.ok or op == "page"


@pytest.mark.parametrize("op", ["arm", "start", "ack"])
def test_one_operator_at_a_time_has_control(op: str) -> None:
    world = World((ALICE, BOB))
    alice, bob = world.client(ALICE), world.client(BOB)
    assert world.ask(alice, "arm").ok  # type: ignore[union-attr]
    refused = world.ask(bob, op)
    assert refused is not None
    assert refused.code == "lease"
    assert "alice" in refused.reason
    world.now_ns += 5 * S
    assert world.ask(bob, op).ok  # type: ignore[union-attr]
    assert world.ask(alice, op).code == "lease"  # type: ignore[union-attr]


@pytest.mark.parametrize("op", ["stop", "retreat"])
def test_every_operator_can_always_bring_the_robot_to_rest(op: str) -> None:
    world = World((ALICE, BOB))
    alice, bob = world.client(ALICE), world.client(BOB)
    assert world.ask(alice, "start").ok  # type: ignore[union-attr]
    assert world.ask(bob, op).ok  # type: ignore[union-attr]
    assert world.done == [("start", "alice"), (op, "bob")]
    # That does not take control away either.
    assert world.ask(bob, "start").code == "lease"  # type: ignore[union-attr]


def test_control_is_renewed_by_operating_not_by_looking() -> None:
    for op, kept in (("stop", True), ("status", False)):
        world = World((ALICE, BOB))
        alice, bob = world.client(ALICE), world.client(BOB)
        assert world.ask(alice, "arm").ok  # type: ignore[union-attr]
        world.now_ns += 4 * S
        assert world.ask(alice, op).ok  # type: ignore[union-attr]
        world.now_ns += 2 * S
        assert world.ask(bob, "arm").ok is not kept  # type: ignore[union-attr]


def test_a_lease_that_has_ended_is_not_renewed() -> None:
    lease = ControlLease()
    assert lease.claim("a", 0) is None
    lease.renew("a", 6 * S)
    assert lease.claim("b", 6 * S) is None


def test_a_start_that_was_overtaken_by_a_stop_is_refused() -> None:
    world = World((ALICE,))
    client = world.client()
    start = client.request("start", {}, world.now_ns + 500 * MS)
    assert world.ask(client, "stop").ok  # type: ignore[union-attr]
    address = ("client", id(client))
    (reply,) = world.deliver(start.frame, address)
    answer = client.on_datagram(reply, world.now_ns)
    assert getattr(answer, "code", None) == "order"
    assert world.done == [("stop", "alice")]


def test_a_stop_that_was_overtaken_is_carried_out_all_the_same() -> None:
    world = World((ALICE,))
    client = world.client()
    stop = client.request("stop", {}, world.now_ns + 500 * MS)
    assert world.ask(client, "start").ok  # type: ignore[union-attr]
    assert len(world.deliver(stop.frame, ("client", id(client)))) == 1
    assert world.done == [("start", "alice"), ("stop", "alice")]


def test_a_late_stop_does_not_let_an_older_start_pass() -> None:
    world = World((ALICE,))
    client = world.client()
    stop = client.request("stop", {}, world.now_ns + 500 * MS)
    start = client.request("start", {}, world.now_ns + 500 * MS)
    assert world.ask(client, "retreat").ok  # type: ignore[union-attr]
    for late in (stop, start):
        world.deliver(late.frame, ("client", id(client)))
    assert world.done == [("retreat", "alice"), ("stop", "alice")]


def test_a_look_does_not_overtake_an_order() -> None:
    world = World((ALICE,))
    client = world.client()
    arm = client.request("arm", {}, world.now_ns + 500 * MS)
    assert world.ask(client, "status").ok  # type: ignore[union-attr]
    world.deliver(arm.frame, ("client", id(client)))
    assert world.done == [("status", "alice"), ("arm", "alice")]


@pytest.mark.parametrize(
    ("ahead_ms", "code"),
    [(-1, "expired"), (0, ""), (MAX_AHEAD_MS, ""), (MAX_AHEAD_MS + 1, "deadline")],
)
def test_a_deadline_is_neither_past_nor_far(ahead_ms: int, code: str) -> None:
    payload = encode_request("stop", {}, START_NS // MS + ahead_ms)
    outcome = conversation().judge(payload, 1, START_NS)
    if code:
        assert isinstance(outcome, bytes)
        assert decode_reply(outcome).e == code
    else:
        assert outcome == CommandOrder("stop", {}, 1, Role.OPERATE, "x")


@given(st.dictionaries(st.text(max_size=30), st.text(max_size=400), max_size=150))
@settings(max_examples=30, deadline=None)
def test_an_answer_of_any_length_comes_whole_or_is_refused(result: dict[str, str]) -> None:
    result.pop("refused", None)
    world = World((ALICE,), lambda *_: dict(result))
    answer = world.ask(world.client(), "status")
    assert answer is not None
    assert answer.ok
    assert answer.result == result


def test_the_longest_answer_comes_in_parts_and_a_longer_one_is_refused() -> None:
    limit = MAX_RESULT_BYTES - 6  # map head, key "a", bin head
    for length, ok in ((limit, True), (limit + 1, False)):
        world = World((ALICE,), lambda *_, n=length: {"a": bytes(n)})
        answer = world.ask(world.client(), "params")
        assert answer is not None
        assert answer.ok is ok
        assert answer.code == ("" if ok else "too_long")


def test_no_reply_is_longer_than_a_frame() -> None:
    for length in range(1100, 1200):
        world = World((ALICE,), lambda *_, n=length: {"a": bytes(n)})
        client = world.client()
        sent = client.request("status", {}, world.now_ns + 500 * MS)
        (reply,) = world.deliver(sent.frame, ("client", id(client)))
        assert len(reply) <= 1200


def test_a_part_of_an_answer_that_is_not_kept_is_refused() -> None:
    world = World((ALICE,), lambda *_: {"a": bytes(3000)})
    client = world.client()
    sent = client.request("status", {}, world.now_ns + 500 * MS)
    world.deliver(sent.frame, ("client", id(client)))
    for of, page in ((sent.sequence, 3), (sent.sequence + 1, 1)):
        answer = world.ask(client, "page", {"of": of, "page": page})
        assert answer is not None
        assert answer.code == "page"


def test_parts_that_are_replaced_between_are_noticed() -> None:
    world = World((ALICE,), lambda *_: {"a": bytes(3000)})
    client = world.client()
    one = client.request("status", {}, world.now_ns + 500 * MS)
    (first,) = world.deliver(one.frame, ("client", id(client)))
    more = client.on_datagram(first, world.now_ns)
    assert world.ask(client, "params") is not None
    (reply,) = world.deliver(more.request.frame, ("client", id(client)))  # type: ignore[union-attr]
    answer = client.on_datagram(reply, world.now_ns)
    assert getattr(answer, "code", None) == "page"


def test_what_a_handler_cannot_say_is_refused_not_raised() -> None:
    for result, code in (
        ({"a": object()}, "unencodable"),
        ({"refused": "\ud800" * 999}, "refused"),
    ):
        world = World((ALICE,), lambda *_, r=result: r)
        answer = world.ask(world.client(), "status")
        assert answer is not None
        assert answer.code == code


def test_a_failed_handler_is_answered_as_internal() -> None:
    reply = decode_reply(conversation().fail(START_NS))
    assert (reply.ok, reply.e) == (False, "internal")


def test_telemetry_keeps_its_rate_over_any_polling_and_ends_by_itself() -> None:
    for poll_ms in (1, 4, 12, 13):
        talk = conversation(Role.VIEW)
        params = {"rate_hz": 50.0, "duration_s": 2.0}
        talk.judge(encode_request("subscribe", params, START_NS // MS + 1), 1, START_NS)
        polls = range(START_NS, START_NS + 3 * S, poll_ms * MS)
        sent = sum(talk.event_due(now_ns) for now_ns in polls)
        assert 98 <= sent <= 100
        assert not talk.subscribed


def test_telemetry_is_never_faster_than_50_hz_even_after_a_stall() -> None:
    talk = conversation()
    talk.judge(encode_request("subscribe", {"rate_hz": 50.0}, START_NS // MS + 1), 1, START_NS)
    assert talk.event_due(START_NS)
    stalled = START_NS + S
    times = [t for t in range(stalled, stalled + S, MS) if talk.event_due(t)]
    assert len(times) <= 51
    assert min(b - a for a, b in itertools.pairwise(times)) >= 10 * MS


def test_a_subscription_ends_when_asked() -> None:
    talk = conversation()
    at = START_NS // MS + 1
    talk.judge(encode_request("subscribe", {"rate_hz": 50.0}, at), 1, START_NS)
    talk.judge(encode_request("subscribe", {"rate_hz": 0.0}, at), 2, START_NS)
    assert not talk.subscribed
    assert not talk.event_due(START_NS + S)
