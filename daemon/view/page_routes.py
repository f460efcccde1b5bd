"""What is at each path of the page's server: its files, and a live daemon or recordings.

Invariants:
    * Bytes by path; no socket.
    * The page's files are read once. No path reaches another file.
"""

import asyncio
import contextlib
import json
import sys
import threading
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, TypeVar

from linemate.daemon.transport.http_server import Answer, NoPageError, Page
from linemate.daemon.view import recorded_run
from linemate.daemon.view.broadcast_hub import (
    MAX_SUBSCRIBERS,
    BroadcastHub,
    FullError,
    encode_event,
)
from linemate.daemon.view.recorded_run import RecordedRun

JSON: Final = "application/json"
KINDS: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
INDEX: Final = "index.html"
FULL: Final = b'{"up":false,"reason":"%d pages are open already"}' % MAX_SUBSCRIBERS
MAX_LINE: Final = 65_536

Result = TypeVar("Result")


def read_assets() -> dict[str, Page]:
    """Return the page's files by their paths."""
    assets = {}
    for file in files("linemate.daemon.view").joinpath("data").iterdir():
        kind = KINDS.get(Path(file.name).suffix)
        if kind is not None:
            assets[f"/{file.name}"] = Page(kind, file.read_bytes())
    assets["/"] = assets[f"/{INDEX}"]
    return assets


@dataclass(slots=True)
class LiveRoutes:
    """Paths of a page that shows a daemon.

    Attributes:
        hub: Where its newest is.
        source: Name of the daemon in the page's head.
    """

    hub: BroadcastHub
    source: str
    _assets: Mapping[str, Page] = field(default_factory=read_assets)

    def ask(self, path: str, query: Mapping[str, str]) -> Answer:
        """Return what is at a path.

        Raises:
            NoPageError: There is nothing.
        """
        del query
        if path == "/mode":
            counts = {"frames": self.hub.frames, "dropped": self.hub.dropped}
            return _json({"mode": "live", "source": self.source, **counts})
        if path == "/stream":
            return self._stream()
        return _asset(self._assets, path)

    async def _stream(self) -> AsyncIterator[bytes]:
        try:
            with self.hub.subscribe() as subscriber:
                while True:
                    yield await subscriber.drain()
        except FullError:
            yield b"retry: 5000\n" + encode_event("link", FULL)


@dataclass(slots=True)
class RecordingRoutes:
    """Paths of a page that plays recordings.

    Attributes:
        runs: As many of them as have been read, in the same order.
        share: Share of all files that has been read, 0 to 1.
    """

    paths: Sequence[Path]
    runs: list[RecordedRun] = field(default_factory=list)
    share: float = 0.0
    _assets: Mapping[str, Page] = field(default_factory=read_assets)
    _pages: dict[int, Page] = field(default_factory=dict)
    _done: set[int] = field(default_factory=set)

    def ask(self, path: str, query: Mapping[str, str]) -> Answer:
        """Return what is at a path.

        Raises:
            NoPageError: There is nothing.
        """
        if path == "/mode" and len(self.runs) < len(self.paths):
            return _json({"mode": "reading", "share": round(self.share, 3)})
        if path == "/mode":
            runs = [recorded_run.total(run) for run in self.runs]
            return _json({"mode": "recording", "source": self.runs[0].name, "runs": runs})
        if path not in {"/run", "/frames", "/progress"}:
            return _asset(self._assets, path)
        number = _number(query, "i", 0)
        if not 0 <= number < len(self.runs):
            raise NoPageError(f"no recording {number}")
        run = self.runs[number]
        if path == "/run":
            if number not in self._pages:
                self._pages[number] = _json(run.as_page())
            return self._pages[number]
        if path == "/progress":
            newest = max(run.horizons, default=-1)
            return _json({"k": newest, "done": number in self._done, "inexact": run.inexact,
                          "count": len(run.horizons)})  # fmt: skip
        return _json(run.between(_number(query, "from", 0), _number(query, "to", 0)))

    async def read(self) -> None:
        """Read the recordings in a thread: a long one takes a minute.

        Raises:
            UnreadableRecordingError: A file is not a recording.
        """
        for path in self.paths:
            self.runs.append(await _in_thread(lambda path=path: self._read(path)))  # type: ignore[misc]

    def _read(self, path: Path) -> RecordedRun:
        return recorded_run.read_run(path, self._on_progress)

    def _on_progress(self, share: float) -> None:
        self.share = (len(self.runs) + share) / len(self.paths)

    async def compute_horizons(self) -> None:
        """Compute the predicted horizons again, one recording after the other, in a process."""
        for number, (run, path) in enumerate(zip(self.runs, self.paths, strict=True)):
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "linemate.daemon.view.horizon_replay", str(path.resolve())),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.DEVNULL,
                limit=MAX_LINE,
            )
            try:
                if process.stdout is not None:
                    async for line in process.stdout:
                        k, exact, ahead_ms, points = json.loads(line)
                        run.add_horizon(k, ahead_ms, points, exact=exact)
                await process.wait()
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.wait()
            self._done.add(number)


async def _in_thread(function: Callable[[], Result]) -> Result:
    """Call a function in a thread that does not outlive the process, unlike asyncio's own."""
    loop = asyncio.get_running_loop()
    future: asyncio.Future[Result] = loop.create_future()

    def finish(result: Result | None, error: BaseException | None) -> None:
        if future.cancelled():
            return
        if error is not None:
            future.set_exception(error)
        else:
            future.set_result(result)  # type: ignore[arg-type]

    def work() -> None:
        result, error = None, None
        try:
            result = function()
        except Exception as raised:  # noqa: BLE001 - handed to the one who waits
            error = raised
        # The loop is closed if the page was ended in between.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(finish, result, error)

    threading.Thread(target=work, daemon=True).start()
    return await future


def _asset(assets: Mapping[str, Page], path: str) -> Page:
    if path not in assets:
        raise NoPageError(f"nothing at {path[:80]}")
    return assets[path]


def _number(query: Mapping[str, str], name: str, default: int) -> int:
    text = query.get(name, str(default))
    if not text.isascii() or not text.isdigit() or len(text) > 9:
        raise NoPageError(f"{name} is not a number")
    return int(text)


def _json(value: Any) -> Page:
    return Page(JSON, json.dumps(value, separators=(",", ":")).encode())
