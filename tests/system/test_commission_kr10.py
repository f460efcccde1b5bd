"""Commissioning of the second shipped cell by its files, with wrong mountings, end to end.

Recordings are those of ``linemate.simulators.lab.commission_cell``; the command line measures.
"""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from linemate.daemon.commissioning import walk
from linemate.daemon.commissioning.walk import StepName
from linemate.daemon.core import rotations
from linemate.daemon.operator import main as tool
from linemate.simulators.harness import lockstep
from linemate.simulators.harness.cell import cell_files
from linemate.simulators.judge.judge import judge
from linemate.simulators.lab import commission_cell
from linemate.simulators.lab.commission_cell import EmulatedCell

pytestmark = pytest.mark.row

CAMERA_PLACE, CAMERA_TURN = (-0.06, 0.05, -0.12), (0.1, -0.2, 0.9)
SENSOR_TURN = (0.2, -0.4, 1.0)
MASS = 6.0  # of the tool [kg]
WRONG_CAMERA = (
    f"scenario.camera.position_in_tcp={list(CAMERA_PLACE)}",
    f"scenario.camera.rotation_in_tcp={list(CAMERA_TURN)}",
)
WRONG_SENSOR = (
    f"scenario.force_torque.rotation_in_tcp={list(SENSOR_TURN)}",
    "scenario.force_torque.sign=-1",
    f"scenario.effector.load.tool_mass={MASS}",
)
ELSEWHERE = ("scenario.body.offset=[0.05, 0.0, -0.04]", "scenario.body.rotation=[0.0, 0.03, 0.0]")
ASKEW = ("scenario.conveyor.effects.askew=[0.01, 0.0]",)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    return Path(shutil.copytree(cell_files.DATA / "kr10", tmp_path / "site"))


def commission(cell: EmulatedCell, step: StepName, *words: str) -> int:
    files = map(str, commission_cell.recorded(cell, step, cell.site))
    arguments = ["commission", str(cell.site), "--step", step.value, "--from", *files]
    return tool.main([*arguments, *words])


def overlay(site: Path, step: StepName) -> dict[str, Any]:
    text = (site / "commission" / f"{step.value}.yaml").read_text()
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def turn_off(quaternion: list[float], truth: tuple[float, float, float]) -> float:
    w, x, y, z = quaternion
    off = rotations.exp(np.array(truth)).T @ rotations.matrix((w, x, y, z))
    return float(np.linalg.norm(rotations.log(off)))


def run(cell: EmulatedCell, *, with_overlay: StepName | None) -> dict[str, Any]:
    """Assemble at the site, with an overlay in force or without."""
    config = cell.site / "linemated.yaml"
    if with_overlay is not None:
        listed = f", commission/{with_overlay.value}.yaml]"
        config.write_text(
            config.read_text().replace("identified.yaml]", f"identified.yaml{listed}")
        )
    evidence = lockstep.run(cell.setup(), 0)
    return {**judge(evidence), "collided": evidence.collision is not None}


def test_a_camera_that_is_turned_is_found_and_assembles_once_its_overlay_is_in_force(
    site: Path,
) -> None:
    cell = EmulatedCell(site, overrides=WRONG_CAMERA)
    before = run(cell, with_overlay=None)
    assert not before["assembled"]
    assert not before["collided"]
    assert commission(cell, StepName.CAMERA) == 0
    place = overlay(site, StepName.CAMERA)["task"]["arm"]["camera_in_tcp"]
    assert place["position"] == pytest.approx(CAMERA_PLACE, abs=5e-4)
    assert turn_off(place["quaternion"], CAMERA_TURN) < 1e-3
    # The truth stays where it is: an overlay is what the daemon believes.
    after = run(cell, with_overlay=StepName.CAMERA)
    assert cell.setup().scenario.camera.position_in_tcp == CAMERA_PLACE
    assert after["assembled"]


