"""Rows of the realistic world: every one is a scenario, with the daemon's settings apart."""

import pytest

from linemate.simulators.harness import scenario_file, setup
from linemate.simulators.harness.setup import laid_over
from linemate.simulators.harness.world import world_rows
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.scenario_draw import sample

NOMINAL = scenario_file.load("wheel")


@pytest.mark.parametrize("name", world_rows.names())
def test_every_row_is_a_scenario_that_can_be_sampled(name: str) -> None:
    scenario = scenario_file.load(name)
    assert scenario.name == name
    assert sample(3, sample(3, scenario)) == sample(3, scenario)


@pytest.mark.parametrize("name", [name for name in world_rows.names() if name != "world/nominal"])
def test_every_row_but_the_nominal_one_changes_the_plant(name: str) -> None:
    assert plain(scenario_file.load(name)) != plain(NOMINAL)


def plain(scenario: Scenario) -> dict[str, object]:
    # A row ends later, so that a tool that waits before contact may still assemble.
    return {**scenario_file.to_plain(scenario), "name": "", "duration_s": 0.0}


def test_the_nominal_row_is_the_default_scenario() -> None:
    assert plain(scenario_file.load("world/nominal")) == plain(NOMINAL)


@pytest.mark.parametrize("name", world_rows.names())
def test_a_rows_daemon_settings_fit_and_leave_its_truth_alone(name: str) -> None:
    made = setup.make(name)
    assert made.scenario == scenario_file.load(name)
    settings, known = world_rows.daemon_settings(name), setup.identified()
    # Laid over once more they change nothing: they are in force.
    assert laid_over(made, settings) == made
    if settings == world_rows.daemon_settings("world/nominal"):
        assert (made.tracking, made.control, made.task) == (
            known.tracking, known.control, known.task
        )  # fmt: skip


def test_a_mapping_over_a_list_changes_the_named_items() -> None:
    below = {"a": [{"b": 1, "c": 2}, {"b": 3}], "d": [1, 2]}
    assert world_rows.laid_over(below, {"a": {"0": {"b": 9}}, "d": [5]}) == {
        "a": [{"b": 9, "c": 2}, {"b": 3}], "d": [5]
    }  # fmt: skip


def test_another_scenario_has_no_settings_of_ours() -> None:
    assert world_rows.daemon_settings("stop-early") == {}
    assert world_rows.daemon_settings("../parameters/wheel") == {}
