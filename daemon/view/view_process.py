"""The view's process: a page served until somebody ends it, with what it shows beside it.

Law of this file: it wires; the event loop is its own and the daemon's is another process's.
"""

import asyncio
import contextlib
import ipaddress
import os
import signal
import sys
import webbrowser
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from linemate.daemon.transport.client import Client
from linemate.daemon.transport.http_server import Server
from linemate.daemon.view.broadcast_hub import Board
from linemate.daemon.view.live_feed import Live
from linemate.daemon.view.page_routes import LiveSite, TapeSite

LEAST_URGENT = 19
"""The greatest niceness."""


@dataclass(frozen=True, slots=True)
class Where:
    """Where the page is.

    Attributes:
        is_opened: in a browser, at once.
    """

    host: str = "127.0.0.1"
    port: int = 0
    is_opened: bool = False


async def watch(make: Callable[[], Client], source: str, where: Where) -> None:
    """Show a daemon until told to end.

    Args:
        make: a client that has not been used.
        source: what the daemon is called.

    Raises:
        OSError: the port is taken.
    """
    make().close()  # a key that cannot be read is said at once
    board = Board()
    live = Live(make, board, asyncio.get_running_loop().call_soon_threadsafe)
    live.start()
    try:
        await serve(LiveSite(board, source), where)
    finally:
        await asyncio.to_thread(live.end)


async def play(paths: Sequence[Path], where: Where) -> None:
    """Show recordings until told to end.

    Raises:
        OSError: the port is taken.
        UnreadableRecordingError: a file is no recording.
    """
    site = TapeSite(paths)

    async def work() -> None:
        await site.read()
        await site.foresee()

    await serve(site, where, work)


async def serve(
    site: LiveSite | TapeSite, where: Where, work: Callable[[], Awaitable[None]] | None = None
) -> None:
    """Listen, tell the address on standard output, and wait for a signal.

    Args:
        site: what is at which path.
        work: beside it; what it raises ends the serving.

    Raises:
        OSError: the port is taken.
        UnreadableRecordingError: of the work.
    """
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    server = Server(site.ask, where.host, where.port)
    await server.open()
    working = None if work is None else asyncio.ensure_future(work())
    if working is not None:
        working.add_done_callback(lambda done: _end_if_failed(done, ended))
    try:
        print(server.address, flush=True)
        if not ipaddress.ip_address(where.host).is_loopback:
            print("linemate view: whoever reaches this address can look on", file=sys.stderr)
        if where.is_opened:
            await asyncio.to_thread(_open, server.address)
        await ended.wait()
    finally:
        await server.close()
        if working is not None and not working.done():
            working.cancel()
            await asyncio.gather(working, return_exceptions=True)
    if working is not None and not working.cancelled():
        working.result()


def _open(address: str) -> None:
    """Open a browser; one that starts here runs after everything else of the machine."""
    with contextlib.suppress(OSError):
        os.nice(LEAST_URGENT)  # of this thread, which its children inherit
    webbrowser.open(address)


def _end_if_failed(done: "asyncio.Future[None]", ended: asyncio.Event) -> None:
    if not done.cancelled() and done.exception() is not None:
        ended.set()
