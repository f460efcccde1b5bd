"""Laws of the scenario: draws within range, given values kept, one stream a value."""

import math
from dataclasses import replace

import pytest

from linemate.simulators.plants import rotation
from linemate.simulators.plants.conveyor_plan import Conveyor
from linemate.simulators.plants.scenario import Body, Scenario, Swing, to_dict
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.streams import Draws, stream


@pytest.mark.parametrize("seed", range(20))
def test_a_drawn_body_is_within_its_range_and_23_degrees_off(seed: int) -> None:
    body = sample(seed).body
    assert body.offset is not None
    assert body.rotation is not None
    assert all(abs(o) <= r for o, r in zip(body.offset, body.offset_range, strict=True))
    assert math.degrees(rotation.norm(body.rotation)) == pytest.approx(23.0)
    amplitude = body.swings[0].amplitude
    assert amplitude is not None
    assert 4e-3 <= amplitude <= 8e-3


def test_sampling_twice_changes_nothing() -> None:
    once = sample(7)
    assert sample(7, once) == once
    assert sample(7) == once


def test_another_seed_is_another_body() -> None:
    assert sample(1).body.offset != sample(2).body.offset


def test_a_given_value_is_kept_and_shifts_no_other() -> None:
    given = sample(5, Scenario(body=Body(offset=(0.001, 0.002, 0.003))))
    free = sample(5)
    assert given.body.offset == (0.001, 0.002, 0.003)
    assert given.body.rotation == free.body.rotation
    assert given.body.swings == free.body.swings
    assert given.conveyor == free.conveyor


def test_one_more_swing_shifts_no_other() -> None:
    two = sample(5, Scenario(body=Body(swings=(Swing(), Swing(axis=(1, 0, 0))))))
    assert two.body.swings[0] == sample(5).body.swings[0]
    assert two.body.swings[1].phase != two.body.swings[0].phase


def test_the_default_events_are_the_papers() -> None:
    stop, start = Scenario().events
    assert (stop.kind, stop.onset_s, stop.acceleration) == ("stop", 5.0, -0.104)
    assert stop.settled_s == pytest.approx(6.019, abs=1e-3)
    assert (start.kind, start.onset_s, start.speed) == ("start", 9.0, 0.0)
    assert start.settled_s == pytest.approx(17.154, abs=1e-3)


def test_a_scenario_is_plain_values_all_the_way_down() -> None:
    plain = to_dict(replace(Scenario(), conveyor=Conveyor(events=())))
    assert plain["conveyor"]["events"] == []
    assert plain["body"]["swings"][0]["frequency_hz"] == 0.62

    def check(value: object) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                assert isinstance(key, str)
                check(item)
        elif isinstance(value, list):
            for item in value:
                check(item)
        else:
            assert value is None or isinstance(value, (str, int, float, bool))

    check(plain)


def test_draws_are_the_same_singly_and_in_groups() -> None:
    singly, grouped = Draws.normal(3, "x"), Draws.normal(3, "x")
    values = [singly.one() for _ in range(1200)]
    taken: list[float] = []
    while len(taken) < 1200:
        taken += grouped.take(7) if len(taken) % 2 else [grouped.one()]
    assert taken[:1200] == values
    assert values[:600] == stream(3, "x").standard_normal(600).tolist()


def test_streams_differ_by_name_and_by_seed() -> None:
    first = stream(1, "a").random(4).tolist()
    assert first == stream(1, "a").random(4).tolist()
    assert first != stream(1, "b").random(4).tolist()
    assert first != stream(2, "a").random(4).tolist()
