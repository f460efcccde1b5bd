"""The board: the newest for everybody, and one who does not read loses only his own."""

import asyncio
import json
from typing import Any

import pytest

from linemate.daemon.view.broadcast_hub import (
    ONLOOKERS,
    REMEMBERED,
    WAITING,
    Board,
    FullError,
    event,
)


def events_of(data: bytes) -> list[tuple[str, Any]]:
    found = []
    for block in data.decode().split("\n\n")[:-1]:
        name, told = block.split("\n")
        found.append((name.removeprefix("event: "), json.loads(told.removeprefix("data: "))))
    return found


def test_who_comes_later_is_told_what_is_known() -> None:
    async def main() -> None:
        board = Board()
        board.tell("scene", {"task": "wheel"})
        board.tell("status", {"health": "old"})
        board.tell("status", {"health": "healthy"})
        for k in range(3):
            board.frame({"k": k})
        board.happened([[1, 5_000_000_000, "state: idle"]])
        with board.looking() as onlooker:
            told = events_of(await onlooker.take())
        assert told == [
            ("scene", {"task": "wheel"}),
            ("status", {"health": "healthy"}),
            ("history", [{"k": 0}, {"k": 1}, {"k": 2}]),
            ("happened", {"t": 5.0, "text": "state: idle", "missed": 0}),
        ]

    asyncio.run(main())


def test_one_who_does_not_read_loses_the_oldest_and_it_is_counted() -> None:
    async def main() -> None:
        board = Board()
        with board.looking() as slow, board.looking() as quick:
            await slow.take()
            for k in range(WAITING + 10):
                await quick.take()
                board.frame({"k": k})
            assert slow.dropped == 10
            assert quick.dropped == 0
            taken = [told["k"] for _, told in events_of(await slow.take())]
            assert taken == list(range(10, WAITING + 10))
        assert board.dropped == 10
        assert board.onlookers == 0

    asyncio.run(main())


def test_memory_has_an_end() -> None:
    async def main() -> None:
        board = Board()
        for k in range(REMEMBERED + 50):
            board.frame({"k": k})
        with board.looking() as onlooker:
            (history,) = [told for name, told in events_of(await onlooker.take())]
        assert len(history) == REMEMBERED
        assert history[0] == {"k": 50}
        assert board.frames == REMEMBERED + 50

    asyncio.run(main())


def test_happenings_are_shown_once_and_a_gap_is_told() -> None:
    async def main() -> None:
        board = Board()
        with board.looking() as onlooker:
            await onlooker.take()
            board.happened([[4, 0, "a"], [5, 0, "b"]])
            board.happened([[5, 0, "b"], [6, 0, "c"]])
            board.happened([[9, 0, "d"], [10, 0, "e"]])
            told = [one for _, one in events_of(await onlooker.take())]
        assert [one["text"] for one in told] == ["a", "b", "c", "d", "e"]
        assert [one["missed"] for one in told] == [0, 0, 0, 2, 0]

    asyncio.run(main())


def test_too_many_onlookers_are_refused_and_a_place_is_given_back() -> None:
    board = Board()
    places = [board.looking() for _ in range(ONLOOKERS)]
    for place in places:
        place.__enter__()
    with pytest.raises(FullError), board.looking():
        pass
    places[0].__exit__(None, None, None)
    with board.looking():
        assert board.onlookers == ONLOOKERS


def test_what_is_no_number_is_left_out_and_stays_json() -> None:
    board = Board()
    board.frame({"speed": float("nan"), "arm": [[float("inf"), 1.0]]})
    assert events_of(board._known())[0] == ("history", [{"speed": None, "arm": [[None, 1.0]]}])


def test_an_event_is_one_of_the_servers_sent() -> None:
    assert event("frame", b"{}") == b"event: frame\ndata: {}\n\n"
