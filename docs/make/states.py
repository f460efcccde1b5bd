"""The diagram of the operating states, drawn from the table: ``python -m docs.make.states``.

Law of this file: the table in ``daemon/cycle/states.py`` is the only source. It writes between
two marks of ``docs/reliability.md`` and touches nothing else; a test holds both in step.
"""

from pathlib import Path

from linemate.daemon.cycle.states import TABLE, State

PAGE = Path(__file__).resolve().parents[1] / "reliability.md"
BEGIN, END = "<!-- states: begin -->", "<!-- states: end -->"


def diagram() -> str:
    """The table as a mermaid diagram, and each row in its order below it."""
    edges: dict[tuple[State, State], list[str]] = {}
    for row in TABLE:
        edges.setdefault((row.source, row.target), []).append(row.because)
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {State.INIT.upper()}"]
    for (source, target), reasons in edges.items():
        lines.append(f"    {source.upper()} --> {target.upper()}: {', '.join(reasons)}")
    lines += ["```", "", "| from | to | because | |", "|---|---|---|---|"]
    for row in TABLE:
        marks = [name for name in ("latches", "programmed") if getattr(row, name)]
        lines.append(
            f"| {row.source.upper()} | {row.target.upper()} | {row.because} | {', '.join(marks)} |"
        )
    return "\n".join(lines)


def drawn(page: str) -> str:
    """The page with the diagram as the table has it now."""
    head, _, rest = page.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n{diagram()}\n{END}{tail}"


if __name__ == "__main__":
    PAGE.write_text(drawn(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
