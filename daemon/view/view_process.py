"""The view's process: serve a page until a signal ends it."""

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
from typing import Final

from linemate.daemon.transport.client import Client
from linemate.daemon.transport.http_server import Server
from linemate.daemon.view.broadcast_hub import BroadcastHub
from linemate.daemon.view.live_feed import LiveFeed
from linemate.daemon.view.page_routes import LiveRoutes, RecordingRoutes

MAX_NICE: Final = 19


@dataclass(frozen=True, slots=True)
class Where:
    """Where the page is.

    Attributes:
        host: Numeric address to listen on.
        port: 0 takes any free one.
        is_opened: Whether a browser is opened on it.
    """

    host: str = "127.0.0.1"
    port: int = 0
    is_opened: bool = False


async def watch(connect: Callable[[], Client], source: str, where: Where) -> None:
    """Show a daemon until a signal ends it.

    Args:
        connect: Makes a client of the daemon, for each attempt.
        source: Name of the daemon on the page.

    Raises:
        OSError: The port is taken.
    """
    connect().close()  # reports an unreadable key at once
    hub = BroadcastHub()
    feed = LiveFeed(connect, hub, asyncio.get_running_loop().call_soon_threadsafe)
    feed.start()
    try:
        await serve(LiveRoutes(hub, source), where)
    finally:
        await asyncio.to_thread(feed.end)


async def play(paths: Sequence[Path], where: Where) -> None:
    """Show recordings until a signal ends it.

    Raises:
        OSError: The port is taken.
        UnreadableRecordingError: A file is not a recording.
    """
    routes = RecordingRoutes(paths)

    async def work() -> None:
        await routes.read()
        await routes.compute_horizons()

    await serve(routes, where, work)


async def serve(
    routes: LiveRoutes | RecordingRoutes,
    where: Where,
    work: Callable[[], Awaitable[None]] | None = None,
) -> None:
    """Listen, print the address, and wait for a signal.

    Args:
        work: Runs at the same time; an error of it ends the server.

    Raises:
        OSError: The port is taken.
        UnreadableRecordingError: Raised by the work.
    """
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    server = Server(routes.ask, where.host, where.port)
    await server.open()
    working = None if work is None else asyncio.ensure_future(work())
    if working is not None:
        working.add_done_callback(lambda task: _end_if_failed(task, ended))
    try:
        print(server.address, flush=True)
        if not ipaddress.ip_address(where.host).is_loopback:
            print("linemate view: all who reach this address can watch", file=sys.stderr)
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
    """Open a browser with the least priority."""
    with contextlib.suppress(OSError):
        os.nice(MAX_NICE)  # of this thread; a browser that it starts inherits it
    webbrowser.open(address)


def _end_if_failed(task: "asyncio.Future[None]", ended: asyncio.Event) -> None:
    if not task.cancelled() and task.exception() is not None:
        ended.set()
