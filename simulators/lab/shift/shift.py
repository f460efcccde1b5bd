"""``linemate-sim shift``: a shift in virtual time, its table and its JSON.

Invariants:
- A split shift has one daemon a share; the cars are those of the whole shift.
- Shares are run where the runs of a campaign are: on local cores, or on a dask cluster.
"""

import itertools
import math
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Final

from linemate.daemon.command_line import UsageError
from linemate.simulators.devices.line.cars import Car, CarFault, CarTruth
from linemate.simulators.harness.line import line_station
from linemate.simulators.judge import report_json
from linemate.simulators.lab import worker_pool
from linemate.simulators.lab.shift import plan
from linemate.simulators.lab.shift.line_controller import LineController
from linemate.simulators.lab.shift.run import ShiftOutcome, run

VERSION: Final = 1
CAUSES: Final[Mapping[CarFault, tuple[str, ...]]] = {
    CarFault.CAMERA_COVERED: ("camera",),
    CarFault.ROBOT_RESTARTED: ("programme began again", "no answered telegram"),
    CarFault.FORCE_SILENT: ("force_torque",),
    CarFault.PART_MISSING: ("the part was not seen",),
}
"""What a report must name, by fault."""

GROWTH: Final = 1.1  # of what the daemon remembers, from the first car to the last
RESIDENT_GROWTH: Final = 32 << 20  # of the process' memory, from the first car to the last [bytes]
BYTES_A_CAR: Final = 8192  # of the record files


@dataclass(frozen=True, slots=True)
class ShiftShare:
    """Cars of one daemon, as a worker gets them.

    Attributes:
        longest_s: time of the host after which no further car enters [s].
        cell: a shipped one or a folder that the worker can read; None: the shipped wheel.
        controller: family; None: that of the cell.
        over_opc_ua: the line's controller is a client of the OPC UA server, and of nothing else.
    """

    takt_s: float
    cars: tuple[Car, ...]
    longest_s: float = math.inf
    cell: str | None = None
    controller: str | None = None
    over_opc_ua: bool = False


def main(args: Namespace) -> int:
    """Run a shift and print what became of it.

    Args:
        args: cars, cell, controller, seed, takt, faulty, workers, minutes, opc_ua, scheduler, json.

    Returns:
        0 if every good car was mounted and every other one reported with its cause; else 1.
    """
    station = line_station.station(args.cell, args.controller)
    cars = plan.draw(args.cars, args.seed, station, args.faulty)
    longest_s = math.inf if args.minutes is None else 60.0 * args.minutes
    shares = split(cars, args.workers or 1, args.takt, longest_s, args.cell)
    shares = [
        replace(share, controller=args.controller, over_opc_ua=args.opc_ua) for share in shares
    ]
    outcomes = worker_pool.spread(perform, shares, len(shares), scheduler=args.scheduler)
    result = judge(outcomes, args.seed)
    print(report_json.text(result) if args.json else table(result))
    return 0 if result["good"] else 1


