"""Recordings: complete, readable after a sudden death, and never in the way."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from msgspec.structs import replace

from linemate.daemon.config.task_file import Task
from linemate.daemon.core import step as stepping
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.clock.timing import CycleTimes
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording.format import LAYOUT, METADATA, STEP, TIMING, Item, ItemKind
from linemate.daemon.recording.reader import pieces
from linemate.daemon.recording.reader import read as read_recording
from linemate.daemon.recording.recorder import Recorder, Rotation
from linemate.daemon.recording.step_codec import StepRecord, decode, differences
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_replay import ReplayedStep, replay
from linemate.daemon.recording.writer_process import RecordingStart, RecordingWriter, Report
from linemate.daemon.recording.writer_restart import (
    FIRST_NS,
    LONGEST_NS,
    MOST_IN_A_ROW,
    STEADY_NS,
    WriterRestart,
)

Entries = tuple[LogEntry, ...]
SECOND_NS = 1_000_000_000
TEXTS = {"config": "task: wheel.yaml\n", "urdf": "<robot/>"}


def wait_for(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 10.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.002)


def read(path: Path) -> list[StepRecord]:
    with path.open("rb") as stream:
        return [decode(message.data) for _, _, message in make_reader(stream).iter_messages(STEP)]


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    made = Recorder(tmp_path, TEXTS)
    yield made
    made.close()


def test_a_recording_holds_every_step_and_all_that_a_replay_needs(
    recorder: Recorder, entries: Entries
) -> None:
    assert recorder.start() is None
    recorder.record(entries[:12])
    recorder.record(entries[12:])
    recorder.close()
    path = Path(recorder.status.file)
    records = read(path)
    assert [record.inputs for record in records] == [entry.inputs for entry in entries]
    for record, entry in zip(records, entries, strict=True):
        assert differences(record, entry.outputs) == ()
    with path.open("rb") as stream:
        (metadata,) = make_reader(stream).iter_metadata()
    assert metadata.name == METADATA
    assert metadata.metadata["urdf"] == "<robot/>"
    assert "stamp_ns" in json.loads(metadata.metadata[LAYOUT])["Inputs"]
    assert recorder.status.written == len(entries)
    assert not recorder.status.recording


def test_steps_outside_of_a_recording_are_not_taken(recorder: Recorder, entries: Entries) -> None:
    recorder.record(entries)
    assert recorder.stop() == "nothing is being recorded"
    assert not list(recorder.directory.iterdir())


def test_a_second_start_is_refused_and_a_later_one_makes_another_file(
    recorder: Recorder, entries: Entries
) -> None:
    assert recorder.start() is None
    assert "already" in str(recorder.start())
    recorder.close()
    assert recorder.start() is None
    recorder.close()
    assert len(list(recorder.directory.glob("*.mcap"))) == 2


def test_a_writer_that_stands_still_costs_steps_that_are_counted_and_no_cycle(
    recorder: Recorder, entries: Entries
) -> None:
    recorder.queue = 50
    assert recorder.start() is None
    wait_for(lambda: recorder.status.files == 1)
    assert recorder.writer_pid is not None
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    try:
        taken, longest = 0, 0.0
        while recorder.status.dropped < 100:
            assert taken < 100_000
            began = time.thread_time()
            recorder.record(entries)
            longest = max(longest, time.thread_time() - began)
            taken += len(entries)
            assert len(recorder._waiting) < 50 + 6
    finally:
        os.kill(recorder.writer_pid, signal.SIGCONT)
    wait_for(lambda: recorder.status.written > taken - recorder.status.dropped - 100)
    recorder.close()
    assert recorder.status.written == taken - recorder.status.dropped
    assert len(read(Path(recorder.status.file))) == recorder.status.written


def test_a_directory_that_is_gone_is_a_reason_and_no_exception(
    recorder: Recorder, tmp_path: Path
) -> None:
    recorder.directory = tmp_path / "gone"
    assert "No such file" in str(recorder.start())


def test_a_step_that_cannot_be_packed_is_counted(recorder: Recorder, entries: Entries) -> None:
    recorder.start()
    bad = LogEntry(1, object(), entries[0].inputs, entries[0].outputs)  # type: ignore[arg-type]
    recorder.record([bad, entries[0]])
    recorder.close()
    assert recorder.status.unfit == 1
    assert recorder.status.written == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path: Path) -> None:
    reports: list[Report] = []
    writer = RecordingWriter(reports.append)
    writer.begin(RecordingStart(1, "/dev/full", {}, 65_536, 0.0, Rotation()))
    writer.write([Item(ItemKind.STEP, 1, b"step")])
    writer.flush_if_due(1.0)
    assert "No space left" in reports[-1]["failure"]
    assert reports[-1]["ended"]
    path = tmp_path / "next.mcap"
    writer.begin(RecordingStart(2, str(path), {}, 65_536, 0.0, Rotation()))
    writer.write([Item(ItemKind.STEP, 1, b"step"), Item(ItemKind.END, 0)])
    assert (reports[-1]["number"], reports[-1]["written"], reports[-1]["failure"]) == (2, 1, "")
    with path.open("rb") as stream:
        assert [m.data for _, _, m in make_reader(stream).iter_messages(STEP)] == [b"step"]


def test_what_the_daemon_hears_as_failure_ends_the_recording_and_a_new_one_may_begin(
    recorder: Recorder, entries: Entries
) -> None:
    assert recorder.start() is None
    wait_for(lambda: recorder.status.files == 1)
    assert recorder.writer_pid is not None
    os.kill(recorder.writer_pid, signal.SIGKILL)
    wait_for(lambda: not recorder.status.recording)
    assert "has ended" in recorder.status.failure
    recorder.record(entries)
    assert recorder.start() is None
    recorder.record(entries)
    recorder.close()
    assert (recorder.status.written, recorder.status.failure) == (len(entries), "")


def test_chunks_stay_small_and_are_compressed(entries: Entries) -> None:
    class Kept(io.BytesIO):
        def close(self) -> None:
            """Keep what was written."""

    stream = Kept()
    file = StepFile(stream, TEXTS, chunk_bytes=1024)
    data = b"a step that compresses well" * 4
    for k in range(200):
        file.write(k, data)
    file.close()
    stream.seek(0)
    summary = make_reader(stream).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) > 10
    assert all(c.uncompressed_size < 2 * 1024 for c in summary.chunk_indexes)
    assert all(c.compressed_size < c.uncompressed_size for c in summary.chunk_indexes)


KILLED = """
import sys, time
from pathlib import Path
from linemate.daemon.recording.recorder import Recorder
from linemate.daemon.recording.format import Item, ItemKind
recorder = Recorder(Path(sys.argv[1]), {}, flush_s=0.05)
recorder.start()
for k in range(100):
    recorder._enqueue(Item(ItemKind.STEP, k, b"step %d" % k))
    recorder._send_waiting()
