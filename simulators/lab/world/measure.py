"""``linemate-sim world``: rows of the realistic world, each over the same seeds.

Invariants:
    A run is judged by the plant's truth.
    A finished run is kept under the digest of its sources and its setup, so an interrupted
        command goes on.
    Rows and seeds are in the order in which they were asked for.
"""

import hashlib
import json
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from linemate.daemon.near_names import near_names
from linemate.simulators.devices.worlds import OWN
from linemate.simulators.harness import setup
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.cluster import digest
from linemate.simulators.harness.setup import Setup
from linemate.simulators.harness.world import world_rows
from linemate.simulators.judge import report_json
from linemate.simulators.lab.worker_pool import progress_bar, spread
from linemate.simulators.lab.world import (
    as_identified,
    drawn_line,
    drawn_world,
    measured_arm,
    mujoco_rows,
    world_table,
)
from linemate.simulators.lab.world.as_identified import CellJob
from linemate.simulators.lab.world.mujoco_rows import MUJOCO_ROWS, prepared

WORKERS = 2
SCENARIOS = ("plant-floor", "plant-floor-harsh")
"""Scenario files that are measured like rows."""
DRAWN = {
    drawn_world.NAME: drawn_world.WHAT,
    **{name: line.what for name, line in drawn_line.LINES.items()},
}
"""Rows of which each seed draws its own, and what they are."""


@dataclass(frozen=True, slots=True)
class WorldJob:
    """One run of one row.

    Attributes:
        kept: folder of finished runs.
        sources: digest of the sources that the run is made with.
        learnt: cars before it, in the same cell, whose touches the daemon learns from.
    """

    row: str
    setup: Setup
    seed: int
    kept: Path
    sources: str
    learnt: int = 0


def main(args: Namespace) -> int:
    """Measure what the arguments say.

    Args:
        args: world, rows, seeds, cycle_ms, overrides, learnt, identified, workers, kept, json,
            list.

    Returns:
        0 when every run was made; 1 with ``--check`` if one of them collided.

    Raises:
        SetupError: a row or a setting is unknown.
    """
    names = chosen(args.rows, args.world)
    if args.list:
        print("\n".join(f"{name:28s} {what(name)}" for name in names))
        return 0
    jobs = prepare(names, args.seeds, args.overrides, args.cycle_ms, args.kept)
    jobs = [replace(job, learnt=args.learnt) for job in jobs]
    workers = args.workers or WORKERS
    if args.identified:
        jobs = identified(jobs, args.identified, workers)
    with progress_bar(len(jobs), "world") as progress:
        runs = spread(measured, jobs, workers, progress)
    whole = collect(runs)
    print(report_json.text(whole) if args.json else world_table.text(whole))
    return int(args.check and any(run["outcome"] == "collision" for run in runs))


def known() -> tuple[str, ...]:
    """Names of everything that can be measured."""
    from linemate.simulators.harness import scenario_file

    shipped = scenario_file.shipped()
    floors = (name for name in SCENARIOS if name in shipped)
    return (*world_rows.rows(), *floors, *measured_arm.ROWS, *DRAWN)


def chosen(text: str | None, world: str = OWN) -> tuple[str, ...]:
    """Names of rows, separated by commas; ``sway*`` is all that begin so; None is all not drawn.

    Raises:
        SetupError: no such row.
    """
    every = known() if world == OWN else tuple(MUJOCO_ROWS)
    if text is None:
        return tuple(name for name in every if not _is_drawn(name))
    names: list[str] = []
    for name in filter(None, (part.strip() for part in text.split(","))):
        begin = name.removesuffix("*")
        matches = [row for row in every if row == name or (begin != name and row.startswith(begin))]
        if not matches:
            raise SetupError(f"no row {name!r}{_elsewhere(name, world) or near_names(name, every)}")
        names += matches
    return tuple(dict.fromkeys(names))


def _elsewhere(name: str, world: str) -> str:
    """Return in which other world a row is, empty if in none."""
    if world == OWN:
        return "; it is of --world mujoco" if name in MUJOCO_ROWS else ""
    return "; it is not of --world mujoco" if name in known() else ""


def _is_drawn(name: str) -> bool:
    """Return whether each seed of a row draws its own."""
    return name in DRAWN or name in mujoco_rows.DRAWN


def what(name: str) -> str:
    """What a row changes, in one line."""
    if name in MUJOCO_ROWS:
        return MUJOCO_ROWS[name].what
    if name in DRAWN:
        return DRAWN[name]
    if name in measured_arm.ROWS:
        return measured_arm.WHAT
    row = world_rows.rows().get(name)
    return "all effects at once" if row is None else row.what


def prepare(
    names: Sequence[str],
    seeds: Sequence[int],
    overrides: Sequence[str],
    cycle_ms: float | None,
    kept: Path,
) -> list[WorldJob]:
    """Make the jobs of rows and seeds."""
    sources = digest()

    @cache
    def setup_of(name: str, seed: int | None) -> Setup:
        return _setup(name, overrides, cycle_ms, seed)

    return [
        WorldJob(name, setup_of(name, seed if _is_drawn(name) else None), seed, kept, sources)
        for name in names
        for seed in seeds
    ]


