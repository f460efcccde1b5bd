"""The client's part: it believes only what is genuine, asked for, and whole."""

import pytest
from command_ends import MS, World, client_address, key_of

from linemate.protocol.command.authenticated import CommandClient
from linemate.protocol.command.client_core import MAX_OUTSTANDING, Answer, More, Telemetry
from linemate.protocol.command.frame_codec import CommandError, FrameType, frame_body
from linemate.protocol.command.payloads import Reply, encode_reply


def asked(world: World, client: CommandClient, op: str = "status") -> bytes:
    """Ask, and return the reply's datagram undelivered."""
    sent = client.request(op, {}, world.now_ns + 500 * MS)
    (reply,) = world.deliver(sent.frame, client_address(client))
    return reply


def forged_by_server(world: World, client: CommandClient, sequence: int, reply: Reply) -> bytes:
    """What a broken server with the right keys might send."""
    assert client._keys is not None
    body = frame_body(
        FrameType.REPLY, world.keys[0].id, client._session, sequence, encode_reply(reply)
    )
    return client._keys.to_client.seal(body)


@pytest.mark.parametrize("kind", ["cookie", "reply", "event"])
def test_every_flipped_bit_and_truncation_of_what_the_server_sends_is_refused(kind: str) -> None:
    world = World()
    client = world.client(ready=kind != "cookie")
    if kind == "cookie":
        (good,) = world.deliver(client.hello(0))
    elif kind == "reply":
        good = asked(world, client)
    else:
        world.ask(client, "subscribe", {"rate_hz": 50.0})
        ((good, _),) = world.server.events(world.now_ns, lambda: {"k": 1})
    for bit in range(len(good) * 8):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        assert client.on_datagram(bytes(bad), world.now_ns) is None
    for length in range(len(good)):
        assert client.on_datagram(good[:length], world.now_ns) is None
    assert client.on_datagram(good + b"\0", world.now_ns) is None
    assert client.on_datagram(good, world.now_ns) is not None


def test_a_reply_is_believed_once() -> None:
    world = World()
    client = world.client()
    reply = asked(world, client)
    assert isinstance(client.on_datagram(reply, world.now_ns), Answer)
    assert client.on_datagram(reply, world.now_ns) is None
    assert client.counters["dropped_unasked"] == 1


def test_a_reply_to_another_client_of_the_same_key_is_refused() -> None:
    world = World()
    one, two = world.client(), world.client()
    reply = asked(world, one)
    asked(world, two)
    assert two.on_datagram(reply, world.now_ns) is None
    assert two.counters["dropped_session"] == 1


def test_requests_without_an_answer_are_forgotten_in_the_end() -> None:
    world = World()
    client = world.client()
    first = asked(world, client)
    for _ in range(MAX_OUTSTANDING - 1):
        last = asked(world, client)
    assert client.on_datagram(first, world.now_ns) is not None
    first = asked(world, client)
    for _ in range(MAX_OUTSTANDING):
        last = asked(world, client)
    assert client.on_datagram(first, world.now_ns) is None
    assert client.on_datagram(last, world.now_ns) is not None


def test_parts_in_the_wrong_order_are_not_joined() -> None:
    world = World()
    client = world.client()
    sent = client.request("status", {}, world.now_ns)
    wrong = Reply(ok=True, t=1, r=b"x", i=1, n=3)
    answer = client.on_datagram(forged_by_server(world, client, sent.sequence, wrong), 0)
    assert isinstance(answer, Answer)
    assert (answer.ok, answer.code) == (False, "page")


def test_parts_without_end_are_not_joined() -> None:
    world = World()
    client = world.client()
    sent = client.request("status", {}, world.now_ns)
    for page in range(70):
        part = Reply(ok=True, t=1, r=bytes(1100), i=min(page, 62), n=64)
        event = client.on_datagram(forged_by_server(world, client, sent.sequence, part), 0)
        if isinstance(event, Answer):
            break
        assert isinstance(event, More)
        sent = event.request
    assert isinstance(event, Answer)
    assert event.code == "page"


def test_a_result_that_is_no_map_is_an_answer_that_says_so() -> None:
    world = World()
    client = world.client()
    for result in (b"\xc1", b"\x91\x01", b"\x81\x01\x01", b"\x91" * 900):
        sent = client.request("status", {}, world.now_ns)
        reply = Reply(ok=True, t=1, r=result)
        answer = client.on_datagram(forged_by_server(world, client, sent.sequence, reply), 0)
        assert isinstance(answer, Answer)
        assert (answer.ok, answer.code) == (False, "malformed")


def test_an_event_that_is_malformed_does_not_use_up_its_number() -> None:
    world = World()
    client = world.client()
    assert client._keys is not None
    body = frame_body(FrameType.EVENT, world.keys[0].id, client._session, 1, b"\xc1")
    assert client.on_datagram(client._keys.to_client.seal(body), 0) is None
    world.ask(client, "subscribe", {"rate_hz": 50.0})
    ((event, _),) = world.server.events(world.now_ns, lambda: {"k": 1})
    assert isinstance(client.on_datagram(event, 0), Telemetry)


def test_the_servers_clock_is_estimated_from_every_reply() -> None:
    world = World()
    client = world.client()
    # The client's clock runs away by two seconds; one refused call is the price.
    ahead = 2_000 * MS
    sent = client.request("status", {}, world.now_ns)
    (reply,) = world.deliver(sent.frame, client_address(client))
    assert client.on_datagram(reply, world.now_ns + ahead) is not None
    sent = client.request("stop", {}, world.now_ns + ahead + 500 * MS)
    (reply,) = world.deliver(sent.frame, client_address(client))
    answer = client.on_datagram(reply, world.now_ns + ahead)
    assert isinstance(answer, Answer)
    assert answer.ok
    world.now_ns += 501 * MS
    late = client.request("stop", {}, world.now_ns - 2 * MS + ahead)
    (reply,) = world.deliver(late.frame, client_address(client))
    answer = client.on_datagram(reply, world.now_ns)
    assert isinstance(answer, Answer)
    assert answer.code == "expired"


def test_a_client_refuses_what_its_key_cannot_reach() -> None:
    client = CommandClient(key_of(), 1)
    with pytest.raises(CommandError, match="handshake"):
        client.request("status", {}, 0)
