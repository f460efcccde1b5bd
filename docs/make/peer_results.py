"""Table of docs/interop.md: programs of others that drove linemate, or that it drove."""

from collections.abc import Callable
from typing import Any

Result = dict[str, Any]
Load = Callable[[str], Result]

COMMANDS = {"peers": "python -m tests.system.peers"}
HEADS = (
    "peer",
    "runs against",
    "idle",
    "motion",
    "cycles",
    "unanswered",
    "refused",
    "load",
    "file",
)


def rows(raw: Result) -> Result:
    """Return the rows as they were counted."""
    return {"rows": raw["rows"]}


def table(load: Load) -> str:
    """Return a row for each peer."""
    lines = ["| " + " | ".join(HEADS) + " |", "|---" * len(HEADS) + "|"]
    for row in load("peers")["rows"]:
        cells = (
            row["peer"], row["against"], *("yes" if row[name] else "" for name in HEADS[2:4]),
            row["cycles"], row["unanswered"], row["refused"], f"{row['load_1min']:.1f}",
            f"`tests/system/{row['file']}`",
        )  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)
