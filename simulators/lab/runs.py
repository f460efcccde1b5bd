"""``linemate-sim run``: the whole chain in virtual time, for one seed or several.

Invariants:
    Exit code 0 only if every run assembled within the limits.
    Output depends on the arguments alone, unless computing times are requested.
"""

from argparse import Namespace
from pathlib import Path
from typing import Any

from linemate.simulators.harness.cell import cell_files
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.setup import make
from linemate.simulators.judge import report_json
from linemate.simulators.lab.campaign import CampaignJob, collect, execute
from linemate.simulators.lab.worker_pool import progress_bar


def main(args: Namespace) -> int:
    """Run what the arguments say.

    Args:
        args: scenario, cell, config, task, seeds, variant, overrides, cycle_ms, out, json, timing,
            record, workers, world, controller.

    Returns:
        0 assembled within limits, 1 not.

    Raises:
        SetupError: what was asked for cannot be run.
    """
    if args.record and args.out is None:
        raise SetupError("--record needs a folder: --out DIR")
    cell = cell_files.chosen(args)
    setup = make(
        cell_files.scenario(args.scenario, cell),
        args.overrides,
        variant=args.variant,
        cycle_ms=args.cycle_ms,
        world=args.world,
        controller=args.controller,
        cell=cell,
    )
    single = len(args.seeds) == 1
    jobs = [
        CampaignJob(
            setup,
            seed,
            _folder(args.out, seed, single),
            timing=args.timing,
            is_recorded=args.record,
        )
        for seed in args.seeds
    ]
    with progress_bar(len(jobs), "run") as progress:
        results = execute(jobs, args.workers, progress)
    if args.json:
        print(report_json.text(results[0] if single else collect(results)))
    else:
        print(_table_of_runs(results))
    return 0 if all(result["within_limits"] for result in results) else 1


def _folder(out: Path | None, seed: int, single: bool) -> Path | None:
    if out is None:
        return None
    return out if single else out / f"seed-{seed}"


def _table_of_runs(results: list[dict[str, Any]]) -> str:
    """One run whole, several as a line each."""
    from linemate.simulators.judge.table import aligned, plain

    if len(results) == 1:
        return plain(results[0])
    head = ("seed", "outcome", "control mm", "mrad", "total stop mm", "impact mm", "in limits")
    lines = aligned(head, [_line(result) for result in results])
    good = sum(result["within_limits"] for result in results)
    return "\n".join([*lines, "", f"{len(results)} runs, {good} assembled within limits"])


def _line(result: dict[str, Any]) -> tuple[str, ...]:
    judged = [result["control_error"][w] for w in ("approach", "stop", "contact")]
    control = [window for window in judged if window is not None]
    total = result["total_error"]
    return (
        str(result["seed"]),
        result["outcome"],
        _number(max((w["max_mm"] for w in control), default=None)),
        _number(max((w["max_mrad"] for w in control), default=None)),
        _number(total["stop"] and total["stop"]["max_mm"]),
        _number(total["impact"] and total["impact"]["max_mm"]),
        "yes" if result["within_limits"] else "no",
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
