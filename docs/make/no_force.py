"""Forces in a cell without a force-torque sensor: ``python -m docs.make.no_force`` prints JSON.

The cell ``no-force`` of the fault campaign, one case of trouble a row, the plant's own force.
"""

import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace

from linemate.simulators.lab.faults import dst_run
from linemate.simulators.lab.faults.dst_plan import CycleMs, FaultPlan
from linemate.simulators.plants.conveyor_plan import Conveyor
from linemate.simulators.plants.scenario import Fault

TOUCH_S, HELD_S = 1.05, 1.45
"""When trouble begins: at the touch, and in contact, scenario time [s]."""
STOPS_S = (0.85, 1.0, 1.15, 1.3, 1.5)
PAUSE_S = 0.32
SEEDS = range(1, 5)

WITHOUT_FAULT: tuple[tuple[CycleMs, range], ...] = ((12, range(12)), (4, range(6)))

Row = tuple[str, Iterable[FaultPlan]]


def rows() -> Iterator[Row]:
    """Yield what happens and the plans that are run for it."""
    for cycle_ms, seeds in WITHOUT_FAULT:
        name = f"no fault, {len(seeds)} seeds at {cycle_ms} ms"
        yield name, [_plan(seed, cycle_ms=cycle_ms) for seed in seeds]
    yield "the conveyor stops at 0.85 to 1.5 s", [_plan(1, stop_s=at_s) for at_s in STOPS_S]
    yield (
        f"the conveyor stops and starts again {PAUSE_S} s later",
        [_plan(1, stop_s=at_s, start_s=round(at_s + PAUSE_S, 3)) for at_s in STOPS_S],
    )
    for name, link, kind, lasting_s, value in (
        ("a stop is ordered", "operator", "stop", 0.0, 0.0),
        ("a retreat is ordered", "operator", "retreat", 0.0, 0.0),
        ("distance silent for 0.4 s", "distance", "silence", 0.4, 0.0),
        ("distance 30 mm off for 1 s", "distance", "offset", 1.0, 0.03),
        ("distance frozen for 1 s", "distance", "stuck", 1.0, 0.0),
    ):
        faults = [Fault(at_s, link, kind, lasting_s, value) for at_s in (TOUCH_S, HELD_S)]
        yield name, [_plan(seed, fault) for seed in SEEDS for fault in faults]


def _plan(
    seed: int,
    *faults: Fault,
    cycle_ms: CycleMs = 12,
    stop_s: float | None = None,
    start_s: float | None = None,
) -> FaultPlan:
    times = zip((stop_s, start_s), Conveyor().events, strict=True)
    events = [replace(shipped, onset_s=at_s) for at_s, shipped in times if at_s is not None]
    return FaultPlan(
        seed,
        duration_s=1.9,
        events=tuple(events),
        faults=faults,
        cycle_ms=cycle_ms,
        cell="no-force",
    )


def main() -> int:
    """Run each row, and print the largest force, runs and violations of each."""
    measured = []
    for name, plans in rows():
        outcomes = [dst_run.run(plan) for plan in plans]
        measured.append(
            {
                "row": name,
                "runs": len(outcomes),
                "force_n": round(max(each.force_n for each in outcomes), 1),
                "violations": sum(bool(each.violations) for each in outcomes),
            }
        )
    json.dump({"rows": measured}, sys.stdout, indent=1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
