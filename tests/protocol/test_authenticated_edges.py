"""The command protocol's table of sessions at its edges, with the specification's numbers."""

import pytest
from command_ends import MS, START_NS, S, World, client_address, key_of

from linemate.protocol.command.authenticated import CommandClient
from linemate.protocol.command.frame_codec import Role, cut_frame

ALICE, BOB = key_of(), key_of("bob", Role.VIEW, seed=2)


def test_a_key_with_two_sessions_gives_one_to_a_key_that_has_none() -> None:
    keys = tuple(key_of(f"k{n}", seed=n + 10) for n in range(8))
    world = World(keys)
    clients = [world.client(key) for key in (keys[0], *keys[:7])]
    for client in clients:
        assert world.ask(client, "status") is not None
        world.now_ns += MS
    assert world.server.sessions == 8
    assert world.ask(world.client(keys[7]), "status") is not None
    assert world.server.sessions == 8
    assert world.server.counters["sessions_evicted"] == 1
    assert [world.ask(client, "status") is not None for client in clients] == [False] + [True] * 7


@pytest.mark.parametrize(("silent_ns", "idle"), [(60 * S, 0), (60 * S + 1, 1)])
def test_a_session_is_idle_after_more_than_a_minute_of_silence(silent_ns: int, idle: int) -> None:
    world = World((ALICE, BOB))
    assert world.ask(world.client(ALICE), "status") is not None
    world.now_ns += silent_ns
    assert world.ask(world.client(BOB), "status") is not None
    assert world.server.counters["sessions_idle"] == idle
    assert world.server.sessions == 2 - idle


@pytest.mark.parametrize(("later_ns", "is_buried"), [(20 * S - 1, True), (20 * S, False)])
def test_an_ended_session_cannot_begin_again_for_20_s(later_ns: int, is_buried: bool) -> None:
    world = World((ALICE,))
    client = world.client()
    assert world.ask(client, "status") is not None
    closing = client.close()
    assert closing is not None
    assert world.deliver(closing, client_address(client)) == []
    assert world.server.counters["sessions_closed"] == 1
    assert world.server.sessions == 0
    world.now_ns += later_ns
    # The recorded session's cookie is too old by then, too: nothing is answered either way.
    assert world.ask(client, "status") is None
    assert world.server.counters["dropped_tombstoned"] == is_buried


def test_an_ended_session_is_remembered_when_an_older_one_is_forgotten() -> None:
    world = World((ALICE,))
    clients = []
    for _ in range(2):
        clients.append(world.client())
        assert world.ask(clients[-1], "status") is not None
        closing = clients[-1].close()
        assert closing is not None
        world.deliver(closing, client_address(clients[-1]))
        world.now_ns += 10 * S
    assert world.ask(clients[1], "status") is None
    assert world.server.counters["dropped_tombstoned"] == 1
    assert world.ask(clients[0], "status") is None
    assert world.server.counters["dropped_tombstoned"] == 1


def test_each_session_of_a_key_that_is_taken_away_is_counted() -> None:
    world = World((ALICE, BOB))
    for key in (ALICE, ALICE, BOB):
        assert world.ask(world.client(key), "status") is not None
    world.server.replace_keys([BOB])
    assert world.server.counters["sessions_revoked"] == 2
    assert world.server.sessions == 1


def test_1024_ended_sessions_of_a_key_are_remembered_and_no_more_are_begun() -> None:
    world = World((ALICE, BOB))
    for _ in range(1024):
        client = world.client(ALICE)
        assert world.ask(client, "status") is not None
        closing = client.close()
        assert closing is not None
        world.deliver(closing, client_address(client))
    assert world.ask(world.client(ALICE), "status") is None
    assert world.server.counters["dropped_tombstones_full"] == 1
    assert world.server.counters["hellos"] == 1025
    assert world.ask(world.client(BOB), "status") is not None


@pytest.mark.parametrize(
    ("made_ns", "used_ns", "is_taken"),
    [
        (0, 20 * S - 1, True),
        (0, 20 * S, False),
        (10 * S - 1, 20 * S - 1, True),
        (10 * S - 1, 20 * S, False),
        (10 * S, 20 * S, True),
    ],
)
def test_a_cookie_holds_to_the_end_of_the_next_ten_seconds(
    made_ns: int, used_ns: int, is_taken: bool
) -> None:
    world = World((ALICE,))
    assert START_NS % (10 * S) == 0
    world.now_ns = START_NS + made_ns
    client = world.client()
    world.now_ns = START_NS + used_ns
    assert (world.ask(client, "status") is not None) is is_taken


def test_events_are_numbered_from_one() -> None:
    world = World((ALICE,))
    client: CommandClient = world.client()
    assert world.ask(client, "subscribe", {"rate_hz": 10.0}) is not None
    numbers = []
    for _ in range(3):
        world.now_ns += 101 * MS
        for data, address in world.server.events(world.now_ns, dict):
            assert address == client_address(client)
            numbers.append(cut_frame(data).sequence)
    assert numbers == [1, 2, 3]
