"""Rows of text from a result, for the terminal and the page.

Invariants:
    It reads what ``result.json`` has.
    A missing value prints as a dash, never as zero.
    Limits are applied in ``judge`` only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

DASH = "\N{EN DASH}"
ERRORS = {
    "control_error": "control (tcp to committed x_c)",
    "plan_error": "plan (x_c to sensed x_f)",
    "prediction_error": "prediction (x_f to true hub)",
    "total_error": "total (tcp to true hub)",
}
WINDOWS = ("approach", "stop", "impact", "contact", "restart", "quiet")


@dataclass(frozen=True, slots=True)
class ResultTable:
    """One titled table of text; `head` and every row have the same length."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def number(value: object, digits: int = 2) -> str:
    """Print a number with fixed digits; None and anything else not a number give a dash."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value:  # noqa: PLR0124 -- NaN
        return DASH
    return f"{value:.{digits}f}" if isinstance(value, float) else str(value)


def error_rows(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """List every window of every error: name, window, max mm, rms mm, max mrad, rms mrad."""
    rows: list[tuple[str, ...]] = []
    for key, name in ERRORS.items():
        windows = {name: span for name, span in (result.get(key) or {}).items() if span}
        known = [window for window in WINDOWS if window in windows]
        for window in known + [window for window in windows if window not in WINDOWS]:
            figures = (windows[window].get(k) for k in ("max_mm", "rms_mm", "max_mrad", "rms_mrad"))
            rows.append((name, window, *(number(figure, 3) for figure in figures)))
            name = ""  # noqa: PLW2901 -- a name heads its group once
    return rows


def tables(result: Mapping[str, Any]) -> tuple[ResultTable, ...]:
    """Cut a result into its tables: errors, detection, telegrams, times."""
    detection = tuple(
        (
            str(entry.get("event", DASH)),
            number(entry.get("onset_s")),
            number(entry.get("perceived_s"), 3),
            number(entry.get("confirmed_s"), 3),
        )
        for entry in result.get("detection") or ()
    )
    telegrams = result.get("telegrams") or {}
    alarms = result.get("false_alarms") or {}
    result_tables = [
        ResultTable(
            "Errors",
            ("error", "window", "max mm", "rms mm", "max mrad", "rms mrad"),
            tuple(error_rows(result)),
        ),
        ResultTable(
            "Detection, latency after onset",
            ("event", "onset s", "perceived s", "confirmed s"),
            detection,
        ),
        ResultTable(
            "False alarms",
            ("tentative", "confirmed"),
            ((number(alarms.get("tentative")), number(alarms.get("confirmed"))),),
        ),
        ResultTable(
            "Telegrams, as the controller counted them",
            tuple(telegrams),
            (tuple(number(count) for count in telegrams.values()),) if telegrams else (),
        ),
        ResultTable("Times", ("what", "p50 us", "p99 us", "p99.9 us", "max us"), time_rows(result)),
    ]
    return tuple(table for table in result_tables if table.rows)


def time_rows(result: Mapping[str, Any]) -> tuple[tuple[str, ...], ...]:
    """List turn-around and computing time where the result has them [us]."""
    names = {"turnaround_us": "turn-around at the controller", "step_us": "one step, computing"}
    return tuple(
        (name, *(number(result[key].get(q), 0) for q in ("p50", "p99", "p999", "max")))
        for key, name in names.items()
        if result.get(key)
    )


def outcome_line(result: Mapping[str, Any]) -> str:
    """Say in one line how the run ended."""
    ended = "assembled" if result.get("assembled") else f"NOT assembled: {result.get('outcome')}"
    if result.get("reason"):
        ended += f" ({result['reason']})"
    if result.get("assembled") and result.get("within_limits") is not None:
        missed = "; ".join(map(str, result.get("shortfalls") or ()))
        ended += " within limits" if result["within_limits"] else f", NOT within limits: {missed}"
    return (
        f"{ended}; {answers(result)}; scenario {result.get('scenario', DASH)}, "
        f"seed {result.get('seed', DASH)}, {number(result.get('cycle_ms'), 0)} ms, "
        f"{number(result.get('duration_s'), 1)} s"
    )


def answers(result: Mapping[str, Any]) -> str:
    """Say how many telegrams got no good reply in time, and how many are tolerated."""
    telegrams = result.get("telegrams") or {}
    tolerated = telegrams.get("tolerated")
    bound = "" if tolerated is None else f" ({tolerated} tolerated)"
    kinds = ((kind, telegrams.get(kind) or 0) for kind in ("late", "lost", "refused"))
    counts = [f"{count} {kind}" for kind, count in kinds if count] or ["0 late"]
    return f"replies: {', '.join(counts)}{bound}"


def notes(result: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the remarks of a run: what failed, what this host lacks."""
    return tuple(str(note) for note in result.get("notes") or ())


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Align columns: the first two left where they hold words, figures to the right."""
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    words = [
        any(row[i] and not is_figure(row[i]) for row in rows) or not rows for i in range(len(head))
    ]
    return [
        "  ".join(
            cell.ljust(width) if word else cell.rjust(width)
            for cell, width, word in zip(row, widths, words, strict=True)
        ).rstrip()
        for row in (head, *rows)
    ]


def is_figure(cell: str) -> bool:
    """Return whether a text is a number or a missing one: figures stand to the right."""
    return cell == DASH or cell.replace(".", "", 1).lstrip("-").isdigit()


def plain(result: Mapping[str, Any]) -> str:
    """Print a whole result as plain text."""
    lines = [outcome_line(result)]
    for table in tables(result):
        lines += ["", table.title, *(f"  {line}" for line in aligned(table.head, table.rows))]
    if notes(result):
        lines += ["", *(f"note: {note}" for note in notes(result))]
    return "\n".join(lines)
