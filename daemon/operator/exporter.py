"""``linemate metrics``: a page for Prometheus, by a process of its own.

Law of this file: it asks daemons for their status as any operator's tool does, at most once a
second however often it is asked itself, and answers one request at a time in a bounded time. No
HTTP ever comes near the process that answers the robot. Loopback unless told otherwise.
"""

import argparse
import contextlib
import ipaddress
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any, Final

from linemate.daemon.operator import metrics
from linemate.daemon.operator.client import Client, NoAnswerError, RefusedError
from linemate.protocol.command import CommandError

PORT: Final = 9465
TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
FRESH_S: Final = 1.0
"""No daemon is asked more often than this [s]."""

REQUEST_S: Final = 2.0
"""What a request may take to come [s]."""

ANSWER_S: Final = 0.5
UNUSABLE: Final = 1

Status = Mapping[str, Any]


@dataclass(slots=True)
class Stations:
    """Daemons by name, and what they said last.

    Attributes:
        sockets: their local sockets.
        ask: asks one.
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


def serve(address: tuple[str, int], stations: Stations) -> HTTPServer:
    """Return a server that listens; its caller runs it.

    Args:
        address: numeric; port 0 takes any.
        stations: what it tells of.

    Raises:
        OSError: the port cannot be had.
    """

    class Handler(BaseHTTPRequestHandler):
        timeout = REQUEST_S
        server_version = "linemate"
        sys_version = ""

        def do_GET(self) -> None:
            if self.path.partition("?")[0] != "/metrics":
                self.send_error(404, "metrics are at /metrics")
                return
            page = metrics.text(stations.statuses()).encode()
            self.send_response(200)
            self.send_header("Content-Type", TYPE)
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, *_: object) -> None:
            """Say nothing: whoever asks, asks every few seconds."""

    return _Quiet(address, Handler)


class _Quiet(HTTPServer):
    """One request at a time; a client that goes away or stays silent costs itself alone."""

    request_queue_size = 8

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing."""


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
    parser.add_argument("--once", action="store_true", help="print the page and end")
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Serve until told to end, or print once.

    Returns:
        0; with --once 3 if no daemon answered; 1 if the port cannot be had.
    """
    from linemate.daemon.operator.client import default_socket_path

    stations = Stations(dict(args.station) or {"linemate": default_socket_path()}, asked)
    if args.once:
        told = stations.statuses()
        print(metrics.text(told), end="")
        return 0 if any(status is not None for status in told.values()) else 3
    host, port = args.listen
    if not ipaddress.ip_address(host).is_loopback and not args.allow_remote:
        print(f"linemate: {host} can be reached by others; say --allow-remote", file=sys.stderr)
        return UNUSABLE
    try:
        server = serve((host, port), stations)
    except OSError as error:
        print(f"linemate: {host}:{port}: {error.strerror}", file=sys.stderr)
        return UNUSABLE
    with server:
        print(f"http://{host}:{server.server_address[1]}/metrics", flush=True)
        server.serve_forever()
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
