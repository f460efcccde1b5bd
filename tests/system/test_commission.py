"""Commissioning of a cell whose sensors are mounted wrongly, judged by the plant's truth.

The controller's own programme moves the robot, the daemon listens. Recordings go through the
command line. What it writes is compared with the scenario, which the daemon never sees.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from linemate.daemon.commissioning import walk
from linemate.daemon.commissioning.walk import StepName, StepOutcome
from linemate.daemon.config import config
from linemate.daemon.core import rotations
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.operator import main as tool
from linemate.daemon.operator.commissioning import motion_files, site_files
from linemate.daemon.recording.reader import read
from linemate.simulators.devices.guided_robot import FORWARD, PostureProgramme
from linemate.simulators.devices.rsi_controller import Seven
from linemate.simulators.harness import lockstep
from linemate.simulators.harness.setup import Setup, laid_over, make
from linemate.simulators.judge.judge import RunEvidence, judge
from linemate.simulators.lab import commission_run
from linemate.simulators.lab.commission_run import CommissioningRun
from linemate.simulators.plants.conveyor_plan import Conveyor, ConveyorEvent
from linemate.simulators.plants.scenario import Scenario

pytestmark = pytest.mark.row

CAMERA_PLACE = (-0.05, 0.08, -0.2)
TURNED_CAMERA = (0.2, 0.3, -1.5)
SENSOR_ON_FLANGE = (-0.2, 0.0, -0.35)
SENSOR_TURN = (0.0, 1.5, 0.6)
MIRRORED: Seven = (1.0, 1.0, 1.0, 1.0, -1.0, 1.0, 1.0)
MOVE_S, DWELL_S = 0.8, 1.6
DRY_RUN_S = 5.6  # scenario time shortly before the tool meets the wheel


@pytest.fixture
def site(tmp_path: Path) -> Path:
    (tmp_path / "linemated.yaml").write_text("task: wheel.yaml\n")
    return tmp_path


def commission(site: Path, step: str, *words: object) -> int:
    return tool.main(["commission", str(site), "--step", step, *map(str, words)])


def guided(
    scenario: Scenario, postures: list[Seven], signs: Seven | None = None, move_s: float = MOVE_S
) -> tuple[Setup, list[Inputs]]:
    programme = PostureProgramme(postures, 0.5, move_s, DWELL_S)
    plan = CommissioningRun(programme) if signs is None else CommissioningRun(programme, signs)
    setup = Setup(scenario)
    return setup, commission_run.listen(setup, plan)


def recorded(path: Path, guided: tuple[Setup, list[Inputs]]) -> Path:
    return commission_run.write(*guided, path)


def overlay(site: Path, step: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((site / "commission" / f"{step}.yaml").read_text())
    return found


def turn_between(quaternion: list[float], truth: tuple[float, float, float]) -> float:
    w, x, y, z = quaternion
    off = rotations.exp(np.array(truth)).T @ rotations.matrix((w, x, y, z))
    return float(np.linalg.norm(rotations.log(off)))


def wrong_cell(plain: Scenario) -> Scenario:
    """The camera is turned and shifted; the sensor on the flange is turned, biased, inverted."""
    return replace(
        plain,
        camera=replace(plain.camera, position_in_tcp=CAMERA_PLACE, rotation_in_tcp=TURNED_CAMERA),
        force_torque=replace(
            plain.force_torque,
            position_in_tcp=SENSOR_ON_FLANGE,
            rotation_in_tcp=SENSOR_TURN,
            sign=-1,
            effects=replace(plain.force_torque.effects, bias_force=10.0, bias_torque=1.0),
        ),
    )


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site with a wrong cell after the steps camera and force, from one recording."""
    site = tmp_path_factory.mktemp("site")
    (site / "linemated.yaml").write_text("task: wheel.yaml\n")
    scenario = wrong_cell(commission_run.resting_scenario())
    load = replace(scenario.effector.load, tool_mass=40.0)
    scenario = replace(scenario, effector=replace(scenario.effector, load=load))
    postures = commission_run.looking_postures(15) + commission_run.weighing_postures()
    file = recorded(site / "postures.mcap", guided(scenario, postures, move_s=1.8))
    assert commission(site, "camera", "--from", file) == 0
    assert commission(site, "force", "--from", file, "--sensor-at", "flange") == 0
    return site


def test_a_camera_that_is_turned_in_the_tool_is_found(measured: Path) -> None:
    place = overlay(measured, "camera")["task"]["arm"]["camera_in_tcp"]
    assert place["position"] == pytest.approx(CAMERA_PLACE, abs=5e-4)
    assert turn_between(place["quaternion"], TURNED_CAMERA) < 1e-3
    # What was written is what the daemon starts with.
    config_file = measured / "linemated.yaml"
    config_file.write_text("task: wheel.yaml\noverlays: [commission/camera.yaml]\n")
    arm = config.load(config_file).task.file.arm
    assert arm.camera_in_tcp.position == tuple(place["position"])


