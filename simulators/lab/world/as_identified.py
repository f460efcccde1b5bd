"""A cell that is identified before its runs: exercises, `linemate identify`, and its overlay.

Invariants:
    Exercises and runs are in one cell: the fixed errors that a scenario draws are the same.
    A value that an exercise does not show stays as the row has it.
    An overlay is kept under the digest of its sources and of the cell.
"""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

from linemate.daemon.operator import identify_command
from linemate.simulators.harness import identified_overlay
from linemate.simulators.harness.setup import Setup, laid_over
from linemate.simulators.lab import identify_run

CELL = identify_run.FIRST_SEED
"""Seed of the cell's fixed errors, and of the first exercise."""


@dataclass(frozen=True, slots=True)
class CellJob:
    """One cell to be identified.

    Attributes:
        exercises: how many are recorded.
        kept: folder of recordings and overlays.
        sources: digest of the sources that the exercises are run with.
    """

    setup: Setup
    exercises: int
    kept: Path
    sources: str


def identified(job: CellJob) -> Setup:
    """Return the setup of runs whose daemon has what exercises in their cell show."""
    setup = job.setup
    cell = replace(setup, scenario=replace(setup.scenario, cell_seed=CELL))
    exercise = identify_run.exercise_in(cell)
    text = f"{job.sources} {exercise!r} {job.exercises}"
    folder = job.kept / f"identified-{hashlib.blake2b(text.encode(), digest_size=12).hexdigest()}"
    overlay = folder / "identified.yaml"
    if not overlay.exists():
        files = [
            identify_run.record(exercise, CELL + i, folder / f"exercise-{i}.mcap")
            for i in range(job.exercises)
        ]
        outcome = identify_command.from_files(files)
        table = identify_command.table(outcome.findings)
        (folder / "table.txt").write_text(f"{setup.scenario.name}\n{table}\n", encoding="utf-8")
        names = [file.name for file in files]
        identify_command.write(overlay, identify_command.overlay_text(outcome, names))
    return laid_over(cell, identified_overlay.load(overlay))
