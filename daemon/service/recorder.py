"""Recordings: MCAP files, written by a thread that the cycle never waits for.

Law of this file: the loop makes bytes of a step and puts them into a bounded queue, after the
reply; the thread does the rest. A full queue drops steps and a full disk ends the recording; both
are counted and told, and neither costs a cycle. A killed process loses at most the last chunk.
A file that has grown too large or too old is followed by the next one, and each stands for itself.
"""

import contextlib
import logging
import shutil
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Final

from linemate.daemon.parameters import Parameters
from linemate.daemon.service.cycle import LogEntry
from linemate.daemon.service.step_file import LAYOUT, METADATA, TOPIC, Feed, Item, Kind, StepFile
from linemate.daemon.service.timing import CycleTimes
from linemate.daemon.service.viewer_messages import INFO

__all__ = ["LAYOUT", "METADATA", "TOPIC", "Recorder", "RecorderStatus", "Rotation", "StepFile"]

WAKE_S: Final = 0.05
CLOSE_S: Final = 5.0
PATTERN: Final = "linemate-*.mcap"
MIB: Final = 1_048_576

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Rotation:
    """When a file is followed by the next one, and what is kept.

    Attributes:
        size_bytes: of a file.
        age_s: of a file [s].
        total_bytes: of all recordings in the directory; the oldest go. None keeps them all.
        reserve_bytes: left free on the disk, or the recording ends.
    """

    size_bytes: int = 512 * MIB
    age_s: float = 3600.0
    total_bytes: int | None = None
    reserve_bytes: int = 64 * MIB


@dataclass(slots=True)
class RecorderStatus:
    """What an operator wants to know of recordings.

    Attributes:
        file: the present or the last one.
        recording: steps are being taken.
        files: begun since the start of the recording.
        written: steps in all of them.
        dropped: steps that found the queue full or the file ended.
        unfit: steps that could not be made bytes of.
        failure: why the last recording ended early, empty if it did not.
    """

    file: str = ""
    recording: bool = False
    files: int = 0
    written: int = 0
    dropped: int = 0
    unfit: int = 0
    failure: str = ""


@dataclass(slots=True)
class Recorder:
    """Takes steps from the loop and writes them in a thread.

    Attributes:
        directory: where files are written.
        metadata: text by name, the same for every file.
        queue: items that may wait.
        chunk_bytes: size of a chunk.
        flush_s: what a sudden death loses at most, beside what waits [s].
        rotation: of files.
    """

    directory: Path
    metadata: Mapping[str, str]
    queue: int = 4096
    chunk_bytes: int = 65_536
    flush_s: float = 0.5
    rotation: Rotation = field(default_factory=Rotation)
    status: RecorderStatus = field(default_factory=RecorderStatus)
    _feed: Feed = field(default_factory=Feed)
    _waiting: deque[Item] = field(default_factory=deque)
    _ending: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None
    _is_full: bool = False

    def start(self) -> str | None:
        """Begin a file.

        Returns:
            None, or why not.
        """
        if self._thread is not None and self._thread.is_alive():
            return "a recording runs already" if self.status.recording else "the last one is ending"
        try:
            path, stream = _new_file(self.directory)
        except OSError as error:
            return f"{self.directory}: {error.strerror}"
        self._waiting.clear()
        self._feed.begin()
        self._is_full = False
        self._ending = threading.Event()
        self.status = RecorderStatus(str(path), recording=True, files=1)
        self._thread = threading.Thread(
            target=self._write, args=(stream, self.status, self._ending), name="recorder"
        )
        self._thread.start()
        return None

    def take(self, entries: Iterable[LogEntry], times: Iterable[CycleTimes] = ()) -> None:
        """Record steps; called in the loop after the reply, and never waits.

        Args:
            entries: oldest first.
            times: what their cycles took.
        """
        if not self.status.recording:
            return
        for entry in entries:
            self._take_step(entry)
        for one in times:
            self._enqueue(Item(Kind.TIMING, one.arrival_ns, one))

    def say(self, stamp_ns: int, text: str, level: int = INFO) -> None:
        """Record a line for people.

        Args:
            stamp_ns: when [ns].
            text: what happened.
            level: viewer_messages.INFO or WARNING.
        """
        if self.status.recording:
            self._enqueue(Item(Kind.LINE, stamp_ns, (text, level)))

    def explain(self, parameters: Parameters, who: str, changed: Mapping[str, Any]) -> None:
        """Remember whose parameters these are, for the first step made with them.

        Args:
            parameters: that will be in force.
            who: set them.
            changed: by name, the old and the new value.
        """
        self._feed.explain(parameters, who, changed)

    def stop(self) -> str | None:
        """End the file; the thread finishes it by itself.

        Returns:
            None, or why not.
        """
        if not self.status.recording:
            return "nothing is being recorded"
        self.status.recording = False
        self._ending.set()
        return None

    def close(self, patience_s: float = CLOSE_S) -> None:
        """End the file and wait for the thread; for the end of the process."""
        self.stop()
        if self._thread is not None:
            self._thread.join(patience_s)

    def _take_step(self, entry: LogEntry) -> None:
        if len(self._waiting) >= self.queue or self.status.failure:
            self.status.dropped += 1
            self._feed.lost()
            return
        if self._is_full:
            self._is_full = False
            self._feed.begin()
            self._waiting.append(Item(Kind.NEXT_FILE, entry.inputs.stamp_ns))
        try:
            items = list(self._feed.of(entry))
        except (TypeError, ValueError, OverflowError, AttributeError):
            self._feed.lost()
            self.status.unfit += 1
            if self.status.unfit == 1:
                log.exception("a step cannot be recorded; said once")
            return
        self._waiting.extend(items)

    def _enqueue(self, item: Item) -> None:
        if len(self._waiting) < self.queue and not self.status.failure:
            self._waiting.append(item)

    def _write(self, stream: BinaryIO, status: RecorderStatus, ending: threading.Event) -> None:
        """The thread: take what waits, at a leisurely pace, until told to end."""
        writing = _Writing(self, stream)
        try:
            writing.begin(stream)
            due_s = 0.0
            while not ending.wait(WAKE_S):
                self._drain(writing, status)
                due_s += WAKE_S
                if due_s >= self.flush_s:
                    due_s = 0.0
                    writing.flush()
                    self._is_full = self._is_full or writing.is_full()
            self._drain(writing, status)
            writing.end()
        except OSError as error:
            status.failure = f"{status.file}: {error.strerror or error}"
            log.error("recording ended: %s", status.failure)  # noqa: TRY400 - an operator's line
            writing.abandon()
        except Exception as error:
            status.failure = f"{status.file}: {type(error).__name__}: {error}"
            log.exception("recording ended: %s", status.failure)
            writing.abandon()
        finally:
            status.recording = False

    def _drain(self, writing: "_Writing", status: RecorderStatus) -> None:
        while self._waiting:
            item = self._waiting.popleft()
            if item.kind is Kind.NEXT_FILE:
                path, stream = _new_file(self.directory)
                writing.end()
                writing.begin(stream)
                status.file = str(path)
                status.files += 1
                continue
            writing.put(item)
            status.written += item.kind is Kind.STEP


