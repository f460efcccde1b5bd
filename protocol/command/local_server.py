"""The command protocol on the local socket: the same conversation, vouched for by the kernel.

Law of this file: frames are those of the network without the tag; who sent them is what
the kernel says of the socket's other end (SO_PEERCRED), so there is nothing to
authenticate and nothing to replay. Deadlines, roles and the lease hold all the same.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from linemate.protocol.command.conversation import CommandOrder, ControlLease, Conversation
from linemate.protocol.command.frame_codec import (
    LOCAL_ROOM_BYTES,
    NS_PER_MS,
    CommandError,
    CommandFrame,
    FrameType,
    Role,
    cut_local,
    local_body,
)
from linemate.protocol.command.payloads import encode_result


class LocalAccess(NamedTuple):
    """Which local users may do what; the socket's file mode decides first.

    Attributes:
        operate_uids: user ids that may operate.
        operate_gids: group ids whose members may operate.
        view_gids: group ids whose members may view.
    """

    operate_uids: frozenset[int] = frozenset()
    operate_gids: frozenset[int] = frozenset()
    view_gids: frozenset[int] = frozenset()

    def role(self, uid: int, gids: frozenset[int]) -> Role | None:
        """Return the role of a user with these groups, None for no access."""
        if uid in self.operate_uids or gids & self.operate_gids:
            return Role.OPERATE
        return Role.VIEW if gids & self.view_gids else None


class LocalServer:
    """The daemon's end of one accepted local connection.

    Args:
        who: the peer's name for logs and the lease.
        lease: shared with all other conversations.
    """

    def __init__(self, who: str, role: Role, lease: ControlLease, counters: Counter[str]) -> None:
        self._conversation = Conversation(who, role, lease, LOCAL_ROOM_BYTES, counters)
        self._counters = counters
        self._events = 0

    @property
    def subscribed(self) -> bool:
        """Whether the peer wants telemetry."""
        return self._conversation.subscribed

    def on_message(self, data: bytes, now_ns: int) -> CommandOrder | bytes | None:
        """Take one message: an order to carry out, a reply to send, or None (counted)."""
        self._counters["received"] += 1
        try:
            return self._on_frame(cut_local(data), now_ns)
        except CommandError as error:
            self._counters[f"dropped_{error.kind}"] += 1
            return None

    def reply(self, order: CommandOrder, result: Mapping[str, Any], now_ns: int) -> bytes:
        """Return the message that answers an order; see CommandServer.reply."""
        payload = self._conversation.answer(order.sequence, result, now_ns)
        return self._reply(order.sequence, payload)

    def fail(self, order: CommandOrder, now_ns: int) -> bytes:
        """Return the message that says a handler broke."""
        return self._reply(order.sequence, self._conversation.fail(now_ns))

    def event(self, now_ns: int, snapshot: Callable[[], Mapping[str, Any]]) -> bytes | None:
        """Return the telemetry that is due, None if none is."""
        if not self._conversation.event_due(now_ns):
            return None
        try:
            packed = encode_result(snapshot())
        except CommandError as error:
            self._counters[f"events_{error.kind}"] += 1
            return None
        payload = self._conversation.event(packed, now_ns)
        if payload is None:
            return None
        self._events += 1
        return local_body(FrameType.EVENT, 0, 0, self._events, payload)

    def _on_frame(self, frame: CommandFrame, now_ns: int) -> CommandOrder | bytes:
        if frame.type is FrameType.HELLO:
            return local_body(FrameType.COOKIE, 0, 0, now_ns // NS_PER_MS)
        if frame.type is not FrameType.REQUEST or frame.sequence == 0:
            raise CommandError("direction", frame.type.name)
        said = self._conversation.ask(frame.payload, frame.sequence, now_ns)
        return said if isinstance(said, CommandOrder) else self._reply(frame.sequence, said)

    @staticmethod
    def _reply(sequence: int, payload: bytes) -> bytes:
        return local_body(FrameType.REPLY, 0, 0, sequence, payload)
