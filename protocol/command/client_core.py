"""Client of the command protocol, common part: number requests, match and join answers.

Invariants:
    No I/O and no randomness; time is an argument.
    The server's clock is estimated from its frames at their arrival. The estimate is late by the
    transit, never early: a deadline can only be too early.
    A frame that matches no request is counted, not raised.
"""

from abc import ABC, abstractmethod
from collections import Counter, OrderedDict
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from linemate.protocol.command.frame_codec import (
    MAX_RESULT_BYTES,
    NS_PER_MS,
    CommandError,
    CommandFrame,
    FrameType,
)
from linemate.protocol.command.payloads import (
    BARE,
    Reply,
    decode_event,
    decode_reply,
    decode_result,
    encode_bare,
)

MAX_OUTSTANDING: Final = 16
PAGE_DEADLINE_NS: Final = 500_000_000


class Sent(NamedTuple):
    """A request, to be sent repeatedly until its answer comes.

    Attributes:
        sequence: number of the request and of its answer.
    """

    sequence: int
    frame: bytes


# Named tuples: to create dataclasses took a tenth of the time of a status.


class Ready:
    """The handshake is complete."""

    __slots__ = ()


class Answer(NamedTuple):
    """The answer to a request.

    Attributes:
        result: of the operation; empty after a refusal.
        code: reason of a refusal, one word.
        reason: the same as a sentence.
    """

    sequence: int
    ok: bool
    result: dict[str, Any]
    code: str = ""
    reason: str = ""


class More(NamedTuple):
    """A part of an answer has come; ``request`` fetches the next one.

    Attributes:
        sequence: number of the request that is answered in parts.
    """

    sequence: int
    request: Sent


class Telemetry(NamedTuple):
    """An event of a subscription."""

    server_ms: int
    data: dict[str, Any]


ClientEvent = Ready | Answer | More | Telemetry


class _OutstandingRequest:
    """A request without its whole answer; ``root`` is the number of the first one."""

    __slots__ = ("page", "parts", "root")

    def __init__(self, root: int, page: int = 0, parts: list[bytes] | None = None) -> None:
        self.root = root
        self.page = page
        self.parts: list[bytes] = [] if parts is None else parts


def _encode(op: str, params: Mapping[str, Any], deadline_ms: int) -> bytes:
    if op in BARE and not params:
        return encode_bare(op, deadline_ms)
    # Loaded with the first parameters: a status does not need the types that check them.
    from linemate.protocol.command.requests import encode_request

    return encode_request(op, params, deadline_ms)


class ClientCore(ABC):
    """Common part of CommandClient and LocalClient.

    Attributes:
        counters: frames that matched nothing, by reason.
    """

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self._offset_ms: int | None = None
        self._last = 0
        self._last_event = 0
        self._waiting: OrderedDict[int, _OutstandingRequest] = OrderedDict()

    @property
    def ready(self) -> bool:
        """Whether the handshake is complete."""
        return self._offset_ms is not None

    def request(self, op: str, params: Mapping[str, Any], deadline_ns: int) -> Sent:
        """Return a request to send.

        Args:
            deadline_ns: on the client's monotonic clock; the server refuses the request after it.

        Raises:
            CommandError: no handshake, unknown operation or parameters.
        """
        sent = self._request(op, params, deadline_ns)
        self._wait(sent.sequence, _OutstandingRequest(sent.sequence))
        return sent

    def on_datagram(self, data: bytes, now_ns: int) -> ClientEvent | None:
        """Process one datagram; a refused one is counted.

        Args:
            now_ns: time on the client's monotonic clock.
        """
        try:
            frame = self._cut_genuine(data)
            if frame.type is FrameType.COOKIE:
                return self._on_cookie(frame, now_ns)
            if frame.type is FrameType.EVENT:
                return self._on_event(frame)
            return self._on_reply(frame, now_ns)
        except CommandError as error:
            self.counters[f"dropped_{error.kind}"] += 1
            return None

    @abstractmethod
    def hello(self, now_ns: int) -> bytes:
        """Return the bytes that open the handshake."""

    @abstractmethod
    def close(self) -> bytes | None:
        """Return the bytes that end the session, None if none are needed."""

    @abstractmethod
    def _frame(self, kind: FrameType, sequence: int, payload: bytes) -> bytes: ...

    @abstractmethod
    def _cut_genuine(self, data: bytes) -> CommandFrame: ...

    @abstractmethod
    def _on_cookie_payload(self, frame: CommandFrame) -> None: ...

    def _next(self) -> int:
        self._last += 1
        return self._last

    def _request(self, op: str, params: Mapping[str, Any], deadline_ns: int) -> Sent:
        if self._offset_ms is None:
            raise CommandError("no_session", "the handshake has not been answered")
        payload = _encode(op, params, deadline_ns // NS_PER_MS + self._offset_ms)
        sequence = self._next()
        return Sent(sequence, self._frame(FrameType.REQUEST, sequence, payload))

    def _wait(self, sequence: int, waiting: _OutstandingRequest) -> None:
        self._waiting[sequence] = waiting
        while len(self._waiting) > MAX_OUTSTANDING:
            self._waiting.popitem(last=False)

    def _on_cookie(self, frame: CommandFrame, now_ns: int) -> ClientEvent:
        # Only the first one: another would change the keys of requests that are waiting.
        if self.ready:
            raise CommandError("duplicate", "COOKIE")
        self._on_cookie_payload(frame)
        self._offset_ms = frame.sequence - now_ns // NS_PER_MS
        return Ready()

    def _on_event(self, frame: CommandFrame) -> ClientEvent:
        if frame.sequence <= self._last_event:
            raise CommandError("replayed", "EVENT")
        server_ms, data = decode_event(frame.payload)
        self._last_event = frame.sequence
        return Telemetry(server_ms, data)

    def _on_reply(self, frame: CommandFrame, now_ns: int) -> ClientEvent:
        waiting = self._waiting.get(frame.sequence)
        if waiting is None:
            raise CommandError("unasked", "REPLY")
        reply = decode_reply(frame.payload)
        del self._waiting[frame.sequence]
        self._offset_ms = reply.t - now_ns // NS_PER_MS
        if not reply.ok:
            return Answer(waiting.root, ok=False, result={}, code=reply.e, reason=reply.why)
        return self._join(waiting, reply, now_ns)

    def _join(self, waiting: _OutstandingRequest, reply: Reply, now_ns: int) -> ClientEvent:
        waiting.parts.append(reply.r)
        size = sum(len(part) for part in waiting.parts)
        if reply.i != waiting.page or size > MAX_RESULT_BYTES:
            why = f"part {reply.i} came for part {waiting.page}, {size} bytes in all"
            return Answer(waiting.root, ok=False, result={}, code="page", reason=why)
        if reply.i + 1 < reply.n:
            return self._fetch_next(waiting, now_ns)
        try:
            result = decode_result(b"".join(waiting.parts))
        except CommandError as error:
            return Answer(waiting.root, ok=False, result={}, code=error.kind, reason=error.detail)
        return Answer(waiting.root, ok=True, result=result)

    def _fetch_next(self, waiting: _OutstandingRequest, now_ns: int) -> ClientEvent:
        waiting.page += 1
        params = {"of": waiting.root, "page": waiting.page}
        sent = self._request("page", params, now_ns + PAGE_DEADLINE_NS)
        self._wait(sent.sequence, waiting)
        return More(waiting.root, sent)
