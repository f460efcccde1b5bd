"""The rows on which a run is judged."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from linemate.protocol.exchange_controller import Judgement
from linemate.simulators.devices.robot_plant import RobotPlant
from linemate.simulators.devices.rsi_controller import Applied
from linemate.simulators.devices.truth import TruthLog, load, pose_rows
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.world import World


@pytest.mark.parametrize("seed", range(50))
def test_poses_become_positions_and_quaternions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.standard_normal(3) * (np.pi if seed % 2 else 1e-9))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), rng.standard_normal(3)
    row = pose_rows(pose[np.newaxis, :3, 3], pose[np.newaxis, :3, :3])[0]
    np.testing.assert_allclose(row[:3], pose[:3, 3])
    assert row[3] >= 0.0
    again = Rotation.from_quat([*row[4:], row[3]])
    assert (again * turn.inv()).magnitude() < 1e-7
    assert np.linalg.norm(row[3:]) == pytest.approx(1.0)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.8, 0)])
def test_half_turns_are_no_exception(axis: tuple[float, float, float]) -> None:
    turn = Rotation.from_rotvec(np.pi * np.array(axis))
    pose = np.eye(4)
    pose[:3, :3] = turn.as_matrix()
    row = pose_rows(pose[np.newaxis, :3, 3], pose[np.newaxis, :3, :3])[0]
    assert (Rotation.from_quat([*row[4:], row[3]]) * turn.inv()).magnitude() < 1e-7


def _applied(plant: RobotPlant, cycle: int, answered: bool) -> Applied:
    outcome = Judgement.ACCEPTED if answered else Judgement.MISSING
    return Applied(cycle, 1000 + 12 * cycle, plant.start, 0, outcome, clamped=False)


def test_a_row_is_the_telegrams_instant_and_what_was_applied_from_it_on(tmp_path: Path) -> None:
    world = World(Scenario(lead_in_s=0.0, duration_s=1.0))
    plant, log = RobotPlant(world), TruthLog(3)
    for cycle in range(4):
        plant.read()
        log.begin(world, plant.axes)
        applied = _applied(plant, cycle, answered=cycle != 1)
        log.end(applied, 250_000)
        plant.apply(applied)
    assert len(log) == 3
    assert log.dropped == 1
    log.save(tmp_path / "truth.npz", {"seed": 7})
    columns, facts = load(tmp_path / "truth.npz")
    assert facts == {"seed": 7}
    np.testing.assert_allclose(columns["t"], [0.0, 0.012, 0.024])
    np.testing.assert_array_equal(columns["ipoc"], [1000, 1012, 1024])
    np.testing.assert_array_equal(columns["answered"], [True, False, True])
    np.testing.assert_array_equal(np.isnan(columns["turnaround_us"]), [False, True, False])
    np.testing.assert_allclose(columns["setpoints"][0], plant.start)
    np.testing.assert_allclose(columns["tcp"], columns["tcp_rigid"], atol=1e-6)
    assert columns["unit_position"][2] == pytest.approx(0.106 * 0.024, abs=1e-3)


def test_the_plant_is_commanded_and_goes_to_the_next_telegram() -> None:
    world = World(Scenario(lead_in_s=0.0))
    plant = RobotPlant(world)
    moved = (0.01, *plant.start[1:])
    for cycle in range(100):
        applied = Applied(cycle, cycle, moved, 0, Judgement.ACCEPTED, clamped=False)
        plant.apply(applied)
    assert world.time_s == pytest.approx(1.2)
    reading = plant.read()
    assert reading.axes[0] == pytest.approx(0.01, abs=1e-3)
    expected = world.tcp_rigid_pose()
    np.testing.assert_allclose(reading.tcp[:3], expected[:3, 3])
    a, b, c = reading.tcp[3:]
    turn = Rotation.from_euler("ZYX", [a, b, c]).as_matrix()
    np.testing.assert_allclose(turn, expected[:3, :3], atol=1e-9)
