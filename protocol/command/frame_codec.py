"""Frames of the command protocol, and what both ends say of all messages.

Law of this file: a frame is cut by fixed offsets and its tag compared before one byte of
its payload is looked at; any bytes give a frame or CommandError. Payloads are
requests' and payloads'. No key material, no session, no time is kept here;
those live in preshared_keys, conversation and authenticated. Light imports only: a
status from the shell pays for them. `docs/command-protocol.md` is the specification, with
vectors made by another implementation of BLAKE2b.
"""

import struct
from enum import IntEnum, StrEnum
from typing import Final, NamedTuple

from linemate.protocol.errors import ProtocolError

MAGIC: Final = b"LM"
VERSION: Final = 1
HEADER: Final = struct.Struct(">2sBBHQQ")
TAG_BYTES: Final = 16
MAX_FRAME_BYTES: Final = 1200  # one datagram, never fragmented on an Ethernet
COOKIE_BYTES: Final = 16
HANDSHAKE_BYTES: Final = HEADER.size + COOKIE_BYTES + TAG_BYTES
ROOM_BYTES: Final = MAX_FRAME_BYTES - HEADER.size - TAG_BYTES
"""What is left for a payload in one authenticated frame."""

MAX_RESULT_BYTES: Final = 65536  # what one answer may hold in all its pages
PAGE_BYTES: Final = 1024
MAX_PAGES: Final = MAX_RESULT_BYTES // PAGE_BYTES
LOCAL_ROOM_BYTES: Final = MAX_RESULT_BYTES + 256  # a local message holds a whole answer
LOCAL_LIMIT_BYTES: Final = HEADER.size + LOCAL_ROOM_BYTES
NS_PER_MS: Final = 1_000_000
MAX_AHEAD_MS: Final = 5000  # a command that may wait longer is a command nobody watches


class CommandError(ProtocolError):
    """Bytes that the command protocol refuses, or a message that it cannot carry.

    Attributes:
        kind: short name of the reason, the name of its counter.
        detail: evidence for a person.
    """

    def __init__(self, kind: str, detail: str = "") -> None:
        super().__init__(f"{kind}: {detail}" if detail else kind)
        self.kind = kind
        self.detail = detail


class FrameType(IntEnum):
    """What a frame is for; the direction belongs to the type."""

    HELLO = 1  # client: I hold this key, give me a fresh cookie
    COOKIE = 2  # server: here it is, and my clock
    REQUEST = 3  # client
    REPLY = 4  # server, the sequence of its request
    EVENT = 5  # server, unasked after a subscription, a sequence of its own
    CLOSE = 6  # client: forget this session


class Role(StrEnum):
    """What the holder of a key may do."""

    VIEW = "view"
    OPERATE = "operate"


class CommandFrame(NamedTuple):
    """A frame cut at its offsets, not yet authenticated.

    Attributes:
        type: what it is for.
        key_id: id of the key it claims.
        session: the client's random number, 64 bit.
        sequence: 64 bit; a COOKIE carries the server's clock here [ms].
        body: header and payload, what the tag is over.
        payload: as on the wire.
        tag: 16 bytes; empty on a local socket.
    """

    type: FrameType
    key_id: int
    session: int
    sequence: int
    body: bytes
    payload: bytes
    tag: bytes


class Tagger:
    """Keyed BLAKE2b-128 over a frame's body, with its key schedule done once."""

    __slots__ = ("_is_same", "_prepared")

    def __init__(self, key: bytes, person: bytes = b"") -> None:
        # Loaded with the first key: the local socket has none, and a status shall cost little.
        import hashlib
        import hmac

        self._is_same = hmac.compare_digest
        self._prepared = hashlib.blake2b(key=key, digest_size=TAG_BYTES, person=person)

    def tag(self, body: bytes) -> bytes:
        """Return the 16-byte tag of ``body``."""
        digest = self._prepared.copy()
        digest.update(body)
        return digest.digest()

    def seal(self, body: bytes) -> bytes:
        """Return ``body`` with its tag behind it."""
        return body + self.tag(body)

    def genuine(self, frame: CommandFrame) -> bool:
        """Tell in constant time whether ``frame`` was sealed with this key."""
        return self._is_same(self.tag(frame.body), frame.tag)


def frame_body(
    kind: FrameType, key_id: int, session: int, sequence: int, payload: bytes = b""
) -> bytes:
    """Return header and payload, what a tag is computed over.

    Raises:
        CommandError: the payload does not fit a frame, or a number its field.
    """
    if len(payload) > ROOM_BYTES:
        raise CommandError("too_long", f"payload of {len(payload)} bytes, room for {ROOM_BYTES}")
    return local_body(kind, key_id, session, sequence, payload)


def local_body(
    kind: FrameType, key_id: int, session: int, sequence: int, payload: bytes = b""
) -> bytes:
    """Return a message of the local socket: the same header, no tag, no limit but its own.

    Raises:
        CommandError: a number does not fit its field.
    """
    try:
        return HEADER.pack(MAGIC, VERSION, kind, key_id, session, sequence) + payload
    except struct.error as error:
        raise CommandError("header", str(error)) from error


def cut_frame(data: bytes) -> CommandFrame:
    """Cut a datagram into a frame. Looks at the header alone.

    Raises:
        CommandError: length, magic, version or type.
    """
    if not HEADER.size + TAG_BYTES <= len(data) <= MAX_FRAME_BYTES:
        raise CommandError("length", f"{len(data)} bytes")
    body = data[:-TAG_BYTES]
    return _cut(body, data[-TAG_BYTES:])


def cut_local(data: bytes, limit: int = MAX_FRAME_BYTES) -> CommandFrame:
    """Cut a message of the local socket, which has no tag.

    Raises:
        CommandError: length, magic, version or type.
    """
    if not HEADER.size <= len(data) <= limit:
        raise CommandError("length", f"{len(data)} bytes")
    return _cut(data, b"")


def _cut(body: bytes, tag: bytes) -> CommandFrame:
    magic, version, kind, key_id, session, sequence = HEADER.unpack_from(body)
    if magic != MAGIC:
        raise CommandError("magic", magic.hex())
    if version != VERSION:
        raise CommandError("version", str(version))
    if kind not in _TYPES:
        raise CommandError("type", str(kind))
    return CommandFrame(_TYPES[kind], key_id, session, sequence, body, body[HEADER.size :], tag)


_TYPES: Final = {int(kind): kind for kind in FrameType}
