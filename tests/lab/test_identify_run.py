"""From wrong settings over recordings to an overlay: the plant's true values are found."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.identification.outcome import Estimate, Refusal
from linemate.daemon.identification.pipeline import Identified
from linemate.daemon.operator import identify_command
from linemate.simulators.devices.worlds import WORLDS, order_of
from linemate.simulators.harness import setup
from linemate.simulators.lab import exercise, identify_run
from linemate.simulators.lab.identify_run import IdentificationPlan
from linemate.simulators.plants.scenario import Effector, Robot

pytestmark = pytest.mark.row("one exercise")

PLAN = IdentificationPlan(exercises=1, wheels=0, overrides=("scenario.duration_s=12.5",))
"""A third of the exercise."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="module")
def found(folder: Path) -> Identified:
    return identify_run.identified(PLAN, folder)


def value(found: Identified, name: str) -> Estimate:
    (outcome,) = [f.outcome for f in found.findings if f.name == name]
    assert isinstance(outcome, Estimate), outcome
    return outcome


def test_servos_are_the_plants_although_others_were_believed(found: Identified) -> None:
    models = found.overlay["control"]["servos"]
    axes = Robot().axes
    for axis in (0, 1, 2, 4, 6):  # a third of the exercise does not move the others
        assert models[axis]["frequency_hz"] == pytest.approx(axes[axis].frequency_hz, rel=5e-3)
        assert models[axis]["damping"] == pytest.approx(axes[axis].damping, rel=5e-3)
        assert models[axis]["dead_time"] == pytest.approx(axes[axis].dead_time_s, abs=2e-4)


def test_the_tools_modes_are_reported_where_it_was_excited(found: Identified) -> None:
    modes, true = found.overlay["control"]["effector"], Effector().frequency_hz
    for axis in (0, 1, 2):
        assert modes[axis]["frequency_hz"] == pytest.approx(true[axis], rel=0.01)
        assert modes[axis]["damping"] == pytest.approx(0.02, abs=0.006)


def test_the_swing_is_reported(found: Identified) -> None:
    frequency = value(found, "swing 1 frequency")
    assert abs(frequency.value - 0.62) < 4.0 * frequency.deviation
    assert frequency.deviation < 0.005


def test_what_was_kept_is_reported(found: Identified) -> None:
    refused = {f.name for f in found.findings if isinstance(f.outcome, Refusal)}
    assert "distance offset of the sensor" in refused
    for path in found.kept:
        assert path.startswith(("control.servos.", "control.effector."))


def test_the_overlay_is_what_the_command_line_writes_and_a_run_accepts(
    found: Identified, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "identified.yaml"
    text = identify_command.overlay_text(found, ["exercise-0.mcap"])
    identify_command.write(path, text)
    read = yaml.safe_load(path.read_text())
    assert read == found.overlay
    made = setup.laid_over(setup.make("wheel"), read)
    assert made.control.servos[0].frequency_hz == read["control"]["servos"][0]["frequency_hz"]
    assert made.tracking.swing[0].levers == tuple(read["tracking"]["swing"][0]["levers"])
    assert made.scenario == setup.make("wheel").scenario


def test_recordings_of_one_identification_are_of_one_cell() -> None:
    for scenario in ("identify", "wheel"):
        for world in WORLDS:
            plan = replace(PLAN, world=world, seed=11, overrides=())
            order = order_of(identify_run._initial_setup(plan, scenario).scenario)
            assert order.cell_seed == 11


def test_the_exercise_is_a_valid_task_that_turns_and_touches_nothing() -> None:
    task = task_file.load(DAEMON_DATA / exercise.EXERCISE).file
    assert task.arm == setup.shipped_task().file.arm
    assert replace(task.conveyor) == setup.shipped_task().file.conveyor
    assert {w.phase.value for w in task.waypoints} == {"approach", "done"}
    quaternions = {w.pose.quaternion for w in task.waypoints}
    assert len(quaternions) > 8


def test_a_stranger_believes_nothing_that_is_true() -> None:
    truth = Robot().axes
    for model, axis in zip(identify_run.STRANGER.servos, truth, strict=True):
        assert (model.frequency_hz, model.damping, model.dead_time) != (
            axis.frequency_hz, axis.damping, axis.dead_time_s,
        )  # fmt: skip
    for mode, true in zip(identify_run.STRANGER.effector, Effector().frequency_hz, strict=True):
        assert (mode.frequency_hz, mode.damping) != (true, 0.02)
