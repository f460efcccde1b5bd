"""Tables of docs/commission-steps.md: the time of each step, and what wrong mountings gave."""

from collections.abc import Callable, Mapping
from typing import Any

Result = dict[str, Any]
Load = Callable[[str], Result]

STEPS, MOUNTINGS = "commission-steps", "commission-mountings"
COMMANDS = {
    STEPS: "python -m linemate.simulators.lab.commissioning.step_times",
    MOUNTINGS: "python -m linemate.simulators.lab.commissioning.wrong_mountings",
}
NOT_MEASURED = "Not measured yet: `make results NAME={}`."


def rows(raw: Result) -> Result:
    """Return the rows as they were measured."""
    return {"rows": raw["rows"]}


def steps(load: Load, is_stored: Callable[[str], bool]) -> str:
    """Return a row for each step: seconds of the cell and of the processor."""
    if not is_stored(STEPS):
        return NOT_MEASURED.format(STEPS)
    by_step = _by(load(STEPS)["rows"], "step")
    heads = ("step", "wheel: cell, s", "computing, s", "kr10: cell, s", "computing, s", "result")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for step, cells in by_step.items():
        times: list[str] = []
        for name in ("wheel", "kr10"):
            row = cells.get(name)
            times += ["", ""] if row is None else [_seconds(row), f"{row['processor_s']:.1f}"]
        lines.append(f"| `{step}` | {' | '.join(times)} | {_outcome(cells)} |")
    return "\n".join(lines)


def _seconds(row: Result) -> str:
    """Return how long the cell was recorded, and in how many recordings."""
    if not row["recordings"]:
        return ""
    several = f" ({row['recordings']} recordings)" if row["recordings"] > 1 else ""
    return f"{row['recorded_s']:.0f}{several}"


def _outcome(cells: Mapping[str, Result]) -> str:
    refused = [f"{name} refused: {row['reason']}" for name, row in cells.items()
               if not row["measured"]]  # fmt: skip
    return "; ".join(refused) or "measured"


def mountings(load: Load, is_stored: Callable[[str], bool]) -> str:
    """Return a row for each mounting: how far off the truth the result is, or the refusal."""
    if not is_stored(MOUNTINGS):
        return NOT_MEASURED.format(MOUNTINGS)
    by_what = _by(load(MOUNTINGS)["rows"], "mounting")
    lines = ["| mounted wrongly | step | wheel | kr10 |", "|---|---|---|---|"]
    for what, cells in by_what.items():
        step = next(iter(cells.values()))["step"]
        cells_text = [
            _result_text(cells[name]) if name in cells else "" for name in ("wheel", "kr10")
        ]
        lines.append(f"| {what} | `{step}` | {' | '.join(cells_text)} |")
    return "\n".join(lines)


def _result_text(row: Result) -> str:
    if "refused" in row:
        return f"refused, {'an overlay' if row['written'] else 'nothing'} written: {row['refused']}"
    off = [f"{value:.2g} {unit} off" for unit, value in row["off"].items()]
    return ", ".join(["found", *off])


def _by(listed: list[Result], key: str) -> dict[str, dict[str, Result]]:
    """Return the rows by a key, and of each its cells by name."""
    rows: dict[str, dict[str, Result]] = {}
    for row in listed:
        rows.setdefault(row[key], {})[row["cell"]] = row
    return rows
