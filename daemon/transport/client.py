"""Blocking client of the command protocol: the local socket without a key, or UDP with one.

Invariants:
    * It imports nothing heavy: a status costs a few milliseconds.
    * A request is sent again until its answer or its deadline, never after it.
"""

import contextlib
import os
import socket
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from linemate.protocol.command.client_core import Answer, ClientCore, ClientEvent, More, Telemetry
from linemate.protocol.command.frame_codec import LOCAL_LIMIT_BYTES, CommandError
from linemate.protocol.command.local_client import LocalClient

if TYPE_CHECKING:
    from linemate.protocol.command.preshared_keys import PresharedKey

SOCKET_NAME: Final = "linemate/command.sock"
DEFAULT_PORT: Final = 49160
DEFAULT_TIMEOUT_S: Final = 0.5
# Requests that may be repeated when they expired on their way: they change nothing.
REPEATABLE: Final = frozenset({"status", "params", "get", "scene", "sensors", "subscribe"})
MAX_REPEATS: Final = 3
RESEND_S: Final = 0.1
RENEW_S: Final = 20.0  # a server closes sessions that are idle for a minute


class NoAnswerError(Exception):
    """No daemon is there, or none answered in time."""


class RefusedError(Exception):
    """The daemon refused a request.

    Attributes:
        code: Kind of refusal, one word.
    """

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason or code)
        self.code = code
        self.reason = reason


class KeyFileError(Exception):
    """A key file cannot be used; the text says why."""


def default_socket_path() -> Path:
    """Return the default path of the daemon's socket.

    ``LINEMATE_SOCKET``; else the system's daemon if its socket is there; else the user's.
    """
    configured = os.environ.get("LINEMATE_SOCKET")
    if configured:
        return Path(configured)
    system = Path("/run") / SOCKET_NAME
    own = os.environ.get("XDG_RUNTIME_DIR")
    if own and not system.exists():
        return Path(own) / SOCKET_NAME
    return system


def default_key_path() -> Path:
    """Return the default path of an operator's key."""
    base = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(base) / "linemate" / "key"


def read_private(path: Path) -> str:
    """Return the text of a file that no other user can read.

    Raises:
        KeyFileError: it is missing, another user's, or readable by others.
    """
    from linemate.protocol.command.preshared_keys import unsafe_file

    try:
        with path.open(encoding="utf-8") as file:
            state = os.fstat(file.fileno())
            unsafe = unsafe_file(state.st_mode, state.st_uid, os.geteuid())
            if unsafe is not None:
                raise KeyFileError(f"{path}: {unsafe}")
            return file.read(65536)
    except OSError as error:
        raise KeyFileError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise KeyFileError(f"{path}: not a text: {error.reason}") from error


def read_key(path: Path, name: str | None = None) -> "PresharedKey":
    """Read one key from a key file that no other user can read.

    Args:
        name: Which one, if it holds several; else the first.

    Raises:
        KeyFileError: It is missing, another user's, readable by others, or malformed.
    """
    from linemate.protocol.command.preshared_keys import parse_keys

    try:
        keys = parse_keys(read_private(path), str(path))
    except CommandError as error:
        raise KeyFileError(error.detail) from error
    for key in keys:
        if name in {None, key.name}:
            return key
    raise KeyFileError(f"{path}: no key" + (f" named {name}" if name else ""))


