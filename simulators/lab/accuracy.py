"""``make accuracy``: the runs and the tables of ``docs/results/accuracy.md``.

Invariants:
    Results replace the text between two marks of the page.
    A piece of work is stored under the digest of its sources, so an interrupted campaign
        goes on.
    A piece of other sources is not used.
"""

import argparse
import hashlib
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from linemate.daemon.command_line import one_thread
from linemate.daemon.config.documents import FileError
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.simulators.harness.cell import variants
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.cluster import digest
from linemate.simulators.harness.main import scheduler as parse_scheduler
from linemate.simulators.harness.setup import Setup, shipped_control
from linemate.simulators.judge import report_json
from linemate.simulators.lab import accuracy_tables
from linemate.simulators.lab.cases import ABLATIONS, CASES, TUNED, VERIFY, Case
from linemate.simulators.lab.detection_runs import Kind

PAGE = Path("docs/results/accuracy.md")
KEPT = Path("out/accuracy")
BEGIN, END = "<!-- tables: begin -->", "<!-- tables: end -->"
HEAD = "# Accuracy\n\n"

HOURS = 20.0
DETECTION: Mapping[str, tuple[Kind, ...]] = {
    "12 default": ("free", "contact", "restart", "jerk", "push"),
    "12 bank": ("free", "contact", "jerk", "push"),
    "12 imm": ("free", "contact", "jerk", "push"),
    "12 rule": ("free",),
    "4 default": ("free",),
}
"""Hours of each kind by cycle and classifier."""

SHORT = ("wheel", "oracle", "servo-0.9")
SHORT_DETECTION = ("12 default", "12 rule")
SHORT_HOURS = 0.02


@dataclass(frozen=True, slots=True)
class AccuracyPlan:
    """What is run.

    Attributes:
        seeds: of each group at most.
        hours: of each kind of detection run.
        own: seeds of a case, hours of a detection run, where they differ from those of all.
        overlay: identified parameters for all of them, or None.
    """

    cases: tuple[str, ...]
    sources: tuple[str, ...]
    seeds: int = len(VERIFY)
    hours: float = HOURS
    own: Mapping[str, float] = field(default_factory=dict)
    overlay: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class WorkPlace:
    """Where work is done and kept, and the digest of the sources that it is done with."""

    kept: Path
    sources: str
    workers: int | None = None
    scheduler: str = "local"


