"""Contact made, as a step decides on it."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.core import parameters
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.contact_decision import update_contact
from linemate.daemon.core.tracking.conveyor import Motion
from linemate.daemon.core.tracking.goal.rest_state import at_rest
from linemate.daemon.core.tracking.observation import remember
from linemate.daemon.core.tracking.task import Phase
from linemate.daemon.core.tracking.tracker_state import Report
from linemate.simulators.harness.setup import Setup
from linemate.simulators.plants.scenario import Scenario

CYCLE_S = 0.012


def reported(part: Array, force: Array) -> Report:
    return Report(
        sensed=None,
        part=part,
        speed=0.0,
        motion=Motion.RUNNING,
        tentative=False,
        confidence=0.0,
        events=(),
        phase=Phase.APPROACH,
        force=force,
        overload=False,
        object_left=False,
        rejected=0,
    )


def touched(bolts: float, back_s: float, push: float = 20.0) -> bool:
    """Return whether a push counts as a contact of a tool at the estimated object.

    Args:
        bolts: their length from the face [m].
        back_s: time for which the tool has backed off as it is pushed [s].
        push: along the tool's axis [N].
    """
    cell = Setup(Scenario())
    payload = replace(cell.tracking.payload, bolts=bolts)
    tracking = replace(cell.tracking, payload=payload)
    tracker = parameters.build(cell.task, cell.urdf, tracking, cell.control, CYCLE_S).tracker
    pose = np.concatenate((tracker.reference.origin, np.zeros(3)))
    history = remember(None, 0, pose, tracker.history_length)
    state = structs.replace(at_rest(tracker, pose, 0.0), blended=9.0, started=True, history=history)
    steps = 200
    for k in range(steps):
        left = (steps - k) * CYCLE_S
        distance = -0.001 - 0.005 * abs(left - back_s)
        force = np.array((0.0, 0.0, -push if k > steps - 4 else 0.0))
        report = reported(pose, force)
        before = structs.replace(state, distance=distance)
        state = update_contact(tracker, before, before, report, held=False)
    return state.contact


@pytest.mark.parametrize(
    ("bolts", "back_s", "contact"), [(0.025, 0.0, True), (0.025, 0.5, False), (0.0, 0.5, True)]
)
def test_what_pushes_a_tool_that_backs_off_may_be_bolts(
    bolts: float, back_s: float, contact: bool
) -> None:
    assert touched(bolts, back_s) is contact


def test_a_force_that_only_a_face_gives_is_a_contact_of_a_tool_that_backs_off() -> None:
    assert touched(0.025, 0.5, 60.0)


@pytest.mark.parametrize("keeps", [True, False])
def test_a_retreat_that_takes_its_part_along_is_in_contact_no_more(*, keeps: bool) -> None:
    cell = Setup(Scenario())
    built = parameters.build(cell.task, cell.urdf, cell.tracking, cell.control, CYCLE_S)
    pose = np.concatenate((built.tracker.reference.origin, np.zeros(3)))
    state = structs.replace(at_rest(built.tracker, pose, 0.0), contact=True, keeps=keeps)
    report = reported(pose, np.array((0.0, 0.0, -60.0)))
    after = update_contact(built.tracker, state, state, report, held=False)
    assert after.contact is not keeps
