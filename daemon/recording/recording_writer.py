"""The process that writes recordings: items in by a socket, files out.

Law of this file: what it takes, be it the interpreter, a processor or a disk, it takes from no
cycle. It ends when its socket does and not before: whatever becomes of the daemon, what the daemon
has sent is in the file. It tells what it does; it is asked nothing.
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

from linemate.daemon.recording.step_file import Item, Kind, StepFile

PAUSE_S: Final = 0.05
"""Between two looks at the socket: what comes one by one is written by the dozen [s]."""

PIECE: Final = 1_048_576
MIB: Final = 1_048_576
LONGEST: Final = 64 * MIB
PATTERN: Final = "linemate-*.mcap"

log = logging.getLogger(__name__)

Told = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Rotation:
    """When a file is followed by the next one, and what is kept.

    Attributes:
        age_s: of a file [s].
        total_bytes: of all recordings in the directory; the oldest go. None keeps them all.
        reserve_bytes: left free on the disk, or the recording ends.
    """

    size_bytes: int = 512 * MIB
    age_s: float = 3600.0
    total_bytes: int | None = None
    reserve_bytes: int = 64 * MIB


@dataclass(frozen=True, slots=True)
class Beginning:
    """What begins a recording.

    Attributes:
        number: of the recording, so that what is told of an earlier one is known as such.
        path: of its first file, which is there and empty.
        texts: by name, the same for every file.
        chunk_bytes: size of a chunk.
        flush_s: what a sudden death of this process loses at most [s].
    """

    number: int
    path: str
    texts: Mapping[str, str]
    chunk_bytes: int
    flush_s: float
    rotation: Rotation


class Writer:
    """One recording after the other.

    Args:
        tell: is given what changed: ``number``, ``file``, ``files``, ``written``, ``full``,
            ``failure``, ``ended``.
    """

    def __init__(self, tell: Callable[[Told], None]) -> None:
        self._tell = tell
        self._told: Told = {}
        self._beginning: Beginning | None = None
        self._file: StepFile | None = None
        self._stream: BinaryIO | None = None
        self._path = ""
        self._files = self._written = 0
        self._is_full = False
        self._began_s = self._flushed_s = 0.0

    @property
    def patience_s(self) -> float | None:
        """How long nothing may come before it is looked after the file, None without one [s]."""
        return None if self._file is None or self._beginning is None else self._beginning.flush_s

    def begin(self, beginning: Beginning) -> None:
        """Begin a recording; one that runs is ended."""
        self.end()
        self._beginning = beginning
        self._files = self._written = 0
        path = Path(beginning.path)
        self._guarded(lambda: self._open(path, path.open("wb")))

    def take(self, items: Iterable[Item]) -> None:
        """Write items; without a recording they are nobody's."""
        if self._file is not None:
            self._guarded(lambda: self._put(items))

    def look(self, now_s: float) -> None:
        """Flush when it is time, and tell what has changed.

        Args:
            now_s: monotonic [s].
        """
        beginning = self._beginning
        if self._file is None or beginning is None:
            return
        if now_s - self._flushed_s >= beginning.flush_s:
            self._flushed_s = now_s
            self._guarded(self._flush)
        if self._file is not None:
            self._say()

    def end(self) -> None:
        """End the recording, if there is one."""
        if self._file is None:
            return
        self._guarded(self._close)
        self._say(ended=True)

    def _guarded(self, act: Callable[[], None]) -> None:
        """Do something to the file; what fails ends the recording and nothing else."""
        try:
            act()
        except OSError as error:
            self._abandon(f"{self._path}: {error.strerror or error}")
        except Exception as error:
            log.exception("a recording cannot go on")
            self._abandon(f"{self._path}: {type(error).__name__}: {error}")

    def _open(self, path: Path, stream: BinaryIO) -> None:
        beginning = self._beginning
        assert beginning is not None  # noqa: S101 - as begin left it
        self._path, self._stream = str(path), stream
        make_room(path.parent, beginning.rotation.total_bytes)
        offset_ns = time.time_ns() - time.monotonic_ns()
        self._file = StepFile(stream, beginning.texts, beginning.chunk_bytes, offset_ns)
        self._began_s = time.monotonic()
        self._files += 1
        self._is_full = False
        self._say()

    def _put(self, items: Iterable[Item]) -> None:
        for item in items:
            if self._file is None:
                return
            if item.kind is Kind.END:
                self.end()
            elif item.kind is Kind.NEXT_FILE:
                self._file.close()
                self._open(*new_file(Path(self._path).parent))
            else:
                self._file.put(item)
                self._written += item.kind is Kind.STEP

    def _flush(self) -> None:
        """Let a sudden death lose nothing up to here.

        Raises:
            OSError: the disk is full, or nearly.
        """
        beginning, file = self._beginning, self._file
        assert file is not None  # noqa: S101 - as look found it
        assert beginning is not None  # noqa: S101
        file.flush()
        rotation = beginning.rotation
        if shutil.disk_usage(Path(self._path).parent).free < rotation.reserve_bytes:
            raise OSError(f"less than {rotation.reserve_bytes // MIB} MiB are free on the disk")
        aged_s = time.monotonic() - self._began_s
        self._is_full = file.size() >= rotation.size_bytes or aged_s >= rotation.age_s

    def _close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _abandon(self, failure: str) -> None:
        """Leave the file as it is; what is in it can be recovered."""
        self._file = None
        if self._stream is not None:
            with contextlib.suppress(OSError):
                self._stream.close()
        self._say(failure=failure, ended=True)

    def _say(self, *, failure: str = "", ended: bool = False) -> None:
        told = {
            "number": 0 if self._beginning is None else self._beginning.number,
            "file": self._path,
            "files": self._files,
            "written": self._written,
            "full": self._is_full,
            "failure": failure,
            "ended": ended,
        }
        if told != self._told:
            self._told = told
            self._tell(told)