class ChangedError(SetupError):
    """Somebody edited what is being measured."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run what the arguments say and write the page.

    Returns:
        0; 1 with ``--check`` if a bar is not met; 2 what was asked for cannot be run.
    """
    args = _parser().parse_args(argv)
    one_thread()
    try:
        plan = _plan(args)
        where = WorkPlace(args.kept, digest(), args.workers, args.scheduler)
        runs, detection = gather(plan, where)
    except (SetupError, FileError) as error:
        print(f"accuracy: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    page = args.page or (args.kept / "short.md" if args.short else PAGE)
    write(page, page_text(plan, runs, detection))
    report_json.write(args.kept / "accuracy.json", {"runs": runs, "detection": detection})
    missed = [label for label, held in accuracy_tables.bars_met(runs, detection) if not held]
    print(f"{page}: {len(missed)} bars missed" + "".join(f"\n  {label}" for label in missed))
    return 1 if args.check and missed else 0


# Work


def gather(
    plan: AccuracyPlan, where: WorkPlace
) -> tuple[accuracy_tables.Runs, accuracy_tables.Detection]:
    """Do all that has not been done yet.

    Returns:
        Runs by case and group, and detection by cycle and classifier.

    Raises:
        SetupError: a case or the scheduler cannot be used.
    """
    runs: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for name in plan.cases:
        case = CASES[name]
        setup = case.setup(plan.overlay)
        for group, seeds in groups(case, int(plan.own.get(name, plan.seeds))).items():
            make = partial(_runs_of, setup, seeds, where)
            runs.setdefault(name, {})[group] = _piece(
                where, f"{name}-{group}", (setup, seeds), make
            )
    detection = {source: _detected(plan, source, where) for source in plan.sources}
    return runs, detection


def groups(case: Case, most: int) -> dict[str, Sequence[int]]:
    """Name the seeds of a case that may be tuned on, and those that only verify."""
    counts = {"tuned": (TUNED, case.tuned), "verify": (VERIFY, case.verify)}
    return {name: seeds[: min(count, most)] for name, (seeds, count) in counts.items() if count}


def _runs_of(setup: Setup, seeds: Sequence[int], where: WorkPlace) -> list[dict[str, Any]]:
    from linemate.simulators.judge.statistics import figures
    from linemate.simulators.lab.campaign import CampaignJob, execute
    from linemate.simulators.lab.worker_pool import progress_bar

    jobs = [CampaignJob(setup, seed) for seed in seeds]
    with progress_bar(len(jobs), f"{setup.variant} {setup.scenario.name}") as progress:
        results = execute(jobs, where.workers, progress, where.scheduler)
    return [
        {
            "seed": result["seed"],
            "assembled": result["assembled"],
            "outcome": result["outcome"],
            **dict(figures(result)),
        }
        for result in results
    ]


def _detected(plan: AccuracyPlan, source: str, where: WorkPlace) -> dict[str, Any]:
    from linemate.simulators.lab import detection
    from linemate.simulators.lab.worker_pool import progress_bar

    cycle, variant = source.split()
    setup = Case(source, variant=variant, cycle_ms=float(cycle)).setup(plan.overlay)
    hours = plan.own.get(source, plan.hours)

    def make(kind: Kind) -> dict[str, Any]:
        detection_plan = detection.DetectionPlan([setup], hours, VERIFY.start, (kind,))
        label = f"detection {source} {kind}"
        with progress_bar(len(list(detection_plan.runs())), label) as progress:
            whole = detection.execute(detection_plan, where.workers, progress, where.scheduler)
        figures: dict[str, Any] = whole["detection"][variant][kind]
        return figures

    name = f"detection-{source.replace(' ', 'ms-')}"
    return {
        kind: _piece(where, f"{name}-{kind}", (setup, hours), partial(make, kind))
        for kind in DETECTION[source]
    }


def _piece(where: WorkPlace, name: str, asked: object, make: Callable[[], Any]) -> Any:
    """Take a piece of work that is kept for the same sources and question, or do and keep it."""
    mark = f"{where.sources} {hashlib.blake2b(repr(asked).encode(), digest_size=16).hexdigest()}"
    path = where.kept / f"{name}.json"
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["mark"] == mark:
            return kept["made"]
    except (OSError, ValueError, KeyError, TypeError):
        pass  # missing or half written: run it again
    # By way of JSON either way, so that a kept piece and a fresh one are the same to the byte.
    result = json.loads(report_json.text(make()))
    if digest() != where.sources:
        raise ChangedError(f"sources changed while {name} was made; run it in a clone of its own")
    report_json.write(path, {"mark": mark, "made": result})
    return result


# The page


def page_text(
    plan: AccuracyPlan, runs: accuracy_tables.Runs, detection: accuracy_tables.Detection
) -> str:
    """What stands between the marks."""
    most = {
        group: max((len(case.get(group, ())) for case in runs.values()), default=0)
        for group in accuracy_tables.GROUPS
    }
    parameters = "identified parameters" if plan.overlay else "the shipped parameters"
    lines = [
        "*Written by `make accuracy`; edit around it, not in it.*",
        f"Seeds that parameters were tuned on: {_range(TUNED.start, most['tuned'])}. "
        f"Seeds that only verify: {_range(VERIFY.start, most['verify'])}; a bar is met or not by "
        f"these. A case takes the first of them, as many as the table of runs says. "
        f"Detection: seeds from {VERIFY.start} on, as many hours as their table says. "
        f"All runs on {parameters}. Figures: median over the seeds of a run's largest value "
        "[95 % interval of the median] (worst seed); a dash: not there in every run.",
    ]
    return "\n\n".join([*lines, accuracy_tables.tables(runs, detection)])


def _range(first: int, count: int) -> str:
    if count < 2:
        return str(first) if count else "none"
    return f"{first}-{first + count - 1}"


def write(page: Path, text: str) -> None:
    """Put the tables between the marks of a page; a page without them gets them at its end."""
    old = page.read_text(encoding="utf-8") if page.exists() else HEAD
    before, begin, rest = old.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        before, after = old.rstrip("\n") + "\n\n", "\n"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


# Arguments


def _plan(args: argparse.Namespace) -> AccuracyPlan:
    named = (
        name for name in CASES if name not in ABLATIONS or not _is_default(CASES[name].variant)
    )
    sources = (source for source in DETECTION if not _is_default(source.split()[1]))
    plan = AccuracyPlan(tuple(named), tuple(sources))
    if args.overlay is not None:
        plan = replace(plan, overlay=_overlay(args.overlay))
    if args.short:
        plan = replace(plan, cases=SHORT, seeds=1, sources=SHORT_DETECTION, hours=SHORT_HOURS)
    if args.cases is not None:
        cases = _known("case", args.cases, CASES)
        plan = replace(plan, cases=tuple(cases), own={**plan.own, **_amounts(cases)})
    if args.detection is not None:
        asked = _known("detection run", args.detection, DETECTION)
        plan = replace(plan, sources=tuple(asked), own={**plan.own, **_amounts(asked)})
    seeds = plan.seeds if args.seeds is None else args.seeds
    hours = plan.hours if args.hours is None else args.hours
    if seeds < 1 or not 0.0 < hours < math.inf:
        raise SetupError(f"{seeds} seeds and {hours:g} hours are none")
    return replace(plan, seeds=seeds, hours=hours)


def _is_default(variant: str) -> bool:
    """Return whether a variant is the default by another name; once is enough."""
    plain = TrackingSettings(), shipped_control()
    return variant != "default" and variants.apply(variant, *plain) == plain


def _amounts(each: Mapping[str, float | None]) -> dict[str, float]:
    """Return the seeds or hours of the named items."""
    return {name: number for name, number in each.items() if number is not None}


def _known(what: str, text: str, known: Mapping[str, object]) -> dict[str, float | None]:
    """Read ``A,B:N``: names, each with a number of its own or None."""
    figures: dict[str, float | None] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, number = part.partition(":")
        if name not in known:
            raise SetupError(f"no {what} {name!r}; there are {', '.join(known)}")
        try:
            own = float(number) if number else None
        except ValueError:
            raise SetupError(f"{part!r}: no number") from None
        if own is not None and not 0.0 < own < math.inf:
            raise SetupError(f"{part!r} are none")
        figures[name] = own
    return figures


def _overlay(path: Path) -> Mapping[str, Any]:
    from linemate.simulators.harness import identified_overlay as overlay

    return overlay.load(path)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="accuracy", description="Write docs/results/accuracy.md.")
    add = parser.add_argument
    add("--short", action="store_true", help="a few runs of a few cases, for CI")
    add(
        "--cases",
        metavar="A,B,...",
        help=f"some of {', '.join(CASES)}, each with its seeds if it is A:N; empty for none",
    )
    add(
        "--detection",
        metavar="A,B,...",
        help=f"some of {', '.join(DETECTION)}, each with its hours if it is A:H; empty for none",
    )
    add("--seeds", type=int, metavar="N", help="of each group at most")
    add("--hours", type=float, metavar="H", help=f"of each kind of detection run; {HOURS:g}")
    add("--overlay", type=Path, metavar="FILE", help="identified parameters for all runs")
    add("--page", type=Path, metavar="FILE", help=f"where tables go; {PAGE}, unless short")
    add("--kept", type=Path, default=KEPT, metavar="DIR", help=f"for pieces of the work; {KEPT}")
    add("--workers", type=int, help="processes; all cores by default")
    add("--scheduler", type=parse_scheduler, default="local", metavar="local|ADDRESS")
    add("--check", action="store_true", help="end with 1 if a bar is not met")
    return parser


if __name__ == "__main__":
    sys.exit(main())
