"""Values for a PLC from a daemon's status."""

from typing import Any

import pytest

from linemate.daemon.operator.plc.plc_values import PlcValues, values_of

POSE = [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]


def status(state: str, **changes: Any) -> dict[str, Any]:
    production = {"held": None, "part": None, "queue": [], "at_home": True}
    return {"state": state, "latched": False, "cause": "c", "held": None} | {
        "production": production | changes
    }


def test_a_daemon_that_does_not_answer_is_neither_ready_nor_in_sync() -> None:
    assert values_of(None) == PlcValues()
    assert not PlcValues().Connected


@pytest.mark.parametrize(
    ("state", "changes", "ready", "busy"),
    [
        ("idle", {}, True, False),
        ("idle", {"at_home": False}, False, False),
        ("idle", {"held": "hold ordered"}, False, False),
        ("idle", {"part": {"part": "P1", "variant": "a"}}, False, True),
        ("home", {}, False, True),
        ("track", {"part": {"part": "P1", "variant": "a"}}, False, True),
        ("fault", {"held": "fault"}, False, False),
    ],
)
def test_ready_and_busy_follow_state_and_part(
    state: str, changes: dict[str, Any], ready: bool, busy: bool
) -> None:
    values = values_of(status(state, **changes))
    assert (values.Ready, values.Busy) == (ready, busy)
    assert values.Fault == (state == "fault")


@pytest.mark.parametrize(
    ("state", "off_m", "held", "in_sync"),
    [
        ("track", 0.0019, None, True),
        ("track", 0.0021, None, False),
        ("contact", 0.0, None, True),
        ("contact", 0.0, "limited: A1", False),
        ("idle", 0.0, None, False),
    ],
)
def test_in_sync_needs_a_robot_that_follows_within_the_tolerance(
    state: str, off_m: float, held: str | None, in_sync: bool
) -> None:
    sensed = [POSE[0] + off_m, *POSE[1:]]
    values = values_of(status(state) | {"target": POSE, "sensed": sensed, "held": held})
    assert values.InSync == in_sync


def test_a_daemon_without_production_is_never_ready() -> None:
    values = values_of({"state": "idle", "cause": "c"})
    assert (values.Connected, values.Ready, values.PartIn) == (True, False, "")
