"""Many runs: the same seeds through several variants, on all cores.

Invariants:
    A run depends on its job alone.
    Jobs and results are ordered by variant, then seed.
"""

from argparse import Namespace
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from linemate.simulators.harness.setup import Setup
from linemate.simulators.judge import report_json
from linemate.simulators.lab.worker_pool import LOCAL, Progress, progress_bar, spread

KEY_FIGURES = (
    ("assembled", "assembled", 1.0),
    ("control_error.approach.max_mm", "control approach mm", 1.0),
    ("control_error.contact.max_mm", "control contact mm", 1.0),
    ("total_error.stop.max_mm", "total stop mm", 1.0),
    ("total_error.impact.max_mm", "total impact mm", 1.0),
    ("total_error.contact.max_mm", "total contact mm", 1.0),
    ("detection.stop.perceived_s", "stop perceived s", 1.0),
    ("detection.stop.confirmed_s", "stop confirmed s", 1.0),
    ("detection.start.perceived_s", "start perceived s", 1.0),
    ("detection.start.confirmed_s", "start confirmed s", 1.0),
)


@dataclass(frozen=True, slots=True)
class CampaignJob:
    """One run.

    Attributes:
        seed: of the plant's draws.
        out: where its report goes, None for nowhere.
        timing: measure computing times, which are no function of the seed.
        is_recorded: leave a recording with the truth in ``out``.
    """

    setup: Setup
    seed: int
    out: Path | None = None
    timing: bool = False
    is_recorded: bool = False


def perform(job: CampaignJob) -> dict[str, Any]:
    """Run one job in this process and judge it."""
    from linemate.simulators.harness import lockstep
    from linemate.simulators.harness.research import truth_recording
    from linemate.simulators.judge.judge import judge

    if job.is_recorded and job.out is not None:
        path = job.out / truth_recording.FILE
        evidence, result = truth_recording.record(job.setup, job.seed, path, timing=job.timing)
    else:
        evidence = lockstep.run(job.setup, job.seed, timing=job.timing)
        result = judge(evidence)
    if job.out is not None:
        report_json.write_results(job.out, result, evidence.rows)
    return result


def execute(
    jobs: Sequence[CampaignJob],
    workers: int | None = None,
    progress: Progress = lambda: None,
    scheduler: str = LOCAL,
) -> list[dict[str, Any]]:
    """Run jobs on local cores, or on a dask cluster.

    Args:
        workers: processes; None takes the cores there are, 1 stays in this process.
        progress: called after each run.
        scheduler: "local", or the address of a cluster's scheduler, which has its own workers.

    Returns:
        Results in the order of the jobs.

    Raises:
        SetupError: a job or the cluster cannot be used.
    """
    return spread(perform, jobs, workers, progress, scheduler)


def main(args: Namespace) -> int:
    """``linemate-sim campaign``: runs, and a table of variants.

    Args:
        args: seeds, first_seed, scenario, variants, overrides, cycle_ms, workers, scheduler,
            detection, json, out.

    Returns:
        The exit code: 0 when every run was made, whatever came of it.
    """
    from linemate.simulators.harness import setup
    from linemate.simulators.harness.cell import cell_files

    if args.detection is not None:
        from linemate.simulators.lab import detection

        return detection.main(args)
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    cell = cell_files.chosen(args)
    scenario = cell_files.scenario(args.scenario, cell)
    jobs = [
        CampaignJob(run_setup, seed)
        for run_setup in (
            setup.make(
                scenario,
                args.overrides,
                variant=variant,
                cycle_ms=args.cycle_ms,
                world=args.world,
                controller=args.controller,
                cell=cell,
            )
            for variant in args.variants
        )
        for seed in seeds
    ]
    with progress_bar(len(jobs), "campaign") as progress:
        results = execute(jobs, args.workers, progress, args.scheduler)
    whole = collect(results)
    if args.out is not None:
        report_json.write(args.out / "campaign.json", whole)
    print(report_json.text(whole) if args.json else table(whole))
    return 0


def collect(results: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """What ``campaign --json`` prints: runs, and a summary for each variant."""
    from linemate.simulators.judge.statistics import summarise

    runs = list(results)
    names = list(dict.fromkeys(run["variant"] for run in runs))
    summary = {name: summarise([r for r in runs if r["variant"] == name]) for name in names}
    return {"version": 1, "runs": runs, "summary": summary}


def table(whole: dict[str, Any]) -> str:
    """Key figures as text: a row a figure, a column a variant, "median [interval] (worst)"."""
    from linemate.simulators.judge.table import aligned

    summary = whole["summary"]
    head = ("figure", *summary)
    rows = [
        (label, *(_cell(figures.get(name)) for figures in summary.values()))
        for name, label, _ in KEY_FIGURES
        if any(name in figures for figures in summary.values())
    ]
    counts = {name: sum(run["variant"] == name for run in whole["runs"]) for name in summary}
    runs = ", ".join(f"{name} {count}" for name, count in counts.items())
    legend = "median [95 % interval, of 6 runs or more] (worst); assembled: share; -: missed"
    return "\n".join([*aligned(head, rows), "", legend, f"runs: {runs}"])


def _cell(figure: dict[str, Any] | None) -> str:
    if figure is None:
        return "-"
    from linemate.simulators.judge.statistics import interval_text

    interval = interval_text(figure["ci95"], _number)
    return f"{_number(figure['median'])}{interval} ({_number(figure['worst'])})"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
