"""Server and client of the authenticated command protocol, as state machines without I/O.

Invariants:
    The server keeps nothing for an unknown sender. A session begins with the first request that
    proves a cookie of the last two epochs, so that no recorded request can begin one.
    A frame that is not genuine, fresh and new gets no answer; it is counted.
    Time and randomness are arguments.
"""

from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from linemate.protocol.command.client_core import ClientCore
from linemate.protocol.command.conversation import CommandOrder, ControlLease, Conversation
from linemate.protocol.command.frame_codec import (
    COOKIE_BYTES,
    HANDSHAKE_BYTES,
    NS_PER_MS,
    PAYLOAD_BYTES,
    CommandError,
    CommandFrame,
    FrameType,
    Tagger,
    cut_frame,
    frame_body,
)
from linemate.protocol.command.payloads import encode_result
from linemate.protocol.command.preshared_keys import (
    PresharedKey,
    SessionKeys,
    cookie,
    cookie_tagger,
    hello_tagger,
    session_keys,
)

MAX_SESSIONS: Final = 8
EPOCH_NS: Final = 10_000_000_000  # a cookie proves freshness for one to two of these
TOMBSTONE_NS: Final = 2 * EPOCH_NS
MAX_TOMBSTONES_PER_KEY: Final = 1024
IDLE_NS: Final = 60_000_000_000
CACHED_REPLIES: Final = 4
WINDOW: Final = 64


class ReplayWindow:
    """The last 64 sequence numbers that have come."""

    __slots__ = ("_highest", "_seen")

    def __init__(self) -> None:
        self._highest = 0
        self._seen = 0

    def is_fresh(self, sequence: int) -> bool:
        """Whether ``sequence`` is new."""
        if sequence > self._highest:
            return True
        age = self._highest - sequence
        return sequence > 0 and age < WINDOW and not self._seen >> age & 1

    def note(self, sequence: int) -> None:
        """Note a fresh sequence of a genuine frame."""
        if sequence > self._highest:
            shift = min(sequence - self._highest, WINDOW)
            self._seen = (self._seen << shift | 1) & (1 << WINDOW) - 1
            self._highest = sequence
        else:
            self._seen |= 1 << self._highest - sequence


class Incoming(NamedTuple):
    """An order to execute, and its session.

    Attributes:
        tag: of the request's frame; an exact duplicate has the same.
    """

    order: CommandOrder
    key_id: int
    session: int
    tag: bytes


class Received(NamedTuple):
    """Outcome of a datagram.

    Attributes:
        replies: datagrams to its sender.
        request: an order; its result goes to ``CommandServer.reply``.
    """

    replies: tuple[bytes, ...] = ()
    request: Incoming | None = None


NOTHING: Final = Received()
_Id = tuple[int, int]


class _KeyState:
    __slots__ = ("cookies", "hellos", "key", "tombstones")

    def __init__(self, key: PresharedKey) -> None:
        self.key = key
        self.hellos = hello_tagger(key)
        self.cookies = cookie_tagger(key)
        self.tombstones: OrderedDict[int, int] = OrderedDict()


@dataclass(slots=True)
class _ServerSession:
    keys: SessionKeys
    conversation: Conversation
    address: Hashable
    last_ns: int
    window: ReplayWindow
    replies: OrderedDict[int, tuple[bytes, bytes]]
    events: int = 0


