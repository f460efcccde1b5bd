"""``linemate bridge``: status, events and telemetry of many stations over zenoh, and their answers.

Law of this file: a process of its own that asks daemons as any operator's tool does and can order
nothing. A station that does not answer costs itself alone; queries wait in a bounded queue. Nothing
is looked for: no multicast and no gossip, it meets whom its command line names.
"""

import argparse
import contextlib
import queue
import signal
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from linemate.daemon.operator import bridge_messages as messages
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
WAITING: Final = 32
"""Queries that may wait for a station."""

JSON: Final = "application/json"
OK, UNUSABLE = 0, 1
Query = Any
Token = Any
"""zenoh's, whose own types leave these open."""

_FAILURES: Final = (NoAnswerError, RefusedError, CommandError, OSError)


class Station:
    """One daemon and what is told of it.

    Args:
        name: part of its keys.
        session: where it is told.
        rate_hz: of the telemetry, 0 for none.

    Attributes:
        refused: queries that found no room.
    """

    def __init__(self, name: str, socket: Path, session: "zenoh.Session", rate_hz: float) -> None:
        self.refused = 0
        self._name = name
        self._socket = socket
        self._session = session
        self._rate_hz = rate_hz
        self._end = threading.Event()
        self._queries: queue.Queue[tuple[str, Query]] = queue.Queue(WAITING)
        self._known: Mapping[str, Any] | None = None
        self._token: Token | None = None
        self._askable = [
            session.declare_queryable(messages.key(name, op), self._taker(op))
            for op in messages.ASKABLE
        ]
        work = [self._tell_status] + ([self._tell_telemetry] if rate_hz > 0.0 else [])
        self._threads = [threading.Thread(target=one, daemon=True) for one in work]

    def start(self) -> None:
        """Begin to tell."""
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """End, in a second or two."""
        self._end.set()
        for thread in self._threads:
            thread.join(ASK_S + RETRY_S)

    def _taker(self, op: str) -> Any:
        def take(query: Query) -> None:
            try:
                self._queries.put_nowait((op, query))
            except queue.Full:
                self.refused += 1
                query.reply_err(b"busy")
                query.drop()

        return take

    def _put(self, data: Mapping[str, Any], *parts: str) -> None:
        payload = messages.message(self._name, time.time(), data)
        self._session.put(messages.key(self._name, *parts), payload, encoding=JSON)

    def _tell_status(self) -> None:
        client = Client.local(self._socket)
        due = time.monotonic()
        while not self._end.is_set():
            if time.monotonic() >= due:
                due = time.monotonic() + STATUS_S
                self._look(client)
            with contextlib.suppress(queue.Empty):
                op, query = self._queries.get(timeout=max(0.01, due - time.monotonic()))
                self._answer(client, op, query)
        client.close()

    def _look(self, client: Client) -> None:
        try:
            status: Mapping[str, Any] | None = client.call("status", None, ASK_S)
        except _FAILURES:
            status = None
        for change in messages.changes(self._known, status):
            self._put(change, "events")
        self._known = status
        if status is not None:
            self._put(status, "status")
            if self._token is None:
                self._token = self._session.liveliness().declare_token(messages.key(self._name))
        elif self._token is not None:
            self._token.undeclare()
            self._token = None

    def _answer(self, client: Client, op: str, query: Query) -> None:
        try:
            parameters = {name: query.parameters.get(name) or "" for name in messages.PARAMETERS}
            told = client.call(op, messages.asked(op, parameters), ASK_S)
        except (*_FAILURES, ValueError) as error:
            query.reply_err(str(error).encode())
        else:
            payload = messages.message(self._name, time.time(), told)
            query.reply(messages.key(self._name, op), payload, encoding=JSON)
        # Whoever asked is told that this was all when the query goes.
        query.drop()

    def _tell_telemetry(self) -> None:
        while not self._end.is_set():
            try:
                with Client.local(self._socket) as client:
                    for told in client.telemetry(self._rate_hz):
                        self._put(told, "telemetry")
                        if self._end.is_set():
                            break
            except _FAILURES:
                self._end.wait(RETRY_S)


def opened(listen: Sequence[str], connect: Sequence[str]) -> "zenoh.Session":
    """Open a session that meets whom it is told to and nobody else.

    Args:
        listen: endpoints such as ``tcp/127.0.0.1:7447``.
        connect: the same, of others.

    Raises:
        zenoh.ZError: an endpoint cannot be had.
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


def add_parser(commands: Any) -> None:
    """Add the command to the tool's."""
    about = "carry status, events and telemetry of stations over zenoh (extra 'fleet')"
    parser = commands.add_parser("bridge", help=about, description=about)
    parser.add_argument(
        "--station", action="append", type=_station, default=[], metavar="NAME=SOCKET",
        help="a daemon's local socket and the name it goes by; the system's daemon",
    )  # fmt: skip
    parser.add_argument(
        "--listen", action="append", default=[], metavar="ENDPOINT", help=f"{ENDPOINT}"
    )
    parser.add_argument(
        "--connect", action="append", default=[], metavar="ENDPOINT",
        help="a router or another bridge",
    )  # fmt: skip
    parser.add_argument(
        "--allow-remote", action="store_true", help="consent to endpoints that others can reach"
    )
    parser.add_argument(
        "--rate", type=_rate, default=10.0, metavar="HZ", help="of the telemetry, 0 to 50; 10"
    )
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Carry until told to end.

    Returns:
        0; 1 if an endpoint or zenoh cannot be had.
    """
    listen = args.listen or ([] if args.connect else [ENDPOINT])
    remote = [one for one in listen if not _is_loopback(one)]
    if remote and not args.allow_remote:
        return _failed(f"{', '.join(remote)} can be reached by others; say --allow-remote")
    try:
        import zenoh
    except ImportError:
        return _failed("zenoh is not installed; pip install linemate[fleet]")
    try:
        session = opened(listen, args.connect)
    except zenoh.ZError as error:
        return _failed(" ".join(str(error).split()))
    named = dict(args.station) or {"linemate": default_socket_path()}
    end = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: end.set())
    with session:
        stations = [Station(name, path, session, args.rate) for name, path in named.items()]
        for station in stations:
            station.start()
        print(f"{len(stations)} stations, {', '.join([*listen, *args.connect])}", flush=True)
        end.wait()
        for station in stations:
            station.end()
    return OK


def _failed(why: str) -> int:
    print(f"linemate: {why}", file=sys.stderr)
    return UNUSABLE


def _is_loopback(endpoint: str) -> bool:
    address = endpoint.partition("/")[2]
    return address.startswith(("127.", "localhost:", "[::1]:"))


def _station(text: str) -> tuple[str, Path]:
    name, equals, path = text.partition("=")
    if not (equals and path) or not name or set(name) & set("/*$?# "):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=SOCKET")
    return name, Path(path)


def _rate(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0.0 <= float(text) <= 50.0:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not 0 to 50 Hz")
