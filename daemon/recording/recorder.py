"""Recordings: MCAP files, written by a process that the cycle never waits for.

Invariants:
    * After the reply the loop makes bytes of a step and puts them into a bounded queue; what the
      kernel has room for goes to the process that writes. Nothing here waits, but ``close``.
    * A full queue drops steps, and a full disk ends the recording: both are counted and told.
    * A killed daemon loses nothing that it sent, a killed writer the last chunk.
    * A writer that was killed is started again with back-off, and the recording goes on in a new
      file; the steps between the two are counted as dropped.
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
from linemate.daemon.recording.recording_link import WriterLink
from linemate.daemon.recording.recording_writer import MIB, Rotation, new_file
from linemate.daemon.recording.revival import Revival
from linemate.daemon.recording.step_feed import Feed, described
from linemate.daemon.recording.step_file import Item, Kind
from linemate.daemon.recording.viewer_messages import INFO

__all__ = ["MIB", "Recorder", "RecorderStatus", "Rotation"]

CLOSE_S: Final = 5.0
BATCH: Final = 64
"""Items in a message."""

BATCHES: Final = 4
"""Messages a call: so fast a queue empties that a slow disk has let grow."""

PUSH_NS: Final = 25_000_000
"""So long items are gathered before they are handed on: a call of the kernel costs as much as a
step's bytes. It is what a killed daemon loses of its own [ns]."""

HEAR_EVERY: Final = 8
"""Of those calls, one in so many listens."""

log = logging.getLogger(__name__)

