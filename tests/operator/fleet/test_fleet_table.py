"""Rows of several stations: newest message, hostile messages, text."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linemate.daemon.operator.fleet.fleet_table import (
    HEAD,
    MOST_BYTES,
    MOST_STATIONS,
    WIDEST,
    fleet_rows,
    fleet_table,
)


def message(station: str, time_s: float = 100.0, **status: Any) -> bytes:
    data = {"health": "healthy", "state": "idle", "task": "wheel", "complaints": []} | status
    return json.dumps({"version": 1, "station": station, "time_s": time_s, "data": data}).encode()


def test_stations_stand_in_the_order_of_their_names_each_with_its_newest_message() -> None:
    production = {"part": {"part": "P7"}, "counts": {"good": 3, "bad": 1}}
    rows, unreadable = fleet_rows(
        [
            message("west", 99.0, state="track", in_sync=True, late=2, production=production),
            message("east", health="degraded", complaints=["link camera is silent", "x"]),
            message("west", 98.0),
        ],
        100.0,
    )
    assert unreadable == 0
    east, west = rows
    assert east["station"] == "east"
    assert east["complaint"] == "link camera is silent"
    found = [west[name] for name in ("state", "part", "in sync", "good", "bad", "late", "age s")]
    assert found == ["track", "P7", True, 3, 1, 2, 1.0]
    lines = fleet_table(rows).splitlines()
    assert lines[0].split()[0] == "station"
    assert len(lines) == 3
    assert "link camera is silent" in lines[1]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff",
        b"[]",
        b"{}",
        b'{"station": 1, "time_s": 1, "data": {}}',
        b'{"station": "a", "time_s": true, "data": {}}',
        b'{"station": "a", "time_s": 1, "data": []}',
        b'{"station": "a", "time_s": NaN, "data": {}}',
        b'{"station": "a", "time_s": 1' + b"0" * 400 + b', "data": {}}',
        b"[" * 100_000,
        message("a", task="x" * MOST_BYTES),
    ],
)
def test_a_message_that_cannot_be_read_is_counted(data: bytes) -> None:
    assert fleet_rows([data, message("b")], 100.0)[1] == 1


def test_rows_and_cells_are_bounded_and_have_no_control_characters() -> None:
    many = [message(f"s{n:04d}") for n in range(MOST_STATIONS + 10)]
    assert len(fleet_rows(many, 0.0)[0]) == MOST_STATIONS
    rows, _ = fleet_rows([message("a", state="\x1b[2J\n" + "y" * 100)], 0.0)
    text = fleet_table(rows)
    assert "\x1b" not in text
    assert len(text.splitlines()) == 2
    assert max(map(len, text.split("  "))) <= WIDEST + 2


values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=5,
)
names = st.sampled_from(["health", "state", "complaints", "production", "in_sync", "late"])


@given(st.dictionaries(names, values))
def test_any_status_gives_a_row(status: dict[str, Any]) -> None:
    rows, _ = fleet_rows([message("a", **status)], 0.0)
    assert set(rows[0]) == set(HEAD)
    assert len(fleet_table(rows).splitlines()) == 2
