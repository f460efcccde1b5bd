"""Drawn lines: each seed its own, with stops and starts other than the task file states."""

from pathlib import Path

import pytest

from linemate.simulators.harness import setup
from linemate.simulators.lab.world import drawn_line, measure


@pytest.mark.parametrize("name", drawn_line.LINES)
def test_a_line_stops_and_starts_in_turn_within_the_ranges_of_its_row(name: str) -> None:
    line = drawn_line.LINES[name]
    for seed in range(20):
        events = setup.make(
            "plant-floor", drawn_line.overrides(name, seed)
        ).scenario.conveyor.events
        assert [event.kind for event in events] == ["stop", "start"] * (len(events) // 2)
        assert [event.onset_s for event in events] == sorted(event.onset_s for event in events)
        for event in events:
            ranges = line.stops if event.kind == "stop" else line.starts
            assert min(map(min, ranges)) <= event.acceleration <= max(map(max, ranges))


def test_a_seed_draws_the_line_with_which_it_was_first_run() -> None:
    first, duration = drawn_line.overrides(drawn_line.NAME, 2014)
    events = setup.make("plant-floor", (first, duration)).scenario.conveyor.events
    orders = [(event.onset_s, event.acceleration) for event in events[:2]]
    assert orders == [(10.022, 0.167), (12.17, 0.082)]


def test_a_line_is_the_only_thing_that_differs_from_the_floor(tmp_path: Path) -> None:
    (drawn,) = measure.prepare((drawn_line.NAME,), (3,), ("scenario.duration_s=9",), None, tmp_path)
    (floor,) = measure.prepare(("plant-floor",), (3,), ("scenario.duration_s=9",), None, tmp_path)
    assert drawn.setup.tracking == floor.setup.tracking
    assert drawn.setup.scenario.body == floor.setup.scenario.body
    assert drawn.setup.scenario.conveyor.events != floor.setup.scenario.conveyor.events
    assert drawn.setup.scenario.duration_s == 9.0
