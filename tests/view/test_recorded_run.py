"""A recording as the page plays it: the golden run, what is cut short, and what is none."""

import json
import shutil
from itertools import pairwise
from pathlib import Path

import pytest
from cell import TASK, World, parameters
from msgspec.structs import astuple

from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.cycle.clock.timing import CycleTimes
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording.format import Item, ItemKind, UnreadableRecordingError
from linemate.daemon.recording.reader import read as read_steps
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import StepItems, metadata_of
from linemate.daemon.view import horizon_replay, recorded_run
from linemate.daemon.view.recorded_run import MAX_ANSWER, OVERVIEW_LENGTH, SPACING_NS, RecordedRun

GOLDEN = Path(__file__).parents[1] / "system" / "golden" / "wheel.mcap"


@pytest.fixture(scope="module")
def golden() -> RecordedRun:
    return recorded_run.read_run(GOLDEN)


def test_a_whole_run_is_shown_from_its_first_step_to_its_last(golden: RecordedRun) -> None:
    steps = read_steps(GOLDEN).steps
    span_s = (steps[-1].inputs.stamp_ns - steps[0].inputs.stamp_ns) * 1e-9
    assert golden.steps == len(steps)
    assert golden.trouble == ""
    assert golden.cell.trouble == ""
    assert golden.length_s == pytest.approx(span_s, abs=SPACING_NS * 1e-9)


def test_frames_are_evenly_spread_and_no_change_of_class_is_between_them(
    golden: RecordedRun,
) -> None:
    times = [frame["t"] for frame in golden.frames]
    assert all(0.0 < b - a < 0.1 for a, b in pairwise(times))
    steps = read_steps(GOLDEN).steps
    marks = [(s.state, s.outputs["scenario"], s.outputs["scenario_state"]) for s in steps]
    changes = [b for a, b in pairwise(marks) if a != b]
    shown = [
        (f["state"], f["scenario"], "tentative" if f["tentative"] else "confirmed")
        for f in golden.frames
    ]
    assert [b for a, b in pairwise(shown) if a != b] == changes


def test_the_arm_moves_and_its_tool_comes_to_the_hub(golden: RecordedRun) -> None:
    (first,), (last,) = golden.between(0, 1), golden.between(len(golden.frames) - 1, 10**9)
    assert first["arm"] != last["arm"]
    contact = [frame for frame in golden.frames if frame["state"] == "contact"]
    assert min(frame["errors"]["gap_mm"] for frame in contact) < 3.0
    assert max(frame["errors"]["control_mm"] for frame in contact) < 3.0


def test_the_log_is_shown_in_its_order_with_its_times(golden: RecordedRun) -> None:
    texts = [text for _, text in golden.events]
    assert "state: track" in texts
    assert "conveyor: stop confirmed" in texts
    times = [t for t, _ in golden.events]
    assert times == sorted(times)
    confirmed_s = next(t for t, text in golden.events if text.endswith("stop confirmed"))
    near = min(golden.frames, key=lambda frame: abs(frame["t"] - confirmed_s))
    assert near["scenario"] == "stopping"


def test_frames_are_given_in_bounded_portions(golden: RecordedRun) -> None:
    times = [frame["t"] for frame in golden.frames]
    assert [frame["t"] for frame in golden.between(0, 10)] == times[:10]
    assert [frame["t"] for frame in golden.between(len(times) - 3, 10**9)] == times[-3:]
    assert len(golden.between(0, 10**9)) == min(MAX_ANSWER, len(golden.frames))
    assert golden.between(10**6, 10**9) == []


def test_the_page_data_is_json(golden: RecordedRun) -> None:
    data = json.loads(json.dumps(golden.as_page(), allow_nan=False))
    assert len(data["times"]) == len(golden.frames)
    assert {row["state"] for row in data["summary"]} >= {"track", "contact"}


def test_the_overview_keeps_the_worst_of_each_stretch() -> None:
    frames = [
        {"t": i * 0.03, "tentative": i == 7, "margin_ms": 11.0 - (i == 5000), "errors":
         {"plan_mm": 9.0 if i == 4321 else 0.1}, "confidence": float(i == 77)}
        for i in range(10_000)
    ]  # fmt: skip
    data = recorded_run.overview(frames)
    assert len(data) <= OVERVIEW_LENGTH
    assert max(one["errors"]["plan_mm"] for one in data) == 9.0
    assert min(one["margin_ms"] for one in data) == 10.0
    assert max(one["confidence"] for one in data) == 1.0
    assert sum(one["tentative"] for one in data) == 1