def test_a_sensor_that_is_turned_and_states_the_opposite_force_is_found(site: Path) -> None:
    cell = EmulatedCell(site, overrides=WRONG_SENSOR)
    assert commission(cell, StepName.FORCE, "--sensor-at", "tcp") == 0
    found = overlay(site, StepName.FORCE)
    assert found["task"]["arm"]["sensor_sign"] == -1
    assert turn_off(found["task"]["arm"]["sensor_in_tcp"]["quaternion"], SENSOR_TURN) < 5e-3
    assert found["tracking"]["payload"]["mass"] == pytest.approx(MASS, abs=0.1)


def test_an_axis_that_counts_the_other_way_is_named(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = EmulatedCell(site, signs=(1.0, 1.0, 1.0, 1.0, -1.0, 1.0, 1.0))
    assert commission(cell, StepName.CAMERA) == 1
    assert "They agree if A5 turns the other way than in the URDF" in capsys.readouterr().err
    assert not (site / "commission" / "camera.yaml").exists()


def test_a_correction_with_the_wrong_sign_is_named_after_a_fifth_of_a_degree(site: Path) -> None:
    cell = EmulatedCell(site, corrected=(1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0))
    assert commission(cell, StepName.SIGNS) == 1
    state = walk.from_text((site / "commission" / "progress.json").read_text())
    figures = {figure["name"]: figure for figure in state.of(StepName.SIGNS).figures}
    assert len(figures) == 6
    assert figures["A3 moved for commanded"]["refused"].startswith("A3 moves the other way: -1.0")
    assert figures["A2 moved for commanded"]["value"] == pytest.approx(1.0, abs=0.01)


def test_a_line_that_runs_10_mrad_off_is_found_and_the_truth_does_not_turn_with_it(
    site: Path,
) -> None:
    cell = EmulatedCell(site, overrides=ASKEW)
    assert commission(cell, StepName.CONVEYOR) == 0
    found = overlay(site, StepName.CONVEYOR)
    axis = found["task"]["conveyor"]["axis"]
    assert float(np.linalg.norm(np.array(axis) - (0.01, 0.99995, 0.0))) < 1e-3
    assert found["tracking"]["distance"]["deviation"] == pytest.approx(0.38e-3, rel=0.1)
    assert run(cell, with_overlay=StepName.CONVEYOR)["assembled"]


def test_objects_that_hang_off_their_nominal_place_are_found(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three objects, 50 and 40 mm off and turned about the line; each swings, for a short time."""
    monkeypatch.setattr(commission_cell, "SWING_S", 6.0)
    nominal = EmulatedCell(site).setup().task.object.nominal
    cell = EmulatedCell(site, overrides=ELSEWHERE)
    assert commission(cell, StepName.OBJECT) == 0
    found = overlay(site, StepName.OBJECT)["task"]["object"]["nominal"]
    C = rotations.matrix(nominal.quaternion)
    off = C.T @ (np.array(found["position"]) - nominal.position)
    assert off == pytest.approx((0.05, 0.0, -0.04), abs=1e-4)
    turned = rotations.log(C.T @ rotations.matrix(tuple(found["quaternion"])))
    assert turned == pytest.approx((0.0, 0.03, 0.0), abs=1e-4)
    assert run(cell, with_overlay=StepName.OBJECT)["assembled"]


def test_the_truth_of_a_cell_is_its_task_file_whatever_overlays_say(site: Path) -> None:
    plain = EmulatedCell(site).setup()
    (site / "commission").mkdir()
    (site / "commission" / "camera.yaml").write_text(
        "task: {arm: {camera_in_tcp: {position: [0.5, 0.0, 0.0]}}}\n"
    )
    config = site / "linemated.yaml"
    listed = "identified.yaml, commission/camera.yaml]"
    config.write_text(config.read_text().replace("identified.yaml]", listed))
    believing = EmulatedCell(site).setup()
    assert believing.task.arm.camera_in_tcp.position == (0.5, 0.0, 0.0)
    assert believing.scenario == plain.scenario
