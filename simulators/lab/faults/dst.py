"""Deterministic simulation: ``python -m linemate.simulators.lab.faults.dst FIRST:LAST``.

Invariants:
    Seeds in (half open), one line a violation out; the last line counts.
    With ``--json`` the counts are the output, and these lines go to stderr.
    A failing seed is shrunk to the smallest plan that fails in the same way.
    Every fiftieth seed runs again with another hash seed and must give the same trace.
"""

import argparse
import contextlib
import gc
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

from linemate.daemon.command_line import one_thread
from linemate.simulators.judge.statistics import seed_text
from linemate.simulators.lab.faults import dst_plan
from linemate.simulators.lab.faults.dst_plan import SHORTEST_S, CycleMs, FaultPlan

if TYPE_CHECKING:
    from linemate.simulators.lab.faults.dst_run import RunOutcome

Drawn = partial[FaultPlan]
"""Draws the plan of a seed: the campaign's cycle and cell are its keywords."""

AGAIN_EVERY = 50
CHUNK = 10
MOST_SEEDS = 10_000_000
SHRINKING = 200
"""Runs that shrinking may cost."""

KEPT = Path("tests/dst/regressions.txt")

ASKED_CELLS = (*dst_plan.CELLS, dst_plan.OTHER_LINE, *dst_plan.FAMILY_CYCLES_MS)
"""Cells of which every seed can be run."""

EVERY: tuple[tuple[CycleMs | None, str | None], ...] = (
    (12, None),
    (4, None),
    *((None, cell) for cell in ASKED_CELLS),
)
"""Cycle and cell of each campaign of ``--every``."""


class Lived(NamedTuple):
    """What a run came to, as the campaign counts it; the fields are those of ``RunOutcome``."""

    seed: int
    violations: tuple[str, ...]
    digest: str
    force_n: float


def main(argv: Sequence[str] | None = None) -> int:
    """Run many seeds.

    Returns:
        0 if nothing was violated, 1 if something was, 2 for wrong arguments.
    """
    args = _parser().parse_args(argv)
    one_thread()
    campaigns = EVERY if args.every else ((args.cycle_ms, args.cell),)
    drawn = [partial(dst_plan.draw, cycle_ms=cycle, cell=cell) for cycle, cell in campaigns]
    if args.trace:
        for seed in args.trace.split(","):
            print(seed, _live(drawn[0](int(seed))).digest, flush=True)
        return 0
    try:
        seeds = _seeds(args.seeds)
    except ValueError as error:
        print(f"dst: {error}", file=sys.stderr)
        return 2
    keep = None if args.forget else args.keep
    lines = sys.stderr if args.json else sys.stdout
    with contextlib.redirect_stdout(lines):
        counts = [
            _run_seeds(seeds, each, max(1, args.workers), keep, args.seconds) for each in drawn
        ]
    if args.json:
        print(json.dumps({"campaigns": counts}, indent=1))
    return 1 if any(count["violations"] or count["not_repeated"] for count in counts) else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dst", description="Deterministic simulation of the daemon under seeded faults."
    )
    parser.add_argument("seeds", nargs="?", default="0:100", help="FIRST:LAST, half open")
    parser.add_argument(
        "--cycle-ms",
        type=int,
        choices=get_args(CycleMs),
        help="of the controller (12; fanuc 8, egm 4)",
    )
    parser.add_argument("--cell", choices=ASKED_CELLS, help="another cell or family of controllers")
    parser.add_argument(
        "--every", action="store_true", help="one campaign after the other, of each cycle and cell"
    )
    parser.add_argument("--json", action="store_true", help="print the counts as JSON")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--keep", type=Path, default=KEPT, help="file for plans that failed")
    parser.add_argument("--forget", action="store_true", help="neither shrink nor keep")
    parser.add_argument(
        "--seconds",
        type=float,
        default=float("inf"),
        help="begin no further seed of a campaign after that",
    )
    parser.add_argument("--trace", metavar="SEED,...", help="print the traces of some seeds")
    return parser


def _seeds(text: str) -> range:
    first, colon, last = text.partition(":")
    if not (colon and first.isdigit() and last.isdigit()):
        raise ValueError(f"seeds should be FIRST:LAST, not {text!r}")
    seeds = range(int(first), int(last))
    if not 0 < len(seeds) <= MOST_SEEDS:
        raise ValueError(f"{len(seeds)} seeds, wanted 1..{MOST_SEEDS}")
    return seeds


