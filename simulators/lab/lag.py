"""Assemblies behind controllers that lag, and at every cycle: what both cost.

By lag: a dead time that is identified as it is, then one that grows while the robot moves and is
followed. By cycle (``--cycles``): RSI at one period after another. ``--curve``: more dead times.
``--touch``: runs end when the tool has touched the object.

Invariants:
    The daemon's dead times are the plant's: what is measured is the price of the lag itself.
    Seeds are run one after another, in virtual time.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from linemate.daemon.command_line import one_thread
from linemate.simulators.harness import setup
from linemate.simulators.harness.cell import families
from linemate.simulators.harness.setup import Setup
from linemate.simulators.judge.statistics import summarise
from linemate.simulators.lab.campaign import CampaignJob, execute

LAGS_MS = (36.0, 84.0, 120.0, 180.0)
CURVE_MS = (20.0, 36.0, 60.0, 84.0, 120.0, 150.0, 180.0)
TOUCH_S = 6.5  # a stop of the conveyor and the touch are over by then
DRIFTS_MS = ((84.0, 180.0),)
"""From and to, in twenty seconds: FANUC rested and warm, the drift of hours in one assembly."""

DRIFT_MARGIN_S = 0.014  # allowed beyond the warm dead time
CYCLES_MS = (1.0, 2.0, 4.0, 8.0, 12.0, 24.0)
FIGURES = (
    "control_error.approach.max_mm",
    "control_error.contact.max_mm",
    "total_error.stop.max_mm",
    "total_error.impact.max_mm",
    "total_error.contact.max_mm",
    "contact_force_n.max",
    "limits.violations",
)


def lagging(lag_s: float, growth_s: float = 0.0, changes: Sequence[str] = ()) -> Setup:
    """Return a cell behind a FANUC controller whose slowest axis has a dead time.

    Args:
        lag_s: dead time of the slowest axis; all axes get as much more [s].
        growth_s: by which it grows in twenty seconds, followed by the daemon [s].
        changes: of the scenario and the parameters, ``KEY=VALUE``.
    """
    if growth_s:
        changes = [
            *changes,
            f"scenario.robot.effects.warming.growth_s={growth_s}",
            f"control.drift.longer={growth_s + DRIFT_MARGIN_S}",
        ]
    run_setup = setup.make("wheel", changes, controller=families.FANUC)
    robot = run_setup.scenario.robot
    later = lag_s - max(axis.dead_time_s for axis in robot.axes)
    first, *others = [replace(axis, dead_time_s=axis.dead_time_s + later) for axis in robot.axes]
    two, three, four, five, six, seven = others
    axes = (first, two, three, four, five, six, seven)
    servos = tuple(
        replace(servo, dead_time=servo.dead_time + later) for servo in run_setup.control.servos
    )
    return replace(
        run_setup,
        scenario=replace(run_setup.scenario, robot=replace(robot, axes=axes)),
        control=replace(run_setup.control, servos=servos),
    )


def measured(run_setup: Setup, seeds: Sequence[int]) -> dict[str, Any]:
    """Return how many assemblies succeeded, and the figures over the seeds."""
    runs = execute([CampaignJob(run_setup, seed) for seed in seeds], 1)
    figures = summarise(runs)
    counts = {"runs": len(runs), "assembled": sum(run["assembled"] for run in runs)}
    return counts | {name: figures[name] for name in FIGURES if name in figures}


def main(words: Sequence[str] | None = None) -> int:
    """Print the figures by lag, or by cycle."""
    parser = argparse.ArgumentParser(
        prog="python -m linemate.simulators.lab.lag", description=__doc__
    )
    parser.add_argument("--seeds", type=int, default=4)
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--cycles", action="store_true", help="by cycle, with RSI")
    kinds.add_argument("--curve", action="store_true", help="more dead times")
    parser.add_argument("--touch", action="store_true", help="end after the touch")
    args = parser.parse_args(words)
    one_thread()
    seeds = range(args.seeds)
    changes = (f"scenario.duration_s={TOUCH_S}",) if args.touch else ()
    if args.cycles:
        rows = {
            f"{cycle:g}": measured(setup.make("wheel", changes, cycle_ms=cycle), seeds)
            for cycle in CYCLES_MS
        }
    else:
        lags_ms = CURVE_MS if args.curve else LAGS_MS
        rows = {f"{lag:g}": measured(lagging(1e-3 * lag, 0.0, changes), seeds) for lag in lags_ms}
    if not (args.cycles or args.curve):
        rows |= {
            f"{low:g} to {high:g}": measured(lagging(1e-3 * low, 1e-3 * (high - low)), seeds)
            for low, high in DRIFTS_MS
        }
    print(json.dumps({"rows": rows}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