class CommandServer:
    """Server of the authenticated protocol, for up to ``MAX_SESSIONS`` clients.

    Args:
        secret_source: returns 32 random bytes; called once in each epoch.
        lease: the control lease, shared with the local socket.

    Attributes:
        counters: datagrams and their outcomes, by name.
    """

    def __init__(
        self,
        keys: Iterable[PresharedKey],
        secret_source: Callable[[], bytes],
        lease: ControlLease | None = None,
    ) -> None:
        self._secret_source = secret_source
        self._lease = lease if lease is not None else ControlLease()
        self._keys = {key.id: _KeyState(key) for key in keys}
        self._secrets: dict[int, bytes] = {}
        self._sessions: dict[_Id, _ServerSession] = {}
        self.counters: Counter[str] = Counter()

    @property
    def sessions(self) -> int:
        """Number of sessions."""
        return len(self._sessions)

    @property
    def subscribed(self) -> bool:
        """Whether a session has subscribed to telemetry."""
        return any(session.conversation.subscribed for session in self._sessions.values())

    def on_datagram(self, data: bytes, address: Hashable, now_ns: int) -> Received:
        """Process one datagram at a time on the server's monotonic clock [ns].

        A refused one is counted.
        """
        self.counters["received"] += 1
        try:
            return self._on_frame(cut_frame(data), address, now_ns)
        except CommandError as error:
            self.counters[f"dropped_{error.kind}"] += 1
            return NOTHING

    def reply(self, request: Incoming, result: Mapping[str, Any], now_ns: int) -> bytes | None:
        """Return the datagram that answers a request, None if its session has ended.

        Args:
            request: as returned by ``on_datagram``.
            result: of the handler; with the key ``refused`` a refusal.
            now_ns: time on the server's monotonic clock.
        """
        session = self._sessions.get((request.key_id, request.session))
        if session is None:
            return None
        payload = session.conversation.answer(request.order.sequence, result, now_ns)
        return self._sealed_reply(session, request, payload)

    def fail(self, request: Incoming, now_ns: int) -> bytes | None:
        """Return the reply to a request whose handler has failed, None if its session has ended."""
        session = self._sessions.get((request.key_id, request.session))
        if session is None:
            return None
        return self._sealed_reply(session, request, session.conversation.fail(now_ns))

    def events(
        self, now_ns: int, snapshot: Callable[[], Mapping[str, Any]]
    ) -> list[tuple[bytes, Hashable]]:
        """Return the telemetry that is due, as datagrams with their addresses.

        Args:
            now_ns: time on the server's monotonic clock.
            snapshot: returns the telemetry; called once at most, and only if some is due.
        """
        due = [item for item in self._sessions.items() if item[1].conversation.event_due(now_ns)]
        if not due:
            return []
        try:
            packed = encode_result(snapshot())
        except CommandError as error:
            self.counters[f"events_{error.kind}"] += 1
            return []
        datagrams: list[tuple[bytes, Hashable]] = []
        for (key_id, number), session in due:
            payload = session.conversation.event(packed, now_ns)
            if payload is not None:
                session.events += 1
                body = frame_body(FrameType.EVENT, key_id, number, session.events, payload)
                datagrams.append((session.keys.to_client.seal(body), session.address))
        return datagrams

    def replace_keys(self, keys: Iterable[PresharedKey]) -> None:
        """Use a new set of keys; sessions of removed or changed keys end."""
        states: dict[int, _KeyState] = {}
        for key in keys:
            old = self._keys.get(key.id)
            states[key.id] = old if old is not None and old.key == key else _KeyState(key)
        for key_id, number in list(self._sessions):
            if states.get(key_id) is not self._keys[key_id]:
                del self._sessions[key_id, number]
                self.counters["sessions_revoked"] += 1
        self._keys = states
        # Cookies of the old set become invalid. Otherwise recorded sessions of a key that is
        # removed and added again could begin again, because their tombstones are gone.
        self._secrets.clear()

    def _on_frame(self, frame: CommandFrame, address: Hashable, now_ns: int) -> Received:
        state = self._keys.get(frame.key_id)
        if state is None:
            raise CommandError("unknown_key", str(frame.key_id))
        if frame.type is FrameType.HELLO:
            return self._on_hello(frame, state, now_ns)
        if frame.type not in {FrameType.REQUEST, FrameType.CLOSE}:
            raise CommandError("direction", frame.type.name)
        session = self._sessions.get((frame.key_id, frame.session))
        if session is None:
            session = self._begin_session(frame, state, address, now_ns)
        elif not session.keys.to_server.is_genuine(frame):
            raise CommandError("tag")
        # Otherwise a copied request could send replies and telemetry to another address.
        if address != session.address:
            raise CommandError("moved")
        if not session.window.is_fresh(frame.sequence):
            return self._on_duplicate(frame, session)
        session.window.note(frame.sequence)
        session.last_ns = now_ns
        if frame.type is FrameType.CLOSE:
            self._end((frame.key_id, frame.session), now_ns)
            self.counters["sessions_closed"] += 1
            return NOTHING
        return self._on_request(frame, session, now_ns)

    def _on_hello(self, frame: CommandFrame, state: _KeyState, now_ns: int) -> Received:
        # As long as its answer: the server must not amplify floods.
        if len(frame.body) + len(frame.tag) != HANDSHAKE_BYTES:
            raise CommandError("length", "HELLO")
        if not state.hellos.is_genuine(frame):
            raise CommandError("tag", "HELLO")
        self.counters["hellos"] += 1
        proof = cookie(self._secret(now_ns // EPOCH_NS), frame.key_id, frame.session)
        body = frame_body(FrameType.COOKIE, frame.key_id, frame.session, now_ns // NS_PER_MS, proof)
        return Received((state.cookies.seal(body),))

    def _begin_session(
        self, frame: CommandFrame, state: _KeyState, address: Hashable, now_ns: int
    ) -> _ServerSession:
        if frame.type is not FrameType.REQUEST:
            raise CommandError("no_session")
        self._drop_old_tombstones(state, now_ns)
        if frame.session in state.tombstones:
            raise CommandError("tombstoned")
        # If a tombstone were dropped early, a recorded session could begin again.
        if len(state.tombstones) >= MAX_TOMBSTONES_PER_KEY:
            raise CommandError("tombstones_full", state.key.name)
        keys = self._prove(frame, state, now_ns)
        self._free_session(frame.key_id, now_ns)
        conversation = Conversation(
            state.key.name, state.key.role, self._lease, PAYLOAD_BYTES, self.counters
        )
        session = _ServerSession(keys, conversation, address, now_ns, ReplayWindow(), OrderedDict())
        self._sessions[frame.key_id, frame.session] = session
        self.counters["sessions_made"] += 1
        return session

    def _prove(self, frame: CommandFrame, state: _KeyState, now_ns: int) -> SessionKeys:
        epoch = now_ns // EPOCH_NS
        for secret in (self._secret(epoch), self._secrets.get(epoch - 1)):
            if secret is None:
                continue
            proof = cookie(secret, frame.key_id, frame.session)
            keys = session_keys(state.key, frame.session, proof)
            if keys.to_server.is_genuine(frame):
                return keys
        raise CommandError("no_session")

    def _on_duplicate(self, frame: CommandFrame, session: _ServerSession) -> Received:
        tag, reply = session.replies.get(frame.sequence, (b"", b""))
        if tag == frame.tag and reply:
            self.counters["replies_repeated"] += 1
            return Received((reply,))
        raise CommandError("replayed")

    def _on_request(self, frame: CommandFrame, session: _ServerSession, now_ns: int) -> Received:
        outcome = session.conversation.judge(frame.payload, frame.sequence, now_ns)
        if isinstance(outcome, CommandOrder):
            return Received(request=Incoming(outcome, frame.key_id, frame.session, frame.tag))
        return Received((self._sealed(session, frame.key_id, frame.session, outcome, frame),))

    def _sealed_reply(self, session: _ServerSession, request: Incoming, payload: bytes) -> bytes:
        return self._sealed(
            session,
            request.key_id,
            request.session,
            payload,
            _Answered(request.order.sequence, request.tag),
        )

    @staticmethod
    def _sealed(
        session: _ServerSession,
        key_id: int,
        number: int,
        payload: bytes,
        to: "CommandFrame | _Answered",
    ) -> bytes:
        body = frame_body(FrameType.REPLY, key_id, number, to.sequence, payload)
        datagram = session.keys.to_client.seal(body)
        session.replies[to.sequence] = (to.tag, datagram)
        while len(session.replies) > CACHED_REPLIES:
            session.replies.popitem(last=False)
        return datagram

    def _secret(self, epoch: int) -> bytes:
        if epoch not in self._secrets:
            last = self._secrets.get(epoch - 1)
            self._secrets = {epoch: self._secret_source()}
            if last is not None:
                self._secrets[epoch - 1] = last
        return self._secrets[epoch]

    def _end(self, which: _Id, now_ns: int) -> None:
        del self._sessions[which]
        self._keys[which[0]].tombstones[which[1]] = now_ns + TOMBSTONE_NS

    @staticmethod
    def _drop_old_tombstones(state: _KeyState, now_ns: int) -> None:
        stones = state.tombstones
        while stones and next(iter(stones.values())) <= now_ns:
            stones.popitem(last=False)

    def _free_session(self, key_id: int, now_ns: int) -> None:
        """End idle sessions, and if needed the oldest one, for a new session of ``key_id``.

        It is one of the same key. If the key has none, it is one of the key with most sessions, but
        not its last.
        """
        for which, session in list(self._sessions.items()):
            if now_ns - session.last_ns > IDLE_NS:
                self._end(which, now_ns)
                self.counters["sessions_idle"] += 1
        if len(self._sessions) < MAX_SESSIONS:
            return
        sessions = Counter(which[0] for which in self._sessions)
        owner = key_id if sessions[key_id] else sessions.most_common(1)[0][0]
        if owner != key_id and sessions[owner] < 2:
            raise CommandError("table_full")
        oldest = min(
            (which for which in self._sessions if which[0] == owner),
            key=lambda which: self._sessions[which].last_ns,
        )
        self._end(oldest, now_ns)
        self.counters["sessions_evicted"] += 1


class _Answered(NamedTuple):
    sequence: int
    tag: bytes


class CommandClient(ClientCore):
    """Client of the authenticated protocol: one key, one session.

    Args:
        session: 64 random bits, new for each session.
    """

    def __init__(self, key: PresharedKey, session: int) -> None:
        super().__init__()
        self._key = key
        self._session = session
        self._cookies = cookie_tagger(key)
        self._keys: SessionKeys | None = None

    def hello(self, now_ns: int) -> bytes:
        """Return the datagram that begins the handshake; it may be sent again."""
        del now_ns
        body = frame_body(FrameType.HELLO, self._key.id, self._session, 0, bytes(COOKIE_BYTES))
        return hello_tagger(self._key).seal(body)

    def close(self) -> bytes | None:
        """Return the datagram that ends the session, None before it has begun."""
        return self._frame(FrameType.CLOSE, self._next(), b"") if self.ready else None

    def _frame(self, kind: FrameType, sequence: int, payload: bytes) -> bytes:
        if self._keys is None:
            raise CommandError("no_session", "the handshake has not been answered")
        body = frame_body(kind, self._key.id, self._session, sequence, payload)
        return self._keys.to_server.seal(body)

    def _cut_genuine(self, data: bytes) -> CommandFrame:
        frame = cut_frame(data)
        if (frame.key_id, frame.session) != (self._key.id, self._session):
            raise CommandError("session")
        tagger: Tagger | None = None
        if frame.type is FrameType.COOKIE:
            tagger = self._cookies
        elif frame.type in {FrameType.REPLY, FrameType.EVENT} and self._keys is not None:
            tagger = self._keys.to_client
        if tagger is None:
            raise CommandError("direction", frame.type.name)
        if not tagger.is_genuine(frame):
            raise CommandError("tag")
        return frame

    def _on_cookie_payload(self, frame: CommandFrame) -> None:
        if len(frame.payload) != COOKIE_BYTES:
            raise CommandError("length", "COOKIE")
        self._keys = session_keys(self._key, self._session, frame.payload)
