"""Drawn MuJoCo stations: each seed its own, within the ranges that were written down."""

from pathlib import Path

import pytest

from linemate.simulators.harness.setup import Setup
from linemate.simulators.lab.world import drawn_station, measure, mujoco_rows

NAME = "mujoco-drawn"


def drawn(seed: int) -> Setup:
    return mujoco_rows.prepared(NAME, (), None, seed)


@pytest.fixture(scope="module")
def setups() -> list[Setup]:
    return [drawn(seed) for seed in range(6)]


def test_a_station_is_within_its_ranges(setups: list[Setup]) -> None:
    for setup in setups:
        cell = setup.mujoco
        for value, (low, high) in (
            (cell.car.mass, drawn_station.MASS),
            (cell.tool.stiffness_share, drawn_station.MOUNT_SHARE),
            (cell.tool.friction, drawn_station.FRICTION),
            (setup.scenario.conveyor.nominal_speed, drawn_station.SPEED),
        ):
            assert value is not None
            assert low <= value <= high


def test_the_task_states_the_speed_alone(setups: list[Setup]) -> None:
    plain = mujoco_rows.prepared("mujoco", (), None, None)
    for setup in setups:
        conveyor = setup.task.conveyor
        assert conveyor.nominal_speed == setup.scenario.conveyor.nominal_speed
        assert conveyor.deceleration == plain.task.conveyor.deceleration
        assert (setup.tracking, setup.control) == (plain.tracking, plain.control)


def test_each_seed_is_another_station_and_always_the_same(setups: list[Setup]) -> None:
    cells = [setup.mujoco for setup in setups]
    assert all(cell != other for i, cell in enumerate(cells) for other in cells[:i])
    assert len({setup.scenario.conveyor.events for setup in setups}) == len(setups)
    assert drawn(3) == setups[3]


def test_a_weighed_station_is_the_same_and_states_its_wheel_within_a_tenth(
    setups: list[Setup],
) -> None:
    for seed, setup in enumerate(setups):
        weighed = mujoco_rows.prepared("mujoco-drawn-weighed", (), None, seed)
        assert weighed.mujoco == setup.mujoco
        stated, true = weighed.tracking.payload.part_mass, setup.mujoco.tool.wheel_mass
        assert true is not None
        assert stated == pytest.approx(true, rel=0.101)


def test_the_row_is_measured_only_when_it_is_named(tmp_path: Path) -> None:
    assert NAME not in measure.chosen(None, "mujoco")
    assert measure.chosen(NAME, "mujoco") == (NAME,)
    first, second = measure.prepare((NAME,), (0, 1), ("scenario.duration_s=9",), None, tmp_path)
    assert first.setup.mujoco != second.setup.mujoco
    assert first.setup.scenario.duration_s == 9.0
