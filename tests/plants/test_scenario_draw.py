"""Draws of a scenario: within range, given values kept, one stream a value."""

import math

import pytest

from linemate.simulators.plants import rotation
from linemate.simulators.plants.scenario import Body, Scenario, Swing
from linemate.simulators.plants.scenario_draw import sample


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
