"""Tables of ``docs/results/accuracy.md``: figures and their bars as Markdown.

Invariants:
    Pure: figures in, text out.
    A bar counts as met only on the verification seeds.
    A missing figure counts as missed, not as zero.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from linemate.simulators.judge.statistics import describe, interval_text
from linemate.simulators.lab.cases import ABLATIONS, CASES, NOMINAL, WRONG

Run = Mapping[str, float | bool | None]
"""Figures of one run by their dotted names, and "assembled"."""

Runs = Mapping[str, Mapping[str, Sequence[Run]]]
"""Runs by case, then by group: "tuned", "verify"."""

Detection = Mapping[str, Mapping[str, Any]]
"""What ``campaign --detection`` found, by cycle and classifier, e.g. "12 default"; then by kind."""

GROUPS = ("tuned", "verify")
CONTROLLED = ("approach", "stop", "contact", "restart")
WITHIN = 1.5
"""Models wrong may cost this factor."""


@dataclass(frozen=True, slots=True)
class Bar:
    """What is asked: bounds of the median and of the worst seed, and what is aimed at."""

    median: float | None = None
    worst: float | None = None
    aim: str = ""

    def text(self) -> str:
        """Print it as "<= median (worst)"."""
        if self.median is None:
            return "" if self.worst is None else f"worst ≤ {self.worst:g}"
        return f"≤ {self.median:g}" + (f" ({self.worst:g})" if self.worst is not None else "")

    def holds(self, figure: Mapping[str, Any]) -> bool:
        """Return whether a figure keeps it; None in a figure is an infinity."""
        pairs = ((figure["median"], self.median), (figure["worst"], self.worst))
        return all(
            bound is None or (value is not None and value <= bound) for value, bound in pairs
        )


@dataclass(frozen=True, slots=True)
class Claim:
    """One row of the first table: a figure of a case and its bar."""

    label: str
    case: str
    figure: str
    bar: Bar


CLAIMS = (
    Claim("control, approach to restart, mm", "wheel", "control.max_mm", Bar(None, 0.3, "0.1")),
    Claim("same, mrad", "wheel", "control.max_mrad", Bar(None, 0.5, "0.25")),
    Claim(
        "total after a stop in the approach, mm", "wheel", "total_error.stop.max_mm",
        Bar(2.4, 3.4, "1.7 (2.6)"),
    ),
    Claim(
        "total at impact, stop 0.8 s earlier, mm", "wheel", "total_error.impact.max_mm",
        Bar(0.3, 0.6, "0.18 (0.45)"),
    ),
    Claim(
        "total in contact, stop, mm", "stop-in-contact", "total_error.stop.max_mm",
        Bar(1.2, None, "0.95"),
    ),
    Claim(
        "total in contact, restart, mm", "wheel", "total_error.restart.max_mm",
        Bar(0.5, None, "0.35"),
    ),
    Claim(
        "total in quiet contact, mm", "no-stop", "total_error.quiet.max_mm",
        Bar(0.15, None, "0.08"),
    ),
    Claim("contact force, N", "wheel", "contact_force_n.max", Bar()),
    Claim("same, stop in contact, N", "stop-in-contact", "contact_force_n.max", Bar()),
    Claim(
        "total after a stop, 4 ms, mm", "wheel-4ms", "total_error.stop.max_mm",
        Bar(1.8, 2.3, "1.3 (1.8)"),
    ),
    Claim("control, 4 ms, mm", "wheel-4ms", "control.max_mm", Bar(None, 0.3, "0.1")),
    Claim(
        "total after a stop, sensor of 0.1 mm, mm", "fine", "total_error.stop.max_mm",
        Bar(1.5, 1.8, "1.2"),
    ),
    Claim(
        "same at 4 ms, mm", "fine-4ms", "total_error.stop.max_mm", Bar(1.0, 1.2, "0.8"),
    ),
    Claim("true future known: control, mm", "oracle", "control.max_mm", Bar(None, 0.06, "0.04")),
    Claim("true future known: total, mm", "oracle", "total.max_mm", Bar(None, 0.12, "0.08")),
    Claim("the paper's rule: control, mm", "rule", "control.max_mm", Bar(None, 0.5)),
    Claim("the paper's rule: total after a stop, mm", "rule", "total_error.stop.max_mm", Bar(3.2)),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Asked:
    """One row of the table of detection: where it is found, its bar, and how to print it."""

    label: str
    source: str
    kind: str
    path: tuple[str, ...]
    bar: float
    aim: str
    sense: Literal["most", "least"] = "most"


_STOP, _START = ("stop", "perceived_s"), ("start", "perceived_s")
_STOPPED, _STARTED = ("stop", "confirmed_s"), ("start", "confirmed_s")
_FALSE_STOPS = ("false_per_hour", "stop", "confirmed")
_FALSE_STARTS = ("false_per_hour", "start", "confirmed")

ASKED = (
    Asked("stop perceived, s", "12 default", "free", _STOP, 0.16, "0.15"),
    Asked("stop confirmed, s", "12 default", "free", _STOPPED, 0.18, "0.165"),
    Asked("false stops, /h", "12 default", "free", _FALSE_STOPS, 1.0, "0.1"),
    Asked("start perceived, s", "12 default", "free", _START, 0.40, "0.345"),
    Asked("start confirmed, s", "12 default", "free", _STARTED, 0.45, "0.365"),
    Asked("false starts, /h", "12 default", "free", _FALSE_STARTS, 1.0, "0.1"),
    Asked("4 ms: stop perceived, s", "4 default", "free", _STOP, 0.14, ""),
    Asked("4 ms: stop confirmed, s", "4 default", "free", _STOPPED, 0.15, ""),
    Asked("4 ms: false stops, /h", "4 default", "free", _FALSE_STOPS, 1.0, "0.1"),
    Asked("4 ms: start perceived, s", "4 default", "free", _START, 0.33, ""),
    Asked("4 ms: start confirmed, s", "4 default", "free", _STARTED, 0.36, ""),
    Asked("4 ms: false starts, /h", "4 default", "free", _FALSE_STARTS, 1.0, "0.1"),
    Asked("contact: stop confirmed, s", "12 default", "contact", _STOPPED, 0.14, "0.10"),
    Asked("contact: false stops, /h", "12 default", "contact", _FALSE_STOPS, 0.5, "0.1"),
    Asked(
        "jerks not taken for a stop", "12 default", "jerk", ("not_taken", "share"), 0.98, "0.995",
        "least",
    ),
    Asked(
        "slow pushes not taken for a stop", "12 default", "push", ("not_taken", "share"), 0.98,
        "0.995", "least",
    ),
)  # fmt: skip


# Figures of runs


def value(run: Run, name: str) -> float:
    """Return a run's figure; ``control.max_mm`` is the largest over all windows.

    Returns:
        Infinity where the run did not give it: a run cut short has no largest.
    """
    kind, _, measure = name.partition(".")
    if kind in {"control", "total"}:
        if not run["assembled"]:
            return math.inf
        maxima = [run.get(f"{kind}_error.{window}.{measure}") for window in CONTROLLED]
        known = [float(maximum) for maximum in maxima if maximum is not None]
        return max(known, default=math.inf)
    maximum = run.get(name)
    return math.inf if maximum is None else float(maximum)


def _described(runs: Sequence[Run], figure: str) -> dict[str, Any]:
    return describe([value(run, figure) for run in runs])


def _runs(runs: Runs, case: str, group: str) -> Sequence[Run]:
    return runs.get(case, {}).get(group, ())


def _judging(runs: Runs, case: str) -> Sequence[Run]:
    """Return the runs that a bar is judged by."""
    return _runs(runs, case, "verify")


# Tables


def tables(runs: Runs, detection: Detection) -> str:
    """All tables as Markdown, those that have no figures left out."""
    parts = [
        ("Figures and bars", claims(runs)),
        ("Runs", assembled(runs)),
        ("Detection", asked(detection)),
        ("Classifiers", classifiers(detection)),
        ("Models wrong, each alone", wrong(runs)),
        ("The four errors apart", apart(runs)),
        ("Without", ablations(runs)),
        ("Commands", commands(runs)),
    ]
    return "\n\n".join(f"## {title}\n\n{text}" for title, text in parts if text)


def bars_met(runs: Runs, detection: Detection) -> list[tuple[str, bool]]:
    """Return every bar that has been measured, and whether it holds."""
    bars = [
        (claim.label, claim.bar.holds(_described(_judging(runs, claim.case), claim.figure)))
        for claim in CLAIMS
        if claim.bar.text() and _judging(runs, claim.case)
    ]
    measured = ((bar, _figures_of(detection, bar)) for bar in ASKED)
    bars += [(bar.label, _holds(bar, figure)) for bar, figure in measured if figure is not None]
    return bars + [
        (WRONG[case].label, _ratio_holds(runs, case)) for case in WRONG if _comparable(runs, case)
    ]


def claims(runs: Runs) -> str:
    """The first table: median, interval and worst of both groups next to the bar."""
    rows = []
    for claim in CLAIMS:
        groups = [_runs(runs, claim.case, group) for group in GROUPS]
        if not any(groups):
            continue
        cells = [
            cell(_described(runs_of_group, claim.figure)) if runs_of_group else "–"
            for runs_of_group in groups
        ]
        met = ""
        if claim.bar.text() and groups[1]:
            met = _word(claim.bar.holds(_described(groups[1], claim.figure)))
        rows.append((claim.label, *cells, claim.bar.text(), claim.bar.aim, met))
    return markdown(("figure", "tuned on", "verified", "bar", "aim", "met"), rows)


def assembled(runs: Runs) -> str:
    """How many runs of each case assembled, and what else must be nothing."""
    rows = []
    for case, groups in runs.items():
        every = [run for group in GROUPS for run in groups.get(group, ())]
        if not every:
            continue
        counts = [
            f"{sum(bool(run['assembled']) for run in groups[group])} of {len(groups[group])}"
            if groups.get(group)
            else "–"
            for group in GROUPS
        ]
        limits = sum(value(run, "limits.violations") for run in every)
        alarms = sum(value(run, "false_alarms.confirmed") for run in every)
        rows.append((CASES[case].label, *counts, f"{limits:g}", f"{alarms:g}"))
    head = ("case", "assembled, tuned on", "assembled, verified", "limits violated", "false alarms")
    return markdown(head, rows)


def asked(detection: Detection) -> str:
    """Detection of the default classifier next to its bars."""
    rows = []
    for bar in ASKED:
        figures = _figures_of(detection, bar)
        if figures is None:
            continue
        sign = "≤" if bar.sense == "most" else "≥"
        met = _word(_holds(bar, figures))
        rows.append((bar.label, _figure(figures), f"{sign} {bar.bar:g}", bar.aim, met))
    return markdown(("figure", "found", "bar", "aim", "met"), rows)


def _figures_of(detection: Detection, bar: Asked) -> Mapping[str, Any] | None:
    figures: Any = detection.get(bar.source, {}).get(bar.kind)
    if figures is None:
        return None
    for part in bar.path[:-1] if bar.path[-1] == "share" else bar.path:
        figures = figures.get(part)
        if figures is None:
            return None
    figure: Mapping[str, Any] = figures
    return figure


def _holds(bar: Asked, figures: Mapping[str, Any]) -> bool:
    number = next(figures[name] for name in ("share", "rate", "median") if name in figures)
    if number is None:
        return False
    return bool(number <= bar.bar if bar.sense == "most" else number >= bar.bar)


def _figure(figures: Mapping[str, Any]) -> str:
    from linemate.simulators.lab.detection import latency_cell, rate_cell

    if "share" in figures:
        return f"{figures['share']:.3f}{interval_text(figures['ci95'], '{:.3f}'.format)}"
    return rate_cell(figures) if "rate" in figures else latency_cell(figures)


def classifiers(detection: Detection) -> str:
    """All figures of detection, a column a cycle and classifier."""
    from linemate.simulators.lab.detection import LABELS, LEGEND, cells

    rows: list[tuple[str, ...]] = []
    for kind, label in LABELS.items():
        columns = [dict(cells(kinds.get(kind, {}))) for kinds in detection.values()]
        names = dict.fromkeys(name for column in columns for name in column)
        rows += [(f"{label}: {name}", *(each.get(name, "–") for each in columns)) for name in names]
    if not rows:
        return ""
    head = ("figure", *(source.replace(" ", " ms, ", 1) for source in detection))
    return f"{LEGEND}.\n\n{markdown(head, rows)}"


RATIOS = (
    ("control", "control.max_mm"),
    ("total, stop", "total_error.stop.max_mm"),
    ("total, impact", "total_error.impact.max_mm"),
    ("total, contact", "total_error.contact.max_mm"),
    ("total, restart", "total_error.restart.max_mm"),
)


def wrong(runs: Runs) -> str:
    """Medians of the cases with a wrong model, and their ratio to nominal on the same seeds."""
    rows = []
    for case in WRONG:
        judged = _judging(runs, case)
        if not judged:
            continue
        figures = [_described(judged, name) for _, name in RATIOS]
        comparable = _comparable(runs, case)
        ratios = _ratios(runs, case) if comparable else [None] * len(RATIOS)
        texts = [
            cell(figure) + (f" ×{ratio:.2f}" if ratio is not None else "")
            for figure, ratio in zip(figures, ratios, strict=True)
        ]
        met = _word(_ratio_holds(runs, case)) if comparable else ""
        rows.append((WRONG[case].label, *texts, met))
    if not rows:
        return ""
    nominal = _nominal(runs, next(case for case in WRONG if _judging(runs, case)))
    if nominal:
        first = [cell(_described(nominal, name)) for _, name in RATIOS]
        rows.insert(0, ("nominal, the same seeds", *first, ""))
    head = ("wrong", *(f"{label}, mm" for label, _ in RATIOS), f"assembled, within ×{WITHIN:g}")
    return markdown(head, rows)


def _nominal(runs: Runs, case: str) -> Sequence[Run]:
    return _judging(runs, NOMINAL)[: len(_judging(runs, case))]


def _comparable(runs: Runs, case: str) -> bool:
    judged = _judging(runs, case)
    return bool(judged) and len(_nominal(runs, case)) == len(judged)


def _ratios(runs: Runs, case: str) -> list[float | None]:
    """Return the medians' ratios to nominal; None where nominal has no median."""
    ratios: list[float | None] = []
    for _, name in RATIOS:
        mine = _described(_judging(runs, case), name)["median"]
        theirs = _described(_nominal(runs, case), name)["median"]
        if not theirs:
            ratios.append(None)
        else:
            ratios.append(math.inf if mine is None else mine / theirs)
    return ratios