def test_what_a_step_foresaw_is_made_again_and_shown_with_it(tmp_path: Path) -> None:
    shown = recorded_run.read_run(GOLDEN)
    found = []
    for one in horizon_replay.predicted_horizons(GOLDEN):
        shown.add_horizon(one.k, one.ahead_ms, one.points, exact=one.exact)
        found.append(one)
        if len(found) == 40:
            break
    frame = next(f for f in shown.between(0, MAX_ANSWER) if "foreseen" in f)
    assert frame["foreseen_ms"] > 100
    assert frame["foreseen"][0] == pytest.approx(frame["target"][:3], abs=0.02)
    assert {one.k for one in found} <= {step.inputs.k for step in read_steps(GOLDEN).steps}


def recorded(path: Path, steps: int = 100) -> Path:
    """A recording in small chunks, as a daemon's recorder writes it."""
    texts = {"config": "task: wheel.yaml\n", "task": TASK.text, "urdf": TASK.urdf}
    file, feed, world = (
        StepFile(path.open("wb"), metadata_of(texts), 8192),
        StepItems(),
        World(parameters()),
    )
    for k in range(steps):
        inputs, before = world.inputs(MotionOrder.HOLD), world.state
        outputs = world.take(inputs)
        state = "idle" if k < steps // 2 else "armed"
        entry = LogEntry(k, state, inputs, outputs, before, world.state, world.parameters)
        for item in feed.convert(entry):
            file.write_item(item)
        times = CycleTimes(k, inputs.stamp_ns, None, None, 0, None, 400_000, True, state)
        file.write_item(Item(ItemKind.TIMING, inputs.stamp_ns, astuple(times)))
        if k == 10:
            file.write_item(Item(ItemKind.LINE, inputs.stamp_ns, ("alice ordered arm", 2)))
    file.close()
    return path


def test_a_daemons_recording_tells_its_happenings_once_and_what_was_left_of_each_cycle(
    tmp_path: Path,
) -> None:
    shown = recorded_run.read_run(recorded(tmp_path / "whole.mcap"))
    texts = [text for _, text in shown.events if not text.startswith("conveyor")]
    assert texts == ["state: idle", "alice ordered arm", "state: armed"]
    assert shown.frames[-1]["margin_ms"] == 11.6
    assert shown.frames[-1]["ages_ms"]["distance"] >= 0.0
    (last,) = shown.between(len(shown.frames) - 1, 10**9)
    assert last["samples"]["robot"] >= 90


def test_a_recording_cut_short_is_shown_as_far_as_it_goes(tmp_path: Path) -> None:
    whole, cut = recorded(tmp_path / "whole.mcap"), tmp_path / "cut.mcap"
    data = whole.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    all_of_it, shown = recorded_run.read_run(whole), recorded_run.read_run(cut)
    assert "damaged: the file ends early" in shown.trouble
    assert 0 < len(shown.frames) < len(all_of_it.frames)
    assert shown.frames == all_of_it.frames[: len(shown.frames)]


def test_one_too_long_is_shown_as_far_as_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded_run, "MAX_FRAMES", 20)
    shown = recorded_run.read_run(GOLDEN)
    assert len(shown.frames) == 20
    assert "longer than 20 frames" in shown.trouble


@pytest.mark.parametrize("content", [b"", b"not a recording", b"\x89MCAP0\r\n"])
def test_what_is_no_recording_is_refused_by_its_name(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "x.mcap"
    file.write_bytes(content)
    with pytest.raises(UnreadableRecordingError, match=r"x\.mcap: not a linemate recording"):
        recorded_run.read_run(file)


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(UnreadableRecordingError, match="No such file"):
        recorded_run.read_run(tmp_path / "none.mcap")
    shutil.rmtree(tmp_path)


def test_a_line_of_many_recordings_has_what_was_worst_on_the_way(golden: RecordedRun) -> None:
    data = recorded_run.total(golden)
    on_the_way = [
        frame["errors"]["control_mm"]
        for frame in golden.frames
        if frame["state"] in {"track", "contact", "retreat"}
        and frame["phase"] != "wait"
        and "control_mm" in frame["errors"]
    ]
    assert data["control_mm"]["max"] == pytest.approx(max(on_the_way), abs=1e-3)
    assert 0.0 < data["control_mm"]["rms"] < data["control_mm"]["max"]
    assert data["length_s"] == golden.length_s
