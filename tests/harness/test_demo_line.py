"""Car after car in the demonstration: its cars, the daemon's file, and its judgement."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from linemate.daemon.config import config
from linemate.simulators.devices.line.cars import CarFault
from linemate.simulators.harness.line import demo_line, line_station
from linemate.simulators.harness.line.demo_line import LineLog


def test_the_cars_are_those_of_the_seed_and_have_no_fault() -> None:
    plan = line_station.plan(10, 3, 34.0)
    assert plan == line_station.plan(10, 3, 34.0)
    assert [car.fault for car in plan.cars] == [None] * 10
    assert {car.variant for car in plan.cars} == set(line_station.VARIANTS)
    assert [bool(car.events) for car in plan.cars] == [False, True] * 5
    assert CarFault.PART_MISSING not in {car.fault for car in plan.cars}


def test_the_daemons_sections_load_with_every_variant(tmp_path: Path) -> None:
    (tmp_path / "records").mkdir()
    path = tmp_path / "linemated.yaml"
    path.write_text(yaml.safe_dump(line_station.daemon_sections("records") | {"rsi": {"port": 0}}))
    loaded = config.load(path)
    assert set(loaded.variants) == set(line_station.VARIANTS)
    heights = {task.file.object.nominal.position[2] for task in loaded.variants.values()}
    assert len(heights) == 5


@pytest.mark.parametrize(
    ("mounted", "is_ok", "good"),
    [(True, True, True), (False, True, False), (True, False, False), (True, None, False)],
)
def test_a_car_is_good_if_it_was_mounted_and_reported_so(
    mounted: bool, is_ok: bool | None, good: bool
) -> None:
    cars = line_station.plan(1, 0, 34.0).cars
    part = cars[0].part
    log = LineLog({part: {"mounted": mounted, "collision": None, "impact_mm": 0.2}}, [part])
    record: dict[str, Any] = {"part": part, "ok": is_ok, "reason": "", "duration_s": 1.0}
    records = [] if is_ok is None else [record]
    assert demo_line._judged(cars, log, records, {})["good"] == good
