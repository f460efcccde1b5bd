"""Recordings for each step of ``linemate commission``, of an emulated cell.

    python -m linemate.simulators.lab.commission_cell SITE --out DIR

It leaves ``DIR/STEP.mcap``; two for the dry run, and three of the object, of another one each. SITE
is the folder of a cell: ``linemated.yaml``, and ``scenario.yaml`` or else the scenario
``wheel``. What is mounted wrongly is set by ``--set scenario.KEY=VALUE``.

Invariants:
- The daemon has SITE's configuration with its overlays; the scenario alone has the truth.
- An engineer's orders are home, arm and start. No recording has a contact.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from linemate.daemon import command_line
from linemate.daemon.commissioning.walk import StepName
from linemate.daemon.config import config
from linemate.daemon.config.documents import FileError
from linemate.daemon.core.tracking.task import Phase
from linemate.daemon.operator.commissioning import motion_files, site_files
from linemate.simulators.devices.guided_robot import FORWARD, PostureProgramme
from linemate.simulators.devices.rsi_controller import Seven
from linemate.simulators.harness import setup as setups
from linemate.simulators.harness.cell import cell_files
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.setup import Setup
from linemate.simulators.lab import commission_run
from linemate.simulators.lab.commission_run import CommissioningRun
from linemate.simulators.plants.conveyor_plan import ConveyorEvent
from linemate.simulators.plants.scenario import Scenario

LINKS_S: Final = 10.0
MOVE_S, DWELL_S = 1.8, 1.6  # of a posture; a tool with a part swings after a brisk move
SHARE_OF_CONTACT: Final = 0.8  # of the way from the last waypoint before contact to that in contact
STEPS: Final = (
    StepName.LINKS, StepName.SIGNS, StepName.FORCE, StepName.CAMERA, StepName.CONVEYOR,
    StepName.SERVOS, StepName.OBJECT, StepName.DRY_RUN,
)  # fmt: skip
SEVERAL: Final = {StepName.DRY_RUN: 2, StepName.OBJECT: 3}
"""Recordings of a step. A dry run of a short task shows too few images; objects differ."""
RUN_WAY, STOPS, STAND_S = 0.25, 3, 2.0  # way of the object before each stop [m], rest after it
SWING_S: Final = 32.0  # the object swings for so long before a line at rest


@dataclass(frozen=True, slots=True)
class EmulatedCell:
    """A cell with its truth, and what is wrong in it.

    Attributes:
        site: folder of the cell.
        signs: of the axes as the controller counts.
        corrected: share of a correction by which each axis moves.
        overrides: ``KEY=VALUE`` of the truth, as for a run.
        seed: of the plant's draws.
    """

    site: Path
    signs: Seven = FORWARD
    corrected: Seven = FORWARD
    overrides: tuple[str, ...] = ()
    seed: int = commission_run.SEED

    def setup(self) -> Setup:
        """Return the site's configuration and the truth.

        Raises:
            FileError, SetupError: what is wrong.
        """
        cell = cell_files.named(str(self.site))
        return setups.make(cell_files.scenario(None, cell), self.overrides, cell=cell)


def record(cell: EmulatedCell, name: StepName, path: Path) -> Path:
    """Leave the recording of a step; return where.

    Raises:
        FileError, SetupError: the site's files do not fit, or the motion in them.
    """
    if name in motion_files.MOTIONS:
        return _moved(cell, name, path)
    setup = cell.setup()
    if name is StepName.DRY_RUN:
        return _dry_run(cell, setup, path)
    postures: list[Seven] = []
    resting = commission_run.resting_scenario(setup.scenario)
    nominal = cell_files.named(str(cell.site)).nominal
    if name is StepName.CAMERA:
        postures = commission_run.looking_postures(task=nominal)
    elif name is StepName.FORCE:
        postures = commission_run.weighing_postures(nominal)
    elif name is StepName.CONVEYOR:
        resting = _passing(setup.scenario)
    elif name is StepName.OBJECT:
        resting = _swinging(setup.scenario)
    else:
        resting = replace(resting, duration_s=LINKS_S)
    programme = PostureProgramme(postures, 0.5, MOVE_S, DWELL_S)
    plan = CommissioningRun(programme, cell.signs, cell.corrected, cycle_ms=_cycle_ms(setup))
    setup = replace(setup, scenario=resting)
    return commission_run.write(setup, commission_run.listen(setup, plan, cell.seed), path)


def _cycle_ms(setup: Setup) -> float:
    return round(1e3 * setup.scenario.cycle_s, 6)


def _moved(cell: EmulatedCell, name: StepName, path: Path) -> Path:
    """Record the motion that the step writes, carried out by the daemon."""
    site = site_files.open_site(cell.site, cell_files.CONFIG)
    file = motion_files.write_motion(site, site_files.read_state(site), name)
    station, setup = config.load(file), cell.setup()
    duration_s = station.task.file.waypoints[-1].time + 8.0  # with the way home
    resting = replace(commission_run.resting_scenario(setup.scenario), duration_s=duration_s)
    moving = replace(
        setup,
        scenario=resting,
        tracking=station.config.tracking,
        control=station.config.control,
        task=station.task.file,
        urdf=station.task.urdf,
        station=station,
    )
    return _ordered(cell, moving, path)


def _dry_run(cell: EmulatedCell, setup: Setup, path: Path) -> Path:
    """Record the task until shortly before contact."""
    waypoints = setup.task.waypoints
    first = next(i for i, point in enumerate(waypoints) if point.phase is Phase.CONTACT)
    before, after = waypoints[first - 1].time, waypoints[first].time
    end_s = before + SHARE_OF_CONTACT * (after - before)
    return _ordered(cell, replace(setup, scenario=replace(setup.scenario, duration_s=end_s)), path)


def _ordered(cell: EmulatedCell, setup: Setup, path: Path) -> Path:
    """Record a motion that an engineer arms and starts."""
    plan = CommissioningRun(
        PostureProgramme((), 0.0), cell.signs, cell.corrected, starts=True,
        cycle_ms=_cycle_ms(setup),
    )  # fmt: skip
    return commission_run.record(setup, plan, path, cell.seed)


def _drive(truth: Scenario) -> tuple[float, float]:
    """Return deceleration and acceleration of the line's drive [m/s^2].

    Raises:
        SetupError: the scenario has no stop and start that it could use.
    """
    drive = {event.kind: event.acceleration for event in truth.conveyor.events}
    if not {"stop", "start"} <= drive.keys():
        raise SetupError("the scenario needs a stop and a start of the conveyor: how quick it is")
    return drive["stop"], drive["start"]


def _passing(truth: Scenario) -> Scenario:
    """Return a line that brings the object past the robot and stops three times."""
    speed, (down, up) = truth.conveyor.nominal_speed, _drive(truth)
    run_s, stop_s, start_s = RUN_WAY / speed, speed / down + STAND_S, speed / up
    events, time = [], 0.0
    for _ in range(STOPS):
        time += run_s
        events.append(ConveyorEvent("stop", time, down))
        events.append(ConveyorEvent("start", time + stop_s, up))
        time += stop_s + start_s
    end_s = time + run_s
    lead_in_s = 0.5 * STOPS * run_s  # the object passes in the middle
    moved = tuple(replace(event, onset_s=event.onset_s - lead_in_s) for event in events)
    return replace(
        truth,
        lead_in_s=lead_in_s,
        duration_s=end_s - lead_in_s,
        conveyor=replace(truth.conveyor, events=moved),
    )


def _swinging(truth: Scenario) -> Scenario:
    """Return a line that brings the object, stops, and goes on and stops at the end."""
    speed, (down, up) = truth.conveyor.nominal_speed, _drive(truth)
    again_s = SWING_S + speed / up + 1.0
    events = (
        ConveyorEvent("stop", 0.0, down),
        ConveyorEvent("start", SWING_S, up),
        ConveyorEvent("stop", again_s, down),
    )
    conveyor = replace(truth.conveyor, events=events)
    return replace(truth, lead_in_s=4.0, duration_s=again_s + 8.0, conveyor=conveyor)


def main(arguments: Sequence[str] | None = None) -> int:
    """Record the steps; return 0, or 1 if the files do not fit."""
    parser = argparse.ArgumentParser(description="Recordings for linemate commission, emulated.")
    parser.add_argument("site", type=Path, metavar="SITE", help="folder of the cell")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--step", choices=[name.value for name in STEPS], help="this one alone; all"
    )
    parser.add_argument(
        "--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE",
        help="of the truth, for example scenario.force_torque.sign=-1",
    )  # fmt: skip
    args = parser.parse_args(arguments)
    if not (args.site / cell_files.CONFIG).is_file():
        wanted = f"copy a cell's folder, for example {cell_files.DATA}/wheel, and name the copy"
        print(f"{args.site}: no {cell_files.CONFIG} in it; {wanted}", file=sys.stderr)
        return 1
    cell = EmulatedCell(args.site, overrides=tuple(args.overrides))
    names = STEPS if args.step is None else (StepName(args.step),)
    for name in names:
        try:
            files = [str(path) for path in recorded(cell, name, args.out)]
        except (FileError, SetupError) as error:
            print(error, file=sys.stderr)
            return 1
        print(f"linemate commission {args.site} --step {name.value} --from", *files, flush=True)
    return 0


def recorded(cell: EmulatedCell, name: StepName, folder: Path) -> list[Path]:
    """Leave the recordings of a step; return where.

    Raises:
        FileError, SetupError: the site's files do not fit, or the motion in them.
    """
    if name not in SEVERAL:
        return [record(cell, name, folder / f"{name.value}.mcap")]
    return [
        record(replace(cell, seed=cell.seed + i), name, folder / f"{name.value}-{i + 1}.mcap")
        for i in range(SEVERAL[name])
    ]


if __name__ == "__main__":
    sys.exit(command_line.run("commission_cell", main))
