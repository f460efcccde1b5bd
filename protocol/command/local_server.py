"""Server of the local socket: the same conversation, without key and tag.

Invariants:
    The kernel identifies the peer (SO_PEERCRED), so that nothing can be forged or replayed.
    Deadlines, roles and the lease are checked as on UDP.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from linemate.protocol.command.conversation import CommandOrder, ControlLease, Conversation
from linemate.protocol.command.frame_codec import (
    LOCAL_PAYLOAD_BYTES,
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
    """Access of local users, beyond the socket's file mode.

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
    """Server of one accepted local connection.

    Args:
        who: name of the peer for logs and the lease.
        lease: shared by all conversations of a server.
    """

    def __init__(self, who: str, role: Role, lease: ControlLease, counters: Counter[str]) -> None:
        self._conversation = Conversation(who, role, lease, LOCAL_PAYLOAD_BYTES, counters)
        self._counters = counters
        self._events = 0

    @property
    def subscribed(self) -> bool:
        """Whether the peer has subscribed to telemetry."""
        return self._conversation.subscribed

    def on_message(self, data: bytes, now_ns: int) -> CommandOrder | bytes | None:
        """Process one message; return an order, a reply to send, or None (counted)."""
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
        """Return the reply to an order whose handler has failed."""
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
        outcome = self._conversation.judge(frame.payload, frame.sequence, now_ns)
        if isinstance(outcome, CommandOrder):
            return outcome
        return self._reply(frame.sequence, outcome)

    @staticmethod
    def _reply(sequence: int, payload: bytes) -> bytes:
        return local_body(FrameType.REPLY, 0, 0, sequence, payload)