def split(
    cars: Sequence[Car],
    count: int,
    takt_s: float,
    longest_s: float = math.inf,
    cell: str | None = None,
) -> list[ShiftShare]:
    """Return shares of consecutive cars, as many as asked for, none of them empty."""
    count = min(count, len(cars))
    ends = [i * len(cars) // count for i in range(count + 1)]
    return [
        ShiftShare(takt_s, tuple(cars[a:b]), longest_s, cell) for a, b in itertools.pairwise(ends)
    ]


def perform(share: ShiftShare) -> ShiftOutcome:
    """Run a share in this process."""
    station = line_station.station(share.cell, share.controller)
    with closing(_controller(share)) as plc:
        return run(
            station, share.cars, share.takt_s, on_car=_print_car, longest_s=share.longest_s, plc=plc
        )


def _controller(share: ShiftShare) -> LineController:
    if not share.over_opc_ua:
        return LineController()
    try:
        from linemate.simulators.lab.shift.opc_line import OpcLineController
    except ImportError as error:
        raise UsageError("asyncua is not installed; pip install linemate[plc]") from error
    return OpcLineController()


def _print_car(car: Car, truth: CarTruth) -> None:
    """Print a line a car on standard error, as it leaves."""
    outcome = "mounted" if truth.mounted else truth.collision or "not mounted"
    print(f"{car.part} {car.variant}: {outcome} {car.fault or ''}", file=sys.stderr, flush=True)


def judge(outcomes: Sequence[ShiftOutcome], seed: int) -> dict[str, Any]:
    """Return what became of a shift, split or not, as plain values."""
    rows = [row for outcome in outcomes for row in _rows(outcome)]
    complaints = [complaint for outcome in outcomes for complaint in outcome.complaints]
    complaints += [text for outcome in outcomes for text in _growth(outcome)]
    counts = {
        "unmounted_good": sum(row["fault"] is None and not row["mounted"] for row in rows),
        "mounted_bad": sum(row["outcome"] == "ok" and not row["mounted"] for row in rows),
        "unreported": sum(row["outcome"] == "unreported" for row in rows),
        "wrong_cause": sum(not row["cause_named"] for row in rows),
        "collisions": sum(row["collision"] is not None for row in rows),
    }
    typed = dict.fromkeys(("arm", "start", "home", "retreat", "stop"), 0)
    for outcome in outcomes:
        for op, count in outcome.requests.items():
            typed[op] = typed.get(op, 0) + count
    return {
        "version": VERSION,
        "seed": seed,
        "planned": sum(outcome.planned for outcome in outcomes),
        "good": not any(counts.values()) and not complaints,
        **counts,
        "complaints": complaints,
        "duration_s": sum(outcome.duration_s for outcome in outcomes),
        "requests": typed,
        "remembered_bytes": [list(outcome.growth) for outcome in outcomes],
        "resident_bytes": [list(outcome.resident) for outcome in outcomes],
        "record_bytes": sum(outcome.files for outcome in outcomes),
        "limits": {
            "remembered_growth": GROWTH,
            "resident_growth_bytes": RESIDENT_GROWTH,
            "record_bytes_a_car": BYTES_A_CAR,
        },
        "cars": rows,
    }


def _rows(outcome: ShiftOutcome) -> list[dict[str, Any]]:
    """Return a row for each car of one daemon."""
    records = {record["part"]: record for record in outcome.records}
    rows = []
    for i, car in enumerate(outcome.cars):
        truth = outcome.truths[i] if i < len(outcome.truths) else CarTruth(False, None, None)
        record = records.get(car.part)
        reason = "" if record is None else record["reason"]
        result = "unreported" if record is None else "ok" if record["ok"] else "nok"
        rows.append(
            {
                "id": car.part,
                "variant": car.variant,
                "fault": None if car.fault is None else str(car.fault),
                "outcome": result,
                "reason": reason,
                "mounted": truth.mounted,
                "collision": truth.collision,
                "impact_mm": truth.impact_mm,
                "force_n": None if record is None else record["force"]["largest_n"],
                "cause_named": car.fault is None or any(c in reason for c in CAUSES[car.fault]),
                "duration_s": None if record is None else record["duration_s"],
            }
        )
    return rows


def _growth(outcome: ShiftOutcome) -> list[str]:
    """Return where memory or files grew beyond their bounds."""
    first, last = outcome.growth
    sizes = []
    if last > GROWTH * first:
        sizes.append(f"the daemon remembers {last} bytes at the end, {first} after the first car")
    grown = outcome.resident[1] - outcome.resident[0]
    if grown > RESIDENT_GROWTH:
        sizes.append(f"the process has grown by {grown} bytes, limit {RESIDENT_GROWTH}")
    most = BYTES_A_CAR * len(outcome.cars)
    if outcome.files > most:
        sizes.append(f"the record files have {outcome.files} bytes, limit {most}")
    return sizes


def table(result: Mapping[str, Any]) -> str:
    """Return a shift as text: its counts, and each car that is not plainly good."""
    cars = result["cars"]
    mounted = [car for car in cars if car["mounted"]]
    impacts = sorted(car["impact_mm"] for car in mounted if car["impact_mm"] is not None)
    lines = [
        f"{len(cars)} of {result['planned']} cars in {result['duration_s'] / 3600.0:.2f} h, "
        f"{len(mounted)} mounted, "
        f"{sum(car['fault'] is not None for car in cars)} with a fault",
        ", ".join(
            f"{name} {result[name]}"
            for name in ("unmounted_good", "mounted_bad", "unreported", "wrong_cause", "collisions")
        ),
    ]
    if impacts:
        median = impacts[len(impacts) // 2]
        lines.append(f"error at the touch: median {median:.2f} mm, largest {impacts[-1]:.2f} mm")
    lines += [
        f"{car['id']} {car['variant']}, {car['fault'] or 'no fault'}: {car['outcome']}. "
        f"{car['reason']}"
        for car in cars
        if car["fault"] is not None or not car["mounted"]
    ]
    return "\n".join([*lines, *result["complaints"]])
