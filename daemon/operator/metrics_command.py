"""``linemate metrics``: a page for Prometheus, by a process of its own.

Invariants:
    * A daemon is asked for its status at most once a second, however often the page is asked for.
    * Clients are served at the same time. Each has a bounded time, and their number is bounded.
    * Requests to a name that is not the server's are refused (DNS rebinding).
"""

import argparse
import asyncio
import contextlib
import ipaddress
import sys
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from linemate.daemon.operator import metrics_page
from linemate.daemon.transport.client import Client, NoAnswerError, RefusedError
from linemate.protocol.command.frame_codec import CommandError

if TYPE_CHECKING:
    from linemate.daemon.transport.http_server import Server

PORT: Final = 9465
TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
FRESH_S: Final = 1.0
"""No daemon is asked more often than this [s]."""

REQUEST_S: Final = 2.0
"""Time for a request to come in whole [s]."""

ANSWER_S: Final = 0.5
UNUSABLE: Final = 1

Status = Mapping[str, Any]


@dataclass(slots=True)
class Stations:
    """Daemons by name, and what they said last.

    Attributes:
        now: monotonic time [s].
    """

    sockets: Mapping[str, Path]
    ask: Callable[[Path], Status | None]
    now: Callable[[], float] = time.monotonic
    _told: dict[str, Status | None] = field(default_factory=dict)
    _at: float | None = None

    def statuses(self) -> Mapping[str, Status | None]:
        """What each says, at most a second old."""
        if self._at is None or self.now() - self._at >= FRESH_S:
            self._told = {name: self.ask(path) for name, path in self.sockets.items()}
            self._at = self.now()
        return self._told


def asked(path: Path) -> Status | None:
    """Ask one daemon; None if it does not answer."""
    try:
        with Client.local(path) as client:
            return client.call("status", None, ANSWER_S)
    except (NoAnswerError, RefusedError, CommandError, OSError):
        return None


def server_of(address: tuple[str, int], stations: Stations, names: Iterable[str] = ()) -> "Server":
    """Return a server of the page; its caller opens it.

    Args:
        address: numeric; port 0 takes any.
        stations: whose metrics it serves.
        names: by which it may be asked, beside its address and localhost.
    """
    from linemate.daemon.transport.http_server import NoPageError, Page, Server

    asking = asyncio.Lock()

    async def page() -> Page:
        # One client asks the stations, the others wait for its answer; the loop waits for nobody.
        async with asking:
            statuses = await asyncio.to_thread(stations.statuses)
        return Page(TYPE, metrics_page.text(statuses).encode())

    def ask(path: str, _query: Mapping[str, str]) -> Awaitable[Page]:
        if path != "/metrics":
            raise NoPageError("metrics are at /metrics")
        return page()

    known = frozenset(name.lower() for name in names)
    return Server(ask, *address, head_s=REQUEST_S, names=known)


async def serve(server: "Server", ready: Callable[["Server"], None]) -> None:
    """Serve until the process is told to end.

    Args:
        ready: called when it listens.

    Raises:
        OSError: the port cannot be had.
    """
    await server.open()
    try:
        ready(server)
        await asyncio.Event().wait()
    finally:
        await server.close()


def add_parser(commands: Any) -> None:
    """Add the command to the tool's."""
    parser = commands.add_parser("metrics", help="serve the status of daemons to Prometheus")
    parser.add_argument(
        "--listen", type=_address, default=("127.0.0.1", PORT), metavar="ADDRESS[:PORT]",
        help=f"numeric; 127.0.0.1:{PORT}",
    )  # fmt: skip
    parser.add_argument(
        "--allow-remote", action="store_true", help="consent to an address that others can reach"
    )
    parser.add_argument(
        "--station", action="append", type=_station, default=[], metavar="NAME=SOCKET",
        help="a daemon's local socket and the name it goes by; the system's daemon",
    )  # fmt: skip
    parser.add_argument(
        "--host", action="append", default=[], metavar="NAME",
        help="answer requests to this host name too; else to localhost and addresses alone",
    )  # fmt: skip
    parser.add_argument("--once", action="store_true", help="print the page and end")
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Serve until told to end, or print once.

    Returns:
        0; with --once 3 if no daemon answered; 1 if the port cannot be had.
    """
    from linemate.daemon.transport.client import default_socket_path

    stations = Stations(dict(args.station) or {"linemate": default_socket_path()}, asked)
    if args.once:
        told = stations.statuses()
        print(metrics_page.text(told), end="")
        return 0 if any(status is not None for status in told.values()) else 3
    host, port = args.listen
    if not ipaddress.ip_address(host).is_loopback and not args.allow_remote:
        print(f"linemate: {host} can be reached by others; say --allow-remote", file=sys.stderr)
        return UNUSABLE
    server = server_of((host, port), stations, args.host)
    try:
        asyncio.run(serve(server, lambda opened: print(f"{opened.address}metrics", flush=True)))
    except OSError as error:
        print(f"linemate: {host}:{port}: {error.strerror}", file=sys.stderr)
        return UNUSABLE
    except KeyboardInterrupt:
        pass
    return 0


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.partition(":")
    with contextlib.suppress(ValueError):
        number = int(port or PORT)
        if 0 <= number < 65536:
            return str(ipaddress.IPv4Address(host)), number
    raise argparse.ArgumentTypeError(f"{text!r} is not ADDRESS or ADDRESS:PORT")


def _station(text: str) -> tuple[str, Path]:
    name, equals, path = text.partition("=")
    if not (name and equals and path):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=SOCKET")
    return name, Path(path)