if sys.argv[2] == "daemon":
    print(recorder.status.file, recorder.writer_pid, flush=True)
while recorder.status.written < 100 or Path(recorder.status.file).stat().st_size < 500:
    time.sleep(0.001)
print(recorder.status.file, recorder.writer_pid, flush=True)
time.sleep(30)
"""


def test_a_killed_daemon_loses_nothing_that_it_sent(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path), "daemon"], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    path, writer = process.stdout.readline().split()
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    wait_for(lambda: not Path(f"/proc/{writer}/fd").exists() or is_over(int(writer)))
    with Path(path).open("rb") as stream:
        found = [message.data for _, _, message in make_reader(stream).iter_messages(STEP)]
    assert found == [b"step %d" % k for k in range(100)]


def is_over(pid: int) -> bool:
    """Whether a process that is not our child has ended, or waits to be buried."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def test_a_killed_writer_leaves_a_file_that_can_be_read(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path), "writer"], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    path, writer = process.stdout.readline().split()
    os.kill(int(writer), signal.SIGKILL)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    found: list[bytes] = []
    with Path(path).open("rb") as stream:
        messages = NonSeekingReader(stream).iter_messages(log_time_order=False)
        with pytest.raises(McapError):
            found.extend(message.data for _, _, message in messages)
    assert found == [b"step %d" % k for k in range(100)]


def chained(entries: Entries, parameters: Parameters) -> Entries:
    """The same steps with the states between them, as the cycle hands them on."""
    rest = entries[0].inputs.robot
    assert rest is not None
    state = stepping.initial(parameters, rest)
    made = []
    for entry in entries:
        before = state
        state, outputs = stepping.step(state, entry.inputs, parameters)
        made.append(
            replace(entry, outputs=outputs, before=before, after=state, parameters=parameters)
        )
    return tuple(made)


def replayed(path: Path) -> list[ReplayedStep]:
    return list(replay(pieces(path)))


def test_a_file_that_is_full_is_followed_by_one_that_stands_for_itself(
    tmp_path: Path, task: Task, entries: Entries, parameters: Parameters
) -> None:
    texts = {"task": task.text, "urdf": task.urdf}
    recorder = Recorder(tmp_path, texts, flush_s=0.01, rotation=Rotation(size_bytes=1))
    steps = chained(entries, parameters)
    assert recorder.start() is None
    recorder.record(steps[:8])
    wait_for(lambda: recorder.status.written == 8 and recorder._is_full)
    recorder.record(steps[8:])
    wait_for(lambda: recorder.status.files == 2)
    recorder.close()
    # A file of a byte is full at once: on a slow machine a third is begun before the end.
    first, second, *others = sorted(tmp_path.glob("*.mcap"))
    assert recorder.status.file == str((second, *others)[-1])
    assert not any(map(read, others))
    assert [v.k for v in replayed(first)] == list(range(8))
    assert [v.k for v in replayed(second)] == list(range(8, 20))
    for step in (*replayed(first), *replayed(second)):
        assert not step.changes
        assert step.failure is step.restart is None


