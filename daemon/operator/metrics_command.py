"""``linemate metrics``: serve the status of daemons to Prometheus, from a process of its own.

Invariants:
    * A daemon is asked for its status at most once a second, however often the page is asked for.
    * Clients are served at the same time. Each has a bounded time, and their number is bounded.
    * Requests to a name that is not the server's are refused (DNS rebinding).
"""

import argparse
import asyncio
import contextlib
import ipaddress
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from linemate.daemon.command_line import NO_ANSWER, OK, UsageError
from linemate.daemon.operator import console, metrics_page
from linemate.daemon.transport.client import (
    Client,
    NoAnswerError,
    RefusedError,
    default_socket_path,
)
from linemate.daemon.transport.http_server import NoPageError, Page, Server
from linemate.protocol.command.frame_codec import CommandError

PORT: Final = 9465
TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
FRESH_S: Final = 1.0  # shortest time between two requests to one daemon
REQUEST_S: Final = 2.0  # time for a whole request to arrive
ANSWER_S: Final = 0.5

Status = Mapping[str, Any]


@dataclass(slots=True)
class Stations:
    """Daemons by name, with their newest statuses.

    Attributes:
        sockets: Local socket of each daemon by its name.
        ask: Asks the daemon at a socket; None if it does not answer.
    """

    sockets: Mapping[str, Path]
    ask: Callable[[Path], Status | None]
    now: Callable[[], float] = time.monotonic
    _newest: dict[str, Status | None] = field(default_factory=dict)
    _asked_at: float | None = None

    def statuses(self) -> Mapping[str, Status | None]:
        """Return each daemon's status, at most FRESH_S old."""
        if self._asked_at is None or self.now() - self._asked_at >= FRESH_S:
            self._newest = {name: self.ask(path) for name, path in self.sockets.items()}
            self._asked_at = self.now()
        return self._newest


def ask_status(path: Path) -> Status | None:
    """Ask one daemon; None if it does not answer."""
    try:
        with Client.local(path) as client:
            return client.call("status", None, ANSWER_S)
    except (NoAnswerError, RefusedError, CommandError, OSError):
        return None


def make_server(address: tuple[str, int], stations: Stations, names: Iterable[str] = ()) -> Server:
    """Return a server of the page; its caller opens it.

    Args:
        address: Numeric address and port; port 0 takes any free one.
        stations: Those whose metrics it serves.
        names: Further host names of the server.
    """
    asking = asyncio.Lock()

    async def page() -> Page:
        # One client asks the stations, the others wait for its answer; the loop never waits.
        async with asking:
            statuses = await asyncio.to_thread(stations.statuses)
        return Page(TYPE, metrics_page.text(statuses).encode())

    def ask(path: str, _query: Mapping[str, str]) -> Awaitable[Page]:
        if path != "/metrics":
            raise NoPageError("metrics are at /metrics")
        return page()

    known = frozenset(name.lower() for name in names)
    return Server(ask, *address, head_s=REQUEST_S, names=known)


async def serve(server: Server) -> None:
    """Serve until the process is ended.

    Raises:
        OSError: The port cannot be had.
    """
    await server.open()
    try:
        print(f"{server.address}metrics", flush=True)
        await asyncio.Event().wait()
    finally:
        await server.close()


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser = commands.add_parser("metrics", help="serve the status of daemons to Prometheus")
    parser.add_argument(
        "--listen", type=_address, default=("127.0.0.1", PORT), metavar="ADDRESS[:PORT]",
        help=f"numeric; 127.0.0.1:{PORT}",
    )  # fmt: skip
    console.add_stations(parser)
    parser.add_argument(
        "--host", action="append", default=[], metavar="NAME",
        help="answer requests to this host name too; else to localhost and addresses alone",
    )  # fmt: skip
    parser.add_argument("--once", action="store_true", help="print the page and end")
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Serve until a signal ends it, or print the page once."""
    stations = Stations(dict(args.station) or {"linemate": default_socket_path()}, ask_status)
    if args.once:
        statuses = stations.statuses()
        print(metrics_page.text(statuses), end="")
        return OK if any(status is not None for status in statuses.values()) else NO_ANSWER
    host, port = args.listen
    if not ipaddress.ip_address(host).is_loopback and not args.allow_remote:
        raise UsageError(f"{host} can be reached by others; add --allow-remote")
    try:
        asyncio.run(serve(make_server((host, port), stations, args.host)))
    except OSError as error:
        raise UsageError(f"{host}:{port}: {error.strerror}") from error
    except KeyboardInterrupt:
        pass
    return OK


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.partition(":")
    with contextlib.suppress(ValueError):
        number = int(port or PORT)
        if 0 <= number < 65536:
            return str(ipaddress.IPv4Address(host)), number
    raise argparse.ArgumentTypeError(f"{text!r} is not ADDRESS or ADDRESS:PORT")
