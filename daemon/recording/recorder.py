"""Recorder: encodes steps in the loop and sends them to the writer process.

Invariants:
- Only ``close`` waits. A bounded queue holds what the socket does not take.
- A full queue drops steps and counts them. A full disk ends the recording with a reason.
- A killed daemon loses nothing that it sent, a killed writer its last chunk.
- A killed writer is restarted with back-off. The recording goes on in a new file, and the steps
  between the two files count as dropped.
"""

import logging
from collections import deque
from collections.abc import Iterable, Mapping
from concurrent.futures import Future
from dataclasses import astuple, dataclass, field, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.clock.timing import COLUMNS, CycleTimes
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording.format import Item, ItemKind
from linemate.daemon.recording.step_items import StepItems, metadata_of
from linemate.daemon.recording.viewer_messages import INFO
from linemate.daemon.recording.writer_link import WriterLink
from linemate.daemon.recording.writer_process import MIB, Rotation, new_file
from linemate.daemon.recording.writer_restart import WriterRestart

__all__ = ["MIB", "Recorder", "RecorderStatus", "Rotation"]

CLOSE_S: Final = 5.0
BATCH: Final = 64  # items a message
BATCHES: Final = 4  # messages a call, so that a long queue empties faster than it grows
# Flush interval [ns]. Batching saves one system call a step. A killed daemon loses this much.
SEND_NS: Final = 25_000_000
RECEIVE_EVERY: Final = 8  # flushes for each read of the writer's reports

log = logging.getLogger(__name__)

_times = attrgetter(*COLUMNS)


@dataclass(slots=True)
class RecorderStatus:
    """Status of recordings, as operators see it.

    Attributes:
        file: path of the present or the last file.
        files: number of files since the start of the recording.
        dropped: steps that found the queue full or the file ended.
        unfit: steps that could not be encoded.
        failure: why the last recording ended early, empty if it did not.
        restarts: restarts of the writer process since the daemon began.
    """

    file: str = ""
    recording: bool = False
    files: int = 0
    written: int = 0
    dropped: int = 0
    unfit: int = 0
    failure: str = ""
    restarts: int = 0