_times = attrgetter(*COLUMNS)


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
        restarts: of the process that writes, after it had ended by itself.
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
    """Takes steps from the loop and hands them to the process that writes.

    Attributes:
        directory: where files are written.
        metadata: text by name, the same for every file.
        queue: items that may wait.
        chunk_bytes: size of a chunk.
        flush_s: what a sudden death of the writer loses at most, beside what waits [s].
    """

    directory: Path
    metadata: Mapping[str, str]
    queue: int = 4096
    chunk_bytes: int = 65_536
    flush_s: float = 0.5
    rotation: Rotation = field(default_factory=Rotation)
    _status: RecorderStatus = field(default_factory=RecorderStatus)
    _feed: Feed = field(default_factory=Feed)
    _waiting: deque[Item] = field(default_factory=deque)
    _link: WriterLink | None = None
    _number: int = 0
    _calls: int = 0
    _pushed_ns: int = 0
    _is_full: bool = False
    _is_wanted: bool = False
    _revival: Revival[tuple[WriterLink, Path | None]] = field(default_factory=Revival)

    @property
    def status(self) -> RecorderStatus:
        """How it stands, as far as the writer has told."""
        self._push()
        self._hear()
        return self._status

    @property
    def writer(self) -> int | None:
        """The id of the process that writes, None while there is none."""
        return None if self._link is None else self._link.pid

    def open(self) -> str | None:
        """Start the process that writes, so that a recording may begin at once.

        Returns:
            None, or why not.
        """
        if self._link is not None and not self._link.lost:
            return None
        if self._revival.is_running:
            return "the process that writes recordings is being started again. Try in a second"
        self._revival.reset()
        if self._link is not None:
            self._link.close(0.0)
        try:
            self._link = WriterLink()
        except OSError as error:
            self._link = None
            return f"the process that writes recordings: {error.strerror}"
        return None

    def start(self) -> str | None:
        """Begin a file.

        Returns:
            None, or why not.
        """
        self._hear()
        if self._status.recording:
            return "a recording runs already"
        self._push()
        if self._waiting:
            return "the last one is ending"
        reason = self.open()
        if reason is not None:
            return reason
        try:
            path, stream = new_file(self.directory)
        except OSError as error:
            return f"{self.directory}: {error.strerror}"
        stream.close()
        self._status = RecorderStatus(restarts=self._revival.restarts)
        return self._begin(path)

    def tend(self, now_ns: int) -> None:
        """Start the process that writes again, if it has ended, and go on with the recording.

        Called now and then in the loop; it never waits.

        Args:
            now_ns: monotonic time [ns].
        """
        self._hear()
        done = self._revival.taken()
        if done is not None:
            self._revive(done)
            return
        link = self._link
        if link is not None and link.lost:
            before = self._revival.restarts
            self._revival.tend(now_ns, partial(self._renew, link))
            if self._revival.restarts > before:
                log.warning("%s; it is started again", link.lost)

    def _renew(self, lost: WriterLink) -> tuple[WriterLink, Path | None]:
        """Start the process anew, with a file if one is wanted; runs in a thread.

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

    def _revive(self, done: "Future[tuple[WriterLink, Path | None]]") -> None:
        """Take the process that was started, and go on where the last one ended."""
        error = done.exception()
        if error is not None:
            log.error("the process that writes recordings: %s", error)
            return
        self._link, path = done.result()
        before = self._status
        self._status = replace(before, restarts=self._revival.restarts)
        if path is None:
            return
        if not self._is_wanted:
            path.unlink(missing_ok=True)
            return
        self._status = RecorderStatus(dropped=before.dropped, restarts=self._revival.restarts)
        reason = self._begin(path)
        if reason is None:
            log.warning(
                "recording goes on in %s. %s was cut short: `linemate recover` finishes it. "
                "%d steps are missing between them.",
                path, before.file, before.dropped,
            )  # fmt: skip

    def _begin(self, path: Path) -> str | None:
        """Tell the process to write to a file, which is there and empty.

        Returns:
            None, or why it cannot.
        """
        self._feed.begin()
        self._is_full = False
        self._number += 1
        self._status.file, self._status.recording = str(path), True
        told = [
            self._number,
            str(path),
            described(self.metadata),
            self.chunk_bytes,
            self.flush_s,
            astuple(self.rotation),
        ]
        link = self._link
        assert link is not None  # noqa: S101 - as open left it
        self._is_wanted = link.send(["begin", told])
        if self._is_wanted:
            return None
        self._status.recording = False
        return link.lost or "the last one is ending"

    def take(self, entries: Iterable[LogEntry], times: Iterable[CycleTimes] = ()) -> None:
        """Record steps; called in the loop after the reply, and never waits.

        Args:
            times: what their cycles took.
        """
        if not self._status.recording:
            if self._is_wanted:
                self._status.dropped += sum(1 for _ in entries)
            return
        for entry in entries:
            self._take_step(entry)
        for one in times:
            self._enqueue(Item(Kind.TIMING, one.arrival_ns, _times(one)))
        if not self._waiting:
            return
        newest_ns = self._waiting[-1].stamp_ns
        if 0 <= newest_ns - self._pushed_ns < PUSH_NS:
            return
        self._pushed_ns = newest_ns
        self._push()
        self._calls += 1
        if self._calls % HEAR_EVERY == 0:
            self._hear()

    def say(self, stamp_ns: int, text: str, level: int = INFO, name: str = "linemated") -> None:
        """Record a line for people.

        Args:
            stamp_ns: when [ns].
            name: of who writes it; ``linemated.state`` for changes of the operating state.
        """
        if self._status.recording:
            self._enqueue(Item(Kind.LINE, stamp_ns, (text, level, name)))

    def explain(self, parameters: Parameters, who: str, changed: Mapping[str, Any]) -> None:
        """Remember whose parameters these are, for the first step made with them.

        Args:
            parameters: that will be in force.
            changed: by name, the old and the new value.
        """
        self._feed.explain(parameters, who, changed)

    def stop(self) -> str | None:
        """End the file; the writer finishes it by itself.

        Returns:
            None, or why not.
        """
        is_wanted, self._is_wanted = self._is_wanted, False
        if not self._status.recording:
            return None if is_wanted else "nothing is being recorded"
        self._status.recording = False
        self._waiting.append(Item(Kind.END, 0))
        self._push()
        return None

    def close(self, patience_s: float = CLOSE_S) -> None:
        """End the file and wait for the writer; for the end of the process."""
        self.stop()
        done = self._revival.close()
        if done is not None:
            self._revive(done)
        link, self._link = self._link, None
        if link is None:
            return
        rest = list(self._waiting)
        self._waiting.clear()
        for told in link.close(patience_s, ["items", rest]):
            self._learn(told)

    def _take_step(self, entry: LogEntry) -> None:
        if len(self._waiting) >= self.queue:
            self._status.dropped += 1
            self._feed.lost()
            return
        try:
            self._waiting.extend(list(self._feed.of(entry)))
        except (TypeError, ValueError, OverflowError, AttributeError):
            self._feed.lost()
            self._status.unfit += 1
            if self._status.unfit == 1:
                log.exception("a step cannot be recorded; said once")

    def _enqueue(self, item: Item) -> None:
        if len(self._waiting) < self.queue:
            self._waiting.append(item)

    def _push(self) -> None:
        """Hand on what waits, as far as there is room for it."""
        link, waiting = self._link, self._waiting
        if link is None:
            return
        for _ in range(BATCHES):
            if link.lost or not waiting or not link.flush():
                break
            count = min(BATCH, len(waiting))
            link.send(["items", [waiting.popleft() for _ in range(count)]])
        if link.lost:
            self._end(link.lost)

    def _hear(self) -> None:
        """Learn what the writer has told."""
        link = self._link
        if link is None:
            return
        if not link.lost:  # one that is lost may be closed in a thread at this moment
            for told in link.hear():
                self._learn(told)
        if link.lost:
            self._end(link.lost)

    def _learn(self, told: Mapping[str, Any]) -> None:
        if told["number"] != self._number:
            return
        status = self._status
        status.file, status.files, status.written = told["file"], told["files"], told["written"]
        if told["failure"]:
            self._end(told["failure"])
            return
        if told["full"] and not self._is_full and status.recording:
            # The next file must stand for itself: only the feed can see to that.
            self._feed.begin()
            self._waiting.append(Item(Kind.NEXT_FILE, 0))
        self._is_full = told["full"]

    def _end(self, failure: str) -> None:
        """A recording ended early; what waits is lost with it."""
        status = self._status
        if not status.recording:
            return
        status.recording = False
        status.failure = failure
        # A process that was killed is started again; a disk that is full stays full.
        self._is_wanted = self._link is not None and bool(self._link.lost)
        status.dropped += sum(item.kind is Kind.STEP for item in self._waiting)
        self._waiting.clear()
        log.error("recording ended: %s", failure)
