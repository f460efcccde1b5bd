"""Sessions: what is old, elsewhere, reflected or no one's is not carried out, ever."""

import random

import pytest
from command_ends import MS, START_NS, S, Secrets, World, client_address, key_of
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.protocol.command.authenticated import (
    MAX_SESSIONS,
    MAX_TOMBSTONES_PER_KEY,
    CommandClient,
    CommandServer,
    ReplayWindow,
)
from linemate.protocol.command.client_core import Answer, Ready, Telemetry
from linemate.protocol.command.frame_codec import FrameType, Role, Tagger, frame_body
from linemate.protocol.command.preshared_keys import SessionKeys

ALICE = key_of("alice", Role.OPERATE, 1)
BOB = key_of("bob", Role.OPERATE, 2)
EVE = key_of("eve", Role.VIEW, 3)


def answered(world: World, frame: bytes, client: CommandClient) -> list[object]:
    replies = world.deliver(frame, client_address(client))
    return [client.on_datagram(reply, world.now_ns) for reply in replies]


# --- handshake ----------------------------------------------------------------------------


def test_a_hello_is_answered_with_no_more_bytes_and_nothing_is_kept() -> None:
    world = World()
    client = world.client(ready=False)
    hello = client.hello(0)
    assert hello == client.hello(1)
    for _ in range(100):
        (cookie,) = world.deliver(hello)
        assert len(cookie) == len(hello) == 54
    assert world.server.sessions == 0
    assert isinstance(client.on_datagram(cookie, world.now_ns), Ready)


def test_a_second_cookie_does_not_change_the_keys_of_a_session() -> None:
    world = World()
    client = world.client()
    world.now_ns += 15 * S
    (other,) = world.deliver(client.hello(0))
    assert client.on_datagram(other, world.now_ns) is None
    assert client.counters["dropped_duplicate"] == 1


def test_no_request_is_made_before_the_handshake() -> None:
    client = World().client(ready=False)
    with pytest.raises(Exception, match="handshake"):
        client.request("stop", {}, 1)
    assert client.close() is None


def test_a_hello_of_an_unknown_or_another_key_gets_silence() -> None:
    world = World((ALICE,))
    assert world.deliver(CommandClient(BOB, 7).hello(0)) == []
    forged = frame_body(FrameType.HELLO, ALICE.id, 7, 0, bytes(16))
    assert world.deliver(Tagger(BOB.secret, b"hello").seal(forged)) == []
    counters = world.server.counters
    assert (counters["dropped_unknown_key"], counters["dropped_tag"]) == (1, 1)


def test_a_genuine_hello_of_another_length_gets_silence() -> None:
    world = World((ALICE,))
    short = frame_body(FrameType.HELLO, ALICE.id, 7, 0, b"")
    assert world.deliver(Tagger(ALICE.secret, b"hello").seal(short)) == []


def test_a_cookie_is_good_for_at_least_10_and_at_most_20_seconds() -> None:
    for age_s, good in ((10, True), (21, False)):
        world = World(now_ns=START_NS + 9 * S)
        client = world.client()
        sent = client.request("status", {}, world.now_ns + age_s * S + 500 * MS)
        world.now_ns += age_s * S
        assert bool(answered(world, sent.frame, client)) is good


def test_a_cookie_dies_with_the_servers_restart() -> None:
    world = World()
    client = world.client()
    sent = client.request("stop", {}, world.now_ns + 500 * MS)
    world.server = CommandServer(world.keys, Secrets(first=1000))
    assert answered(world, sent.frame, client) == []
    assert world.done == []


# --- freshness ----------------------------------------------------------------------------


def test_an_exact_duplicate_gets_the_same_reply_and_is_not_carried_out_again() -> None:
    world = World()
    client = world.client()
    sent = client.request("arm", {}, world.now_ns + 500 * MS)
    first = world.deliver(sent.frame, client_address(client))
    world.now_ns += 10 * S
    assert world.deliver(sent.frame, client_address(client)) == first
    assert world.done == [("arm", "alice")]


