"""Tables and figure of docs/accuracy.md: by lag of the controller, by cycle, by family.

``python -m docs.make.lag_results`` draws docs/lag.png from the stored results.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

Result = dict[str, Any]
Load = Callable[[str], Result]
Has = Callable[[str], bool]

FILE = Path(__file__).resolve().parents[1] / "lag.png"
COMMAND = "python -m linemate.simulators.lab.lag"
CURVE, TOUCH = "lag-curve", "cycles-touch"
COMMANDS = {
    CURVE: f"{COMMAND} --curve --touch --seeds 4",
    TOUCH: f"{COMMAND} --cycles --touch --seeds 4",
    "lag": f"{COMMAND} --seeds 40",
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
STOP = "total_error.stop.max_mm"
DECELERATION = 0.104  # of the conveyor [m/s^2]
SEEN_S = 0.15  # a stop is seen after this long [s]
REFERENCE_MS = "4"  # cycle with which the others are compared
CONTROL = "control_error.approach.max_mm"
COLUMNS = (
    ("control error, approach, mm", CONTROL),
    ("total error after a stop, mm", STOP),
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
    """Return a row for each cycle of runs until the touch, with its control error over 4 ms'."""
    if not has(TOUCH):
        return _not_measured(TOUCH)
    rows = load(TOUCH)
    shown, reference = COLUMNS[:3], rows[REFERENCE_MS][CONTROL]["median"]
    head = [f"[cycle, ms](results/{TOUCH}.json)", "runs", *(label for label, _ in shown),
            f"control error over that of {REFERENCE_MS} ms"]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for label, row in rows.items():
        cells = [str(row["runs"]), *(_cell(row.get(key)) for _, key in shown)]
        ratio = f"{row[CONTROL]['median'] / reference:.2f}"
        lines.append("| " + " | ".join([label, *cells, ratio]) + " |")
    return "\n".join(lines)


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


def by_curve(load: Load, has: Has) -> str:
    """Return a row for each dead time of the figure: measured and by the law of the stop."""
    if not has(CURVE):
        return _not_measured(CURVE)
    head = [f"[dead time, ms](results/{CURVE}.json)", *(label for label, _ in COLUMNS[:3]),
            "a t^2 / 2, mm", "t without the dead time, s"]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for label, row in load(CURVE).items():
        lag_s, stop_mm = 1e-3 * float(label), row[STOP]["median"]
        after_s = (2e-3 * stop_mm / DECELERATION) ** 0.5 - lag_s
        cells = [label, *(_cell(row.get(key)) for _, key in COLUMNS[:3]),
                 f"{law_mm(lag_s):.2f}", f"{after_s:.3f}"]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def law_mm(lag_s: float) -> float:
    """Return how far a conveyor lags that stops, until what was seen of it is acted upon [mm]."""
    return 1e3 * 0.5 * DECELERATION * (SEEN_S + lag_s) ** 2


def draw(load: Load) -> Any:
    """Return the figure: total error after a stop by dead time, measured and by the law."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = load(CURVE)
    lags = [float(label) for label in rows]
    figure = Figure(figsize=(7.0, 3.6), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    law = f"a t$^2$/2, a = {DECELERATION:g} m/s$^2$, t = {SEEN_S:g} s + dead time"
    axis.plot(lags, [law_mm(1e-3 * lag) for lag in lags], "--", color="gray", label=law)
    for key, style, name in (("median", "o-", "median"), ("worst", "^:", "worst run")):
        axis.plot(lags, [row[STOP][key] for row in rows.values()], style, label=f"measured, {name}")
    axis.set_xlabel("dead time of the slowest axis, ms")
    axis.set_ylabel("total error after a stop, mm")
    axis.set_ylim(bottom=0.0)
    axis.grid(alpha=0.3)
    axis.legend()
    return figure


if __name__ == "__main__":
    from docs.make import results

    draw(results.load).savefig(FILE, metadata={"Software": None})
