"""Frames: a measured pose is compared with what was desired at its time."""

import json
import math
from typing import Any

import pytest
from cell import REST, TASK
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.daemon.view.broadcast_hub import BroadcastHub
from linemate.daemon.view.cell import read_cell
from linemate.daemon.view.frames import Framer

CELL = read_cell({"task": TASK.text, "urdf": TASK.urdf, "cycle_s": 0.012})
CYCLE_NS = 12_000_000
SPEED = 0.106


def moving(k: int, *, lag_cycles: int = 1) -> dict[str, Any]:
    """Telemetry of a tool that is exactly where it should be, read ``lag_cycles`` ago."""
    at = SPEED * 0.012
    axes = (*REST, at * (k - lag_cycles))
    assert CELL.chain is not None
    _, now = CELL.chain.place((*REST, at * k))
    return {
        "k": k, "stamp_ns": 10**12 + k * CYCLE_NS, "state": "track", "scenario": "running",
        "scenario_state": "confirmed", "confidence": 1.5, "target": now, "sensed": now, "part": now,
        "command": axes, "measured": axes, "measured_ns": 10**12 + (k - lag_cycles) * CYCLE_NS,
        "cycle_ms": 12.0, "turnaround_us": 400,
    }  # fmt: skip


def test_a_geometry_that_cannot_be_read_leaves_the_arm_out_with_the_reason() -> None:
    texts = {"task": TASK.text, "urdf": TASK.urdf, "cycle_s": 0.012}
    good = '{"geometry": [{"shift": [0.001, 0, 0], "turn": [0, 0, 0]}]}'
    assert read_cell({**texts, "geometry": good}).chain != CELL.chain
    for bad in ("{", "[1]", '{"geometry": [{}]}', '{"geometry": [{"shift": 1, "turn": 2}]}'):
        cell = read_cell({**texts, "geometry": bad})
        assert cell.chain is None
        assert "the arm cannot be drawn" in cell.trouble


def test_the_scene_of_the_shipped_task_can_be_drawn() -> None:
    assert CELL.trouble == ""
    assert CELL.task == "wheel"
    assert CELL.as_page()["cycle_ms"] == 12.0


@pytest.mark.parametrize(
    ("data", "why"),
    [
        ({}, "task cannot be read"),
        ({"task": "[1, 2"}, "task cannot be read"),
        ({"task": "- 1"}, "task cannot be read"),
        ({"task": TASK.text, "urdf": ""}, "arm cannot be drawn"),
        ({"task": TASK.text.replace("2.20", ".inf"), "urdf": TASK.urdf}, "task cannot be read"),
        ({"task": TASK.text.replace("flange: flange", "flange: hand"), "urdf": TASK.urdf}, "hand"),
    ],
)
def test_an_unreadable_cell_is_reported_and_frames_go_on(data: dict[str, Any], why: str) -> None:
    scene = read_cell(data)
    assert why in scene.trouble
    frame = Framer(scene).frame(moving(1))
    assert frame is not None
    assert "arm" not in frame
    assert frame["state"] == "track"


def test_a_tool_that_is_where_it_should_be_has_no_error_at_the_conveyors_pace() -> None:
    framer = Framer(CELL)
    frames = [framer.frame(moving(k)) for k in range(5)]
    last = frames[-1]
    assert last is not None
    assert last["errors"]["control_mm"] == pytest.approx(0.0, abs=1e-3)
    assert last["errors"]["gap_mm"] == pytest.approx(0.0, abs=1e-3)
    # Held against what is desired now it would be a cycle's way off.
    assert 1e3 * math.dist(last["tcp"][:3], last["target"][:3]) == pytest.approx(1.272, abs=0.01)


def test_steps_that_are_not_drawn_are_remembered() -> None:
    framer = Framer(CELL)
    for k in range(5):
        framer.remember(moving(k))
    frame = framer.frame(moving(5))
    assert frame is not None
    assert frame["errors"]["control_mm"] == pytest.approx(0.0, abs=1e-3)


def test_there_is_no_error_across_a_gap_or_another_boot() -> None:
    framer = Framer(CELL)
    framer.frame(moving(0))
    frame = framer.frame(moving(40))
    assert frame is not None
    assert "control_mm" not in frame["errors"]
    again = framer.frame(moving(1))
    assert again is not None
    assert "control_mm" not in again["errors"]


def test_the_same_step_sent_twice_has_the_same_error() -> None:
    framer = Framer(CELL)
    for k in range(4):
        framer.frame(moving(k))
    once, again = framer.frame(moving(4)), framer.frame(moving(4))
    assert once == again
    assert once is not None
    assert "control_mm" in once["errors"]


def test_a_plan_away_from_the_object_is_its_error() -> None:
    data = moving(3)
    data["sensed"] = (data["target"][0] + 0.002, *data["target"][1:])
    frame = Framer(CELL).frame(data)
    assert frame is not None
    assert frame["errors"]["plan_mm"] == pytest.approx(2.0, abs=1e-6)


def test_the_margin_is_what_is_left_of_the_cycle() -> None:
    frame = Framer(CELL).frame(moving(1))
    assert frame is not None
    assert frame["margin_ms"] == 11.6


def test_a_robot_that_was_not_heard_is_drawn_where_it_was_sent() -> None:
    data = moving(2)
    del data["measured"]
    frame = Framer(CELL).frame(data)
    assert frame is not None
    assert frame["guessed"] is True
    assert len(frame["arm"]) == len(CELL.chain.joints) + 2  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "wrong",
    [{"measured": [math.nan] * 7}, {"measured": "joints"}, {"target": 5}, {"confidence": "much"},
     {"foreseen": [1.0]}, {"target": ["a"] * 7}, {"cycle_ms": "x", "turnaround_us": 1}],
)  # fmt: skip
def test_unfit_telemetry_makes_no_frame_and_is_counted(wrong: dict[str, Any]) -> None:
    framer = Framer(CELL)
    assert framer.frame(moving(1) | wrong) is None
    assert framer.unfit == 1
    assert framer.frame(moving(2)) is not None


def test_a_daemon_that_has_not_begun_makes_a_frame_of_what_there_is() -> None:
    frame = Framer(CELL).frame({"state": "init", "k": 0})
    assert frame == {"state": "init", "k": 0, "tentative": False, "errors": {}}


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.binary(),
    lambda inner: st.lists(inner, max_size=8) | st.dictionaries(st.text(max_size=4), inner),
    max_leaves=12,
)


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(st.sampled_from([*moving(1), "foreseen", "foreseen_ms", "held"]), ANYTHING))
def test_any_telemetry_gives_a_frame_or_none(wrong: dict[str, Any]) -> None:
    framer, hub = Framer(CELL), BroadcastHub()
    framer.frame(moving(1))
    odd = framer.frame(moving(2) | wrong)
    if odd is not None:
        hub.push_frame(odd)
    after = framer.frame(moving(3))
    assert after is not None
    hub.push_frame(after)
    history = hub._known().partition(b"data: ")[2].partition(b"\n")[0]
    assert json.loads(history)[-1]["state"] == "track"