def test_only_the_last_four_replies_are_repeated() -> None:
    world = World()
    client = world.client()
    frames = [client.request("status", {}, world.now_ns + 500 * MS).frame for _ in range(5)]
    for frame in frames:
        world.deliver(frame, client_address(client))
    again = [len(world.deliver(frame, client_address(client))) for frame in frames]
    assert again == [0, 1, 1, 1, 1]
    assert len(world.done) == 5


def test_a_request_replayed_after_many_newer_ones_gets_silence() -> None:
    world = World()
    client = world.client()
    old = client.request("stop", {}, world.now_ns + 500 * MS).frame
    world.deliver(old, client_address(client))
    for _ in range(70):
        assert world.ask(client, "status") is not None
    done = list(world.done)
    assert world.deliver(old, client_address(client)) == []
    assert world.done == done


def test_a_request_that_was_overtaken_by_64_others_gets_silence() -> None:
    world = World()
    client = world.client()
    late = [client.request("stop", {}, world.now_ns + 500 * MS).frame for _ in range(3)]
    for _ in range(62):
        assert world.ask(client, "status") is not None
    done = len(world.done)
    results = [len(world.deliver(frame, client_address(client))) for frame in late]
    assert results == [0, 1, 1]
    assert len(world.done) == done + 2


@given(st.lists(st.integers(0, 300), max_size=200))
def test_the_window_takes_each_sequence_once_and_none_too_old(sequences: list[int]) -> None:
    window = ReplayWindow()
    taken: set[int] = set()
    for sequence in sequences:
        expected = sequence > 0 and sequence not in taken and sequence > max(taken, default=0) - 64
        assert window.is_fresh(sequence) is expected
        if expected:
            window.note(sequence)
            taken.add(sequence)
        assert window._seen < 1 << 64


def test_a_request_held_back_beyond_its_deadline_is_refused_as_expired() -> None:
    for held_s in (0.502, 10.0):
        world = World()
        client = world.client()
        assert world.ask(client, "status") is not None
        sent = client.request("start", {}, world.now_ns + 500 * MS)
        world.now_ns += int(held_s * S)
        (event,) = answered(world, sent.frame, client)
        assert isinstance(event, Answer)
        assert (event.ok, event.code) == (False, "expired")
        assert world.done == [("status", "alice")]


def test_the_first_request_of_a_session_can_be_late_too() -> None:
    world = World()
    client = world.client()
    sent = client.request("start", {}, world.now_ns + 500 * MS)
    world.now_ns += 600 * MS
    (event,) = answered(world, sent.frame, client)
    assert isinstance(event, Answer)
    assert event.code == "expired"
    assert world.done == []


def test_a_held_back_cookie_makes_deadlines_earlier_never_later() -> None:
    world = World()
    client = world.client(ready=False)
    (cookie,) = world.deliver(client.hello(0), client_address(client))
    world.now_ns += 3 * S
    client.on_datagram(cookie, world.now_ns)
    answer = world.ask(client, "stop")
    assert answer is not None
    assert answer.code == "expired"
    # The refusal itself has the time.
    again = world.ask(client, "stop")
    assert again is not None
    assert again.ok


def test_a_clients_clock_may_be_any_other() -> None:
    world = World()
    client = CommandClient(ALICE, 9)
    for reply in world.deliver(client.hello(5), client_address(client)):
        client.on_datagram(reply, 5)
    sent = client.request("stop", {}, 5 + 500 * MS)
    (event,) = (
        client.on_datagram(r, 5 + MS) for r in world.deliver(sent.frame, client_address(client))
    )
    assert isinstance(event, Answer)
    assert event.ok


# --- other places -------------------------------------------------------------------------


def test_what_the_server_sent_is_refused_when_it_comes_back() -> None:
    world = World()
    client = world.client()
    hello = client.hello(0)
    (cookie,) = world.deliver(hello)
    sent = client.request("subscribe", {"rate_hz": 50.0}, world.now_ns + 500 * MS)
    (reply,) = world.deliver(sent.frame, client_address(client))
    ((event, _),) = world.server.events(world.now_ns, dict)
    for frame in (cookie, reply, event):
        assert world.deliver(frame, client_address(client)) == []
    assert world.server.counters["dropped_direction"] == 3