def identified(jobs: Sequence[WorldJob], exercises: int, workers: int) -> list[WorldJob]:
    """Return jobs whose daemons have what exercises in their cells show, each cell once."""
    cells = {repr(job.setup): job for job in jobs}
    with progress_bar(len(cells), "identify") as progress:
        cell_jobs = [CellJob(job.setup, exercises, job.kept, job.sources) for job in cells.values()]
        setups = spread(as_identified.identified, cell_jobs, workers, progress)
    known = dict(zip(cells, setups, strict=True))
    return [replace(job, setup=known[repr(job.setup)]) for job in jobs]


def _setup(name: str, overrides: Sequence[str], cycle_ms: float | None, seed: int | None) -> Setup:
    """Return the runs of a row before their seeds.

    Args:
        seed: which world is drawn; None for a row that draws none.
    """
    if name in MUJOCO_ROWS:
        return prepared(name, tuple(overrides), cycle_ms, seed)
    if seed is not None:
        is_line = name in drawn_line.LINES
        drawn = drawn_line.overrides(name, seed) if is_line else drawn_world.overrides(seed)
        return setup.make(drawn_world.BASE, (*drawn, *overrides), cycle_ms=cycle_ms)
    name = measured_arm.ROWS.get(name, name)
    listed = name in world_rows.rows()
    return setup.make(world_rows.PREFIX + name if listed else name, overrides, cycle_ms=cycle_ms)


def measured(job: WorldJob) -> dict[str, Any]:
    """Return the figures of a run: those that are kept, or those of a new run."""
    mark = hashlib.blake2b(
        f"{job.sources} {job.setup!r} {job.seed} {job.learnt}".encode(), digest_size=12
    ).hexdigest()
    path = job.kept / f"{job.row}-{job.seed}-{mark}.json"
    try:
        kept: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        kept = {}
    if kept:
        return kept
    result: dict[str, Any] = json.loads(report_json.text(perform(job)))
    if digest() != job.sources:
        raise SetupError(f"sources changed while {job.row} was measured; use a clone of its own")
    report_json.write(path, result)
    return result


def perform(job: WorldJob) -> dict[str, Any]:
    """Run one job and return its figures."""
    from linemate.simulators.harness import lockstep
    from linemate.simulators.judge.judge import judge
    from linemate.simulators.lab.world.taught import taught

    setup = job.setup
    if job.row in measured_arm.ROWS:
        setup = measured_arm.identified(setup, job.seed)
    setup = taught(setup, job.seed, job.learnt)
    return {"row": job.row, **figures(judge(lockstep.run(setup, job.seed)))}


def figures(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a judged run; None where the run has none."""
    control, total = result["control_error"], result["total_error"]
    latencies = {entry["event"]: entry for entry in reversed(result["detection"])}
    force, contact = result["contact_force_n"], result["contact"]
    windows = [control[name] for name in ("approach", "stop", "contact") if control[name]]
    return {
        "seed": result["seed"],
        "cycle_ms": result["cycle_ms"],
        "outcome": result["outcome"],
        "reason": result["reason"],
        "control_rms_mm": _of(control["approach"], "rms_mm"),
        "control_mm": _of(control["approach"], "max_mm"),
        "control_all_mm": max((window["max_mm"] for window in windows), default=None),
        "impact_mm": _of(total["impact"], "max_mm"),
        "impact_mrad": _of(total["impact"], "max_mrad"),
        # A tool that never touched did not follow to the end; its distance is no error.
        "stop_mm": None if total["impact"] is None else _of(total["stop"], "max_mm"),
        "stop_s": _of(latencies.get("stop"), "confirmed_s"),
        "start_s": _of(latencies.get("start"), "confirmed_s"),
        "force_n": _of(force, "max"),
        "oscillation_mm": None if contact is None else contact["oscillation_mm"]["worst"],
        "energy_j": None if contact is None else contact["energy_j"]["worst"],
        "false_tentative": result["false_alarms"]["tentative"],
        "false_confirmed": result["false_alarms"]["confirmed"],
        "missed": sum(entry["confirmed_s"] is None for entry in result["detection"]),
        "violations": result["limits"]["violations"],
    }


def _of(values: Mapping[str, Any] | None, key: str) -> Any:
    return None if values is None else values[key]


def collect(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What ``world --json`` prints: runs, and a summary of each row."""
    names = list(dict.fromkeys(run["row"] for run in runs))
    return {
        "version": 1,
        "rows": {
            name: {
                "what": what(name),
                "summary": world_table.summarise([run for run in runs if run["row"] == name]),
                "runs": [run for run in runs if run["row"] == name],
            }
            for name in names
        },
    }
