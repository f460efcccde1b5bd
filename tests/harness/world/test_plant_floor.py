"""The two scenarios of a plant floor: all effects are on, and the harsh one has 1.5 times them."""

import math
from dataclasses import replace
from typing import Any

import pytest

from docs.make import world_results
from linemate.simulators.harness import scenario_file, setup
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.world import World

WHEEL = scenario_file.to_plain(scenario_file.load("wheel"))
MODERATE = scenario_file.to_plain(scenario_file.load("plant-floor"))
HARSH = scenario_file.to_plain(scenario_file.load("plant-floor-harsh"))

FACTORS = {"frequency_hz": 1.5**-0.5, "mass": 1 / 1.5, "view_limit": 1.5**-0.5, "teeth": 10 / 12}
"""What 1.5 times the effect is, where it is not 1.5 times the value."""

SAME = ("duration_s", "bolts", "travel", "correlation_s", "damping", "direction", "drive")
"""What is no size."""


def leaves(value: Any, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    items = value.items() if isinstance(value, dict) else enumerate(value)
    found: dict[tuple[str, ...], Any] = {}
    for key, item in items:
        here = (*path, str(key))
        found |= leaves(item, here) if isinstance(item, (dict, list)) else {here: item}
    return found


def changed() -> list[tuple[str, ...]]:
    before, after = leaves(WHEEL), leaves(MODERATE)
    return [path for path in after if before.get(path) != after[path] and path != ("name",)]


@pytest.mark.parametrize("path", changed(), ids=".".join)
def test_the_harsh_floor_has_one_and_a_half_times_each_size(path: tuple[str, ...]) -> None:
    moderate, harsh = leaves(MODERATE)[path], leaves(HARSH)[path]
    name = next(part for part in reversed(path) if not part.isdigit())
    if name in SAME or path[:2] == ("distance", "delay_s"):
        return
    assert harsh == pytest.approx(moderate * FACTORS.get(name, 1.5), rel=0.011)


def test_the_distance_sensor_is_one_and_a_half_times_as_late() -> None:
    nominal = WHEEL["distance"]["delay_s"]
    late = MODERATE["distance"]["delay_s"] - nominal
    assert HARSH["distance"]["delay_s"] - nominal == pytest.approx(1.5 * late)


def test_every_effect_is_on() -> None:
    off = leaves(scenario_file.to_plain(Scenario()))
    every = {path[:3] for path in off if "effects" in path}
    on = {path[:3] for path in changed() if "effects" in path}
    # A rail's supports, a speed and a correlation time are no effects of their own. A dead time
    # that grows with the duty is that of another make of controller.
    plain = {"sag_span", "stick_slip_speed", "pitch", "correlation_s", "drift_time_s", "warming"}
    assert {path for path in every - on if path[-1] not in plain} == set()
    assert MODERATE["body"]["carrier"]


def emissions(seed: int) -> list[object]:
    world = World(replace(scenario_file.load("plant-floor-harsh"), seed=seed, lead_in_s=1.0))
    world.advance(1.5)
    return [*world.take_camera(), *world.take_distance(), *world.take_wrench(), world.encoders()]


def test_one_seed_gives_one_plant_floor() -> None:
    assert emissions(3) == emissions(3)
    assert emissions(3) != emissions(4)


def test_the_daemon_is_configured_from_the_data_sheets() -> None:
    for name in ("plant-floor", "plant-floor-harsh", "wheel"):
        made = setup.make(name)
        assert made.tracking.camera.blind_below == made.scenario.camera.blind_below


@pytest.mark.parametrize("name", ["plant-floor", "plant-floor-harsh"])
def test_a_plant_floor_can_be_sampled_and_set_up(name: str) -> None:
    made = setup.make(name)
    assert sample(3, sample(3, made.scenario)) == sample(3, made.scenario)
    stop, start = made.scenario.events
    assert stop.settled_s < start.onset_s
    assert math.isclose(start.onset_s, 9.0)


def test_the_page_gives_a_source_for_every_size_of_the_plant_floor() -> None:
    listed = [tuple(path.split(".")) for path, *_ in world_results.SIZES]
    values = leaves(MODERATE)
    sized = [path for path in changed() if values[path] and not set(path) & set(SAME)]
    unsourced = [path for path in sized if not any(path[: len(p)] == p for p in listed)]
    assert unsourced == []
