"""Recordings as tables, and recordings made whole."""

import csv
from pathlib import Path
from typing import Any

import pytest
from cell import TASK, World, parameters
from msgspec.structs import astuple

from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.cycle.clock.timing import CycleTimes
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.operator import main as tool
from linemate.daemon.recording.format import Item, ItemKind
from linemate.daemon.recording.reader import read
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import StepItems, metadata_of

STEPS = 100
TEXTS = {"config": "task: wheel.yaml\n", "task": TASK.text, "urdf": TASK.urdf}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "whole.mcap"
    file, feed, world = (
        StepFile(path.open("wb"), metadata_of(TEXTS), 8192),
        StepItems(),
        World(parameters()),
    )
    for k in range(STEPS):
        inputs, before = world.inputs(MotionOrder.HOLD), world.state
        outputs = world.take(inputs)
        entry = LogEntry(k, "idle", inputs, outputs, before, world.state, world.parameters)
        for item in feed.convert(entry):
            file.write_item(item)
        turnaround = None if k == 0 else 1000 + k
        times = CycleTimes(k, inputs.stamp_ns, None, None, 0, None, turnaround, True, "idle")
        file.write_item(Item(ItemKind.TIMING, inputs.stamp_ns, astuple(times)))
    file.close()
    return path


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_recording_becomes_tables_with_every_digit(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tool.main(["export", str(whole), "--out", str(tmp_path / "csv")]) == 0
    assert "steps.csv" in capsys.readouterr().out
    rows = table(tmp_path / "csv" / "steps.csv")
    steps = read(whole).steps
    assert [int(row["k"]) for row in rows] == [step.inputs.k for step in steps]
    for row, step in zip(rows, steps, strict=True):
        assert float(row["command_A1"]) == step.outputs["command"][0]
        assert [float(row[f"target_{part}"]) for part in ("x", "y", "z")] == list(
            step.outputs["target"][:3]
        )
        assert row["scenario"] == step.outputs["scenario"]
        assert row["part_x"] == (
            "" if step.outputs["part"] is None else repr(step.outputs["part"][0])
        )
    readings = table(tmp_path / "csv" / "distance.csv")
    samples = [sample for step in steps for sample in step.inputs.distance]
    assert [float(row["position"]) for row in readings] == [s.position for s in samples]


def test_what_was_not_there_is_an_empty_cell(whole: Path, tmp_path: Path) -> None:
    tool.main(["export", str(whole), "--out", str(tmp_path / "csv")])
    timing = table(tmp_path / "csv" / "timing.csv")
    assert [row["turnaround_ns"] for row in timing[:2]] == ["", "1001"]
    assert len(timing) == STEPS
    (log,) = table(tmp_path / "csv" / "log.csv")
    assert log["message"] == "state: idle"


def test_a_table_that_exists_is_not_overwritten(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "steps.csv").write_text("mine")
    assert tool.main(["export", str(whole), "--out", str(tmp_path)]) == 2
    assert "steps.csv" in capsys.readouterr().err
    assert (tmp_path / "steps.csv").read_text() == "mine"


def run_tool(capsys: pytest.CaptureFixture[str], *words: Any) -> tuple[int, str]:
    code = tool.main([str(word) for word in words])
    return code, capsys.readouterr().out


@pytest.mark.parametrize("share", [0.5, 0.8, 0.97])
def test_a_file_cut_anywhere_becomes_whole_again(
    share: float, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(len(data) * share)])
    before = read(cut)
    assert not before.whole
    assert run_tool(capsys, "recover", cut)[0] == 0
    after = read(tmp_path / "cut-recovered.mcap")
    assert after.whole
    assert after.steps == before.steps
    assert 0 < len(after.steps) <= STEPS
    assert after.texts == before.texts
    assert run_tool(capsys, "replay", tmp_path / "cut-recovered.mcap")[0] == 0
    assert cut.read_bytes() == data[: int(len(data) * share)]


def test_a_damaged_chunk_costs_itself_and_no_other(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(whole.read_bytes())
    for at in range(len(data) // 2, len(data) // 2 + 8):
        data[at] ^= 0x55
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    code, out = run_tool(capsys, "recover", bad)
    assert code == 0
    assert "1 damaged chunks left out" in out
    kept = {step.inputs.k for step in read(tmp_path / "bad-recovered.mcap").steps}
    assert {0, STEPS - 1} <= kept
    assert STEPS // 3 < len(kept) < STEPS


def test_a_recovery_overwrites_nothing_and_refuses_other_files(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / "there.mcap"
    there.write_bytes(b"mine")
    assert run_tool(capsys, "recover", whole, "--out", there)[0] == 2
    assert there.read_bytes() == b"mine"
    other = tmp_path / "other"
    other.write_bytes(b"no recording at all")
    assert run_tool(capsys, "recover", other)[0] == 1
    assert run_tool(capsys, "export", other)[0] == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other", "there.mcap"]