def _run_seeds(
    seeds: range, drawn: Drawn, workers: int, keep: Path | None, seconds: float
) -> dict[str, Any]:
    """Run all seeds that there is time for, then some of them again; return the counts."""
    begun = time.monotonic()
    failed: list[Lived] = []
    traces: dict[int, str] = {}
    done, force_n = 0, 0.0
    for done, lived in enumerate(_lives(seeds, drawn, workers), 1):
        if lived.violations:
            failed.append(lived)
            for what in lived.violations:
                print(f"seed {lived.seed}: {what}", flush=True)
        else:
            force_n = max(force_n, lived.force_n)
        if lived.seed % AGAIN_EVERY == 0:
            traces[lived.seed] = lived.digest
        passed_s = time.monotonic() - begun
        if done % (AGAIN_EVERY * CHUNK) == 0:
            print(f"{done} of {len(seeds)}, {passed_s:.0f} s", flush=True)
        if passed_s > seconds:
            break
    lived_s = time.monotonic() - begun
    different = list(_different(traces, drawn))
    for seed in different:
        print(f"seed {seed}: determinism: another trace in another process", flush=True)
    if keep is not None:
        _keep(failed, drawn, keep)
    print(f"{60.0 * done / lived_s:.0f} runs a minute, {len(traces)} of them twice")
    print(f"{done} runs, {len(failed) + len(different)} violations", flush=True)
    plan = drawn(seeds[0])
    return {
        "cell": drawn.keywords["cell"] or "drawn",
        "cycle_ms": plan.cycle_ms,
        "seeds": seed_text(seeds[:done]),
        "runs": done,
        "force_n": round(force_n, 1),
        "violations": [{"seed": run.seed, "what": list(run.violations)} for run in failed],
        "not_repeated": different,
    }


def _lives(seeds: Iterable[int], drawn: Drawn, workers: int) -> Iterator[Lived]:
    settle, live = partial(_settle, drawn), partial(_live_seed, drawn)
    if workers == 1:
        settle()
        try:
            yield from map(live, seeds)
        finally:
            gc.enable()
            gc.unfreeze()
        return
    with ProcessPoolExecutor(workers, initializer=settle) as pool:
        try:
            yield from pool.map(live, seeds, chunksize=CHUNK)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _settle(drawn: Drawn) -> None:
    """Load and compile what all runs share, and let the collector leave it alone."""
    from linemate.simulators.lab.faults import dst_cells

    plan = drawn(0)
    dst_cells.compiled(plan.cycle_s, plan.cell)
    gc.collect()
    gc.freeze()
    gc.disable()


def _live_seed(drawn: Drawn, seed: int) -> Lived:
    outcome = _live(drawn(seed))
    if seed % CHUNK == 0:
        gc.collect()
    return Lived(seed, outcome.violations, outcome.digest, outcome.force_n)


def _live(plan: FaultPlan) -> "RunOutcome":
    from linemate.simulators.lab.faults import dst_run

    return dst_run.run(plan)


def _different(traces: dict[int, str], drawn: Drawn) -> Iterator[int]:
    """Seeds whose trace is another one in a process with another hash seed."""
    if not traces:
        return
    command = [sys.executable, "-m", __spec__.name if __spec__ else __name__]
    for name, value in drawn.keywords.items():
        command += [] if value is None else [f"--{name.replace('_', '-')}", str(value)]
    command += ["--trace", ",".join(map(str, traces))]
    environment = {**os.environ, "PYTHONHASHSEED": str(1 + min(traces) % 4_000_000_000)}
    done = subprocess.run(  # noqa: S603 - ourselves
        command, env=environment, capture_output=True, text=True, check=True
    )
    again = dict(line.split() for line in done.stdout.splitlines())
    yield from (seed for seed, digest in traces.items() if again.get(str(seed)) != digest)


def _keep(failed: Sequence[Lived], drawn: Drawn, path: Path) -> None:
    """Shrink what failed and add it to the regressions, one of a kind."""
    kinds: set[str] = set()
    for lived in failed:
        kind = _kind(lived.violations)
        if kind in kinds:
            continue
        kinds.add(kind)
        plan = shrink(drawn(lived.seed), kind)
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(f"# {lived.violations[0][:160]}\n{plan.to_line()}\n")
        print(f"seed {lived.seed}: kept with {len(plan.faults)} faults in {path}", flush=True)


def _kind(violations: tuple[str, ...]) -> str:
    return violations[0].partition(":")[0] if violations else ""


def shrink(plan: FaultPlan, kind: str) -> FaultPlan:
    """The least plan found that is violated in the same way.

    Args:
        kind: what its first violation is called.
    """
    budget = SHRINKING
    progress = True
    while progress:
        progress = False
        for smaller in _smaller(plan):
            budget -= 1
            if budget < 0:
                return plan
            if _kind(_live(smaller).violations) == kind:
                plan, progress = smaller, True
                break
    return plan


def _smaller(plan: FaultPlan) -> Iterator[FaultPlan]:
    """Plans with one thing less, the greatest cuts first."""
    faults = plan.faults
    half = len(faults) // 2
    if half > 1:
        yield replace(plan, faults=faults[:half])
        yield replace(plan, faults=faults[half:])
    for i in range(len(faults)):
        yield replace(plan, faults=faults[:i] + faults[i + 1 :])
    if plan.events:
        yield replace(plan, events=())
        yield replace(plan, events=plan.events[:-1])
    if plan.duration_s > SHORTEST_S:
        yield replace(plan, duration_s=max(SHORTEST_S, round(plan.duration_s / 2, 3)))
    if plan.lead_ms:
        yield replace(plan, lead_ms=0.0)
    if plan.eager:
        yield replace(plan, eager=False)


if __name__ == "__main__":
    sys.exit(main())