def _ratio_holds(runs: Runs, case: str) -> bool:
    done = all(bool(run["assembled"]) for run in _judging(runs, case))
    return done and all(ratio is None or ratio <= WITHIN for ratio in _ratios(runs, case))


def apart(runs: Runs) -> str:
    """The four errors of the default scenario, window by window."""
    judged = _judging(runs, NOMINAL)
    if not judged:
        return ""
    windows = ("approach", "stop", "impact", "contact", "restart")
    rows = [
        (
            kind,
            measure,
            *(cell(_described(judged, f"{kind}_error.{w}.max_{measure}")) for w in windows),
        )
        for kind in ("control", "plan", "prediction", "total")
        for measure in ("mm", "mrad")
    ]
    return markdown(("error", "", *windows), rows)


def ablations(runs: Runs) -> str:
    """What each part of the method is worth."""
    names = (
        ("control, mm", "control.max_mm"),
        ("total, stop, mm", "total_error.stop.max_mm"),
        ("total, impact, mm", "total_error.impact.max_mm"),
        ("total, contact, mm", "total_error.contact.max_mm"),
        ("total, restart, mm", "total_error.restart.max_mm"),
    )
    rows = []
    for case in (NOMINAL, "oracle", "rule", *ABLATIONS):
        judged = _judging(runs, case)
        if judged:
            done = f"{sum(bool(run['assembled']) for run in judged)} of {len(judged)}"
            figures = (cell(_described(judged, name)) for _, name in names)
            rows.append((CASES[case].label, done, *figures))
    if len(rows) < 2:
        return ""
    return markdown(("case", "assembled", *(label for label, _ in names)), rows)


def commands(runs: Runs) -> str:
    """What one types to see a case, ``--first-seed 1000 --seeds N`` added."""
    rows = [(CASES[case].label, f"`{CASES[case].command()}`") for case in runs]
    return markdown(("case", "command"), rows)


# Text


def cell(figure: Mapping[str, Any]) -> str:
    """Print "median [95 % interval] (worst)"; a dash for what was not there in a run."""
    interval = interval_text(figure["ci95"], number)
    return f"{number(figure['median'])}{interval} ({number(figure['worst'])})"


def number(value: float | None) -> str:
    """Print three significant digits, a dash for None."""
    return "–" if value is None else f"{value:.3g}"


def _word(held: bool) -> str:
    return "yes" if held else "**no**"


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Print a table; nothing without rows."""
    lines = [_line(row) for row in rows]
    if not lines:
        return ""
    return "\n".join([_line(head), _line(["---"] * len(head)), *lines])


def _line(cells: Sequence[str]) -> str:
    escape: Callable[[str], str] = lambda text: text.replace("|", "\\|")  # noqa: E731
    return "| " + " | ".join(map(escape, cells)) + " |"
