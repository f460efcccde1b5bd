"""Server and client of the command protocol as state machines without I/O.

Law of this file: nothing is kept for a stranger; a session exists from the first request
that proves a cookie of the last two epochs, so nothing recorded earlier can make one.
What is not genuine, fresh and new gets no answer, only a count. Time and randomness are
arguments. The local socket uses the same conversation without tags, in local_server.
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
    ROOM_BYTES,
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
    """Which of the last 64 sequence numbers have come."""

    __slots__ = ("_highest", "_seen")

    def __init__(self) -> None:
        self._highest = 0
        self._seen = 0

    def fresh(self, sequence: int) -> bool:
        """Tell whether ``sequence`` is new; changes nothing."""
        if sequence > self._highest:
            return True
        age = self._highest - sequence
        return sequence > 0 and age < WINDOW and not self._seen >> age & 1

    def take(self, sequence: int) -> None:
        """Remember a sequence that was found fresh and whose frame was genuine."""
        if sequence > self._highest:
            shift = min(sequence - self._highest, WINDOW)
            self._seen = (self._seen << shift | 1) & (1 << WINDOW) - 1
            self._highest = sequence
        else:
            self._seen |= 1 << self._highest - sequence


class Incoming(NamedTuple):
    """An order to carry out, and whose it is.

    Attributes:
        tag: of the request's frame, to know an exact duplicate by.
    """

    order: CommandOrder
    key_id: int
    session: int
    tag: bytes


class Received(NamedTuple):
    """What a datagram came to.

    Attributes:
        replies: datagrams for its sender.
        request: an order whose result is to be given to ``CommandServer.reply``.
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
    """The daemon's end of the authenticated protocol, for any number of clients.

    Args:
        secret_source: returns 32 fresh random bytes, called once an epoch.
        lease: the control lease, shared with the local socket.

    Attributes:
        counters: what came and what became of it, by reason.
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
        """How many sessions there are."""
        return len(self._sessions)

    @property
    def subscribed(self) -> bool:
        """Whether any session wants telemetry."""
        return any(session.conversation.subscribed for session in self._sessions.values())

    def on_datagram(self, data: bytes, address: Hashable, now_ns: int) -> Received:
        """Take one datagram. Never raises; what is refused is counted.

        Args:
            now_ns: the server's monotonic clock.
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
            request: as on_datagram gave it.
            result: the handler's; with the key ``refused`` a refusal.
            now_ns: the server's monotonic clock.
        """
        session = self._sessions.get((request.key_id, request.session))
        if session is None:
            return None
        payload = session.conversation.answer(request.order.sequence, result, now_ns)
        return self._sealed_reply(session, request, payload)

    def fail(self, request: Incoming, now_ns: int) -> bytes | None:
        """Return the datagram that says a handler broke, None if its session has ended."""
        session = self._sessions.get((request.key_id, request.session))
        if session is None:
            return None
        return self._sealed_reply(session, request, session.conversation.fail(now_ns))

    def events(
        self, now_ns: int, snapshot: Callable[[], Mapping[str, Any]]
    ) -> list[tuple[bytes, Hashable]]:
        """Return the telemetry that is due, as datagrams with their addresses.

        Args:
            now_ns: the server's monotonic clock.
            snapshot: gives the telemetry; called at most once, and only if any is due.
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
        """Take a new set of keys; sessions of keys gone or changed end at once."""
        states: dict[int, _KeyState] = {}
        for key in keys:
            old = self._keys.get(key.id)
            states[key.id] = old if old is not None and old.key == key else _KeyState(key)
        for key_id, number in list(self._sessions):
            if states.get(key_id) is not self._keys[key_id]:
                del self._sessions[key_id, number]
                self.counters["sessions_revoked"] += 1
        self._keys = states
        # Cookies given out under the old set die with it, or a key taken away and given
        # back would find its recorded sessions without their tombstones.
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
            session = self._on_stranger(frame, state, address, now_ns)
        elif not session.keys.to_server.genuine(frame):
            raise CommandError("tag")
        # Else a copied request could point replies and telemetry at somebody else.
        if address != session.address:
            raise CommandError("moved")
        if not session.window.fresh(frame.sequence):
            return self._on_duplicate(frame, session)
        session.window.take(frame.sequence)
        session.last_ns = now_ns
        if frame.type is FrameType.CLOSE:
            self._end((frame.key_id, frame.session), now_ns)
            self.counters["sessions_closed"] += 1
            return NOTHING
        return self._on_request(frame, session, now_ns)

    def _on_hello(self, frame: CommandFrame, state: _KeyState, now_ns: int) -> Received:
        # As long as its answer, so that nobody is flooded through this server.
        if len(frame.body) + len(frame.tag) != HANDSHAKE_BYTES:
            raise CommandError("length", "HELLO")
        if not state.hellos.genuine(frame):
            raise CommandError("tag", "HELLO")
        self.counters["hellos"] += 1
        proof = cookie(self._secret(now_ns // EPOCH_NS), frame.key_id, frame.session)
        body = frame_body(FrameType.COOKIE, frame.key_id, frame.session, now_ns // NS_PER_MS, proof)
        return Received((state.cookies.seal(body),))

    def _on_stranger(
        self, frame: CommandFrame, state: _KeyState, address: Hashable, now_ns: int
    ) -> _ServerSession:
        if frame.type is not FrameType.REQUEST:
            raise CommandError("no_session")
        self._bury(state, now_ns)
        if frame.session in state.tombstones:
            raise CommandError("tombstoned")
        # A tombstone forgotten early would let a recorded session begin anew.
        if len(state.tombstones) >= MAX_TOMBSTONES_PER_KEY:
            raise CommandError("tombstones_full", state.key.name)
        keys = self._proven(frame, state, now_ns)
        self._make_room(frame.key_id, now_ns)
        conversation = Conversation(
            state.key.name, state.key.role, self._lease, ROOM_BYTES, self.counters
        )
        session = _ServerSession(keys, conversation, address, now_ns, ReplayWindow(), OrderedDict())
        self._sessions[frame.key_id, frame.session] = session
        self.counters["sessions_made"] += 1
        return session

    def _proven(self, frame: CommandFrame, state: _KeyState, now_ns: int) -> SessionKeys:
        epoch = now_ns // EPOCH_NS
        for secret in (self._secret(epoch), self._secrets.get(epoch - 1)):
            if secret is None:
                continue
            proof = cookie(secret, frame.key_id, frame.session)
            keys = session_keys(state.key, frame.session, proof)
            if keys.to_server.genuine(frame):
                return keys
        raise CommandError("no_session")

    def _on_duplicate(self, frame: CommandFrame, session: _ServerSession) -> Received:
        tag, reply = session.replies.get(frame.sequence, (b"", b""))
        if tag == frame.tag and reply:
            self.counters["replies_repeated"] += 1
            return Received((reply,))
        raise CommandError("replayed")

    def _on_request(self, frame: CommandFrame, session: _ServerSession, now_ns: int) -> Received:
        said = session.conversation.ask(frame.payload, frame.sequence, now_ns)
        if isinstance(said, CommandOrder):
            return Received(request=Incoming(said, frame.key_id, frame.session, frame.tag))
        return Received((self._sealed(session, frame.key_id, frame.session, said, frame),))

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
    def _bury(state: _KeyState, now_ns: int) -> None:
        stones = state.tombstones
        while stones and next(iter(stones.values())) <= now_ns:
            stones.popitem(last=False)

    def _make_room(self, key_id: int, now_ns: int) -> None:
        """End a session so that one more of ``key_id`` fits, never at another's cost.

        A key that has none may take one from the key that has the most, but not its last.
        """
        for which, session in list(self._sessions.items()):
            if now_ns - session.last_ns > IDLE_NS:
                self._end(which, now_ns)
                self.counters["sessions_idle"] += 1
        if len(self._sessions) < MAX_SESSIONS:
            return
        held = Counter(which[0] for which in self._sessions)
        giver = key_id if held[key_id] else held.most_common(1)[0][0]
        if giver != key_id and held[giver] < 2:
            raise CommandError("table_full")
        oldest = min(
            (which for which in self._sessions if which[0] == giver),
            key=lambda which: self._sessions[which].last_ns,
        )
        self._end(oldest, now_ns)
        self.counters["sessions_evicted"] += 1


class _Answered(NamedTuple):
    sequence: int
    tag: bytes


class CommandClient(ClientCore):
    """A client of the authenticated protocol: one key, one session.

    Args:
        session: 64 random bits; a new client for every session.
    """

    def __init__(self, key: PresharedKey, session: int) -> None:
        super().__init__()
        self._key = key
        self._session = session
        self._cookies = cookie_tagger(key)
        self._keys: SessionKeys | None = None

    def hello(self, now_ns: int) -> bytes:
        """Return the datagram that opens the handshake; the same when sent again."""
        del now_ns
        body = frame_body(FrameType.HELLO, self._key.id, self._session, 0, bytes(COOKIE_BYTES))
        return hello_tagger(self._key).seal(body)

    def close(self) -> bytes | None:
        """Return the datagram that ends the session, None if there is none yet."""
        return self._frame(FrameType.CLOSE, self._next(), b"") if self.ready else None

    def _frame(self, kind: FrameType, sequence: int, payload: bytes) -> bytes:
        if self._keys is None:
            raise CommandError("no_session", "the handshake has not been answered")
        body = frame_body(kind, self._key.id, self._session, sequence, payload)
        return self._keys.to_server.seal(body)

    def _genuine(self, data: bytes) -> CommandFrame:
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
        if not tagger.genuine(frame):
            raise CommandError("tag")
        return frame

    def _take_cookie(self, frame: CommandFrame) -> None:
        if len(frame.payload) != COOKIE_BYTES:
            raise CommandError("length", "COOKIE")
        self._keys = session_keys(self._key, self._session, frame.payload)
