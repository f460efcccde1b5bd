"""``linemate bridge``: status, events and telemetry of many stations over zenoh.

Invariants:
    * A process of its own that asks daemons as any client does and can order nothing.
    * A station that does not answer delays no other one. Queries wait in a bounded queue.
    * No multicast and no gossip: it connects to the endpoints of its command line alone.
"""

import argparse
import contextlib
import queue
import signal
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from linemate.daemon.command_line import OK, UsageError, bounded
from linemate.daemon.operator import bridge_messages as messages
from linemate.daemon.operator import console
from linemate.daemon.transport.client import (
    Client,
    NoAnswerError,
    RefusedError,
    default_socket_path,
)
from linemate.protocol.command.frame_codec import CommandError

if TYPE_CHECKING:
    import zenoh

ENDPOINT: Final = "tcp/127.0.0.1:7447"
STATUS_S: Final = 1.0
RETRY_S: Final = 1.0
ASK_S: Final = 1.0
END_S: Final = 0.8  # in all: threads that still wait for a daemon end with the process
MAX_QUERIES: Final = 32  # that wait for one station

JSON: Final = "application/json"
Query = Any  # zenoh's own types leave these open
Token = Any

_FAILURES: Final = (NoAnswerError, RefusedError, CommandError, OSError)


class Station:
    """One daemon, and the publisher of what it answers.

    Attributes:
        refused: Queries that found the queue full.
    """

    def __init__(self, name: str, socket: Path, session: "zenoh.Session", rate_hz: float) -> None:
        self.refused = 0
        self._name = name
        self._socket = socket
        self._session = session
        self._rate_hz = rate_hz
        self._end = threading.Event()
        self._queries: queue.Queue[tuple[str, Query]] = queue.Queue(MAX_QUERIES)
        self._status: Mapping[str, Any] | None = None
        self._token: Token | None = None
        self._queryables = [
            session.declare_queryable(messages.key(name, op), self._handler(op))
            for op in messages.ASKABLE
        ]
        loops = [self._publish_status] + ([self._publish_telemetry] if rate_hz > 0.0 else [])
        self._threads = [threading.Thread(target=loop, daemon=True) for loop in loops]

    def start(self) -> None:
        """Start the threads."""
        for thread in self._threads:
            thread.start()

    def request_end(self) -> None:
        """Ask the threads to end."""
        self._end.set()

    def join(self, until: float) -> None:
        """Wait for the threads until a monotonic time [s]."""
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))

    def _handler(self, op: str) -> Any:
        def handle(query: Query) -> None:
            try:
                self._queries.put_nowait((op, query))
            except queue.Full:
                self.refused += 1
                query.reply_err(b"busy")
                query.drop()

        return handle

    def _publish(self, data: Mapping[str, Any], *parts: str) -> None:
        payload = messages.message(self._name, time.time(), data)
        self._session.put(messages.key(self._name, *parts), payload, encoding=JSON)

    def _publish_status(self) -> None:
        client = Client.local(self._socket)
        due = time.monotonic()
        while not self._end.is_set():
            if time.monotonic() >= due:
                due = time.monotonic() + STATUS_S
                self._ask_status(client)
            with contextlib.suppress(queue.Empty):
                op, query = self._queries.get(timeout=max(0.01, due - time.monotonic()))
                self._answer(client, op, query)
        client.close()

    def _ask_status(self, client: Client) -> None:
        try:
            status: Mapping[str, Any] | None = client.call("status", None, ASK_S)
        except _FAILURES:
            status = None
        for change in messages.changes(self._status, status):
            self._publish(change, "events")
        self._status = status
        if status is not None:
            self._publish(status, "status")
            if self._token is None:
                self._token = self._session.liveliness().declare_token(messages.key(self._name))
        elif self._token is not None:
            self._token.undeclare()
            self._token = None

    def _answer(self, client: Client, op: str, query: Query) -> None:
        try:
            parameters = {name: query.parameters.get(name) or "" for name in messages.PARAMETERS}
            answer = client.call(op, messages.request(op, parameters), ASK_S)
        except (*_FAILURES, ValueError) as error:
            query.reply_err(str(error).encode())
        else:
            payload = messages.message(self._name, time.time(), answer)
            query.reply(messages.key(self._name, op), payload, encoding=JSON)
        # Dropping a query shows its sender that there are no more replies.
        query.drop()

    def _publish_telemetry(self) -> None:
        while not self._end.is_set():
            try:
                with Client.local(self._socket) as client:
                    for telemetry in client.telemetry(self._rate_hz):
                        self._publish(telemetry, "telemetry")
                        if self._end.is_set():
                            break
            except _FAILURES:
                self._end.wait(RETRY_S)


def open_session(listen: Sequence[str], connect: Sequence[str]) -> "zenoh.Session":
    """Open a session that listens and connects at the given endpoints alone.

    Args:
        listen: Endpoints such as ``tcp/127.0.0.1:7447``.
        connect: Endpoints of routers or of other bridges.

    Raises:
        zenoh.ZError: An endpoint cannot be had.
    """
    import json

    import zenoh

    config = zenoh.Config()
    for name, value in (
        ("mode", "peer"),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("listen/endpoints", list(listen)),
        ("connect/endpoints", list(connect)),
    ):
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the command."""
    about = "carry status, events and telemetry of stations over zenoh (extra 'fleet')"
    parser = commands.add_parser("bridge", help=about, description=about)
    console.add_stations(parser, _station)
    parser.add_argument(
        "--listen", action="append", default=[], metavar="ENDPOINT", help=f"{ENDPOINT}"
    )
    parser.add_argument(
        "--connect", action="append", default=[], metavar="ENDPOINT",
        help="a router or another bridge",
    )  # fmt: skip
    parser.add_argument(
        "--rate",
        type=bounded(float, 0.0, 50.0, "is not 0 to 50 Hz"),
        default=10.0,
        metavar="HZ",
        help="of the telemetry, 0 to 50; 10",
    )
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Carry messages until a signal ends it."""
    listen = args.listen or ([] if args.connect else [ENDPOINT])
    remote = [endpoint for endpoint in listen if not _is_loopback(endpoint)]
    if remote and not args.allow_remote:
        raise UsageError(f"{', '.join(remote)} can be reached by others; add --allow-remote")
    try:
        import zenoh
    except ImportError as error:
        raise UsageError("zenoh is not installed; pip install linemate[fleet]") from error
    try:
        session = open_session(listen, args.connect)
    except zenoh.ZError as error:
        raise UsageError(" ".join(str(error).split())) from error
    sockets = dict(args.station) or {"linemate": default_socket_path()}
    end = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: end.set())
    with session:
        stations = [Station(name, path, session, args.rate) for name, path in sockets.items()]
        for station in stations:
            station.start()
        print(f"{len(stations)} stations, {', '.join([*listen, *args.connect])}", flush=True)
        end.wait()
        for station in stations:
            station.request_end()
        until = time.monotonic() + END_S
        for station in stations:
            station.join(until)
    return OK


def _is_loopback(endpoint: str) -> bool:
    address = endpoint.partition("/")[2]
    return address.startswith(("127.", "localhost:", "[::1]:"))


def _station(text: str) -> tuple[str, Path]:
    name, path = console.station(text)
    if set(name) & set("/*$?# "):
        raise argparse.ArgumentTypeError(f"{name!r} is not one part of a zenoh key")
    return name, path
