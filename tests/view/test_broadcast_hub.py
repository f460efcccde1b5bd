"""The broadcast hub: its history, its slow subscribers, and its limits."""

import asyncio
import json
from typing import Any

import pytest

from linemate.daemon.view.broadcast_hub import (
    HISTORY,
    MAX_SUBSCRIBERS,
    QUEUE_LENGTH,
    BroadcastHub,
    FullError,
    encode_event,
)


def events_of(data: bytes) -> list[tuple[str, Any]]:
    found = []
    for block in data.decode().split("\n\n")[:-1]:
        name, data = block.split("\n")
        found.append((name.removeprefix("event: "), json.loads(data.removeprefix("data: "))))
    return found


def test_a_new_subscriber_receives_what_is_known() -> None:
    async def main() -> None:
        hub = BroadcastHub()
        hub.publish("scene", {"task": "wheel"})
        hub.publish("status", {"health": "old"})
        hub.publish("status", {"health": "healthy"})
        for k in range(3):
            hub.push_frame({"k": k})
        hub.push_events([[1, 5_000_000_000, "state: idle"]])
        with hub.subscribe() as subscriber:
            data = events_of(await subscriber.drain())
        assert data == [
            ("scene", {"task": "wheel"}),
            ("status", {"health": "healthy"}),
            ("history", [{"k": 0}, {"k": 1}, {"k": 2}]),
            ("happened", {"t": 5.0, "text": "state: idle", "missed": 0}),
        ]

    asyncio.run(main())


def test_a_slow_subscriber_drops_its_oldest_messages_which_are_counted() -> None:
    async def main() -> None:
        hub = BroadcastHub()
        with hub.subscribe() as slow, hub.subscribe() as quick:
            await slow.drain()
            for k in range(QUEUE_LENGTH + 10):
                await quick.drain()
                hub.push_frame({"k": k})
            assert slow.dropped == 10
            assert quick.dropped == 0
            taken = [data["k"] for _, data in events_of(await slow.drain())]
            assert taken == list(range(10, QUEUE_LENGTH + 10))
        assert hub.dropped == 10
        assert hub.subscribers == 0

    asyncio.run(main())


def test_the_history_is_bounded() -> None:
    async def main() -> None:
        hub = BroadcastHub()
        for k in range(HISTORY + 50):
            hub.push_frame({"k": k})
        with hub.subscribe() as subscriber:
            (history,) = [data for name, data in events_of(await subscriber.drain())]
        assert len(history) == HISTORY
        assert history[0] == {"k": 50}
        assert hub.frames == HISTORY + 50

    asyncio.run(main())


def test_events_are_sent_once_and_with_the_number_of_missed_ones() -> None:
    async def main() -> None:
        hub = BroadcastHub()
        with hub.subscribe() as subscriber:
            await subscriber.drain()
            hub.push_events([[4, 0, "a"], [5, 0, "b"]])
            hub.push_events([[5, 0, "b"], [6, 0, "c"]])
            hub.push_events([[9, 0, "d"], [10, 0, "e"]])
            data = [one for _, one in events_of(await subscriber.drain())]
        assert [one["text"] for one in data] == ["a", "b", "c", "d", "e"]
        assert [one["missed"] for one in data] == [0, 0, 0, 2, 0]

    asyncio.run(main())


def test_too_many_subscribers_are_refused_until_one_leaves() -> None:
    hub = BroadcastHub()
    places = [hub.subscribe() for _ in range(MAX_SUBSCRIBERS)]
    for place in places:
        place.__enter__()
    with pytest.raises(FullError), hub.subscribe():
        pass
    places[0].__exit__(None, None, None)
    with hub.subscribe():
        assert hub.subscribers == MAX_SUBSCRIBERS


def test_a_value_that_is_not_finite_becomes_null() -> None:
    hub = BroadcastHub()
    hub.push_frame({"speed": float("nan"), "arm": [[float("inf"), 1.0]]})
    assert events_of(hub._known())[0] == ("history", [{"speed": None, "arm": [[None, 1.0]]}])


def test_an_event_is_one_of_the_servers_sent() -> None:
    assert encode_event("frame", b"{}") == b"event: frame\ndata: {}\n\n"
