"""Process that writes recordings: items from a socket, MCAP files out.

Invariants:
- It ends when its socket does and not before. What the daemon has sent is in the file.
- It takes two messages, ``begin`` and ``items``, and reports what has changed.
"""

import contextlib
import logging
import os
import select
import shutil
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

import msgpack

from linemate.daemon.recording.format import Item, ItemKind

PAUSE_S: Final = 0.05  # before each read [s], so that one wake writes a dozen steps
MIB: Final = 1_048_576
RECEIVE_BYTES: Final = MIB
LONGEST_MESSAGE: Final = 64 * MIB
PATTERN: Final = "linemate-*.mcap"

log = logging.getLogger(__name__)

Report = dict[str, Any]  # number, file, files, written, full, failure, ended


@dataclass(frozen=True, slots=True)
class Rotation:
    """When the next file begins, and what is kept.

    Attributes:
        size_bytes, age_s: size and age [s] at which a file is full.
        total_bytes: limit for all recordings in the directory. The oldest are removed. None keeps
            them all.
        reserve_bytes: free space on the disk below which the recording ends.
    """

    size_bytes: int = 512 * MIB
    age_s: float = 3600.0
    total_bytes: int | None = None
    reserve_bytes: int = 64 * MIB


@dataclass(frozen=True, slots=True)
class RecordingStart:
    """Message that begins a recording.

    Attributes:
        number: number of the recording, which each report repeats.
        path: path of its first file, which exists and is empty.
        texts: metadata by name, the same for every file.
        chunk_bytes: size of a chunk before compression.
        flush_s: most that the sudden end of this process loses [s].
    """

    number: int
    path: str
    texts: Mapping[str, str]
    chunk_bytes: int
    flush_s: float
    rotation: Rotation


class RecordingWriter:
    """Writer of one recording after the other.

    Args:
        report: called with a ``Report`` whenever it differs from the last one.
    """

    def __init__(self, report: Callable[[Report], None]) -> None:
        # Here, not in the daemon, which needs the names of files only: 2 % of a start.
        from linemate.daemon.recording.step_file import StepFile

        self._new_file = StepFile
        self._report = report
        self._last_report: Report = {}
        self._start: RecordingStart | None = None
        self._file: StepFile | None = None
        self._stream: BinaryIO | None = None
        self._path = ""
        self._files = self._written = 0
        self._is_full = False
        self._began_s = self._flushed_s = 0.0

    @property
    def timeout_s(self) -> float | None:
        """Longest wait for items before ``flush_if_due`` is called [s], None without a file."""
        return None if self._file is None or self._start is None else self._start.flush_s

    def begin(self, start: RecordingStart) -> None:
        """Begin a recording; one that runs is ended."""
        self.end()
        self._start = start
        self._files = self._written = 0
        path = Path(start.path)
        self._guarded(lambda: self._open(path, path.open("wb")))

    def write(self, items: Iterable[Item]) -> None:
        """Write items; without a recording they are dropped."""
        if self._file is not None:
            self._guarded(lambda: self._write_items(items))

    def flush_if_due(self, now_s: float) -> None:
        """Flush every ``flush_s``, and report what has changed."""
        start = self._start
        if self._file is None or start is None:
            return
        if now_s - self._flushed_s >= start.flush_s:
            self._flushed_s = now_s
            self._guarded(self._flush)
        if self._file is not None:
            self._send_report()

    def end(self) -> None:
        """End the recording, if there is one."""
        if self._file is None:
            return
        self._guarded(self._close)
        self._send_report(ended=True)

    def _guarded(self, act: Callable[[], None]) -> None:
        """Call a function that writes. A failure ends the recording, not the process."""
        try:
            act()
        except OSError as error:
            self._abandon(f"{self._path}: {error.strerror or error}")
        except Exception as error:
            log.exception("recording ended")
            self._abandon(f"{self._path}: {type(error).__name__}: {error}")

    def _open(self, path: Path, stream: BinaryIO) -> None:
        start = self._start
        assert start is not None  # noqa: S101 - begin has set it
        self._path, self._stream = str(path), stream
        remove_oldest(path, start.rotation.total_bytes)
        offset_ns = time.time_ns() - time.monotonic_ns()
        self._file = self._new_file(stream, start.texts, start.chunk_bytes, offset_ns)
        self._began_s = time.monotonic()
        self._files += 1
        self._is_full = False
        self._send_report()

    def _write_items(self, items: Iterable[Item]) -> None:
        for item in items:
            if self._file is None:
                return
            if item.kind is ItemKind.END:
                self.end()
            elif item.kind is ItemKind.NEXT_FILE:
                self._file.close()
                self._open(*new_file(Path(self._path).parent))
            else:
                self._file.write_item(item)
                self._written += item.kind is ItemKind.STEP

    def _flush(self) -> None:
        """Flush the file and check its size, its age and the disk.

        Raises:
            OSError: the disk is full, or nearly.
        """
        start, file = self._start, self._file
        assert file is not None  # noqa: S101 - the caller has checked it
        assert start is not None  # noqa: S101
        file.flush()
        rotation = start.rotation
        free_bytes = shutil.disk_usage(Path(self._path).parent).free
        if free_bytes < rotation.reserve_bytes:
            raise OSError(
                f"disk nearly full: {free_bytes // MIB} MiB are free, limit "
                f"{rotation.reserve_bytes // MIB}. Free some space."
            )
        age_s = time.monotonic() - self._began_s
        self._is_full = file.size() >= rotation.size_bytes or age_s >= rotation.age_s

    def _close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _abandon(self, failure: str) -> None:
        """Close the stream without the file's end. ``linemate recover`` finishes the file."""
        self._file = None
        if self._stream is not None:
            with contextlib.suppress(OSError):
                self._stream.close()
        self._send_report(failure=failure, ended=True)

    def _send_report(self, *, failure: str = "", ended: bool = False) -> None:
        report = {
            "number": 0 if self._start is None else self._start.number,
            "file": self._path,
            "files": self._files,
            "written": self._written,
            "full": self._is_full,
            "failure": failure,
            "ended": ended,
        }
        if report != self._last_report:
            self._last_report = report
            self._report(report)


