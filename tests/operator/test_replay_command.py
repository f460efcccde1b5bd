"""Replays: the recorded bits again, and what a change of parameters moves."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cell import TASK, World, parameters
from msgspec import structs

from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.operator import main as tool
from linemate.daemon.recording.format import CellTexts, ParametersInForce, StateBefore
from linemate.daemon.recording.reader import pieces, read
from linemate.daemon.recording.step_codec import StepRecord
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import StepItems, metadata_of
from linemate.daemon.recording.step_replay import distance, replay

STEPS = 120
TEXTS = {"config": "task: wheel.yaml\n", "task": TASK.text, "urdf": TASK.urdf}


def entries(world: World, count: int, order: MotionOrder = MotionOrder.HOLD) -> Iterator[LogEntry]:
    for _ in range(count):
        inputs, before = world.inputs(order), world.state
        outputs = world.take(inputs)
        yield LogEntry(
            12 * inputs.k, "idle", inputs, outputs, before, world.state, world.parameters
        )


def record(path: Path, steps: Iterator[LogEntry], feed: StepItems | None = None) -> Path:
    file, feed = StepFile(path.open("wb"), metadata_of(TEXTS)), feed or StepItems()
    for entry in steps:
        for item in feed.convert(entry):
            file.write_item(item)
    file.close()
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "whole.mcap"
    return record(path, entries(World(parameters()), STEPS))


def run_tool(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, Any]:
    code = tool.main(["replay", *words, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_the_same_program_gives_the_same_bits(
    whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, result = run_tool(capsys, str(whole))
    assert code == 0
    assert result["identical"] is True
    assert result["steps"] == STEPS
    assert result["notes"] == []
    assert tool.main(["replay", str(whole)]) == 0
    assert "identical" in capsys.readouterr().out


def test_another_parameter_shows_what_moves_when_and_by_how_much(
    whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "tracking.distance.deviation"
    code, result = run_tool(capsys, str(whole), "--set", f"{name}=0.002")
    assert code == 1
    assert not result["identical"]
    speed = result["fields"]["speed"]
    assert 0 < speed["steps"] < STEPS
    assert 0.0 < speed["largest"] < 0.2
    assert speed["first"]["recorded"] != speed["first"]["made"]
    assert "command" not in result["fields"]
    assert tool.main(["replay", str(whole), "--set", f"{name}=0.002"]) == 1
    assert "speed" in capsys.readouterr().out


def test_a_configuration_is_laid_over_the_recorded_parameters(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    overlay = tmp_path / "overlay.yaml"
    overlay.write_text("tracking: {distance: {deviation: 2.0e-3}}\n")
    by_file = run_tool(capsys, str(whole), "--config", str(overlay))
    by_name = run_tool(capsys, str(whole), "--set", "tracking.distance.deviation=0.002")
    assert by_file == by_name


def test_parameters_of_another_shape_restart_with_the_reason(
    whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, result = run_tool(capsys, str(whole), "--set", "control.horizon_s=0.6")
    assert code == 1 or result["identical"]
    assert "not one of these parameters" in result["notes"][0]["what"]
    assert result["unmade"] == 0


@pytest.mark.parametrize(
    "value", ["tracking.nonsense=1", "tracking.distance.deviation=-1", "tracking.predict=no", "x"]
)
def test_what_does_not_fit_is_refused_by_its_name(
    whole: Path, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tool.main(["replay", str(whole), "--set", value]) in {1, 2}
    assert value.partition("=")[0] in capsys.readouterr().err


def test_a_tolerance_forgives_what_is_smaller(
    whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (str(whole), "--set", "tracking.distance.deviation=0.00038000001")
    assert run_tool(capsys, *words)[0] == 1
    code, result = run_tool(capsys, *words, "--tolerance", "1e-3")
    assert (code, result["identical"]) == (0, True)
    assert result["different"] > 0


def test_a_recording_that_begins_in_the_middle_replays_from_its_own_state(tmp_path: Path) -> None:
    world = World(parameters())
    list(entries(world, 60))
    path = record(tmp_path / "late.mcap", entries(world, 40))
    replayed = list(replay(pieces(path)))
    assert len(replayed) == 40
    assert all(not v.changes and v.failure is None and v.restart is None for v in replayed)


def test_steps_that_were_dropped_are_bridged_by_a_state(tmp_path: Path) -> None:
    feed = StepItems()

    def with_a_gap() -> Iterator[LogEntry]:
        for entry in entries(World(parameters()), 60):
            if 20 <= entry.inputs.k < 30:
                feed.drop_step()
                continue
            yield entry

    path = record(tmp_path / "gap.mcap", with_a_gap(), feed)
    replayed = list(replay(pieces(path)))
    assert [v.k for v in replayed] == [*range(20), *range(30, 60)]
    assert all(not v.changes and v.failure is None for v in replayed)


def test_other_parameters_in_the_middle_are_replayed_from_their_own_step_on(tmp_path: Path) -> None:
    def swapped() -> Iterator[LogEntry]:
        world = World(parameters())
        yield from entries(world, 40)
        tracker = world.parameters.tracker
        noise = replace(tracker.settings.distance, gate=3.0)
        settings = replace(tracker.settings, distance=noise)
        world.parameters = replace(world.parameters, tracker=replace(tracker, settings=settings))
        yield from entries(world, 40)

    path = record(tmp_path / "swapped.mcap", swapped())
    found = list(pieces(path))
    assert [piece.k for piece in found if isinstance(piece, ParametersInForce)] == [0, 40]
    assert sum(isinstance(piece, StateBefore) for piece in found) == 1
    assert all(not v.changes and v.failure is None for v in replay(found))


def test_one_flipped_bit_of_a_command_is_found(whole: Path) -> None:
    found = list(pieces(whole))
    for index, piece in enumerate(found):
        if isinstance(piece, StepRecord) and piece.inputs.k == 77:
            first, *rest = piece.outputs["command"]
            bent = (first + 2.0**-52 * max(abs(first), 1e-3), *rest)
            found[index] = replace(piece, outputs={**piece.outputs, "command": bent})
    different = [v for v in replay(found) if v.changes]
    assert [(v.k, list(v.changes)) for v in different] == [(77, ["command"])]


def test_an_older_recording_without_states_begins_where_the_robot_was(tmp_path: Path) -> None:
    path = tmp_path / "older.mcap"
    file = StepFile(path.open("wb"), metadata_of(TEXTS))
    for entry in entries(World(parameters()), 40):
        for item in StepItems().convert(
            structs.replace(entry, before=None, after=None, parameters=None)
        ):
            file.write_item(item)
    file.close()
    replayed = list(replay(pieces(path)))
    assert "begun at rest" in str(replayed[0].restart)
    assert not any(v.changes for v in replayed)


def test_a_file_cut_short_is_replayed_as_far_as_it_goes(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 3 // 4])
    code, result = run_tool(capsys, str(cut))
    assert code == 1
    assert result["identical"] is False
    assert 0 < result["steps"] < STEPS
    assert result["broken"]
    assert result["total"] is None


def test_a_damaged_recording_says_how_many_of_its_steps_were_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "damaged.mcap"
    file, feed = StepFile(path.open("wb"), metadata_of(TEXTS), 8192), StepItems()
    for entry in entries(World(parameters()), STEPS):
        for item in feed.convert(entry):
            file.write_item(item)
    file.close()
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    # A whole chunk's length: between chunks lies an index that no step needs.
    for place in range(middle, middle + 8192):
        data[place] ^= 0x55
    path.write_bytes(data)
    code, result = run_tool(capsys, str(path))
    assert code == 1
    assert result["identical"] is False
    assert result["different"] == 0
    assert 0 < result["steps"] < result["total"] == STEPS
    assert tool.main(["replay", str(path)]) == 1
    printed = capsys.readouterr().out.splitlines()
    assert printed[1].startswith("damaged: ")
    assert f"{result['steps']} of {STEPS} steps were read" in printed[1]
    assert printed[-1] == "identical as far as it was read"
    folder = tmp_path / "tables"
    assert tool.main(["export", str(path), "--out", str(folder)]) == 1
    assert f"{result['steps']} of {STEPS} steps were read" in capsys.readouterr().err


def test_what_is_no_recording_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"not a recording" * 10)
    for path in (other, tmp_path / "missing"):
        assert tool.main(["replay", str(path)]) == 1
        assert capsys.readouterr().err.count("\n") == 1


def test_a_recording_has_its_texts_and_all_its_steps(whole: Path) -> None:
    recording = read(whole)
    assert recording.whole
    assert len(recording.steps) == STEPS
    assert recording.texts["urdf"] == TASK.urdf
    assert isinstance(next(pieces(whole)), CellTexts)


def test_a_distance_is_that_of_the_numbers_and_none_of_words() -> None:
    assert distance((1.0, (2.0, 3)), (1.0, (2.5, 3))) == 0.5
    assert distance("running", "stopping") is None
    assert distance((1.0,), None) is None
    assert distance((1.0,), (1.0, 2.0)) is None
    assert distance(True, 1.0) is None
    assert distance(0.0, float("inf")) == float("inf")