def test_a_sensor_on_the_flange_that_states_the_opposite_force_is_found(measured: Path) -> None:
    arm = overlay(measured, "force")["task"]["arm"]
    assert arm["sensor_sign"] == -1
    assert turn_between(arm["sensor_in_tcp"]["quaternion"], SENSOR_TURN) < 5e-3
    assert arm["sensor_in_tcp"]["position"] == pytest.approx(SENSOR_ON_FLANGE, abs=1e-6)
    payload = overlay(measured, "force")["tracking"]["payload"]
    assert payload["mass"] == pytest.approx(40.0, abs=0.2)
    assert payload["centre"] == pytest.approx((0.0, 0.0, -0.15), abs=3e-3)
    state = walk.from_text((measured / "commission" / "progress.json").read_text())
    assert state.overlays() == ("force.yaml", "camera.yaml")


def assembly(measured: Path | None) -> RunEvidence:
    """Run the wrong cell, its conveyor 10 mrad off, with the overlays of a site or without."""
    shipped = make("wheel")
    scenario = wrong_cell(shipped.scenario)
    effects = replace(scenario.conveyor.effects, askew=(0.01, 0.0))
    scenario = replace(scenario, conveyor=replace(scenario.conveyor, effects=effects))
    setup = replace(shipped, scenario=scenario)
    for step in () if measured is None else ("camera", "force"):
        # The wheel of this run weighs nothing.
        setup = laid_over(setup, {"task": overlay(measured, step)["task"]})
    return lockstep.run(setup, 1)


def test_a_wrong_cell_is_not_approached_and_assembles_once_it_is_measured(measured: Path) -> None:
    """Two whole runs, judged by the plant."""
    before = assembly(None)
    assert before.collision is None
    assert not judge(before)["assembled"]
    contradicted = "no fresh position of the object: camera and distance contradict each other"
    assert before.refusal is not None
    assert before.refusal.startswith(f"arm refused: {contradicted}: ")
    after = assembly(measured)
    assert after.collision is None
    assert judge(after)["assembled"]


def test_an_axis_that_counts_the_other_way_is_named_and_nothing_is_written(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = commission_run.resting_scenario()
    postures = commission_run.looking_postures()
    file = recorded(site / "camera.mcap", guided(scenario, postures, MIRRORED))
    assert commission(site, "camera", "--from", file) == 1
    assert "They agree if A5 turns the other way than in the URDF" in capsys.readouterr().err
    assert not (site / "commission" / "camera.yaml").exists()
    state = walk.from_text((site / "commission" / "progress.json").read_text())
    assert state.of(StepName.CAMERA).outcome is StepOutcome.REFUSED


def test_a_conveyor_that_runs_10_mrad_off_is_found(site: Path) -> None:
    plain = commission_run.resting_scenario()
    events = (
        ConveyorEvent("stop", -3.0, 0.104),
        ConveyorEvent("start", 0.0, 0.104),
        ConveyorEvent("stop", 3.5, 0.104),
        ConveyorEvent("start", 6.0, 0.104),
        ConveyorEvent("stop", 9.0, 0.104),
    )
    scenario = replace(
        plain,
        lead_in_s=6.0,
        duration_s=12.0,
        conveyor=Conveyor(events=events, effects=replace(Conveyor().effects, askew=(0.01, 0.0))),
        body=replace(Scenario().body, offset=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0)),
    )
    setup, inputs = guided(scenario, [])
    file = commission_run.write(setup, inputs, site / "conveyor.mcap")
    assert commission(site, "conveyor", "--from", file) == 0
    found = overlay(site, "conveyor")["task"]["conveyor"]
    truth = commission_run.line_direction(setup)
    assert float(np.linalg.norm(np.array(found["axis"]) - truth)) < 1e-3
    assert found["nominal_speed"] == pytest.approx(0.106, abs=5e-4)
    assert found["deceleration"] == pytest.approx(0.104, rel=0.05)
    sensor = scenario.distance
    noise = math.hypot(sensor.sigma, sensor.quantisation / math.sqrt(12.0))
    distance = overlay(site, "conveyor")["tracking"]["distance"]
    assert distance["deviation"] == pytest.approx(noise, rel=0.1)
    (site / "linemated.yaml").write_text("task: wheel.yaml\noverlays: [commission/conveyor.yaml]\n")
    task = config.load(site / "linemated.yaml").task.file
    along = rotations.matrix(task.object.nominal.quaternion)[:, 1]
    assert along == pytest.approx(truth, abs=1e-3)


