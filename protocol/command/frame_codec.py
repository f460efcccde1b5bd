"""Frames of the command protocol: header, payload, tag.

docs/command-protocol.md is the specification. Few imports: each ``linemate status`` loads them.

Invariants:
    A frame is cut at fixed offsets, and its tag is compared before its payload is read.
    Any bytes give a frame or CommandError.
    Keys, sessions and time are elsewhere.
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
PAYLOAD_BYTES: Final = MAX_FRAME_BYTES - HEADER.size - TAG_BYTES  # of an authenticated frame

MAX_RESULT_BYTES: Final = 65536  # limit of an answer in all its pages
PAGE_BYTES: Final = 1024
MAX_PAGES: Final = MAX_RESULT_BYTES // PAGE_BYTES
LOCAL_PAYLOAD_BYTES: Final = MAX_RESULT_BYTES + 256  # a local message has a whole answer
LOCAL_LIMIT_BYTES: Final = HEADER.size + LOCAL_PAYLOAD_BYTES
NS_PER_MS: Final = 1_000_000
MAX_AHEAD_MS: Final = 5000  # longest time from a request to its deadline


class CommandError(ProtocolError):
    """Bytes that the command protocol refuses, or a message that it cannot carry.

    Attributes:
        kind: name of the reason and of its counter.
        detail: evidence for the operator.
    """

    def __init__(self, kind: str, detail: str = "") -> None:
        super().__init__(f"{kind}: {detail}" if detail else kind)
        self.kind = kind
        self.detail = detail


class FrameType(IntEnum):
    """Type of a frame, with its direction."""

    HELLO = 1  # client: request a cookie for this key
    COOKIE = 2  # server: the cookie, and the server's clock
    REQUEST = 3  # client
    REPLY = 4  # server, the sequence of its request
    EVENT = 5  # server, during a subscription, with a sequence of its own
    CLOSE = 6  # client: end this session


class Role(StrEnum):
    """What the holder of a key may do."""

    VIEW = "view"
    OPERATE = "operate"


class CommandFrame(NamedTuple):
    """A frame cut at its offsets, not yet authenticated.

    Attributes:
        key_id: id of the key that the sender claims.
        session: the client's random number, 64 bit.
        sequence: 64 bit; in a COOKIE the server's clock [ms].
        body: header and payload, which the tag covers.
        tag: 16 bytes; empty on the local socket.
    """

    type: FrameType
    key_id: int
    session: int
    sequence: int
    body: bytes
    payload: bytes
    tag: bytes


class Tagger:
    """Keyed BLAKE2b-128 over a frame's body; the key schedule is computed once."""

    __slots__ = ("_is_same", "_prepared")

    def __init__(self, key: bytes, person: bytes = b"") -> None:
        # Loaded with the first key: a status on the local socket needs none.
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
        """Return ``body`` with its tag appended."""
        return body + self.tag(body)

    def is_genuine(self, frame: CommandFrame) -> bool:
        """Whether ``frame`` was sealed with this key, compared in constant time."""
        return self._is_same(self.tag(frame.body), frame.tag)


def frame_body(
    kind: FrameType, key_id: int, session: int, sequence: int, payload: bytes = b""
) -> bytes:
    """Return header and payload, which the tag covers.

    Raises:
        CommandError: the payload does not fit a frame, or a number its field.
    """
    if len(payload) > PAYLOAD_BYTES:
        raise CommandError("too_long", f"payload of {len(payload)} bytes, at most {PAYLOAD_BYTES}")
    return local_body(kind, key_id, session, sequence, payload)


def local_body(
    kind: FrameType, key_id: int, session: int, sequence: int, payload: bytes = b""
) -> bytes:
    """Return a message of the local socket: the same header, no tag.

    Raises:
        CommandError: a number does not fit its field.
    """
    try:
        return HEADER.pack(MAGIC, VERSION, kind, key_id, session, sequence) + payload
    except struct.error as error:
        raise CommandError("header", str(error)) from error


def cut_frame(data: bytes) -> CommandFrame:
    """Cut a datagram into a frame; only the header is checked.

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
