"""Values for a PLC from a daemon's status."""

from typing import Any

import pytest

from linemate.daemon.operator.plc.plc_values import PlcValues, values_of


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


@pytest.mark.parametrize(("shown", "in_sync"), [(True, True), (False, False), (None, False)])
def test_in_sync_is_what_the_daemon_shows(shown: bool | None, in_sync: bool) -> None:
    values = values_of(status("track") | ({} if shown is None else {"in_sync": shown}))
    assert values.InSync == in_sync


def test_a_daemon_without_production_is_never_ready() -> None:
    values = values_of({"state": "idle", "cause": "c"})
    assert (values.Connected, values.Ready, values.PartIn) == (True, False, "")