def test_what_the_client_sent_is_refused_when_it_comes_back() -> None:
    world = World()
    client = world.client()
    sent = client.request("stop", {}, world.now_ns + 500 * MS)
    farewell = client.close()
    assert farewell is not None
    for frame in (client.hello(0), sent.frame, farewell):
        assert client.on_datagram(frame, world.now_ns) is None
    assert client.counters["dropped_direction"] == 3


def test_a_reply_disguised_as_a_request_is_refused() -> None:
    world = World()
    client = world.client()
    sent = client.request("status", {}, world.now_ns + 500 * MS)
    (reply,) = world.deliver(sent.frame, client_address(client))
    disguised = bytearray(reply)
    disguised[3] = FrameType.REQUEST
    assert world.deliver(bytes(disguised), client_address(client)) == []


def test_a_request_of_one_session_is_refused_in_another() -> None:
    world = World()
    one, two = world.client(), world.client()
    assert world.ask(one, "status") is not None
    assert world.ask(two, "status") is not None
    frame = bytearray(one.request("stop", {}, world.now_ns + 500 * MS).frame)
    other = two.request("stop", {}, world.now_ns + 500 * MS).frame
    frame[6:14] = other[6:14]
    assert world.deliver(bytes(frame), client_address(two)) == []


def test_a_request_with_another_keys_id_is_refused() -> None:
    world = World((ALICE, BOB))
    client = world.client(ALICE)
    frame = bytearray(client.request("stop", {}, world.now_ns + 500 * MS).frame)
    frame[4:6] = BOB.id.to_bytes(2, "big")
    assert world.deliver(bytes(frame), client_address(client)) == []
    assert world.done == []


def test_a_request_copied_to_another_address_gets_silence_there() -> None:
    world = World()
    client = world.client()
    assert world.ask(client, "status") is not None
    frame = client.request("stop", {}, world.now_ns + 500 * MS).frame
    assert world.deliver(frame, "somebody else") == []
    assert len(world.deliver(frame, client_address(client))) == 1
    assert world.deliver(frame, "somebody else") == []
    assert world.server.counters["dropped_moved"] == 2


# --- ends ---------------------------------------------------------------------------------


def test_a_closed_session_cannot_be_begun_again_from_its_recording() -> None:
    world = World()
    client = world.client()
    arm = client.request("arm", {}, world.now_ns + 4 * S).frame
    assert len(world.deliver(arm, client_address(client))) == 1
    farewell = client.close()
    assert farewell is not None
    assert world.deliver(farewell, client_address(client)) == []
    assert world.server.sessions == 0
    for _ in range(25):
        for frame in (arm, farewell):
            assert world.deliver(frame, client_address(client)) == []
        world.now_ns += S
    assert world.done == [("arm", "alice")]
    assert world.server.counters["dropped_tombstoned"] >= 20


def test_a_close_opens_no_session() -> None:
    world = World()
    client = world.client()
    farewell = client.close()
    assert farewell is not None
    world.deliver(farewell, client_address(client))
    assert world.server.sessions == 0
    assert world.server.counters["dropped_no_session"] == 1


def test_a_flood_of_handshakes_keeps_the_table_small_and_others_whole() -> None:
    world = World((ALICE, BOB))
    bob = world.client(BOB)
    assert world.ask(bob, "status") is not None
    made = 0
    for _ in range(MAX_TOMBSTONES_PER_KEY + 200):
        made += world.ask(world.client(ALICE), "status") is not None
        assert world.server.sessions <= MAX_SESSIONS
    # The eighth place is Bob's; then every new session of Alice costs one of her own.
    assert made == MAX_TOMBSTONES_PER_KEY + MAX_SESSIONS - 1
    assert world.server.counters["dropped_tombstones_full"] == 200 - MAX_SESSIONS + 1
    assert world.ask(bob, "status") is not None
    world.now_ns += 21 * S
    assert world.ask(world.client(ALICE), "status") is not None


