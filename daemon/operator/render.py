"""What the operator's tool prints: plain text and JSON from what the daemon answered.

Law of this file: values in, strings out; nothing is asked, nothing is printed here.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final


def as_json(value: object, indent: int | None = 2) -> str:
    """Return ``value`` as JSON; numbers that JSON does not know become null."""
    import json  # a status as text needs none

    return json.dumps(_plain(value), indent=indent, sort_keys=False, allow_nan=False)


VERSION: Final = 1
"""Of what ``--json`` prints; it grows by keys, and changes when a key changes its meaning."""


def versioned(answer: Mapping[str, Any]) -> str:
    """Return an answer as JSON with its version, its own if it has one."""
    return as_json({"version": VERSION, **answer})


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


def rows(value: Mapping[str, Any], above: str = "") -> list[tuple[str, str]]:
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
    """Return columns as wide as their widest cell, two blanks between them."""
    lines = [list(head), *(list(row) for row in body)] if head else [list(row) for row in body]
    if not lines:
        return ""
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def parameter_rows(described: Iterable[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the rows of ``param list``: name, value, unit, default, whether live."""
    return [
        (
            str(item["name"]),
            scalar(item.get("value")),
            str(item.get("unit") or ""),
            scalar(item.get("default")),
            str(item.get("change") or ""),
        )
        for item in described
    ]


_WHEN = {
    "live": "at once, between two cycles",
    "idle": "while the robot stands idle",
    "restart": "with a restart, in the configuration file",
}


def difference_rows(described: Iterable[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the rows of ``param diff``: what is not as in the file, or not the default."""
    return [
        (
            str(item["name"]),
            scalar(item.get("value")),
            scalar(item.get("file", item.get("value"))),
            scalar(item.get("default")),
            str(item.get("unit") or ""),
            "unsaved" if item.get("unsaved") else "",
        )
        for item in described
        if item.get("value") != item.get("default")
        or item.get("value") != item.get("file", item.get("value"))
    ]


def description(item: Mapping[str, Any]) -> str:
    """Return the paragraph of ``param describe``."""
    unit = f" {item['unit']}" if item.get("unit") else ""
    lines = [f"{item['name']} = {scalar(item.get('value'))}{unit}"]
    if item.get("describe"):
        lines.append(f"  {item['describe']}")
    low, high = item.get("min"), item.get("max")
    if low is not None or high is not None:
        lines.append(f"  range    {scalar(low)} .. {scalar(high)}{unit}")
    lines.append(f"  default  {scalar(item.get('default'))}{unit}")
    if item.get("choices"):
        lines.append(f"  one of   {', '.join(map(scalar, item['choices']))}")
    if "file" in item and item["file"] != item.get("value"):
        lines.append(f"  file     {scalar(item['file'])}{unit}")
    when = _WHEN.get(str(item.get("change")), "")
    if item.get("in_contact") is False:
        when += ", not in contact"
    lines.append(f"  changes  {when}")
    if item.get("by"):
        kept = "not saved" if item.get("unsaved") else "saved"
        lines.append(f"  set by   {item['by']}, {kept}")
    return "\n".join(lines)
