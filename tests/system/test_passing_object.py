"""A tool that holds next to an object that goes on: it withdraws before the object reaches it."""

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import judge
from linemate.simulators.judge.rows import STATES

FROZEN = "scenario.faults=[{at_s: 9.0, link: force_torque, kind: stuck, duration_s: 1.0}]"


def test_a_hold_ends_in_a_retreat_as_the_object_passes_the_tool() -> None:
    evidence = lockstep.run(setup.make("plant-floor", [FROZEN]), 100)
    states = [STATES[state] for state in evidence.rows.state]
    assert "hold" in states
    assert "retreat" in states[states.index("hold") :]
    # A tool that stands there is hit by the body that the restarted conveyor moves on.
    assert judge(evidence)["outcome"] == "retreated"
    assert "contact" not in states
