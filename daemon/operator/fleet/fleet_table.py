"""Rows of several stations from what their bridges answer.

Invariants:
- Pure: bytes in, values out. A message that cannot be read is left out and counted.
- At most ``MOST_STATIONS`` rows. No cell has control characters or more than ``WIDEST`` of any.
"""

import json
from collections.abc import Iterable, Mapping
from typing import Any, Final

from linemate.daemon.operator.render import scalar, table

MOST_STATIONS: Final = 256
MOST_BYTES: Final = 1 << 18  # of a message
WIDEST: Final = 48
LATEST_S: Final = 1e12  # of a Unix time [s]
HEAD: Final = (
    "station", "health", "state", "task", "part", "in sync", "good", "bad", "late", "age s",
    "complaint",
)  # fmt: skip

Row = dict[str, Any]


def fleet_rows(messages: Iterable[bytes], now_s: float) -> tuple[list[Row], int]:
    """Return a row a station in the order of their names, and how many messages were unreadable.

    Of several messages of one station the newest counts.

    Args:
        messages: JSON that bridges answer to ``linemate/STATION/status``, newest or not.
        now_s: Unix time that ages count from [s].
    """
    newest: dict[str, Mapping[str, Any]] = {}
    unreadable = 0
    for data in messages:
        message = _read(data)
        if message is None:
            unreadable += 1
            continue
        name, time_s = message["station"], message["time_s"]
        if name in newest and newest[name]["time_s"] >= time_s:
            continue
        if name in newest or len(newest) < MOST_STATIONS:
            newest[name] = message
    return [_row(newest[name], now_s) for name in sorted(newest)], unreadable


def _read(data: bytes) -> Mapping[str, Any] | None:
    if len(data) > MOST_BYTES:
        return None
    try:
        message = json.loads(data)
    except (ValueError, RecursionError):
        return None
    if not isinstance(message, dict) or not isinstance(message.get("data"), dict):
        return None
    is_whole = isinstance(message.get("station"), str) and _is_time(message.get("time_s"))
    return message if is_whole else None


def _is_time(value: object) -> bool:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and 0.0 <= value < LATEST_S  # type: ignore[operator]


def _row(message: Mapping[str, Any], now_s: float) -> Row:
    status = message["data"]
    production = _map(status.get("production"))
    counts = _map(production.get("counts"))
    complaints = status.get("complaints")
    is_list = isinstance(complaints, list) and complaints
    return {
        "station": message["station"],
        "health": status.get("health"),
        "state": status.get("state"),
        "task": status.get("task"),
        "part": _map(production.get("part")).get("part"),
        "in sync": status.get("in_sync"),
        "good": counts.get("good"),
        "bad": counts.get("bad"),
        "late": status.get("late"),
        "age s": round(max(0.0, now_s - float(message["time_s"])), 1),
        "complaint": complaints[0] if is_list else None,
    }


def _map(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def fleet_table(rows: Iterable[Row]) -> str:
    """Return the rows as text."""
    return table(HEAD, [[_cell(row[name]) for name in HEAD] for row in rows])


def _cell(value: object) -> str:
    text = scalar(value)
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 1]}…"
