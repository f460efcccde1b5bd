"""Orders of a fault run over the real command protocol: handshake, keys, sessions, answers.

Every frame is encoded by the client and judged by the daemon's own server. Only the socket in
between is left out.
"""

from collections.abc import Mapping
from typing import Any

from linemate.daemon.service.app import App
from linemate.protocol.command.authenticated import CommandClient, Incoming
from linemate.protocol.command.client_core import Answer, More
from linemate.protocol.command.frame_codec import Role
from linemate.protocol.command.preshared_keys import PresharedKey, make_key

ADDRESS = ("127.0.0.1", 50_100)
DEADLINE_NS = 200_000_000
NAMES = ("operator", "colleague")
KEYS: tuple[PresharedKey, ...] = tuple(
    make_key(name, Role.OPERATE, bytes((7 * n + i * i) % 256 for i in range(1, 33)))
    for n, name in enumerate(NAMES, 1)
)


class CommandWire:
    """Clients of one daemon's command server, one a key."""

    def __init__(self) -> None:
        self._app: App | None = None
        self._clients: dict[str, CommandClient] = {}
        self._sessions = 0

    def order(
        self, app: App, name: str, op: str, params: Mapping[str, Any], now_ns: int
    ) -> str | None:
        """Give an order in a client's name.

        Args:
            now_ns: the monotonic clock of client and daemon [ns].

        Returns:
            None, or why it was refused.
        """
        answer = self.ask(app, name, op, params, now_ns)
        if answer is None:
            return "no answer"
        return None if answer.ok else answer.reason or answer.code

    def ask(
        self, app: App, name: str, op: str, params: Mapping[str, Any], now_ns: int
    ) -> Answer | None:
        """Return the answer to a request in a client's name, None without one.

        Args:
            now_ns: the monotonic clock of client and daemon [ns].
        """
        if app is not self._app:
            app._commands.replace_keys(KEYS)  # noqa: SLF001 - a daemon with a key file
            self._app, self._clients = app, {}
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self._shake_hands(name, now_ns)
        answer = self._exchange(
            client, client.request(op, params, now_ns + DEADLINE_NS).frame, now_ns
        )
        if answer is None:
            del self._clients[name]  # the session has ended: another one next time
        return answer

    def _shake_hands(self, name: str, now_ns: int) -> CommandClient:
        self._sessions += 1
        client = CommandClient(KEYS[NAMES.index(name)], self._sessions)
        self._exchange(client, client.hello(now_ns), now_ns)
        return client

    def _exchange(self, client: CommandClient, frame: bytes, now_ns: int) -> Answer | None:
        app = self._app
        assert app is not None  # noqa: S101 - an order has a daemon
        server = app._commands._server  # noqa: SLF001 - behind its socket
        answer, frames = None, [frame]
        while frames:
            received = server.on_datagram(frames.pop(), ADDRESS, now_ns)
            replies = list(received.replies)
            if received.request is not None:
                replies += _carried_out(app, server, received.request, now_ns)
            for reply in replies:
                event = client.on_datagram(reply, now_ns)
                answer = event if isinstance(event, Answer) else answer
                frames += [event.request.frame] if isinstance(event, More) else []
        return answer


def _carried_out(app: App, server: Any, request: Incoming, now_ns: int) -> list[bytes]:
    order = request.order
    result = app._handle(order.op, order.params, str(order.role), order.who)  # noqa: SLF001
    # A promise is kept later; the operator does not wait for it.
    plain = result if isinstance(result, Mapping) else {}
    reply = server.reply(request, plain, now_ns)
    return [] if reply is None else [reply]