def test_a_key_without_a_session_gets_a_place_in_a_full_table() -> None:
    world = World((ALICE, BOB))
    hers = [world.client(ALICE) for _ in range(MAX_SESSIONS)]
    for client in hers:
        assert world.ask(client, "status") is not None
        world.now_ns += MS
    assert world.ask(world.client(BOB), "status") is not None
    assert world.server.sessions == MAX_SESSIONS
    assert world.ask(hers[0], "status") is None
    assert world.ask(hers[1], "status") is not None


def test_a_key_that_has_a_session_pays_for_another_with_its_own() -> None:
    world = World((ALICE, BOB))
    hers = [world.client(ALICE) for _ in range(MAX_SESSIONS - 1)]
    for client in hers:
        assert world.ask(client, "status") is not None
    first = world.client(BOB)
    assert world.ask(first, "status") is not None
    assert world.ask(world.client(BOB), "status") is not None
    assert world.ask(first, "status") is None
    assert all(world.ask(client, "status") for client in hers)


def test_no_key_loses_its_last_session() -> None:
    keys = tuple(key_of(f"k{i}", seed=i + 10) for i in range(MAX_SESSIONS + 1))
    world = World(keys)
    clients = [world.client(key) for key in keys]
    answers = [world.ask(client, "status") is not None for client in clients]
    assert answers == [True] * MAX_SESSIONS + [False]
    assert world.server.counters["dropped_table_full"] == 1
    assert all(world.ask(client, "status") for client in clients[:MAX_SESSIONS])
    # Silence gives the places back.
    world.now_ns += 61 * S
    assert world.ask(world.client(keys[-1]), "status") is not None
    assert world.server.sessions == 1


def test_a_session_in_use_is_neither_idle_nor_the_first_to_go() -> None:
    world = World((ALICE,))
    used = world.client(ALICE)
    assert world.ask(used, "status") is not None
    for _ in range(MAX_SESSIONS + 3):
        world.now_ns += 20 * S
        assert world.ask(used, "status") is not None
        assert world.ask(world.client(ALICE), "status") is not None
    for _ in range(MAX_SESSIONS):
        world.now_ns += MS
        assert world.ask(world.client(ALICE), "status") is not None
        assert world.ask(used, "status") is not None
    assert world.server.counters["sessions_evicted"] > 0
    assert world.server.counters["sessions_idle"] > 0


def test_sessions_of_a_key_that_is_taken_away_end_and_stay_ended() -> None:
    world = World((ALICE, BOB))
    alice, bob = world.client(ALICE), world.client(BOB)
    recorded = alice.request("stop", {}, world.now_ns + 4 * S).frame
    world.deliver(recorded, client_address(alice))
    assert world.ask(bob, "status") is not None
    world.server.replace_keys([BOB])
    assert world.ask(alice, "status") is None
    assert world.ask(bob, "status") is not None
    # Given back within the deadline of what was recorded: it may not live again.
    world.server.replace_keys([ALICE, BOB])
    done = list(world.done)
    assert world.deliver(recorded, client_address(alice)) == []
    assert world.done == done


def test_a_key_with_another_role_begins_a_new_session() -> None:
    world = World((ALICE,))
    client = world.client()
    assert world.ask(client, "stop") is not None
    demoted = key_of("alice", Role.VIEW, 1)
    world.server.replace_keys([demoted])
    assert world.ask(client, "stop") is None
    answer = world.ask(world.client(demoted), "stop")
    assert answer is not None
    assert answer.code == "role"


def test_an_answer_to_an_ended_session_is_not_sent() -> None:
    world = World((ALICE,))
    client = world.client()
    sent = client.request("stop", {}, world.now_ns + 500 * MS)
    received = world.server.on_datagram(sent.frame, client_address(client), world.now_ns)
    assert received.request is not None
    world.server.replace_keys([])
    assert world.server.reply(received.request, {}, world.now_ns) is None
    assert world.server.fail(received.request, world.now_ns) is None