@dataclass(slots=True)
class Recorder:
    """Queue between the loop and the writer process.

    Attributes:
        metadata: text by name, the same for every file.
        queue: longest queue, in items.
        chunk_bytes: size of a chunk before compression.
        flush_s: most that the sudden end of the writer loses [s], and the queue.
    """

    directory: Path
    metadata: Mapping[str, str]
    queue: int = 4096
    chunk_bytes: int = 65_536
    flush_s: float = 0.5
    rotation: Rotation = field(default_factory=Rotation)
    _status: RecorderStatus = field(default_factory=RecorderStatus)
    _items: StepItems = field(default_factory=StepItems)
    _waiting: deque[Item] = field(default_factory=deque)
    _link: WriterLink | None = None
    _number: int = 0
    _calls: int = 0
    _sent_ns: int = 0
    _is_full: bool = False
    _is_wanted: bool = False
    _restart: WriterRestart[tuple[WriterLink, Path | None]] = field(default_factory=WriterRestart)

    @property
    def status(self) -> RecorderStatus:
        """Status as of the writer's last report."""
        self._send_waiting()
        self._receive()
        return self._status

    @property
    def writer_pid(self) -> int | None:
        """Process id of the writer, None while there is none."""
        return None if self._link is None else self._link.pid

    def open(self) -> str | None:
        """Start the writer process; return a refusal, None if it runs."""
        if self._link is not None and not self._link.lost:
            return None
        if self._restart.is_running:
            return "the process that writes recordings is being started again. Try in a second"
        self._restart.reset()
        if self._link is not None:
            self._link.close(0.0)
        try:
            self._link = WriterLink()
        except OSError as error:
            self._link = None
            return f"the process that writes recordings: {error.strerror}"
        return None

    def start(self) -> str | None:
        """Begin a recording; return a refusal, None if it has begun."""
        self._receive()
        if self._status.recording:
            return "a recording runs already. Stop it first."
        self._send_waiting()
        if self._waiting:
            return "the last recording is still ending. Try again in a second."
        reason = self.open()
        if reason is not None:
            return reason
        try:
            path, stream = new_file(self.directory)
        except OSError as error:
            return f"{self.directory}: {error.strerror}"
        stream.close()
        self._status = RecorderStatus(restarts=self._restart.restarts)
        return self._begin(path)

    def restart_writer_if_lost(self, now_ns: int) -> None:
        """Restart the writer process after its end, and continue the recording. Never waits."""
        self._receive()
        result = self._restart.pop_result()
        if result is not None:
            self._use_restarted(result)
            return
        link = self._link
        if link is not None and link.lost:
            before = self._restart.restarts
            self._restart.start_if_due(now_ns, partial(self._start_writer, link))
            if self._restart.restarts > before:
                log.warning("%s; it is started again", link.lost)

    def _start_writer(self, lost: WriterLink) -> tuple[WriterLink, Path | None]:
        """Start the process again, with a file if a recording ran; runs in a thread.

        Raises:
            OSError: the process cannot be started.
        """
        lost.close(0.0)
        link = WriterLink()
        if not self._is_wanted:
            return link, None
        try:
            path, stream = new_file(self.directory)
        except OSError as error:
            log.error("no recording: %s: %s", self.directory, error.strerror)  # noqa: TRY400
            return link, None
        stream.close()
        return link, path

    def _use_restarted(self, result: "Future[tuple[WriterLink, Path | None]]") -> None:
        """Use the restarted process, and continue the recording in a new file."""
        error = result.exception()
        if error is not None:
            log.error("the process that writes recordings: %s", error)
            return
        self._link, path = result.result()
        before = self._status
        self._status = replace(before, restarts=self._restart.restarts)
        if path is None:
            return
        if not self._is_wanted:
            path.unlink(missing_ok=True)
            return
        self._status = RecorderStatus(dropped=before.dropped, restarts=self._restart.restarts)
        reason = self._begin(path)
        if reason is None:
            log.warning(
                "recording goes on in %s. %s was cut short: `linemate recover` finishes it. "
                "%d steps are missing between them.",
                path, before.file, before.dropped,
            )  # fmt: skip

    def _begin(self, path: Path) -> str | None:
        """Send the start of a recording to an empty file; return a refusal, None if sent."""
        self._items.begin_file()
        self._is_full = False
        self._number += 1
        self._status.file, self._status.recording = str(path), True
        start = [
            self._number,
            str(path),
            metadata_of(self.metadata),
            self.chunk_bytes,
            self.flush_s,
            astuple(self.rotation),
        ]
        link = self._link
        assert link is not None  # noqa: S101 - open has set it
        self._is_wanted = link.send(["begin", start])
        if self._is_wanted:
            return None
        self._status.recording = False
        return link.lost or "the last recording is still ending. Try again in a second."

    def record(self, entries: Iterable[LogEntry], times: Iterable[CycleTimes] = ()) -> None:
        """Record steps and the times of their cycles, oldest first. Never waits."""
        if not self._status.recording:
            if self._is_wanted:
                self._status.dropped += sum(1 for _ in entries)
            return
        for entry in entries:
            self._record_step(entry)
        for cycle in times:
            self._enqueue(Item(ItemKind.TIMING, cycle.arrival_ns, _times(cycle)))
        if not self._waiting:
            return
        newest_ns = self._waiting[-1].stamp_ns
        if 0 <= newest_ns - self._sent_ns < SEND_NS:
            return
        self._sent_ns = newest_ns
        self._send_waiting()
        self._calls += 1
        if self._calls % RECEIVE_EVERY == 0:
            self._receive()

    def write_line(self, stamp_ns: int, text: str, name: str = "linemated") -> None:
        """Record a log line.

        Args:
            stamp_ns: monotonic time of the event [ns].
            name: name of the writer, format.STATE_LOG for changes of the operating state.
        """
        if self._status.recording:
            self._enqueue(Item(ItemKind.LINE, stamp_ns, (text, INFO, name)))

    def note_change(self, parameters: Parameters, who: str, changed: Mapping[str, Any]) -> None:
        """Note who set parameters, for the first step that uses them.

        Args:
            changed: old and new value by name.
        """
        self._items.note_change(parameters, who, changed)

    def stop(self) -> str | None:
        """End the recording; return a refusal, None if it ends. The writer finishes the file."""
        is_wanted, self._is_wanted = self._is_wanted, False
        if not self._status.recording:
            return None if is_wanted else "nothing is being recorded"
        self._status.recording = False
        self._waiting.append(Item(ItemKind.END, 0))
        self._send_waiting()
        return None

    def close(self, timeout_s: float = CLOSE_S) -> None:
        """End the recording and wait for the writer; for the end of the daemon."""
        self.stop()
        result = self._restart.close()
        if result is not None:
            self._use_restarted(result)
        link, self._link = self._link, None
        if link is None:
            return
        rest = list(self._waiting)
        self._waiting.clear()
        for report in link.close(timeout_s, ["items", rest]):
            self._apply_report(report)

    def _record_step(self, entry: LogEntry) -> None:
        if len(self._waiting) >= self.queue:
            self._status.dropped += 1
            self._items.drop_step()
            return
        try:
            self._waiting.extend(list(self._items.convert(entry)))
        except (TypeError, ValueError, OverflowError, AttributeError):
            self._items.drop_step()
            self._status.unfit += 1
            if self._status.unfit == 1:
                log.exception("a step cannot be recorded. Further ones are counted only.")

    def _enqueue(self, item: Item) -> None:
        if len(self._waiting) < self.queue:
            self._waiting.append(item)

    def _send_waiting(self) -> None:
        """Send the queue as far as the socket takes it."""
        link, waiting = self._link, self._waiting
        if link is None:
            return
        for _ in range(BATCHES):
            if link.lost or not waiting or not link.flush():
                break
            count = min(BATCH, len(waiting))
            link.send(["items", [waiting.popleft() for _ in range(count)]])
        if link.lost:
            self._fail(link.lost)

    def _receive(self) -> None:
        """Apply the writer's reports."""
        link = self._link
        if link is None:
            return
        if not link.lost:  # a thread may be closing a lost one
            for report in link.receive():
                self._apply_report(report)
        if link.lost:
            self._fail(link.lost)

    def _apply_report(self, report: Mapping[str, Any]) -> None:
        if report["number"] != self._number:
            return
        status = self._status
        status.file, status.files = report["file"], report["files"]
        status.written = report["written"]
        if report["failure"]:
            self._fail(report["failure"])
            return
        if report["full"] and not self._is_full and status.recording:
            # The next file needs a state and parameters of its own.
            self._items.begin_file()
            self._waiting.append(Item(ItemKind.NEXT_FILE, 0))
        self._is_full = report["full"]

    def _fail(self, failure: str) -> None:
        """End a recording early; the queue is lost with it."""
        status = self._status
        if not status.recording:
            return
        status.recording = False
        status.failure = failure
        # A killed process is restarted. A full disk stays full.
        self._is_wanted = self._link is not None and bool(self._link.lost)
        status.dropped += sum(item.kind is ItemKind.STEP for item in self._waiting)
        self._waiting.clear()
        log.error("recording ended: %s", failure)