def test_a_correction_that_moves_an_axis_the_other_way_is_named_before_anything_is_tracked(
    site: Path,
) -> None:
    """The daemon's own motion: the linear axis and two of the six, for each takes 6 s."""
    file = signs_recorded(site, (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0), 19.0)
    assert commission(site, "signs", "--from", file) == 1
    figures = signs_of(site)
    assert figures["A1 moved for commanded"]["refused"].startswith("A1 moves the other way: -1.0")
    assert figures["A2 moved for commanded"]["value"] == pytest.approx(1.0, abs=0.01)
    assert figures["E1 moved for commanded"]["value"] == pytest.approx(1.0, abs=0.01)
    joints = np.array([s.inputs.robot.joints for s in read(file).steps if s.inputs.robot])
    moved = np.degrees(np.abs(joints - joints[0]).max(axis=0))
    assert moved[:2] == pytest.approx((0.2, 0.2), abs=0.02)
    assert moved.max() < 0.22


def test_a_linear_axis_that_moves_the_other_way_is_named_before_the_task_is_armed(
    site: Path,
) -> None:
    file = signs_recorded(site, (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0), 8.0)
    assert commission(site, "signs", "--from", file) == 1
    found = signs_of(site)["E1 moved for commanded"]["refused"]
    assert found.startswith("E1 moves the other way: -1.0")
    places = [s.inputs.robot.external[0] for s in read(file).steps if s.inputs.robot]
    assert max(places) - min(places) < 0.031


@pytest.mark.parametrize(
    ("corrected", "refused"),
    [
        (FORWARD, None),
        ((1.04, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0), "Check servos, camera and conveyor again"),
    ],
    ids=["whole", "4 % too much of A1"],
)
def test_a_dry_run_next_to_the_line_shows_both_errors_without_contact(
    site: Path, corrected: Seven, refused: str | None
) -> None:
    """The shipped task until shortly before contact: 10 s of virtual time, 2 s each."""
    shipped = make("wheel")
    scenario = replace(shipped.scenario, duration_s=DRY_RUN_S)
    plan = CommissioningRun(PostureProgramme((), 0.0), corrected=corrected, starts=True)
    setup = replace(shipped, scenario=scenario)
    file = commission_run.record(setup, plan, site / "dry-run.mcap")
    assert not any(step.outputs["contact"] for step in read(file).steps)
    assert commission(site, "dry-run", "--from", file) == (0 if refused is None else 1)
    state = walk.from_text((site / "commission" / "progress.json").read_text())
    record = state.of(StepName.DRY_RUN)
    control, seen = record.figures
    if refused is None:
        assert 0.0 < control["value"] < 0.7  # 0.56 mm; 3.5 mm if the stamp is left out
        assert 0.0 < seen["value"] < 2.0
    else:
        assert refused in record.reason
        assert refused in control["refused"]


def signs_of(site: Path) -> dict[str, Any]:
    state = walk.from_text((site / "commission" / "progress.json").read_text())
    return {figure["name"]: figure for figure in state.of(StepName.SIGNS).figures}


def signs_recorded(site: Path, corrected: Seven, duration_s: float) -> Path:
    """Record the motion of the step, with shares of the corrections by which each axis moves."""
    opened = site_files.open_site(site, "linemated.yaml")
    path = motion_files.write_motion(opened, walk.SiteState(), StepName.SIGNS)
    station = config.load(path)
    scenario = replace(commission_run.resting_scenario(), duration_s=duration_s)
    setup = Setup(
        scenario, station.config.tracking, station.config.control, station.task.file,
        station.task.urdf,
    )  # fmt: skip
    plan = CommissioningRun(PostureProgramme((), 0.0), corrected=corrected, starts=True)
    return commission_run.record(setup, plan, site / "signs.mcap")


def test_a_listening_daemon_records_the_same_inputs_as_one_that_makes_steps(site: Path) -> None:
    setup = Setup(commission_run.resting_scenario())
    plan = CommissioningRun(PostureProgramme(commission_run.looking_postures()[:1], 0.2, 0.4, 0.4))
    listened = commission_run.listen(setup, plan)
    file = commission_run.record(setup, plan, site / "steps.mcap")
    steps = read(file).steps
    stepped = {step.counter: step.inputs for step in steps}
    moved = [s.inputs for s in steps if s.inputs.robot is not None]
    assert len(stepped) > 50
    assert [x.camera for x in listened if x.camera] == [x.camera for x in moved if x.camera]
    assert {step.state for step in steps} <= {"init", "idle"}