def test_a_file_that_is_old_is_followed_by_the_next(tmp_path: Path, entries: Entries) -> None:
    recorder = Recorder(tmp_path, TEXTS, flush_s=0.01, rotation=Rotation(age_s=0.02))
    assert recorder.start() is None
    for files in (2, 3, 4):
        wait_for(lambda: recorder.status.recording and recorder._is_full)
        recorder.record(entries[:1])
        wait_for(lambda: recorder.status.files >= files)  # noqa: B023 - called at once
    recorder.close()
    assert recorder.status.files == len(list(tmp_path.glob("*.mcap"))) >= 4


def test_the_oldest_recordings_are_removed_and_nothing_else_is_touched(
    tmp_path: Path, entries: Entries
) -> None:
    names = ["linemate-20200101T000000.000Z.mcap", "linemate-20210101T000000.000Z.mcap"]
    for name in (*names, "mine.mcap", "linemate-notes.txt"):
        (tmp_path / name).write_bytes(b"x" * 1000)
    recorder = Recorder(tmp_path, TEXTS, rotation=Rotation(total_bytes=1500))
    assert recorder.start() is None
    recorder.record(entries)
    recorder.close()
    left = {path.name for path in tmp_path.iterdir()}
    assert names[0] not in left
    assert {names[1], "mine.mcap", "linemate-notes.txt"} <= left
    assert len(left) == 4


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT"])
def test_a_signal_to_the_whole_group_leaves_the_writer_to_the_daemon(
    tmp_path: Path, entries: Entries, name: str
) -> None:
    recorder = Recorder(tmp_path, TEXTS, flush_s=0.01)
    assert recorder.start() is None
    recorder.record(entries[:1])
    wait_for(lambda: recorder.status.written == 1)  # the process has begun
    assert recorder.writer_pid is not None
    os.kill(recorder.writer_pid, signal.Signals[name])
    recorder.record(entries[1:])
    recorder.close()
    assert recorder.status.failure == ""
    assert len(read_recording(Path(recorder.status.file)).steps) == len(entries)


def test_a_recording_that_is_written_stays_when_the_clock_was_set_back(
    tmp_path: Path, entries: Entries
) -> None:
    later = tmp_path / "linemate-29990101T000000.000Z.mcap"
    later.write_bytes(b"x" * 2000)
    recorder = Recorder(tmp_path, TEXTS, rotation=Rotation(total_bytes=1500))
    assert recorder.start() is None
    recorder.record(entries)
    recorder.close()
    assert len(read_recording(Path(recorder.status.file)).steps) == len(entries)
    assert not later.exists()


def test_a_disk_that_is_nearly_full_ends_the_recording_with_its_file_readable(
    tmp_path: Path, entries: Entries
) -> None:
    recorder = Recorder(tmp_path, TEXTS, flush_s=0.01, rotation=Rotation(reserve_bytes=2**60))
    assert recorder.start() is None
    recorder.record(entries)
    wait_for(lambda: not recorder.status.recording)
    recorder.close()
    assert "MiB are free" in recorder.status.failure
    assert len(read_recording(Path(recorder.status.file)).steps) == len(entries)


def test_dropped_steps_are_bridged_so_that_the_rest_replays(
    tmp_path: Path, task: Task, entries: Entries, parameters: Parameters
) -> None:
    recorder = Recorder(tmp_path, {"task": task.text, "urdf": task.urdf})
    steps = chained(entries, parameters)
    assert recorder.start() is None
    recorder.record(steps[:5])
    recorder.queue = 0
    recorder.record(steps[5:9])
    recorder.queue = 4096
    recorder.record(steps[9:])
    recorder.close()
    assert recorder.status.dropped == 4
    steps_again = replayed(Path(recorder.status.file))
    assert [v.k for v in steps_again] == [*range(5), *range(9, 20)]
    assert all(not v.changes and v.failure is v.restart is None for v in steps_again)


