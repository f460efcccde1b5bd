"""``linemate-sim campaign --detection HOURS``: latencies and false alarms of a classifier.

Invariants:
    The result does not depend on the number of workers.
    Rate of false stops: per hour of running; of false starts: per hour of standing.
    The latency of a missed event is infinite.
"""

import math
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.stats import chi2

from linemate.simulators.harness.setup import Setup
from linemate.simulators.judge.statistics import CONFIDENCE, describe, interval_text, share
from linemate.simulators.lab import detection_runs
from linemate.simulators.lab.detection_runs import DetectionRun, Kind, Tally
from linemate.simulators.lab.worker_pool import progress_bar, spread

STRETCH_S = 900.0
"""Length of one run: short enough that all cores have work."""

TRIED = 200
"""Restarts, jerks and pushes that are tried in an hour or more; fewer in less."""

EACH_S = {"restart": 39.0, "jerk": 12.1, "push": 12.1}
"""How long one of them takes on average, to plan the time [s]."""

TAIL = 0.95


@dataclass(frozen=True, slots=True)
class DetectionPlan:
    """Kinds, hours and seeds of the runs.

    Attributes:
        hours: of virtual time, of ``free`` and of ``contact`` each.
    """

    setups: Sequence[Setup]
    hours: float
    first_seed: int = 0
    kinds: tuple[Kind, ...] = detection_runs.KINDS

    def runs(self) -> Iterator[DetectionRun]:
        """Cut the time into runs, each with its own seed."""
        for setup in self.setups:
            for kind in self.kinds:
                whole_s = self.hours * 3600.0
                if kind in EACH_S:
                    whole_s = EACH_S[kind] * TRIED * min(1.0, self.hours)
                count = math.ceil(whole_s / STRETCH_S)
                for i in range(count):
                    yield DetectionRun(kind, setup, self.first_seed + i, whole_s / count)


def main(args: Namespace) -> int:
    """Run what the arguments say and print the result.

    Args:
        args: detection (hours), first_seed, scenario, variants, overrides, cycle_ms, workers,
            scheduler, json, out.
    """
    from linemate.simulators.harness import setup
    from linemate.simulators.harness.cell import cell_files
    from linemate.simulators.judge import report_json

    cell = cell_files.chosen(args)
    scenario = cell_files.scenario(args.scenario, cell)
    setups = [
        setup.make(scenario, args.overrides, variant=variant, cycle_ms=args.cycle_ms, cell=cell)
        for variant in args.variants
    ]
    plan = DetectionPlan(setups, args.detection, args.first_seed)
    with progress_bar(len(list(plan.runs())), "detection") as progress:
        whole = execute(plan, args.workers, progress, args.scheduler)
    if args.out is not None:
        report_json.write(args.out / "detection.json", whole)
    print(report_json.text(whole) if args.json else table(whole))
    return 0


def execute(
    plan: DetectionPlan,
    workers: int | None = None,
    progress: Any = lambda: None,
    scheduler: str = "local",
) -> dict[str, Any]:
    """Run a plan.

    Returns:
        ``{"version": 1, "detection": {variant: {kind: figures}}}``.
    """
    jobs = list(plan.runs())
    tallies = spread(detection_runs.run, jobs, workers, progress, scheduler)
    tallied: dict[str, dict[str, Tally]] = {}
    for job, tally in zip(jobs, tallies, strict=True):
        kinds = tallied.setdefault(job.setup.variant, {})
        kinds.setdefault(job.kind, Tally()).add(tally)
    return {
        "version": 1,
        "detection": {
            variant: {kind: figures(kind, tally) for kind, tally in kinds.items()}
            for variant, kinds in tallied.items()
        },
    }


# Figures


def figures(kind: str, tally: Tally) -> dict[str, Any]:
    """Figures of one kind of run, ready for JSON."""
    if kind in {"jerk", "push"}:
        return {"made": tally.pushed["made"], **_confusion(tally.pushed)}
    result: dict[str, Any] = {
        "hours": {name: round(tally.seconds[name] / 3600.0, 4) for name in ("running", "standing")}
    }
    for event in ("stop", "start"):
        if tally.perceived[event]:
            result[event] = {
                "perceived_s": latencies(tally.perceived[event]),
                "confirmed_s": latencies(tally.confirmed[event]),
            }
    if kind != "restart":
        result["false_per_hour"] = {
            event: {
                what: rate(tally.false[event, what], tally.seconds[state] / 3600.0)
                for what in ("tentative", "confirmed")
            }
            for event, state in (("stop", "running"), ("start", "standing"))
        }
        result["corrections"] = tally.corrections
    return result


