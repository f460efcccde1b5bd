"""Telegrams lost while the tool is close to the object: the retreat that follows is gentle."""

import numpy as np
import pytest

from linemate.simulators.harness import lockstep, setup

GENTLE_N = 150.0  # on a free tool; a retreat that was caught up with shook it with 332 N or more


@pytest.mark.row
@pytest.mark.parametrize("kind", ["silence", "deafness"])
@pytest.mark.parametrize("seed", [101, 102, 103])
def test_a_retreat_that_begins_while_telegrams_are_lost_shakes_no_tool(
    seed: int, kind: str
) -> None:
    lost = f"scenario.faults=[{{at_s: 9.2, link: robot, kind: {kind}, duration_s: 0.1}}]"
    evidence = lockstep.run(setup.make("plant-floor", [lost]), seed)
    assert evidence.collision is None
    assert np.nanmax(np.linalg.norm(evidence.rows.force, axis=1)) < GENTLE_N
