"""The second shipped cell, by its files alone: six axes, no linear axis, another part."""

from dataclasses import replace
from pathlib import Path

import pytest

from linemate.daemon.commissioning.rehearsal import rehearse
from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.documents import FileError
from linemate.daemon.core.parameters import build
from linemate.daemon.core.tracking.task import TaskFile
from linemate.simulators.devices.line.cars import Car, CarFault
from linemate.simulators.harness import lockstep, setup
from linemate.simulators.harness.cell import cell_files
from linemate.simulators.harness.line import line_station
from linemate.simulators.judge.judge import judge
from linemate.simulators.lab.shift import shift
from linemate.simulators.lab.shift.run import run

CELL = cell_files.named("kr10")


def station() -> LoadedConfig:
    assert CELL.station is not None
    return CELL.station


def refusals(file: TaskFile) -> list[str]:
    """What ``linemated --check`` says of a task for this arm."""
    settings = station().config
    compiled = build(file, CELL.task.urdf, settings.tracking, settings.control, station().cycle_s)
    return CELL.task.lines(rehearse(compiled).complaints)


def test_the_cell_has_six_axes_and_no_other_file_than_its_own() -> None:
    assert not CELL.task.file.arm.linear_axis
    assert station().controller_file is not None
    assert {e.tag for e in station().controller_file.receive} == {
        *(f"AK.A{i}" for i in range(1, 7)),
        "DiO",
    }
    assert CELL.task.file.object.nominal.position == (1.05, -0.22, 0.65)
    assert len(station().config.control.limits) == 6


def test_a_part_is_assembled_within_limits_although_the_line_stops_and_restarts() -> None:
    made = setup.make(cell_files.scenario(None, CELL), cell=CELL)
    result = judge(lockstep.run(made, 0))
    assert result["within_limits"], result
    assert result["control_error"]["stop"]["max_mm"] < 0.1
    assert result["total_error"]["impact"]["max_mm"] < 0.5


def test_the_shipped_task_fits_the_arm() -> None:
    assert refusals(CELL.task.file) == []


@pytest.mark.parametrize(("speed", "slower"), [(0.2, 1.0), (0.05, 4.0)])
def test_a_line_too_quick_or_a_mating_too_long_for_the_arm_is_refused(
    speed: float, slower: float
) -> None:
    file = CELL.task.file
    waypoints = tuple(replace(point, time=slower * point.time) for point in file.waypoints)
    conveyor = replace(file.conveyor, nominal_speed=speed)
    times = {name: slower * getattr(file.tool, name) for name in ("fix_screws", "release_wheel")}
    tool = replace(file.tool, **times)
    refused = refusals(replace(file, conveyor=conveyor, tool=tool, waypoints=waypoints))[0]
    assert refused.startswith(str(cell_files.DATA / "kr10" / "task.yaml"))
    assert "the arm does not reach the pose at" in refused
    assert "m in base" in refused


def test_a_controller_file_without_an_axis_is_refused_by_name(tmp_path: Path) -> None:
    for file in (cell_files.DATA / "kr10").iterdir():
        kept = [line for line in file.read_text().splitlines() if "AK.A6" not in line]
        (tmp_path / file.name).write_text("\n".join(kept))
    with pytest.raises(FileError, match=r"rsi\.config: the task's arm needs RECEIVE AK\.A6"):
        cell_files.named(str(tmp_path))


@pytest.mark.row
def test_car_after_car_comes_by_the_stations_file() -> None:
    """70 s of virtual time: a part whose line stops, and one that the camera loses."""
    station = line_station.station("kr10")
    cars = (
        Car("P1", "van", 11, station.stop(3.0, 2.0)),
        Car("P2", "estate", 12, fault=CarFault.CAMERA_COVERED, fault_s=1.5),
    )
    outcome = run(station, cars, 32.0)
    result = shift.judge([outcome], 1)
    assert result["good"], result
    assert [row["mounted"] for row in result["cars"]] == [True, False]
    assert set(outcome.requests) <= {"announce", "queue", "next", "ack"}
