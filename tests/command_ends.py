"""Both ends of the command protocol, for tests: in memory, and a real daemon's endpoints."""

import itertools
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from linemate.daemon.service.command_server import CommandPort
from linemate.daemon.service.endpoints import LocalEndpoint, UdpEndpoint
from linemate.protocol.command.authenticated import CommandClient, CommandServer
from linemate.protocol.command.client_core import Answer, ClientCore, More
from linemate.protocol.command.frame_codec import Role
from linemate.protocol.command.preshared_keys import PresharedKey, make_key

MS = 1_000_000
S = 1_000_000_000
START_NS = 1_000 * S
_sessions = itertools.count(0x1000)


def secret_of(seed: int) -> bytes:
    """32 bytes that differ from those of any other seed."""
    return bytes((seed * 37 + i * 11) % 256 for i in range(32))


def key_of(name: str = "alice", role: Role = Role.OPERATE, seed: int = 1) -> PresharedKey:
    return make_key(name, role, secret_of(seed))


class Secrets:
    """A server's random source: never the same twice, yet reproducible."""

    def __init__(self, first: int = 0) -> None:
        self._count = itertools.count(first)

    def __call__(self) -> bytes:
        return next(self._count).to_bytes(4, "big") * 8


def nothing(op: str, params: Mapping[str, Any], role: str, who: str) -> dict[str, Any]:
    del params, role, who
    return {"did": op}


@dataclass
class World:
    """A server, its handler and a clock in memory; counts what was carried out."""

    keys: tuple[PresharedKey, ...] = (key_of(),)
    handle: Callable[[str, Mapping[str, Any], str, str], dict[str, Any]] = nothing
    now_ns: int = START_NS
    done: list[tuple[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.server = CommandServer(self.keys, Secrets())

    def deliver(self, data: bytes, address: object = "client") -> list[bytes]:
        received = self.server.on_datagram(data, address, self.now_ns)
        replies = list(received.replies)
        if received.request is not None:
            order = received.request.order
            self.done.append((order.op, order.who))
            result = self.handle(order.op, order.params, str(order.role), order.who)
            answer = self.server.reply(received.request, result, self.now_ns)
            if answer is not None:
                replies.append(answer)
        return replies

    def client(self, key: PresharedKey | None = None, *, ready: bool = True) -> CommandClient:
        client = CommandClient(key or self.keys[0], next(_sessions))
        if ready:
            for reply in self.deliver(client.hello(self.now_ns), client_address(client)):
                client.on_datagram(reply, self.now_ns)
            assert client.ready
        return client

    def ask(
        self, client: ClientCore, op: str, params: Mapping[str, Any] | None = None
    ) -> Answer | None:
        """One request and all its parts; None if no answer came."""
        sent = client.request(op, params or {}, self.now_ns + 500 * MS)
        frame: bytes | None = sent.frame
        while frame is not None:
            replies, frame = self.deliver(frame, client_address(client)), None
            for reply in replies:
                event = client.on_datagram(reply, self.now_ns)
                if isinstance(event, Answer):
                    return event
                if isinstance(event, More):
                    frame = event.request.frame
        return None


def client_address(client: ClientCore) -> object:
    return "client", id(client)


@contextmanager
def open_port(
    tmp_path: Path,
    keys: tuple[PresharedKey, ...] = (),
    handle: Callable[[str, dict[str, Any], str, str], Mapping[str, Any]] = nothing,
    telemetry: Callable[[], Mapping[str, Any]] = dict,
) -> Iterator[CommandPort]:
    """A daemon's endpoints that a test polls itself."""
    port = CommandPort(
        handle,
        telemetry,
        LocalEndpoint(tmp_path / "command.sock"),
        UdpEndpoint(port=0, keys=keys) if keys else None,
    )
    port.open()
    try:
        yield port
    finally:
        port.close()


@contextmanager
def served(port: CommandPort) -> Iterator[CommandPort]:
    """The same port, polled by a thread every 2 ms."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(0.002):
            port.poll()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield port
    finally:
        ended.set()
        thread.join(5.0)
