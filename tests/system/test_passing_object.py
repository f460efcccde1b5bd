"""A tool that stands next to an object that goes on withdraws before the object reaches it."""

import pytest

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import judge
from linemate.simulators.judge.rows import STATES

FROZEN = "scenario.faults=[{at_s: 9.0, link: force_torque, kind: stuck, duration_s: 1.0}]"
DEAF = "scenario.faults=[{at_s: 7.0, link: robot, kind: deafness, duration_s: 0.13}]"


def test_a_hold_ends_in_a_retreat_as_the_object_passes_the_tool() -> None:
    evidence = lockstep.run(setup.make("plant-floor", [FROZEN]), 100)
    states = [STATES[state] for state in evidence.rows.state]
    assert "hold" in states
    assert "retreat" in states[states.index("hold") :]
    # A tool that stands there is hit by the body that the restarted conveyor moves on.
    assert judge(evidence)["outcome"] == "retreated"
    assert "contact" not in states


def test_a_fault_whose_link_is_back_ends_in_a_retreat_as_the_object_passes_the_tool() -> None:
    evidence = lockstep.run(setup.make("plant-floor", [DEAF]), 100)
    ways = [(change.before, change.after) for change in evidence.changes]
    # The fault stays latched: the tool withdraws once, and waits for its acknowledgement.
    assert ways[-3:] == [("hold", "fault"), ("fault", "retreat"), ("retreat", "fault")]
    assert evidence.collision is None
    assert judge(evidence)["outcome"] == "fault"


@pytest.mark.row
def test_a_retreat_ends_where_the_object_passes_the_tool_with_all_its_width() -> None:
    # A stop of 0.3 s in contact, three times as steep as stated: the tool retreats at 14.5 s.
    events = "[{kind: stop, onset_s: 12.136, acceleration: 0.295},"
    events += " {kind: start, onset_s: 12.464, acceleration: 0.09}]"
    changes = [f"scenario.conveyor.events={events}", "scenario.duration_s=21.5"]
    evidence = lockstep.run(setup.make("plant-floor", changes), 2013)
    assert STATES[evidence.rows.state[-1]] == "idle"
    # The hub's plane reached a tool 150 mm off after 5.4 s.
    assert evidence.collision is None
