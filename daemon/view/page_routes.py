"""What is at which path: the page's files, and beside them a daemon live or recordings to play.

Law of this file: bytes by path; no socket. The page's files are this package's own and are read
once; nothing of the file system can be reached by a path.
"""

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from linemate.daemon.transport.http_server import Answer, NoPageError, Page
from linemate.daemon.view import recorded_run
from linemate.daemon.view.broadcast_hub import ONLOOKERS, Board, FullError, event
from linemate.daemon.view.recorded_run import Tape

JSON: Final = "application/json"
KINDS: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
INDEX: Final = "index.html"
FULL: Final = b'{"up":false,"reason":"%d others look on already"}' % ONLOOKERS
LONGEST_LINE: Final = 65_536


def assets() -> dict[str, Page]:
    """Return the page's files by their paths."""
    found = {}
    for file in files("linemate.daemon.view").joinpath("data").iterdir():
        kind = KINDS.get(Path(file.name).suffix)
        if kind is not None:
            found[f"/{file.name}"] = Page(kind, file.read_bytes())
    found["/"] = found[f"/{INDEX}"]
    return found


@dataclass(slots=True)
class LiveSite:
    """A daemon as it goes.

    Attributes:
        board: what is known of it.
        source: what it is called, for the page's head.
    """

    board: Board
    source: str
    _assets: Mapping[str, Page] = field(default_factory=assets)

    def ask(self, path: str, query: Mapping[str, str]) -> Answer:
        """Return what is at a path.

        Raises:
            NoPageError: nothing.
        """
        del query
        if path == "/mode":
            told = {"frames": self.board.frames, "dropped": self.board.dropped}
            return _json({"mode": "live", "source": self.source, **told})
        if path == "/stream":
            return self._stream()
        return _asset(self._assets, path)

    async def _stream(self) -> AsyncIterator[bytes]:
        try:
            with self.board.looking() as onlooker:
                while True:
                    yield await onlooker.take()
        except FullError:
            yield b"retry: 5000\n" + event("link", FULL)


@dataclass(slots=True)
class TapeSite:
    """Recordings to play.

    Attributes:
        tapes: in the same order, as far as they have been read.
        share: of all of them that has been read, 0 to 1.
    """

    paths: Sequence[Path]
    tapes: list[Tape] = field(default_factory=list)
    share: float = 0.0
    _assets: Mapping[str, Page] = field(default_factory=assets)
    _told: dict[int, Page] = field(default_factory=dict)
    _done: set[int] = field(default_factory=set)

    def ask(self, path: str, query: Mapping[str, str]) -> Answer:
        """Return what is at a path.

        Raises:
            NoPageError: nothing.
        """
        if path == "/mode" and len(self.tapes) < len(self.paths):
            return _json({"mode": "reading", "share": round(self.share, 3)})
        if path == "/mode":
            return _json({"mode": "recording", "source": self.tapes[0].name, "tapes": self._list()})
        if path not in {"/tape", "/frames", "/progress"}:
            return _asset(self._assets, path)
        number = _number(query, "i", 0)
        if not 0 <= number < len(self.tapes):
            raise NoPageError(f"no recording {number}")
        shown = self.tapes[number]
        if path == "/tape":
            if number not in self._told:
                self._told[number] = _json(shown.told())
            return self._told[number]
        if path == "/progress":
            foreseen = max(shown.foreseen, default=-1)
            done = number in self._done
            return _json({"k": foreseen, "done": done, "inexact": shown.inexact,
                          "count": len(shown.foreseen)})  # fmt: skip
        return _json(shown.between(_number(query, "from", 0), _number(query, "to", 0)))

    async def read(self) -> None:
        """Read the recordings, in a thread: a long one takes a minute.

        Raises:
            UnreadableRecordingError: a file is none.
        """
        for path in self.paths:
            self.tapes.append(await asyncio.to_thread(recorded_run.read, path, self._tell))

    def _tell(self, share: float) -> None:
        self.share = (len(self.tapes) + share) / len(self.paths)

    async def foresee(self) -> None:
        """Have the horizons made again, recording by recording, by a process beside this one."""
        for number, (shown, path) in enumerate(zip(self.tapes, self.paths, strict=True)):
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "linemate.daemon.view.horizon_replay", str(path.resolve())),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.DEVNULL,
                limit=LONGEST_LINE,
            )
            try:
                if process.stdout is not None:
                    async for line in process.stdout:
                        k, exact, ahead_ms, points = json.loads(line)
                        shown.foresee(k, ahead_ms, points, exact=exact)
                await process.wait()
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.wait()
            self._done.add(number)

    def _list(self) -> list[dict[str, Any]]:
        return [recorded_run.total(shown) for shown in self.tapes]


def _asset(found: Mapping[str, Page], path: str) -> Page:
    if path not in found:
        raise NoPageError(f"nothing at {path[:80]}")
    return found[path]


def _number(query: Mapping[str, str], name: str, default: int) -> int:
    text = query.get(name, str(default))
    if not text.isascii() or not text.isdigit() or len(text) > 9:
        raise NoPageError(f"{name} is no number")
    return int(text)


def _json(told: Any) -> Page:
    return Page(JSON, json.dumps(told, separators=(",", ":")).encode())
