"""Diagram and table of the operating states in docs/states.md, from ``daemon/cycle/states.py``."""

from pathlib import Path

from linemate.daemon.cycle.states import TABLE, State

PAGE = Path(__file__).resolve().parents[1] / "states.md"
BEGIN, END = "<!-- states: begin -->", "<!-- states: end -->"


LONGEST_LABEL = 80


def label(reasons: list[str]) -> str:
    """Return an edge's label: as many reasons as fit, without their advice in brackets."""
    short = [reason.partition(" (")[0] for reason in reasons]
    kept = [
        reason
        for index, reason in enumerate(short)
        if len(", ".join(short[: index + 1])) <= LONGEST_LABEL
    ]
    more = len(short) - len(kept)
    return ", ".join([*kept, f"{more} more"] if more else kept)


def diagram() -> str:
    """Return a mermaid diagram, and a table with each row in its order."""
    edges: dict[tuple[State, State], list[str]] = {}
    for row in TABLE:
        edges.setdefault((row.source, row.target), []).append(row.because)
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {State.INIT.upper()}"]
    for (source, target), reasons in edges.items():
        lines.append(f"    {source.upper()} --> {target.upper()}: {label(reasons)}")
    lines += ["```", "", "| from | to | because | |", "|---|---|---|---|"]
    for row in TABLE:
        marks = [name for name in ("latches", "programmed") if getattr(row, name)]
        lines.append(
            f"| {row.source.upper()} | {row.target.upper()} | {row.because} | {', '.join(marks)} |"
        )
    return "\n".join(lines)


def drawn(page: str) -> str:
    """Return the page with the current diagram and table."""
    head, _, rest = page.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n{diagram()}\n{END}{tail}"