class _Writing:
    """The file that the thread writes, and the next one."""

    def __init__(self, recorder: Recorder, stream: BinaryIO) -> None:
        self._recorder = recorder
        self._stream = stream
        self._file: StepFile | None = None
        self._began_s = 0.0

    def begin(self, stream: BinaryIO) -> None:
        """Begin a file."""
        told = self._recorder
        _make_room(told.directory, told.rotation.total_bytes)
        self._stream = stream
        self._began_s = time.monotonic()
        offset_ns = time.time_ns() - time.monotonic_ns()
        self._file = StepFile(stream, told.metadata, told.chunk_bytes, offset_ns)

    def put(self, item: Item) -> None:
        """Add an item."""
        if self._file is not None:
            self._file.put(item)

    def flush(self) -> None:
        """Let a sudden death lose nothing up to here.

        Raises:
            OSError: the disk is full, or nearly.
        """
        if self._file is not None:
            self._file.flush()
        if shutil.disk_usage(self._recorder.directory).free < self._recorder.rotation.reserve_bytes:
            reserve_mib = self._recorder.rotation.reserve_bytes // MIB
            raise OSError(f"less than {reserve_mib} MiB are free on the disk")

    def is_full(self) -> bool:
        """The next file is due."""
        rotation = self._recorder.rotation
        if self._file is None:
            return False
        aged_s = time.monotonic() - self._began_s
        return self._file.size() >= rotation.size_bytes or aged_s >= rotation.age_s

    def end(self) -> None:
        """Finish the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def abandon(self) -> None:
        """Leave the file as it is; what is in it can be recovered."""
        with contextlib.suppress(OSError):
            self._stream.close()


def _new_file(directory: Path) -> tuple[Path, BinaryIO]:
    """Open a file named after the present moment.

    Raises:
        OSError: it cannot be written.
    """
    while True:
        path = directory / f"linemate-{_wall_name(time.time_ns())}.mcap"
        with contextlib.suppress(FileExistsError):
            return path, path.open("xb")
        time.sleep(0.001)  # names count milliseconds


def _make_room(directory: Path, total_bytes: int | None) -> None:
    """Remove the oldest recordings beyond what all may take; the newest, being written, stays."""
    if total_bytes is None:
        return
    *older, newest = sorted(directory.glob(PATTERN))
    room = total_bytes - newest.stat().st_size
    for path in reversed(older):
        room -= path.stat().st_size
        if room < 0:
            log.info("recording removed to make room: %s", path)
            path.unlink()


def _wall_name(wall_ns: int) -> str:
    seconds, rest_ns = divmod(wall_ns, 1_000_000_000)
    return f"{time.strftime('%Y%m%dT%H%M%S', time.gmtime(seconds))}.{rest_ns // 1_000_000:03d}Z"
