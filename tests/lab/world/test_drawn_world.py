"""Drawn worlds: each seed its own, the same wherever it is run, within what was commissioned."""

from pathlib import Path

import pytest

from linemate.daemon.core.tracking.settings import SwaySettings
from linemate.simulators.harness import setup
from linemate.simulators.lab.world import drawn_world, measure


def test_a_seed_draws_the_same_world_again_and_another_seed_another_one() -> None:
    assert drawn_world.overrides(3) == drawn_world.overrides(3)
    assert drawn_world.overrides(3) != drawn_world.overrides(4)


@pytest.mark.parametrize("seed", range(40))
def test_every_drawn_world_is_one_that_the_emulated_station_takes(seed: int) -> None:
    scenario = setup.make(drawn_world.BASE, drawn_world.overrides(seed)).scenario
    assert scenario.camera.blind_below <= 0.06
    onsets = [event.onset_s for event in scenario.conveyor.events]
    assert onsets == sorted(onsets)


def test_the_row_has_a_world_for_each_seed_and_is_asked_for_by_its_name(tmp_path: Path) -> None:
    assert drawn_world.NAME not in measure.chosen(None)
    names = measure.chosen(drawn_world.NAME)
    first, second = measure.prepare(names, (0, 1), ("scenario.duration_s=9",), None, tmp_path)
    assert first.setup.scenario.conveyor != second.setup.scenario.conveyor
    assert first.setup.scenario.duration_s == second.setup.scenario.duration_s == 9.0


def test_modes_identified_on_the_floor_are_not_stated_of_a_drawn_body() -> None:
    tracking = setup.make(drawn_world.BASE, drawn_world.overrides(3)).tracking
    assert tracking.sway == SwaySettings()
    assert [mode.gain for mode in tracking.swing] == [0.0]
