"""Bolts whose angle the camera does not see: the tool finds it, and never presses on their tips."""

import numpy as np

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import judge
from linemate.simulators.judge.rows import CLAMPED
from linemate.simulators.lab.world import drawn_world

LARGEST_N = 150.0
"""On the tips and in contact. The programme's press is 50 N, the overload on the tips 175 N."""


def test_a_wheel_whose_bolts_do_not_enter_is_turned_until_they_do() -> None:
    # The first turn is the right one: each attempt takes 8 s.
    made = setup.make("world/bolts-2deg", ["scenario.contact.mating.angle=0.035"])
    evidence = lockstep.run(made, 0)
    assert judge(evidence)["outcome"] == "assembled"
    rows = evidence.rows
    assert np.linalg.norm(rows.force, axis=1)[~np.isnan(rows.force[:, 0])].max() < LARGEST_N
    # No force of the tips was taken for a contact with the face.
    seen = rows.t[rows.contact_seen]
    assert seen.min() >= rows.t[rows.contact == CLAMPED].min()


def test_bolts_that_enter_at_no_known_angle_end_in_a_retreat_that_names_them() -> None:
    known = "tracking.payload.bolt_angle=0.0"
    made = setup.make("world/bolts-2deg", ["scenario.contact.mating.angle=0.035", known])
    evidence = lockstep.run(made, 0)
    result = judge(evidence)
    assert result["outcome"] == "retreated"
    assert "the bolts enter at none" in result["reason"]
    assert not evidence.rows.contact_seen.any()


def test_tips_that_push_a_car_on_a_soft_carrier_away_are_no_contact_with_its_face() -> None:
    # 4.5 N/mm across the line: 40 N of the tips moved the car by 9 mm within 0.6 s.
    drawn = (*drawn_world.overrides(10), "scenario.duration_s=7.0")
    rows = lockstep.run(setup.make(drawn_world.BASE, drawn), 10).rows
    assert not rows.contact_seen.any()
    assert np.abs(rows.sway[:, 2]).max() < 0.009
