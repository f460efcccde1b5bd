"""Tables of docs/accuracy.md: by lag of the controller, by cycle, by family of the controller."""

from collections.abc import Callable, Mapping
from typing import Any

Result = dict[str, Any]
Load = Callable[[str], Result]
Has = Callable[[str], bool]

COMMAND = "python -m linemate.simulators.lab.lag"
COMMANDS = {
    "lag": f"{COMMAND} --seeds 4",
    "cycles": f"{COMMAND} --seeds 4 --cycles",
}
FAMILIES = {
    "campaign": "KUKA RSI, 12 ms",
    "campaign-fanuc": "FANUC, 8 ms",
    "campaign-egm": "ABB EGM, 4 ms",
}
CAMPAIGNS = {
    "campaign-fanuc": "linemate-sim campaign --seeds 40 --controller fanuc --json",
    "campaign-egm": "linemate-sim campaign --seeds 40 --controller egm --json",
}
REFERENCE_MS = "4"  # cycle with which the others are compared
CONTROL = "control_error.approach.max_mm"
COLUMNS = (
    ("control error, approach, mm", CONTROL),
    ("total error after a stop, mm", "total_error.stop.max_mm"),
    ("total error at impact, mm", "total_error.impact.max_mm"),
    ("contact force, N", "contact_force_n.max"),
    ("violations of limits", "limits.violations"),
)


def rows(raw: Result) -> Result:
    """Return the figures of each lag or cycle."""
    figures: Result = raw["rows"]
    return figures


def by_lag(load: Load, has: Has) -> str:
    """Return a row for each dead time."""
    return _table(load, has, "lag", "dead time, ms")


def by_cycle(load: Load, has: Has) -> str:
    """Return a row for each cycle, with its control error over that of 4 ms."""
    if not has("cycles"):
        return _not_measured("cycles")
    result = load("cycles")
    reference = result[REFERENCE_MS][CONTROL]["median"]
    head = f"control error over that of {REFERENCE_MS} ms"
    return _table(
        load,
        has,
        "cycles",
        "cycle, ms",
        head,
        lambda row: f"{row[CONTROL]['median'] / reference:.2f}",
    )


def by_family(load: Load, has: Has) -> str:
    """Return a row for each family of controllers."""
    stored = [name for name in FAMILIES if has(name)]
    lines = _head("controller")
    for name in stored:
        row = load(name)["default"]
        lines.append(_line(f"[{FAMILIES[name]}](results/{name}.json)", row))
    return "\n".join(lines)


def _not_measured(name: str) -> str:
    return f"Not measured yet: `make results NAME={name}`."


def _table(
    load: Load,
    has: Has,
    name: str,
    first: str,
    last: str | None = None,
    value: Callable[[Mapping[str, Any]], str] = lambda _: "",
) -> str:
    if not has(name):
        return _not_measured(name)
    lines = _head(f"[{first}](results/{name}.json)", last)
    for label, row in load(name).items():
        lines.append(_line(label, row) + (f" {value(row)} |" if last else ""))
    return "\n".join(lines)


def _head(first: str, last: str | None = None) -> list[str]:
    heads = [first, "assembled", *(label for label, _ in COLUMNS), *([last] if last else [])]
    return ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]


def _line(label: str, row: Mapping[str, Any]) -> str:
    cells = [label, f"{row['assembled']} of {row['runs']}"]
    cells += [_cell(row.get(key)) for _, key in COLUMNS]
    return "| " + " | ".join(cells) + " |"


def _cell(figure: Mapping[str, Any] | None) -> str:
    """Return "median (worst)"."""
    if figure is None or figure["worst"] is None:
        return "-"
    return f"{figure['median']:.3g} ({figure['worst']:.3g})"