def main(descriptor: int) -> int:
    """Serve a socket until it ends; return the exit code.

    Args:
        descriptor: stream socket whose other end is the daemon's.
    """
    # Only the daemon ends this process, by closing the socket.
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)
    _leave_daemon_cores()
    with socket.socket(fileno=descriptor) as link:
        writer = RecordingWriter(lambda report: _send(link, report))
        unpacker = msgpack.Unpacker(max_buffer_size=LONGEST_MESSAGE)
        is_open = True
        while is_open:
            if _is_readable(link, writer.timeout_s):
                data = _receive(link)
                is_open = bool(data)
                unpacker.feed(data)
                for message in unpacker:
                    _handle(writer, message)
            writer.flush_if_due(time.monotonic())
        writer.end()
    return 0


def _leave_daemon_cores() -> None:
    inherited = os.sched_getaffinity(0)
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
        others = os.sched_getaffinity(0) - inherited
        if others:
            os.sched_setaffinity(0, others)


def _handle(writer: RecordingWriter, message: Any) -> None:
    match message:
        case ["items", items]:
            writer.write(Item(ItemKind(kind), stamp, payload) for kind, stamp, payload in items)
        case ["begin", [number, path, texts, chunk_bytes, flush_s, rotation]]:
            start = RecordingStart(number, path, texts, chunk_bytes, flush_s, Rotation(*rotation))
            writer.begin(start)


def _is_readable(link: socket.socket, timeout_s: float | None) -> bool:
    return bool(select.select([link], [], [], timeout_s)[0])


def _receive(link: socket.socket) -> bytes:
    """Return what has come after PAUSE_S, empty at the end of the stream."""
    time.sleep(PAUSE_S)
    data = _receive_once(link)
    while data and len(data) < RECEIVE_BYTES and _is_readable(link, 0.0):
        more = _receive_once(link)
        if not more:
            break  # the next call meets the end again
        data += more
    return data


def _receive_once(link: socket.socket) -> bytes:
    try:
        return link.recv(RECEIVE_BYTES)
    except ConnectionResetError:  # the daemon was killed with reports unread
        return b""


def _send(link: socket.socket, report: Report) -> None:
    """Send a report; it is lost if the daemon is gone or does not read."""
    with contextlib.suppress(OSError):
        link.send(msgpack.packb(report), socket.MSG_DONTWAIT)


def new_file(directory: Path) -> tuple[Path, BinaryIO]:
    """Create a file named after the present time.

    Raises:
        OSError: it cannot be written.
    """
    while True:
        seconds, rest_ns = divmod(time.time_ns(), 1_000_000_000)
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime(seconds))
        path = directory / f"linemate-{stamp}.{rest_ns // 1_000_000:03d}Z.mcap"
        with contextlib.suppress(FileExistsError):
            return path, path.open("xb")
        time.sleep(0.001)  # names count milliseconds


def remove_oldest(written: Path, total_bytes: int | None) -> None:
    """Remove the oldest recordings beyond a limit, but never the one that is being written.

    Args:
        written: file that is being written. After a step of the clock its name may be the oldest.
        total_bytes: limit for all recordings in its directory, None for no limit.
    """
    if total_bytes is None:
        return
    space_bytes = total_bytes - written.stat().st_size
    for path in sorted({*written.parent.glob(PATTERN)} - {written}, reverse=True):
        space_bytes -= path.stat().st_size
        if space_bytes < 0:
            log.info("recording removed for the limit of all recordings: %s", path)
            path.unlink()


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