# --- telemetry ----------------------------------------------------------------------------


def test_events_reach_the_subscriber_once_each() -> None:
    world = World((ALICE,))
    client = world.client()
    assert world.ask(client, "subscribe", {"rate_hz": 10.0}) is not None
    assert world.server.subscribed
    seen = []
    for step in range(200):
        sent = world.server.events(world.now_ns, lambda k=step: {"k": k})  # type: ignore[misc]
        for datagram, address in sent:
            assert address == client_address(client)
            seen.append(client.on_datagram(datagram, world.now_ns))
            assert client.on_datagram(datagram, world.now_ns) is None
        world.now_ns += 10 * MS
    assert [event.data["k"] for event in seen if isinstance(event, Telemetry)] == [
        *range(0, 200, 10)
    ]


def test_telemetry_that_cannot_be_sent_is_counted() -> None:
    world = World((ALICE,))
    assert world.ask(world.client(), "subscribe", {"rate_hz": 50.0}) is not None
    assert world.server.events(world.now_ns, lambda: {"a": bytes(1200)}) == []
    world.now_ns += 20 * MS
    assert world.server.events(world.now_ns, lambda: {"a": object()}) == []
    assert world.server.counters["events_too_long"] == 1
    assert world.server.counters["events_unencodable"] == 1


# --- everything at once -------------------------------------------------------------------


@given(st.binary(max_size=1300))
def test_any_datagram_gets_silence_at_either_end(data: bytes) -> None:
    world = World()
    client = world.client()
    assert world.deliver(data, client_address(client)) == []
    assert client.on_datagram(data, world.now_ns) is None
    assert world.done == []


@given(st.binary(max_size=1162), st.sampled_from(FrameType), st.integers(0, 70))
def test_any_genuine_payload_gets_an_answer_or_silence_and_never_an_error(
    payload: bytes, kind: FrameType, sequence: int
) -> None:
    world = World()
    client = world.client()
    assert world.ask(client, "status") is not None
    keys: SessionKeys = client._keys  # type: ignore[assignment]
    body = frame_body(kind, ALICE.id, client._session, sequence, payload)
    replies = world.deliver(keys.to_server.seal(body), client_address(client))
    assert len(replies) == (kind is FrameType.REQUEST and sequence > 1)
    client.on_datagram(keys.to_client.seal(body), world.now_ns)


@given(st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_on_a_bad_network_every_order_is_carried_out_once_at_most_and_in_time(seed: int) -> None:
    """Loss, duplication, reordering, delay and damage between two clients and a server."""
    dice = random.Random(seed)
    world = World((ALICE, BOB))
    clients = [world.client(ALICE), world.client(BOB)]
    made: dict[tuple[str, int], int] = {}
    carried: list[tuple[str, int]] = []

    def handle(op: str, params: object, role: str, who: str) -> dict[str, object]:
        number = params["values"]["n"]  # type: ignore[index]
        carried.append((who, number))
        assert world.now_ns <= made[who, number] + MS
        return {}

    world.handle = handle
    wire: list[tuple[int, bytes, CommandClient]] = []
    for number in range(60):
        which = dice.randrange(2)
        client, who = clients[which], ("alice", "bob")[which]
        made[who, number] = world.now_ns + 100 * MS
        frame = client.request("set", {"values": {"n": number}}, made[who, number]).frame
        wire += [
            (world.now_ns + dice.randrange(250) * MS, frame, client)
            for _ in range(dice.randrange(4))
        ]
        world.now_ns += 10 * MS
        for due in sorted((item for item in wire if item[0] <= world.now_ns), key=lambda i: i[0]):
            wire.remove(due)
            data = bytearray(due[1])
            if dice.random() < 0.1:
                data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
            answered(world, bytes(data), due[2])
    assert len(carried) == len(set(carried))
    for who in ("alice", "bob"):
        numbers = [number for name, number in carried if name == who]
        assert numbers == sorted(numbers)
