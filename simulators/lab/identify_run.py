"""From fresh recordings in virtual time to an overlay of identified parameters.

Invariants:
    The daemon starts from wrong settings (``STRANGER``).
    It exercises, identifies, assembles some wheels, and identifies again from all
        recordings.
    The scenario reaches the overlay only through the sensor links.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from linemate.daemon.config import task_file
from linemate.daemon.config.task_file import Task
from linemate.daemon.core.control import urdf_limits
from linemate.daemon.core.control.settings import ControlSettings, EffectorMode, ServoModel
from linemate.daemon.core.tracking.settings import SwingMode, TrackingSettings
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.identification.pipeline import Identified
from linemate.daemon.operator import identify_command
from linemate.daemon.recording.step_codec import encode
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import metadata_of
from linemate.simulators.devices.worlds import OWN, WORLDS
from linemate.simulators.harness import lockstep, scenario_file
from linemate.simulators.harness.cell import cell_files, families
from linemate.simulators.harness.cell.cell_files import CellFiles
from linemate.simulators.harness.cell.cell_truth import shipped_task
from linemate.simulators.harness.setup import Setup, laid_over, override
from linemate.simulators.lab import exercise
from linemate.simulators.plants.scenario import Scenario

EXERCISE_SCENARIO = "identify"
FIRST_SEED = 5000  # of recordings: neither tuned on nor verified with
NEVER_S = 1e6

STRANGER = ControlSettings(
    servos=(ServoModel(5.0, 0.7, 0.03),) * 7, effector=(EffectorMode(6.0, 0.03),) * 6
)
"""Settings for an arm and a tool that were not measured."""

STRANGE_TRACKING = TrackingSettings(swing=(SwingMode(1, 0.7, 0.0, (-0.25, 0.0, -0.8)),))
"""Settings for an object whose swing was not measured."""


@dataclass(frozen=True, slots=True)
class IdentificationPlan:
    """How much is recorded.

    Attributes:
        wheels: recordings of ordinary runs with the settings identified from the exercise.
        seed: of the first recording.
        cycle_ms: instead of the scenarios' cycle.
        overrides: ``KEY=VALUE`` of the plant, as for a run; for a cell that is not the default one.
        world: name, one of ``worlds.WORLDS``.
        controller: family, one of ``families.FAMILIES``.
        cell: name or folder of a cell that is not the default one.
        scenario: whose plant is identified, without its stops and starts; that of the cell
            without one.
    """

    exercises: int = 2
    wheels: int = 2
    seed: int = FIRST_SEED
    cycle_ms: float | None = None
    overrides: tuple[str, ...] = ()
    world: str = OWN
    controller: str = families.RSI
    cell: str | None = None
    scenario: str | None = None


def identified(plan: IdentificationPlan, folder: Path) -> Identified:
    """Return what the recordings of a cell show of it; the recordings stay in ``folder``."""
    files = [
        record(_exercise(plan), plan.seed + i, folder / f"exercise-{i}.mcap")
        for i in range(plan.exercises)
    ]
    outcome = identify_command.from_files(files)
    if not plan.wheels:
        return outcome
    wheel = laid_over(_initial_setup(plan, "wheel"), outcome.overlay)
    files += [
        record(wheel, plan.seed + 100 + i, folder / f"wheel-{i}.mcap") for i in range(plan.wheels)
    ]
    return identify_command.from_files(files)


def record(setup: Setup, seed: int, path: Path) -> Path:
    """Leave the recording of one run in virtual time; return where."""
    path.parent.mkdir(parents=True, exist_ok=True)
    config = {"tracking": _plain(setup.tracking), "control": _plain(setup.control)}
    texts = {
        "config": yaml.safe_dump(config),
        "task": exercise.text(setup.task),
        "urdf": setup.urdf,
        **task_file.geometry_text(setup.control.geometry),
    }
    file = StepFile(path.open("wb"), metadata_of(texts))

    def keep(entry: LogEntry) -> None:
        data = encode(entry.counter, entry.state, entry.inputs, entry.outputs)
        file.write(entry.inputs.stamp_ns, data)

    try:
        lockstep.run(setup, seed, on_step=keep)
    finally:
        file.close()
    return path


def _exercise(plan: IdentificationPlan) -> Setup:
    """Return the exercise of a plan's cell."""
    setup = _initial_setup(plan, EXERCISE_SCENARIO)
    cell = _cell(plan)
    return _exercising(setup, exercise.of_cell(shipped_task() if cell is None else cell.task))


def exercise_in(setup: Setup) -> Setup:
    """Return the exercise in the plant of a run, by its daemon."""
    truth = _with_events(setup.scenario, scenario_file.load(EXERCISE_SCENARIO))
    return _exercising(replace(setup, scenario=truth), exercise.of_cell(shipped_task()))