def main(descriptor: int) -> int:
    """Serve a socket until it ends; the exit code.

    Args:
        descriptor: of a stream socket whose other end is the daemon's.
    """
    # The daemon ends this process by closing the socket, whoever else is told to end.
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    _leave_the_daemons_cores()
    with socket.socket(fileno=descriptor) as link:
        writer = Writer(lambda told: _send(link, told))
        unpacker = msgpack.Unpacker(max_buffer_size=LONGEST)
        is_open = True
        while is_open:
            if _waits(link, writer.patience_s):
                data = _receive(link)
                is_open = bool(data)
                unpacker.feed(data)
                for message in unpacker:
                    _handle(writer, message)
            writer.look(time.monotonic())
        writer.end()
    return 0


def _leave_the_daemons_cores() -> None:
    """Run elsewhere, if the daemon has cores of its own and there are others."""
    inherited = os.sched_getaffinity(0)
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
        others = os.sched_getaffinity(0) - inherited
        if others:
            os.sched_setaffinity(0, others)


def _handle(writer: Writer, message: Any) -> None:
    match message:
        case ["items", items]:
            writer.take(Item(Kind(kind), stamp, payload) for kind, stamp, payload in items)
        case ["begin", [number, path, texts, chunk_bytes, flush_s, rotation]]:
            rotating = Rotation(*rotation)
            writer.begin(Beginning(number, path, texts, chunk_bytes, flush_s, rotating))


def _waits(link: socket.socket, patience_s: float | None) -> bool:
    """Wait for something to come; False if nothing does, None waits for ever."""
    return bool(select.select([link], [], [], patience_s)[0])


def _receive(link: socket.socket) -> bytes:
    """Return what has come, after a pause in which more may; empty at the end."""
    time.sleep(PAUSE_S)
    data = _piece(link)
    while data and len(data) < PIECE and _waits(link, 0.0):
        more = _piece(link)
        if not more:
            break  # the end is met again at the next look
        data += more
    return data


def _piece(link: socket.socket) -> bytes:
    try:
        return link.recv(PIECE)
    except ConnectionResetError:  # the end of a daemon that was killed before it heard us out
        return b""


def _send(link: socket.socket, told: Told) -> None:
    """Tell the daemon; one that is gone or does not listen misses it."""
    with contextlib.suppress(OSError):
        link.send(msgpack.packb(told), socket.MSG_DONTWAIT)


def new_file(directory: Path) -> tuple[Path, BinaryIO]:
    """Open a file named after the present moment.

    Raises:
        OSError: it cannot be written.
    """
    while True:
        path = directory / f"linemate-{_wall_name(time.time_ns())}.mcap"
        with contextlib.suppress(FileExistsError):
            return path, path.open("xb")
        time.sleep(0.001)  # names count milliseconds


def make_room(directory: Path, total_bytes: int | None) -> None:
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


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
