"""Rows with a measured arm: the plant of the row without, and a daemon that knows the geometry."""

from dataclasses import replace
from pathlib import Path

from linemate.simulators.harness import setup
from linemate.simulators.lab.world import measure, measured_arm


def test_the_plant_is_that_of_the_row_without_it(tmp_path: Path) -> None:
    for name, plain in measured_arm.ROWS.items():
        (job,) = measure.prepare((name,), (0,), (), None, tmp_path)
        assert job.setup == setup.make(plain)
        assert measure.what(name) == measured_arm.WHAT


def test_rows_are_known_by_name() -> None:
    assert tuple(n for n in measure.chosen("plant-floor*") if n not in measure.DRAWN) == (
        "plant-floor", "plant-floor-harsh", "plant-floor-measured", "plant-floor-harsh-measured",
    )  # fmt: skip


def test_the_daemon_of_each_seed_has_the_geometry_of_its_arm_and_nothing_else() -> None:
    plain = setup.make("plant-floor")
    known, other = (measured_arm.identified(plain, seed) for seed in (1, 2))
    assert len(known.control.geometry) == 6
    assert known.control.geometry != other.control.geometry
    assert replace(known, control=replace(known.control, geometry=())) == plain