def _exercising(setup: Setup, task: Task) -> Setup:
    """Return a run of programmed motion alone, undamped, so that the tool rings."""
    return replace(
        setup,
        task=task.file,
        urdf=task.urdf,
        tracking=replace(setup.tracking, merge=replace(setup.tracking.merge, blend=NEVER_S)),
        control=replace(setup.control, damping=False),
    )


def _cell(plan: IdentificationPlan) -> CellFiles | None:
    """Return the files of the plan's cell, None for the default one."""
    return None if plan.cell is None else cell_files.named(plan.cell)


def _truth(name: str, cell: CellFiles | None, scenario: str | None) -> Scenario:
    """Return a scenario; the exercise has the plant of the cell, or of the named scenario."""
    nominal = None if cell is None else cell.nominal
    plant = scenario or (None if cell is None else cell.scenario)
    order = scenario_file.load(name, nominal)
    if plant is None:
        return order
    own = scenario_file.load(plant, nominal)
    if name != EXERCISE_SCENARIO:
        return own
    return _with_events(own, order)


def _with_events(truth: Scenario, order: Scenario) -> Scenario:
    """Return a plant with the stops and starts, and the times, of another scenario."""
    conveyor = replace(truth.conveyor, events=order.conveyor.events)
    return replace(truth, conveyor=conveyor, lead_in_s=order.lead_in_s, duration_s=order.duration_s)


def _initial_setup(plan: IdentificationPlan, name: str) -> Setup:
    cell = _cell(plan)
    truth = _truth(name, cell, plan.scenario)
    if plan.cycle_ms is not None:
        truth = replace(truth, cycle_s=round(plan.cycle_ms * 1e-3, 9))
    # The recordings are of one cell: servos that are drawn again contradict each other.
    if truth.cell_seed is None:
        truth = replace(truth, cell_seed=plan.seed)
    truth = families.truth(plan.controller, truth)
    setup = Setup(
        truth,
        tracking=STRANGE_TRACKING,
        control=STRANGER,
        world=plan.world,
        controller=plan.controller,
    )
    if cell is not None:
        setup = _of_stranger(setup, cell)
    return override(setup, plan.overrides) if plan.overrides else setup


def _of_stranger(setup: Setup, cell: CellFiles) -> Setup:
    """Return the set-up of a cell whose servos, tool and object were not measured.

    Its links, and what its data sheets say of mount and camera, are configured.
    """
    arm = cell.task.file.arm
    limits = urdf_limits.read(cell.task.urdf, arm.flange, linear_axis=arm.linear_axis)
    tracking = setup.tracking
    if cell.station is not None:
        known = cell.station.config.tracking
        tactile = replace(known.tactile, deflection=tracking.tactile.deflection)
        tactile = replace(tactile, angle=tracking.tactile.angle)
        camera = replace(tracking.camera, blind_below=known.camera.blind_below)
        tracking = replace(tracking, tactile=tactile, camera=camera)
    return replace(
        setup,
        tracking=tracking,
        control=replace(setup.control, limits=limits),
        task=cell.task.file,
        urdf=cell.task.urdf,
        station=cell.station,
    )


def _plain(settings: TrackingSettings | ControlSettings) -> dict[str, Any]:
    from pydantic import TypeAdapter

    plain: dict[str, Any] = TypeAdapter(type(settings)).dump_python(settings, mode="json")
    return plain


def main(argv: Sequence[str] | None = None) -> int:
    """Make recordings, identify, and leave an overlay.

    Returns:
        0 if there is one.
    """
    plain = IdentificationPlan()
    parser = argparse.ArgumentParser(prog="python -m linemate.simulators.lab.identify_run")
    parser.add_argument("--out", type=Path, default=Path("out/identify"), metavar="DIR")
    parser.add_argument("--overlay", type=Path, metavar="FILE", help="DIR/identified.yaml")
    parser.add_argument("--exercises", type=int, default=plain.exercises, metavar="N")
    parser.add_argument("--wheels", type=int, default=plain.wheels, metavar="N")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, metavar="M")
    parser.add_argument("--cycle-ms", type=float, metavar="MS")
    parser.add_argument("--world", choices=WORLDS, default=OWN)
    parser.add_argument("--controller", choices=families.FAMILIES, default=families.RSI)
    parser.add_argument("--cell", metavar="NAME|DIR")
    parser.add_argument("--scenario", metavar="NAME|FILE")
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    args = parser.parse_args(argv)
    plan = IdentificationPlan(
        args.exercises,
        args.wheels,
        args.first_seed,
        args.cycle_ms,
        tuple(args.overrides),
        args.world,
        args.controller,
        args.cell,
        args.scenario,
    )
    outcome = identified(plan, args.out)
    print(identify_command.table(outcome.findings))
    if not outcome.overlay:
        print("nothing could be identified", file=sys.stderr)
        return 1
    path = args.overlay or args.out / "identified.yaml"
    names = sorted(file.name for file in args.out.glob("*.mcap"))
    identify_command.write(path, identify_command.overlay_text(outcome, names))
    print(f"\noverlay: {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
