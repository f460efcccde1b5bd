"""Table of the realistic world: a line a row, "median (worst)" over its seeds.

Invariants:
    Pure: figures in, text out.
    A missed detection counts as infinite.
    Alarms and missed changes are sums over the seeds.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from linemate.simulators.judge.statistics import describe_seeds, seed_text
from linemate.simulators.judge.table import aligned

OUTCOMES = ("assembled", "held", "retreated", "collision", "fault")
SPREAD = (
    ("control_rms_mm", "control rms"),
    ("control_mm", "control"),
    ("impact_mm", "impact mm"),
    ("stop_mm", "stop mm"),
    ("start_s", "start s"),
    ("force_n", "force N"),
    ("oscillation_mm", "osc. mm"),
    ("energy_j", "energy J"),
)
SUMS = (
    ("false_tentative", "tentative"),
    ("false_confirmed", "false confirmed"),
    ("missed", "missed"),
)
LEGEND = (
    "median (worst) over the seeds; control: in the last second before contact, against the true"
    " tcp, mm; osc.: half of the range that the hub moves against the tcp within a second of"
    " contact; energy: largest that the robot has given to the car; tentative, false confirmed,"
    " missed: sums; -: not in every run"
)

Run = Mapping[str, Any]


def summarise(runs: Sequence[Run]) -> dict[str, Any]:
    """Return seeds, outcomes, spread figures and sums of the runs of one row.

    A figure names the seed of its worst run, a sum the seeds that it is not 0 of.
    """
    seeds = seed_text(run["seed"] for run in runs)
    summary: dict[str, Any] = {"runs": len(runs), "seeds": seeds}
    summary |= {name: sum(run["outcome"] == name for run in runs) for name in OUTCOMES}
    for name, _ in SPREAD:
        by_seed = {run["seed"]: run[name] for run in runs}
        if name == "start_s":
            by_seed = {seed: math.inf if s is None else s for seed, s in by_seed.items()}
        by_seed = {seed: value for seed, value in by_seed.items() if value is not None}
        summary[name] = describe_seeds(by_seed) if by_seed else None
    for name, _ in SUMS:
        summary[name] = sum(run[name] for run in runs)
        summary[f"{name}_seeds"] = seed_text(run["seed"] for run in runs if run[name])
    return summary


def text(whole: Mapping[str, Any]) -> str:
    """Print the table, and below it why runs did not assemble."""
    head = ("row", "runs", "outcome", *(label for _, label in (*SPREAD, *SUMS)))
    lines = aligned(head, [_line(name, row["summary"]) for name, row in whole["rows"].items()])
    reasons = [
        f"{name} seed {run['seed']}: {run['outcome']}: {run['reason']}"
        for name, row in whole["rows"].items()
        for run in row["runs"]
        if run["outcome"] != "assembled"
    ]
    return "\n".join([*lines, "", LEGEND, *reasons])


def _line(name: str, summary: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        name,
        str(summary["runs"]),
        outcomes(summary),
        *(spread(summary[key]) for key, _ in SPREAD),
        *(str(summary[key]) for key, _ in SUMS),
    )


def outcomes(summary: Mapping[str, Any]) -> str:
    """Return e.g. ``2 assembled, 1 held``."""
    return ", ".join(f"{summary[name]} {name}" for name in OUTCOMES if summary[name])


def spread(figure: Mapping[str, Any] | None) -> str:
    """Return "median (worst)", or a dash."""
    if figure is None:
        return "-"
    return f"{_number(figure['median'])} ({_number(figure['worst'])})"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
