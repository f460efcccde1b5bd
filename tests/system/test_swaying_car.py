"""A line that stops in contact with a car that sways on: the tool stays with the car."""

import numpy as np

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.lab.world import drawn_world

LARGEST_N = 150.0
"""The target left this car and the mount was overloaded: 351 N, then 8.3 mm."""


def test_a_stop_makes_no_swaying_car_ring_on_the_mount() -> None:
    drawn = (*drawn_world.overrides(40), "scenario.duration_s=10.0")
    evidence = lockstep.run(setup.make(drawn_world.BASE, drawn), 40)
    assert evidence.collision is None
    force = np.linalg.norm(evidence.rows.force, axis=1)
    assert force[evidence.rows.contact_seen].max() < LARGEST_N
