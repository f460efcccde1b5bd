"""Telegrams lost while the tool is close to the object: the retreat that follows is gentle."""

import numpy as np
import pytest

from linemate.simulators.harness import lockstep, setup

GENTLE_N = 150.0  # on a free tool; a retreat that was caught up with shook it with 332 N or more
STOPPED_N = 300.0  # the controller's own stop gives up to 270 N; the catch-up gave 513 N or more


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


@pytest.mark.row
@pytest.mark.parametrize(("kind", "events"), [("deafness", None), ("silence", "[]")])
def test_a_retreat_that_is_interrupted_shakes_no_tool_more_than_its_stop(
    kind: str, events: str | None
) -> None:
    at = 9.2 if events is None else 6.6  # a conveyor that does not stop is met earlier
    faults = (
        f"{{at_s: {at}, link: force_torque, kind: offset, value: 500, duration_s: 0.05}}",
        f"{{at_s: {at + 0.35}, link: robot, kind: {kind}, duration_s: 0.1}}",
    )
    changes = [f"scenario.faults=[{', '.join(faults)}]"]
    changes += [] if events is None else [f"scenario.conveyor.events={events}"]
    run = lockstep.Lockstep(setup.make("plant-floor", changes), 101)
    while run.turn() and run.world.time_s < at + 1.5:
        pass
    evidence = run.evidence()
    assert evidence.collision is None
    assert np.nanmax(np.linalg.norm(evidence.rows.force, axis=1)) < STOPPED_N
