"""The parts of a cycle make its timing, and a bad moment leaves a file."""

import asyncio
import csv
import os
from dataclasses import replace
from pathlib import Path

import pytest
from loops import run, until
from msgspec import structs

from linemate.daemon.cycle.clock.phase_lock import PhaseLock
from linemate.daemon.cycle.clock.timing import CycleTimes, Incident, Timing
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.service.cycle_timing import CycleTiming
from linemate.daemon.service.incidents import LINES_A_CYCLE, MOST_FILES, IncidentFiles

T = 12_000_000


def test_a_prepared_cycle_is_accounted_for_with_its_parts(entries: tuple[LogEntry, ...]) -> None:
    timing = CycleTiming(Timing(T))
    entry = structs.replace(entries[3], counter=36)
    timing.note_prepared(woken_late_ns=20_000, step_ns=300_000)
    lock = PhaseLock(T, 0, 500_000)
    lock.follow(entry.inputs.stamp_ns - 5_000 - T)
    timing.note_schedule(lock)
    timing.close_cycle([entry], turnaround_ns=70_000)
    (times,) = timing.timing.last()
    assert times == CycleTimes(
        counter=36, arrival_ns=entry.inputs.stamp_ns, expected_ns=entry.inputs.stamp_ns - 5_000,
        woken_late_ns=20_000, lead_ns=500_000, step_ns=300_000, turnaround_ns=70_000,
        prepared=True, state=entry.state,
    )  # fmt: skip
    ages = timing.timing.ages
    assert ages["distance"].summary_us()["max"] == 1000.0
    assert ages["camera"].summary_us()["max"] == 2000.0


def test_what_was_of_one_cycle_is_not_of_the_next(entries: tuple[LogEntry, ...]) -> None:
    timing = CycleTiming(Timing(T))
    timing.note_prepared(woken_late_ns=20_000, step_ns=300_000)
    timing.close_cycle([structs.replace(entries[0], counter=12)], turnaround_ns=70_000)
    timing.note_step(900_000)
    timing.close_cycle([structs.replace(entries[1], counter=24)], turnaround_ns=950_000)
    timing.close_cycle([structs.replace(entries[2], counter=None)], turnaround_ns=950_000)
    first, second, third = timing.timing.last()
    assert (first.prepared, second.prepared, third.prepared) == (True, False, False)
    assert (second.woken_late_ns, second.step_ns) == (None, 900_000)
    assert (third.step_ns, third.turnaround_ns) == (None, None)


def test_after_a_stall_only_the_last_step_has_the_measured_times(
    entries: tuple[LogEntry, ...],
) -> None:
    timing = CycleTiming(Timing(T))
    timing.note_step(900_000)
    timing.close_cycle(
        [structs.replace(e, counter=None) for e in entries[:3]]
        + [structs.replace(entries[3], counter=48)],
        5,
    )
    assert [times.step_ns for times in timing.timing.last()] == [None, None, None, 900_000]


def test_entering_a_fault_takes_the_ring_once(entries: tuple[LogEntry, ...]) -> None:
    timing = CycleTiming(Timing(T))
    timing.close_cycle([structs.replace(entries[0], state=State.TRACK.value)], None)
    assert timing.take_incident() is None
    for n in (1, 2):
        timing.close_cycle([structs.replace(entries[n], state=State.FAULT.value)], None)
    incident = timing.take_incident()
    assert incident is not None
    assert incident.why == "a fault was entered"
    assert [cycle.state for cycle in incident.cycles] == ["track", "fault"]
    assert timing.timing.incidents == 1


def ring(cycles: int) -> Incident:
    one = CycleTimes(1, 2, 3, 4, 5, 6, 7, prepared=True, state="track")
    return Incident("a reply was late", 77, (one,) * cycles)


def test_an_incident_is_written_a_few_lines_a_cycle(tmp_path: Path) -> None:
    async def main() -> None:
        files = IncidentFiles(tmp_path)
        files.begin(ring(50))
        cycles = 0
        while not files.written:
            files.write_some()
            cycles += 1
            await asyncio.sleep(0)
            assert cycles < 100_000
        assert cycles >= 52 // LINES_A_CYCLE

    run(main())
    (path,) = tmp_path.iterdir()
    with path.open(encoding="ascii") as text:
        assert "a reply was late" in next(text)
        assert len(list(csv.DictReader(text))) == 50


def test_one_file_is_written_at_a_time(tmp_path: Path) -> None:
    files = IncidentFiles(tmp_path)
    files.begin(ring(3))
    files.begin(ring(3))
    assert files.refused == 1


def test_an_incident_is_kept_when_the_clock_was_set_back(tmp_path: Path) -> None:
    for k in range(MOST_FILES):
        path = tmp_path / f"incident-{k}.csv"
        path.write_bytes(b"old")
        os.utime(path, (2**32 + k, 2**32 + k))

    async def main() -> None:
        files = IncidentFiles(tmp_path)
        files.begin(replace(ring(3), at_ns=10**15))
        files.write_some()
        await until(lambda: files.written == 1)

    run(main())
    left = {path.name for path in tmp_path.glob("incident-*.csv")}
    assert left == {f"incident-{10**15}.csv", *(f"incident-{k}.csv" for k in range(1, MOST_FILES))}


def test_the_newest_incidents_are_kept_and_the_removed_ones_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    # As an earlier run of the daemon left it: stamps may be later, for the host was started again.
    for k in range(MOST_FILES):
        path = tmp_path / f"incident-{10**15 + k}.csv"
        path.write_bytes(b"old")
        os.utime(path, ns=(k, k))
    (tmp_path / "notes.txt").write_bytes(b"not ours to remove")
    count = MOST_FILES + 5

    async def main() -> None:
        files = IncidentFiles(tmp_path)
        for k in range(count):
            files.begin(replace(ring(3), at_ns=k))
            files.write_some()
            await until(lambda k=k: files.written == k + 1)
        assert files.removed == count
        assert (files.refused, files.failed) == (0, 0)

    run(main())
    left = {path.name for path in tmp_path.glob("incident-*.csv")}
    assert left == {f"incident-{k}.csv" for k in range(count - MOST_FILES, count)}
    assert (tmp_path / "notes.txt").exists()
    assert f"incident-{10**15}.csv" in caplog.text
    assert f"oldest of more than {MOST_FILES}" in caplog.text
