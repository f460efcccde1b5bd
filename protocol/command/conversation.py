"""Conversation with an authenticated peer: judge requests, encode replies and telemetry.

Invariants:
    Keys and sockets are elsewhere. A payload is genuine and comes once.
    Deadline, role, order and lease are checked here only, in this order.
    Time is an argument.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from linemate.protocol.command.frame_codec import (
    MAX_AHEAD_MS,
    NS_PER_MS,
    PAGE_BYTES,
    CommandError,
    Role,
)
from linemate.protocol.command.payloads import Reply, encode_event, encode_reply, encode_result
from linemate.protocol.command.requests import OPERATIONS, Request, decode_request

LEASE_NS: Final = 5_000_000_000
DEFAULT_SUBSCRIPTION_NS: Final = 5_000_000_000
REFUSED: Final = "refused"  # key of a handler's result that refuses; its value is the reason


class ControlLease:
    """Control lease of 5 s for arm, start and ack, renewed by operating.

    Attributes:
        holder: name of the present or last holder, empty at first.
    """

    __slots__ = ("_until_ns", "holder")

    def __init__(self) -> None:
        self.holder = ""
        self._until_ns = 0

    def claim(self, who: str, now_ns: int) -> str | None:
        """Acquire or renew the lease; return None, or the reason of the refusal."""
        left_ns = self._until_ns - now_ns
        if self.holder != who and left_ns > 0:
            return f"control is held by {self.holder} for another {left_ns / 1e9:.1f} s"
        self.holder = who
        self._until_ns = now_ns + LEASE_NS
        return None

    def renew(self, who: str, now_ns: int) -> None:
        """Renew the lease if ``who`` holds it."""
        if self.holder == who and self._until_ns > now_ns:
            self._until_ns = now_ns + LEASE_NS


class CommandOrder(NamedTuple):
    """An accepted request, to be executed now."""

    op: str
    params: dict[str, Any]
    sequence: int
    role: Role
    who: str


class _Refusal(Exception):  # noqa: N818
    def __init__(self, code: str, why: str) -> None:
        super().__init__(code)
        self.code = code
        self.why = why


class _Subscription:
    __slots__ = ("next_ns", "period_ns", "until_ns")

    def __init__(self, period_ns: int, until_ns: int, next_ns: int) -> None:
        self.period_ns = period_ns
        self.until_ns = until_ns
        self.next_ns = next_ns


class Conversation:
    """Requests and replies of one authenticated peer.

    Args:
        lease: shared by all conversations of a server.
        limit: size of a reply's payload at most [bytes].
        counters: shared by all conversations of a server.
    """

    __slots__ = (
        "_counters",
        "_lease",
        "_limit",
        "_newest",
        "_parts",
        "_parts_of",
        "_subscription",
        "role",
        "who",
    )

    def __init__(
        self, who: str, role: Role, lease: ControlLease, limit: int, counters: Counter[str]
    ) -> None:
        self.who = who
        self.role = role
        self._lease = lease
        self._limit = limit
        self._counters = counters
        self._newest = 0
        self._parts: list[bytes] = []
        self._parts_of = 0
        self._subscription: _Subscription | None = None

    def judge(self, payload: bytes, sequence: int, now_ns: int) -> CommandOrder | bytes:
        """Return an order to execute, or the payload of the reply."""
        try:
            request = decode_request(payload)
            self._refuse_unless_allowed(request, sequence, now_ns)
            if request.op == "page":
                return self._further_part(request, now_ns)
            if request.op == "subscribe":
                return self._subscribe(request, now_ns)
        except CommandError as error:
            return self._refuse(error.kind, error.detail, now_ns)
        except _Refusal as refusal:
            return self._refuse(refusal.code, refusal.why, now_ns)
        if OPERATIONS[request.op].role is Role.OPERATE:
            self._newest = max(self._newest, sequence)
        self._counters["orders"] += 1
        return CommandOrder(request.op, request.params, sequence, self.role, self.who)

    def answer(self, sequence: int, result: Mapping[str, Any], now_ns: int) -> bytes:
        """Return the payload of the reply to an executed order.

        Args:
            result: of the handler; with the key ``refused`` it is a refusal with that reason.
        """
        if REFUSED in result:
            return self._refuse(REFUSED, str(result[REFUSED]), now_ns)
        try:
            packed = encode_result(result)
        except CommandError as error:
            return self._refuse(error.kind, error.detail, now_ns)
        whole = encode_reply(Reply(ok=True, t=now_ns // NS_PER_MS, r=packed))
        if len(whole) <= self._limit:
            return whole
        self._parts = [packed[at : at + PAGE_BYTES] for at in range(0, len(packed), PAGE_BYTES)]
        self._parts_of = sequence
        return self._part(0, now_ns)

    def fail(self, now_ns: int) -> bytes:
        """Return the payload of the reply to an order whose handler has failed."""
        return self._refuse("internal", "the daemon failed to do this; see its log", now_ns)

    def event_due(self, now_ns: int) -> bool:
        """Whether telemetry is due; it then counts as sent."""
        subscription = self._subscription
        if subscription is None or now_ns < subscription.next_ns:
            return False
        if now_ns >= subscription.until_ns:
            self._subscription = None
            return False
        # From the schedule, so that the rate is kept. Events of a stall are not sent later.
        period_ns = subscription.period_ns
        subscription.next_ns = max(subscription.next_ns + period_ns, now_ns + period_ns // 2)
        return True

    @property
    def subscribed(self) -> bool:
        """Whether the peer has subscribed to telemetry."""
        return self._subscription is not None

    def event(self, packed: bytes, now_ns: int) -> bytes | None:
        """Return the payload of an event, None (counted) if it is too long."""
        payload = encode_event(now_ns // NS_PER_MS, packed)
        if len(payload) > self._limit:
            self._counters["events_too_long"] += 1
            return None
        return payload

    def _refuse_unless_allowed(self, request: Request, sequence: int, now_ns: int) -> None:
        rule = OPERATIONS[request.op]
        late_ms = now_ns // NS_PER_MS - request.deadline_ms
        if late_ms > 0:
            raise _Refusal("expired", f"came {late_ms} ms after its deadline")
        if late_ms < -MAX_AHEAD_MS:
            raise _Refusal("deadline", f"{-late_ms} ms ahead, at most {MAX_AHEAD_MS}")
        if rule.role is Role.OPERATE and self.role is not Role.OPERATE:
            raise _Refusal("role", f"{self.who} may view, not {request.op}")
        if rule.ordered and sequence < self._newest:
            raise _Refusal("order", f"{request.op} came after a later request was carried out")
        if rule.lease:
            refusal = self._lease.claim(self.who, now_ns)
            if refusal is not None:
                raise _Refusal("lease", refusal)
        elif rule.role is Role.OPERATE:
            self._lease.renew(self.who, now_ns)

    def _subscribe(self, request: Request, now_ns: int) -> bytes:
        rate_hz = float(request.params["rate_hz"])
        duration_ns = int(request.params.get("duration_s", 0.0) * 1e9) or DEFAULT_SUBSCRIPTION_NS
        if rate_hz == 0.0:
            self._subscription = None
        else:
            period_ns = min(int(1e9 / rate_hz), duration_ns)
            self._subscription = _Subscription(period_ns, now_ns + duration_ns, now_ns)
        packed = encode_result({"rate_hz": rate_hz, "duration_s": duration_ns / 1e9})
        return encode_reply(Reply(ok=True, t=now_ns // NS_PER_MS, r=packed))

    def _further_part(self, request: Request, now_ns: int) -> bytes:
        of, page = request.params["of"], request.params["page"]
        if of != self._parts_of or page >= len(self._parts):
            raise _Refusal("page", f"no part {page} of the answer to {of}")
        return self._part(page, now_ns)

    def _part(self, page: int, now_ns: int) -> bytes:
        return encode_reply(
            Reply(ok=True, t=now_ns // NS_PER_MS, r=self._parts[page], i=page, n=len(self._parts))
        )

    def _refuse(self, code: str, why: str, now_ns: int) -> bytes:
        self._counters[f"refused_{code}"] += 1
        text = why[:256].encode("utf-8", "replace").decode("utf-8")
        return encode_reply(Reply(ok=False, t=now_ns // NS_PER_MS, e=code, why=text))
