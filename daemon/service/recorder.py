"""Recordings: MCAP files, written by a thread that the cycle never waits for.

Law of this file: the loop makes bytes of a step and puts them into a bounded queue, after the
reply; the thread does the rest. A full queue drops steps and a full disk ends the recording; both
are counted and told, and neither costs a cycle. A killed process loses at most the last chunk.
"""

import contextlib
import json
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Protocol

from mcap.writer import CompressionType, Writer

from linemate.daemon import recording
from linemate.daemon.inputs import Inputs
from linemate.daemon.step import Outputs

TOPIC = "/linemate/step"
ENCODING = "msgpack"
METADATA = "linemate"
LAYOUT = "layout"
WAKE_S = 0.05
CLOSE_S = 5.0

log = logging.getLogger(__name__)


class Entry(Protocol):
    """One step as the cycle hands it on."""

    @property
    def ipoc(self) -> int | None:
        """Of the telegram it answered."""

    @property
    def state(self) -> str:
        """The operating state."""

    @property
    def inputs(self) -> Inputs:
        """What entered it."""

    @property
    def outputs(self) -> Outputs:
        """What it said."""


class StepFile:
    """One MCAP file of steps; synchronous.

    Args:
        stream: open for writing, empty; it is closed with the file.
        metadata: text by name: whatever a replay needs.
        chunk_bytes: size of a chunk.
        wall_offset_ns: from monotonic stamps to the times of the file [ns].
    """

    def __init__(
        self,
        stream: BinaryIO,
        metadata: Mapping[str, str],
        chunk_bytes: int = 65_536,
        wall_offset_ns: int = 0,
    ) -> None:
        self.written = 0
        self._stream = stream
        self._offset_ns = wall_offset_ns
        self._writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.LZ4)
        self._writer.start(profile="", library="linemate")
        layout = json.dumps(recording.LAYOUT)
        self._writer.add_metadata(METADATA, {**metadata, LAYOUT: layout})
        schema = self._writer.register_schema("linemate.Step", "", b"")
        self._channel = self._writer.register_channel(TOPIC, ENCODING, schema)

    def write(self, stamp_ns: int, data: bytes) -> None:
        """Add one step.

        Args:
            stamp_ns: of the step [ns].
            data: as ``recording.encode`` made it.
        """
        wall_ns = stamp_ns + self._offset_ns
        self._writer.add_message(self._channel, wall_ns, data, stamp_ns, self.written & 0xFFFFFFFF)
        self.written += 1

    def flush(self) -> None:
        """Give everything written so far to the operating system, as a chunk of its own."""
        # The package ends a chunk by its size alone and offers no other way.
        finish_chunk: Callable[[], None] = getattr(self._writer, "_Writer__finalize_chunk")  # noqa: B009
        finish_chunk()
        self._stream.flush()

    def close(self) -> None:
        """Finish the file; the stream is closed whatever happens."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._stream.close()


@dataclass(slots=True)
class RecorderStatus:
    """What an operator wants to know of recordings.

    Attributes:
        file: the present or the last one.
        recording: steps are being taken.
        written: steps in the file.
        dropped: steps that found the queue full or the file ended.
        unfit: steps that could not be made bytes of.
        failure: why the last recording ended early, empty if it did not.
    """

    file: str = ""
    recording: bool = False
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
        queue: steps that may wait.
        chunk_bytes: size of a chunk.
        flush_s: what a sudden death loses at most, beside what waits [s].
    """

    directory: Path
    metadata: Mapping[str, str]
    queue: int = 4096
    chunk_bytes: int = 65_536
    flush_s: float = 0.5
    status: RecorderStatus = field(default_factory=RecorderStatus)
    _waiting: deque[tuple[int, bytes]] = field(default_factory=deque)
    _ending: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None

    def start(self) -> str | None:
        """Begin a file.

        Returns:
            None, or why not.
        """
        if self._thread is not None and self._thread.is_alive():
            return "a recording runs already" if self.status.recording else "the last one is ending"
        path = self.directory / f"linemate-{_wall_name(time.time_ns())}.mcap"
        try:
            stream = path.open("xb")
        except OSError as error:
            return f"{path}: {error.strerror}"
        self._waiting.clear()
        self._ending = threading.Event()
        self.status = RecorderStatus(str(path), recording=True)
        self._thread = threading.Thread(
            target=self._write, args=(stream, self.status, self._ending), name="recorder"
        )
        self._thread.start()
        return None

    def take(self, entries: Iterable[Entry]) -> None:
        """Record steps; called in the loop after the reply, and never waits.

        Args:
            entries: oldest first.
        """
        if not self.status.recording:
            return
        for entry in entries:
            if len(self._waiting) >= self.queue or self.status.failure:
                self.status.dropped += 1
                continue
            try:
                data = recording.encode(entry.ipoc, entry.state, entry.inputs, entry.outputs)
            except (TypeError, ValueError, OverflowError):
                self.status.unfit += 1
                if self.status.unfit == 1:
                    log.exception("a step cannot be recorded; said once")
                continue
            self._waiting.append((entry.inputs.stamp_ns, data))

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

    def _write(self, stream: BinaryIO, status: RecorderStatus, ending: threading.Event) -> None:
        """The thread: take what waits, at a leisurely pace, until told to end."""
        offset_ns = time.time_ns() - time.monotonic_ns()
        try:
            file = StepFile(stream, self.metadata, self.chunk_bytes, offset_ns)
            due_s = 0.0
            while not ending.wait(WAKE_S):
                self._drain(file, status)
                due_s += WAKE_S
                if due_s >= self.flush_s:
                    file.flush()
                    due_s = 0.0
            self._drain(file, status)
            file.close()
        except OSError as error:
            status.failure = f"{status.file}: {error.strerror or error}"
            log.error("recording ended: %s", status.failure)  # noqa: TRY400 - an operator's line
            with contextlib.suppress(OSError):
                stream.close()
        finally:
            status.recording = False

    def _drain(self, file: StepFile, status: RecorderStatus) -> None:
        while self._waiting:
            file.write(*self._waiting.popleft())
        status.written = file.written


def _wall_name(wall_ns: int) -> str:
    seconds, rest_ns = divmod(wall_ns, 1_000_000_000)
    return f"{time.strftime('%Y%m%dT%H%M%S', time.gmtime(seconds))}.{rest_ns // 1_000_000:03d}Z"