def test_the_lines_for_people_and_the_times_of_cycles_stand_next_to_the_steps(
    recorder: Recorder, entries: Entries
) -> None:
    recorder.start()
    recorder.write_line(7, "link camera is down: no datagrams")
    times = CycleTimes(1, 8, None, None, 0, 100, 200, False, "idle")
    recorder.record(entries, [times])
    recorder.close()
    with Path(recorder.status.file).open("rb") as stream:
        messages_of: dict[str, list[object]] = {}
        for _, channel, message in make_reader(stream).iter_messages(["/log", TIMING]):
            messages_of.setdefault(channel.topic, []).append(json.loads(message.data))
    messages = [line["message"] for line in messages_of["/log"]]  # type: ignore[index]
    assert messages[0] == "link camera is down: no datagrams"
    assert "state: track" in messages
    assert messages_of[TIMING] == [
        {"counter": 1, "arrival_ns": 8, "lead_ns": 0, "step_ns": 100, "turnaround_ns": 200,
         "prepared": False, "state": "idle"}
    ]  # fmt: skip


def test_a_killed_writer_is_started_again_and_the_recording_goes_on(
    tmp_path: Path,
    task: Task,
    entries: Entries,
    parameters: Parameters,
    caplog: pytest.LogCaptureFixture,
) -> None:
    recorder = Recorder(tmp_path, {"task": task.text, "urdf": task.urdf})
    steps = chained(entries, parameters)
    half = len(steps) // 2
    assert recorder.start() is None
    recorder.record(steps[:half])
    wait_for(lambda: recorder.status.written == half)
    first, writer = recorder.status.file, recorder.writer_pid
    assert writer is not None
    os.kill(writer, signal.SIGKILL)
    wait_for(lambda: not recorder.status.recording)
    assert "signal 9" in recorder.status.failure
    recorder.record(steps[half : half + 2])
    now_ns = 10 * SECOND_NS
    recorder.restart_writer_if_lost(now_ns)
    recorder.restart_writer_if_lost(now_ns + FIRST_NS - 1)
    assert recorder.status.restarts == 0
    longest_s = 0.0
    while not recorder.status.recording:
        began = time.thread_time()
        recorder.restart_writer_if_lost(now_ns + FIRST_NS)
        longest_s = max(longest_s, time.thread_time() - began)
        time.sleep(0.002)
    assert longest_s < 0.004  # of a cycle of 12 ms
    recorder.record(steps[half + 2 :])
    recorder.close()
    status = recorder.status
    assert (status.restarts, status.dropped, status.failure) == (1, 2, "")
    assert status.file != first
    assert recorder.writer_pid is None
    steps_again = replayed(Path(status.file))
    assert len(steps_again) == len(steps) - half - 2
    assert not any(step.changes or step.failure for step in steps_again)
    assert "recording goes on in" in caplog.text


def test_starts_of_a_writer_grow_apart_and_end_after_eight_in_a_row() -> None:
    restart: WriterRestart[None] = WriterRestart()
    at_ns, starts = 0, []
    while at_ns < 400 * SECOND_NS:
        at_ns += SECOND_NS // 10
        restart.start_if_due(at_ns, lambda: None)
        if restart.is_running:
            starts.append(at_ns)
            wait_for(lambda: restart.pop_result() is not None)
    apart = [b - a for a, b in pairwise(starts)]
    assert len(starts) == restart.restarts == MOST_IN_A_ROW
    assert apart == sorted(apart)
    assert starts[0] >= FIRST_NS
    assert max(apart) <= LONGEST_NS + SECOND_NS
    assert restart.is_over
    restart.reset()
    restart.start_if_due(at_ns, lambda: None)
    restart.start_if_due(at_ns + FIRST_NS, lambda: None)
    assert restart.restarts == MOST_IN_A_ROW + 1
    restart.close()


def test_a_writer_that_lived_for_a_minute_begins_a_new_row() -> None:
    restart: WriterRestart[None] = WriterRestart()
    at_ns = 0
    for _ in range(3 * MOST_IN_A_ROW):
        at_ns += STEADY_NS
        restart.start_if_due(at_ns, lambda: None)
        at_ns += LONGEST_NS
        restart.start_if_due(at_ns, lambda: None)
        wait_for(lambda: restart.pop_result() is not None)
    assert restart.restarts == 3 * MOST_IN_A_ROW
    restart.close()


def test_an_ordered_end_while_a_killed_writer_is_away_ends_the_wish_to_record(
    recorder: Recorder, entries: Entries
) -> None:
    assert recorder.start() is None
    wait_for(lambda: recorder.status.files == 1)
    assert recorder.writer_pid is not None
    os.kill(recorder.writer_pid, signal.SIGKILL)
    wait_for(lambda: not recorder.status.recording)
    assert recorder.stop() is None
    assert recorder.stop() == "nothing is being recorded"
    recorder.restart_writer_if_lost(0)
    recorder.restart_writer_if_lost(FIRST_NS)
    wait_for(
        lambda: (
            recorder.restart_writer_if_lost(FIRST_NS) is None and not recorder._restart.is_running
        )
    )
    assert not recorder.status.recording
    assert recorder.start() is None
    recorder.record(entries)
    recorder.close()
    assert recorder.status.written == len(entries)
