"""The join of truth and recording gives the very rows that virtual time gives directly."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording import step_codec
from linemate.daemon.recording.format import STATE_LOG, Item, ItemKind
from linemate.daemon.recording.step_codec import RecordingError
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import metadata_of
from linemate.simulators.harness import setup
from linemate.simulators.harness.lockstep import Lockstep
from linemate.simulators.judge import joined
from linemate.simulators.judge.judge import StateChange
from linemate.simulators.judge.rows import Rows


@pytest.fixture(scope="module")
def run() -> tuple[Lockstep, list[LogEntry]]:
    made = setup.make("wheel")
    scenario = replace(made.scenario, duration_s=1.5, cycle_s=0.012)
    entries: list[LogEntry] = []
    lockstep = Lockstep(replace(made, scenario=scenario), seed=2, on_step=entries.append)
    while lockstep.turn():
        pass
    return lockstep, entries


def recorded(entries: list[LogEntry], path: Path) -> Path:
    file = StepFile(path.open("xb"), metadata_of({"task": "wheel"}))
    for entry in entries:
        data = step_codec.encode(entry.counter, entry.state, entry.inputs, entry.outputs)
        file.write(entry.inputs.stamp_ns, data)
    file.close()
    return path


def assert_same(found: Rows, wanted: Rows, but: tuple[str, ...] = ()) -> None:
    for field in fields(Rows):
        if field.name in {"events", "step_us", *but}:
            continue
        given, due = getattr(found, field.name), getattr(wanted, field.name)
        np.testing.assert_array_equal(given, due, err_msg=field.name)


def columns(lockstep: Lockstep) -> dict[str, Any]:
    return lockstep.truth.columns()


def test_joined_rows_are_those_of_virtual_time(
    run: tuple[Lockstep, list[LogEntry]], tmp_path: Path
) -> None:
    lockstep, entries = run
    wanted = lockstep.evidence().rows
    path = recorded(entries, tmp_path / "run.mcap")
    found = joined.join(columns(lockstep), joined.read_steps(path))
    assert_same(found, wanted)
    assert [(e.kind, e.what) for e in found.events] == [(e.kind, e.what) for e in wanted.events]
    assert np.isfinite(found.target).all()


def test_a_step_that_was_not_recorded_leaves_its_row_unknown_and_no_other(
    run: tuple[Lockstep, list[LogEntry]], tmp_path: Path
) -> None:
    lockstep, entries = run
    gone = len(entries) // 2
    path = recorded(entries[:gone] + entries[gone + 1 :], tmp_path / "run.mcap")
    found = joined.join(columns(lockstep), joined.read_steps(path))
    unknown = np.flatnonzero(np.isnan(found.target).any(axis=1))
    assert unknown.tolist() == [gone]


def test_order_does_not_matter_and_foreign_telegrams_fill_no_row(
    run: tuple[Lockstep, list[LogEntry]], tmp_path: Path
) -> None:
    lockstep, entries = run
    foreign = structs.replace(entries[0], counter=1)
    path = recorded([foreign, *entries], tmp_path / "run.mcap")
    found = joined.join(columns(lockstep), joined.read_steps(path))
    assert_same(found, lockstep.evidence().rows)


def test_changes_of_state_are_read_from_the_log_and_no_other_line_is_one(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    file = StepFile(path.open("xb"), metadata_of({"task": "wheel"}))
    cause = "no fresh position: camera silent for 0.31 s (limit 0.30 s). Check its link: now."
    for n, payload in enumerate(
        (
            ("state: hold", 2),
            ("track -> hold: logged by another program", 2),
            (f"track -> hold: {cause}", 2, STATE_LOG),
            ("hold -> retreat: overload", 2, STATE_LOG),
        )
    ):
        file.write_item(Item(ItemKind.LINE, n, payload))
    file.close()
    assert list(joined.read_changes(path)) == [
        StateChange("track", "hold", cause),
        StateChange("hold", "retreat", "overload"),
    ]


def test_a_run_in_virtual_time_knows_why_its_state_changed(
    run: tuple[Lockstep, list[LogEntry]],
) -> None:
    lockstep, _ = run
    changes = [str(change) for change in lockstep.evidence().changes]
    assert changes[0].startswith("init -> idle: robot link healthy: 80 answered cycles in a row")
    assert changes[-1].startswith("armed -> track: started: start ordered by")


@pytest.mark.parametrize("data", [b"", b"\x89MCAP0\r\n", bytes(200)])
def test_what_is_no_recording_is_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "broken.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordingError):
        list(joined.read_steps(path))
