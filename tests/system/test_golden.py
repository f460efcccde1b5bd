"""The golden recording: the step gives the same outputs as when it was recorded.

A change of outputs fails here with the table of what moved, when and by how much. If it is meant:
``python tests/system/make_golden.py``, and the commit says why.
"""

from pathlib import Path

import pytest

from linemate.daemon.operator.replay_command import compare, overrides_of, report
from linemate.daemon.recording.reader import read

GOLDEN = Path(__file__).parent / "golden" / "wheel.mcap"
TOLERANCE = 1e-6
"""Another processor adds in another order: its last digits are its own [m, rad, m/s]."""


def test_the_golden_run_is_the_same_today() -> None:
    account, moved = compare(GOLDEN, tolerance=TOLERANCE)
    if moved or account.unmade:
        pytest.fail("\n".join(["the outputs have changed", *report(account, moved)]))
    assert account.steps > 900
    assert account.broken is None


def test_the_golden_run_has_seen_what_matters() -> None:
    steps = read(GOLDEN).steps
    seen = {step.state for step in steps}
    assert {"idle", "armed", "track", "contact"} <= seen
    assert {step.outputs["scenario"] for step in steps} >= {"running", "stopping", "standing"}
    events = {event for step in steps for event in step.outputs["events"]}
    assert {("stop", "confirmed"), ("start", "confirmed")} <= events


def test_a_parameter_a_little_off_does_not_pass_for_the_same() -> None:
    other = overrides_of(None, ["control.servos.0.frequency_hz=4.01"])
    _, moved = compare(GOLDEN, other, TOLERANCE)
    assert "command" in moved
