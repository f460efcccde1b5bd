"""Text and JSON of a daemon's answers: tables, scalars, and the screen of ``status --watch``.

Invariants:
    * Values in, strings out: nothing is asked for and nothing is printed here.
    * A screen has at most WIDTH columns and HEIGHT lines.
    * Neither a screen nor a table has control characters.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

VERSION: Final = 1  # of what ``--json`` prints: keys are only added to it
WIDTH: Final = 80
HEIGHT: Final = 24
MIN_COMPLAINTS: Final = 1  # lines that complaints have on the smallest screen
MAX_LINKS: Final = 6

Status = Mapping[str, Any]


def as_json(value: object, indent: int | None = 2) -> str:
    """Return ``value`` as JSON. Numbers that JSON does not have become null."""
    import json  # A status as text needs none.

    return json.dumps(_plain(value), indent=indent, sort_keys=False, allow_nan=False)


def versioned(answer: Status, indent: int | None = 2) -> str:
    """Return an answer as JSON with its version: its own if it has one."""
    return as_json({"version": VERSION, **answer}, indent)


def _plain(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return value.hex()
    return value


def scalar(value: object) -> str:
    """Return a value as a person reads it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(scalar(item) for item in value) + "]"
    return str(value)


def printable(text: str) -> str:
    """Return a text without control characters: names come from files and from the network."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def rows(value: Status, above: str = "") -> list[tuple[str, str]]:
    """Return a nested map as rows ``dotted.name, value`` in its own order."""
    listed: list[tuple[str, str]] = []
    for name, item in value.items():
        path = f"{above}{name}"
        if isinstance(item, Mapping) and item:
            listed += rows(item, f"{path}.")
        else:
            listed.append((path, scalar(item) if item != {} else "-"))
    return listed


def table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    """Return columns as wide as their widest cell, with two blanks between them."""
    lines = [list(head)] if head else []
    lines += ([printable(cell) for cell in row] for row in body)
    if not lines:
        return ""
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


# --- the screen of ``status --watch`` -----------------------------------------------------


def screen(
    status: Status | None, trouble: str = "", width: int = WIDTH, height: int = HEIGHT
) -> list[str]:
    """Return the lines of a screen, the most important ones first.

    Args:
        status: The newest answer, None before the first one.
        trouble: Why no answer comes now, empty if one came.
        width: Columns of the terminal; at most WIDTH are used.
        height: Lines of the terminal; at most HEIGHT are used.
    """
    width, height = min(width, WIDTH), min(height, HEIGHT)
    head = [f"NO ANSWER  {trouble}"] if trouble else []
    if status is None:
        return _cut(head or ["asking ..."], width, height)
    head += _head(status)
    complaints = [f"  {text}" for text in (*status.get("complaints", ()),)]
    body = ["", *_task(status), "", *_links(status), *_foot(status)]
    space = max(MIN_COMPLAINTS, height - len(head) - len(body))
    if len(complaints) > space:
        complaints[space - 1 :] = [f"  and {len(complaints) - space + 1} more, see --all"]
    return _cut([*head, *complaints, *body], width, height)


def _cut(lines: Sequence[str], width: int, height: int) -> list[str]:
    return [_shortened(printable(line), width) for line in lines[:height]]


def _shortened(line: str, width: int) -> str:
    return line if len(line) <= width else f"{line[: max(0, width - 3)]}..."[:width]


def _head(status: Status) -> Iterator[str]:
    uptime_s = status.get("uptime_s")
    uptime = "-" if uptime_s is None else _clock(float(uptime_s))
    yield f"{scalar(status.get('task'))}   pid {scalar(status.get('pid'))}   up {uptime}"
    cause = status.get("cause") or status.get("because") or ""
    yield f"{str(status.get('state', '-')).upper():9} {cause}".rstrip()
    yield f"health    {scalar(status.get('health'))}"


def _clock(seconds: float) -> str:
    minutes, second = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{second:02}"


def _task(status: Status) -> Iterator[str]:
    waiting = f"   waiting: {status['ready']}" if status.get("ready") else ""
    clock = _number(status.get("task_time"), 1.0, "s", 2)
    yield f"phase     {scalar(status.get('phase'))}   task clock {clock}{waiting}"
    conveyor = f"{scalar(status.get('scenario'))} {status.get('scenario_state') or ''}".rstrip()
    odds = _number(status.get("confidence"), 1.0, "", 1)
    speed = _number(status.get("speed"), 1e3, "mm/s", 0)
    yield f"conveyor  {conveyor}   {speed}   log odds {odds}"
    flags = [name for name in ("contact", "overload") if status.get(name)]
    held = f"held: {status['held']}" if status.get("held") else "not held"
    yield f"tool      {', '.join(flags) or 'no contact'}   {held}"
    if status.get("waiting"):
        yield f"waiting   {status['waiting']}"
    plan, gap = (_distance_mm(status, a, b) for a, b in (("target", "sensed"), ("target", "part")))
    drift = _number((status.get("dead_time") or {}).get("drift_ms"), 1.0, "ms", 1)
    drifted = "" if drift == "-" else f"   dead time drifted by {drift}"
    yield f"errors    plan {plan}   tool to part {gap}{drifted}"
    turnaround = status.get("turnaround_us") or {}
    p99, longest = (_number(turnaround.get(key), 1e-3, "ms", 2) for key in ("p99", "max"))
    period = _number((status.get("clock") or {}).get("period_ms"), 1.0, "ms", 2)
    late, missing = scalar(status.get("late")), scalar(status.get("missing"))
    yield f"deadline  late {late}   missing {missing}   reply p99 {p99}, max {longest} of {period}"


def _number(value: object, factor: float, unit: str, digits: int) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "-"
    return f"{value * factor:.{digits}f} {unit}".rstrip()


def _distance_mm(status: Status, first: str, second: str) -> str:
    a, b = status.get(first), status.get(second)
    if not a or not b:
        return "-"
    return _number(math.dist(a[:3], b[:3]), 1e3, "mm", 2)


def _links(status: Status) -> list[str]:
    links: Status = status.get("links") or {}
    sensors: Status = status.get("sensors") or {}
    body = [
        (
            str(name),
            "up" if link.get("up") else "DOWN",
            _number(link.get("rate_hz"), 1.0, "Hz", 0),
            _number(link.get("age_s"), 1e3, "ms", 0),
            str(_excluded(sensors.get(name)) or link.get("reason") or ""),
        )
        for name, link in [*links.items()][:MAX_LINKS]
    ]
    return table(("link", "is", "rate", "age", "note"), body).splitlines()


def _excluded(sensor: Status | None) -> str:
    return f"excluded: {sensor['out']}" if sensor and sensor.get("out") else ""


def _foot(status: Status) -> Iterator[str]:
    recording = status.get("recording") or {}
    if recording.get("recording"):
        name = str(recording.get("file")).rpartition("/")[2]
        counts = (
            f"{scalar(recording.get('written'))} steps, {scalar(recording.get('dropped'))} dropped"
        )
        yield f"recording {name}: {counts}"
    refusals = len(status.get("host") or ())
    if refusals:
        yield f"host      {refusals} requests refused, see linemate doctor"
    yield "--all shows every key   Ctrl-C ends"