def _confusion(pushed: Mapping[str, int]) -> dict[str, Any]:
    pushes = pushed["made"]
    if not pushes:
        return {}
    shares = {}
    for name, word in (("not_suspected", "suspected"), ("not_taken", "taken")):
        hits = pushes - pushed[word]
        detected = share([i < hits for i in range(pushes)])
        shares[name] = {"share": detected["median"], "ci95": detected["ci95"]}
    return shares


def latencies(values: Sequence[float]) -> dict[str, Any]:
    """Median with its interval, tail, worst, how many there were and how many were missed."""
    description = describe(values)
    ordered = sorted(values)
    tail = ordered[math.ceil(TAIL * len(ordered)) - 1]
    return {
        "median": description["median"],
        "ci95": description["ci95"],
        "p95": round(tail, 6) if math.isfinite(tail) else None,
        "worst": description["worst"],
        "n": len(values),
        "missed": sum(math.isinf(value) for value in values),
    }


def rate(count: int, hours: float) -> dict[str, Any]:
    """Events an hour with their exact Poisson interval.

    Source: Garwood (1936): the bounds are chi-square quantiles at 2 n and 2 n + 2 degrees.
    """
    if hours <= 0.0:
        return {"rate": None, "ci95": [None, None], "count": count}
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = 0.5 * float(chi2.ppf(tail, 2 * count)) if count else 0.0
    high = 0.5 * float(chi2.ppf(1.0 - tail, 2 * count + 2))
    return {
        "rate": round(count / hours, 4),
        "ci95": [round(low / hours, 4), round(high / hours, 4)],
        "count": count,
    }


# Text


LEGEND = (
    "latencies: median [95 % interval] (95th percentile; worst), missed of all; "
    "rates: an hour [95 % interval] (count)"
)

LABELS = {
    "free": "distance sensor alone",
    "contact": "in contact, distance and force",
    "restart": "restart while stopping",
    "jerk": "jerks in contact",
    "push": "slow pushes in contact",
}


def table(whole: Mapping[str, Any]) -> str:
    """All figures as text: a row a figure, a column a variant."""
    from linemate.simulators.judge.table import aligned

    variants = whole["detection"]
    lines: list[str] = []
    for kind, label in LABELS.items():
        measured = {name: kinds[kind] for name, kinds in variants.items() if kind in kinds}
        columns = {name: dict(cells(column)) for name, column in measured.items()}
        names = list(dict.fromkeys(name for column in columns.values() for name in column))
        rows = [(name, *(column.get(name, "-") for column in columns.values())) for name in names]
        if rows:
            lines += [*aligned((label, *columns), rows), ""]
    return "\n".join([*lines, LEGEND])


def cells(kinds: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Name and print every figure of one kind of run."""
    if "hours" in kinds:
        hours = kinds["hours"]
        yield "hours running, standing", f"{hours['running']:.2f}, {hours['standing']:.2f}"
    for event in ("stop", "start"):
        for name, value in kinds.get(event, {}).items():
            yield f"{event} {name.removesuffix('_s')} s", latency_cell(value)
    for event, rates in kinds.get("false_per_hour", {}).items():
        for what, value in rates.items():
            yield f"false {event}s {what} /h", rate_cell(value)
    if "made" in kinds:
        yield "made", str(kinds["made"])
    for name in ("not_suspected", "not_taken"):
        if name in kinds:
            interval = interval_text(kinds[name]["ci95"], _percent)
            shown = f"{_percent(kinds[name]['share'])}{interval}"
            yield f"{name.replace('_', ' ')} for a stop %", shown


def latency_cell(value: Mapping[str, Any]) -> str:
    """One latency as text."""
    interval = interval_text(value["ci95"], _number)
    tail = f"({_number(value['p95'])}; {_number(value['worst'])})"
    return f"{_number(value['median'])}{interval} {tail}, {value['missed']} of {value['n']}"


def rate_cell(value: Mapping[str, Any]) -> str:
    """One rate as text."""
    if value["rate"] is None:
        return "-"
    low, high = value["ci95"]
    return f"{value['rate']:.2f} [{low:.2f}, {high:.2f}] ({value['count']})"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
