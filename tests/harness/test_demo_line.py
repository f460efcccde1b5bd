"""Car after car in the demonstration: its cars, the daemon's file, and its judgement."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from linemate.daemon.config import config
from linemate.simulators.devices.line.cars import CarFault
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.demo import DemoStation
from linemate.simulators.harness.line import demo_line, line_station
from linemate.simulators.harness.line.demo_line import LineLog

STATION = line_station.station()
PLAIN = Namespace(
    cell=None, config=None, task=None, scenario=None, controller=None, cycle_ms=None, world="own",
    strict=False, view=False,
)  # fmt: skip


def test_the_cars_are_those_of_the_seed_and_have_no_fault() -> None:
    plan = line_station.plan(STATION, 10, 3, 34.0)
    assert plan == line_station.plan(STATION, 10, 3, 34.0)
    assert [car.fault for car in plan.cars] == [None] * 10
    assert {car.variant for car in plan.cars} == set(STATION.variants)
    assert [bool(car.events) for car in plan.cars] == [False, True] * 5
    assert CarFault.PART_MISSING not in {car.fault for car in plan.cars}


@pytest.mark.parametrize(("cell", "count"), [(None, 5), ("kr10", 3)])
def test_the_daemons_file_loads_with_every_variant(
    tmp_path: Path, cell: str | None, count: int
) -> None:
    (tmp_path / "records").mkdir()
    path = tmp_path / "linemated.yaml"
    station = line_station.station(cell)
    scenario = replace(station.scenario, lead_in_s=station.entry_s)
    plain = DemoStation(tmp_path, scenario, cell=station.cell()).daemon_file()
    path.write_text(yaml.safe_dump(plain | station.daemon_sections("records")))
    loaded = config.load(path)
    assert loaded.config.production is not None
    assert set(loaded.variants) == set(station.variants)
    assert loaded.config.production.window == station.production.window
    places = {task.file.object.nominal.position for task in loaded.variants.values()}
    assert len(places) == count
    assert loaded.config.tracking == station.files.config.tracking


@pytest.mark.parametrize(
    ("mounted", "is_ok", "good"),
    [(True, True, True), (False, True, False), (True, False, False), (True, None, False)],
)
def test_a_car_is_good_if_it_was_mounted_and_reported_so(
    mounted: bool, is_ok: bool | None, good: bool
) -> None:
    cars = line_station.plan(STATION, 1, 0, 34.0).cars
    part = cars[0].part
    log = LineLog({part: {"mounted": mounted, "collision": None, "impact_mm": 0.2}}, [part])
    record: dict[str, Any] = {"part": part, "ok": is_ok, "reason": "", "duration_s": 1.0}
    records = [] if is_ok is None else [record]
    assert demo_line._judged(cars, log, records, {})["good"] == good


def test_a_stop_of_the_line_is_that_of_the_cells_drive() -> None:
    for cell, drive in ((None, (0.104, 0.013)), ("kr10", (0.08, 0.02))):
        stop, start = line_station.station(cell).stop(3.0, 2.0)
        assert (stop.acceleration, start.acceleration) == drive
        assert (stop.onset_s, start.onset_s) == (3.0, 5.0)


@pytest.mark.parametrize(
    ("option", "value"),
    [("task", "wheel.yaml"), ("cycle_ms", 4.0), ("world", "mujoco"), ("view", True)],
)
def test_an_option_that_a_line_does_not_have_is_refused(option: str, value: object) -> None:
    given = Namespace(**vars(PLAIN) | {option: value})
    with pytest.raises(SetupError, match=f"leave --{option.replace('_', '-')} out"):
        demo_line.main(given)


def test_a_line_behind_another_controller_has_its_period_and_the_cells_files() -> None:
    plain = line_station.station()
    for family, cycle_s in (("fanuc", 8e-3), ("egm", 4e-3)):
        line = line_station.station(None, family)
        assert line.files.config.controller.kind.value == family
        assert (line.scenario.cycle_s, line.files.cycle_s) == (cycle_s, cycle_s)
        assert (line.hubs, line.entry_s, line.variants) == (
            plain.hubs,
            plain.entry_s,
            plain.variants,
        )
    assert line.files.config.control.servos != plain.files.config.control.servos


def test_a_cell_without_a_production_is_refused(tmp_path: Path) -> None:
    (tmp_path / "linemated.yaml").write_text("task: wheel.yaml\n")
    with pytest.raises(SetupError, match=r"no station\.yaml"):
        line_station.station(str(tmp_path))
    (tmp_path / "station.yaml").write_text("task: wheel.yaml\nrsi: {config: rsi_joints.xml}\n")
    with pytest.raises(SetupError, match="no section production"):
        line_station.station(str(tmp_path))