class Client:
    """A client of one daemon.

    >>> with Client.local() as client:          # doctest: +SKIP
    ...     client.call("status")["state"]

    Made by ``local`` or ``udp``. The first call opens a session, and the first one after a
    silence opens another. An order without an answer may have been carried out: it is not
    repeated beyond its deadline. A request that only reads is repeated if it expired on its way.
    """

    def __init__(self, address: Path | tuple[str, int], key: "PresharedKey | None") -> None:
        self._address = address
        self._key = key
        self._socket: socket.socket | None = None
        self._core: ClientCore | None = None
        self._last_ns = 0

    @classmethod
    def local(cls, path: Path | str | None = None) -> Self:
        """Return a client of the daemon on this host.

        Args:
            path: its socket; default_socket_path() if None.
        """
        return cls(Path(path) if path is not None else default_socket_path(), None)

    @classmethod
    def udp(cls, host: str, port: int, key: "PresharedKey") -> Self:
        """Return a client of a daemon anywhere, with a pre-shared key."""
        return cls((host, port), key)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def call(
        self, op: str, params: Mapping[str, Any] | None = None, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> dict[str, Any]:
        """Ask for one operation and return its result.

        Args:
            timeout_s: Time for the answer [s]; each further part of a long one has as much.

        Raises:
            NoAnswerError: There is no daemon, or no answer in time.
            RefusedError: The daemon refused it.
            CommandError: There is no such operation, or it has no such parameters.
        """
        answer = self._call_once(op, params or {}, timeout_s)
        for _ in range(MAX_REPEATS if op in REPEATABLE else 0):
            if answer.code != "expired":
                break
            answer = self._call_once(op, params or {}, timeout_s)
        if not answer.ok:
            raise RefusedError(answer.code, answer.reason)
        return answer.result

    def _call_once(self, op: str, params: Mapping[str, Any], timeout_s: float) -> Answer:
        try:
            core, link = self._ready(timeout_s)
            deadline_ns = time.monotonic_ns() + int(timeout_s * 1e9)
            sent = core.request(op, params, deadline_ns)
            answer = self._await_answer(link, sent.sequence, sent.frame, timeout_s)
        except (OSError, NoAnswerError) as error:
            self.close()
            # Without the number of the error, which says nothing to an operator.
            why = getattr(error, "strerror", None) or error
            raise NoAnswerError(f"{self._where()}: {why}") from error
        self._last_ns = time.monotonic_ns()
        return answer

    def telemetry(self, rate_hz: float, for_s: float | None = None) -> Iterator[dict[str, Any]]:
        """Subscribe and yield telemetry as it comes, renewing the subscription.

        Args:
            rate_hz: wanted, at most 50.
            for_s: how long; for ever if None.

        Raises:
            NoAnswerError: nothing has come for a second and one period.
            RefusedError: The daemon refused it.
        """
        end = None if for_s is None else time.monotonic() + for_s
        silence_s = 1.0 + 1.0 / rate_hz
        renew_at = 0.0
        while end is None or time.monotonic() < end:
            if time.monotonic() >= renew_at:
                self.call("subscribe", {"rate_hz": float(rate_hz), "duration_s": 5.0})
                renew_at = time.monotonic() + 2.0
            event = self._receive(time.monotonic() + silence_s)
            if event is None:
                raise NoAnswerError(f"{self._where()}: telemetry has ended")
            if isinstance(event, Telemetry):
                yield event.data
        self.call("subscribe", {"rate_hz": 0.0})

    def close(self) -> None:
        """End the session, if there is one."""
        if self._socket is None:
            return
        farewell = self._core.close() if self._core is not None else None
        if farewell is not None:
            # A session that is not closed ends by itself when idle.
            with contextlib.suppress(OSError):
                self._socket.send(farewell)
        self._socket.close()
        self._socket = None
        self._core = None

    def _where(self) -> str:
        if isinstance(self._address, Path):
            return str(self._address)
        return f"{self._address[0]}:{self._address[1]}"

    def _ready(self, timeout_s: float) -> tuple[ClientCore, socket.socket]:
        if self._key is not None and time.monotonic_ns() - self._last_ns > RENEW_S * 1e9:
            self.close()
        if self._core is not None and self._socket is not None:
            return self._core, self._socket
        link = self._socket = self._connect()
        core = self._core = self._new_core()
        give_up = time.monotonic() + timeout_s
        hello = core.hello(time.monotonic_ns())
        while not core.ready:
            if time.monotonic() >= give_up:
                raise NoAnswerError("no answer")
            link.send(hello)
            self._receive(min(give_up, time.monotonic() + RESEND_S))
        self._last_ns = time.monotonic_ns()
        return core, link

    def _connect(self) -> socket.socket:
        if isinstance(self._address, Path):
            link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            target: str | tuple[str, int] = str(self._address)
        else:
            info = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)[0]
            link = socket.socket(info[0], socket.SOCK_DGRAM)
            target = info[4][:2]  # type: ignore[assignment]
        try:
            link.settimeout(DEFAULT_TIMEOUT_S)
            link.connect(target)
        except OSError:
            link.close()
            raise
        return link

    def _new_core(self) -> ClientCore:
        if self._key is None:
            return LocalClient()
        # Imported late: the local socket needs no keys.
        from linemate.protocol.command.authenticated import CommandClient

        return CommandClient(self._key, int.from_bytes(os.urandom(8)))

    def _await_answer(
        self, link: socket.socket, sequence: int, frame: bytes, timeout_s: float
    ) -> Answer:
        give_up = time.monotonic() + timeout_s
        send_at = 0.0
        while (now := time.monotonic()) < give_up:
            if now >= send_at:
                link.send(frame)
                send_at = now + RESEND_S if self._key is not None else give_up
            event = self._receive(min(give_up, send_at))
            if isinstance(event, Answer) and event.sequence == sequence:
                return event
            if isinstance(event, More) and event.sequence == sequence:
                frame, send_at = event.request.frame, 0.0
                give_up = time.monotonic() + timeout_s
        raise NoAnswerError("no answer in time")

    def _receive(self, until: float) -> ClientEvent | None:
        """Return the next event, None at the time ``until``."""
        if self._socket is None or self._core is None:
            return None
        while (left := until - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                data = self._socket.recv(LOCAL_LIMIT_BYTES + 1)
            except TimeoutError:
                return None
            if not data and self._key is None:
                raise NoAnswerError("the daemon closed the connection")
            event = self._core.on_datagram(data, time.monotonic_ns())
            if event is not None:
                return event
        return None
