"""Pre-shared keys: text of a key file, and the keys derived from one.

Invariants:
    No file is opened here. Parsing returns all keys or all errors.
    A key's bytes are in no repr, error or message.
    The id of a key is derived from the key: both ends agree without a setting.
"""

import base64
import binascii
import hashlib
import re
import stat
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from linemate.protocol.command.frame_codec import COOKIE_BYTES, CommandError, Role, Tagger

KEY_BYTES: Final = 32
MAX_KEYS: Final = 64
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,31}")


@dataclass(frozen=True, slots=True)
class PresharedKey:
    """A pre-shared key.

    Attributes:
        name: name of its holder, for logs and the control lease.
        id: 1..65535, derived from the secret; 0 is the local socket.
    """

    name: str
    role: Role
    secret: bytes = field(repr=False)
    id: int


def make_key(name: str, role: Role, secret: bytes) -> PresharedKey:
    """Return a key with its id.

    Raises:
        CommandError: bad name, wrong length, or a secret that cannot be random.
    """
    if not _NAME.fullmatch(name):
        raise CommandError("key", f"name {name[:40]!r}: letters, digits, . _ - and at most 32")
    if len(secret) != KEY_BYTES:
        raise CommandError("key", f"{len(secret)} bytes instead of {KEY_BYTES}")
    # 32 random bytes have at least 8 different values; typed ones may not.
    if len(set(secret)) < 8:
        raise CommandError("key", "not random; make one with `linemate keygen`")
    return PresharedKey(name, role, secret, key_id(secret))


def key_id(secret: bytes) -> int:
    """Return the id of a key, 1..65535."""
    digest = hashlib.blake2b(secret, digest_size=8, person=b"id").digest()
    return int.from_bytes(digest, "big") % 65535 + 1


def key_line(key: PresharedKey) -> str:
    """Return the line of a key in a key file, without its end."""
    return f"{key.name} {key.role} {base64.b64encode(key.secret).decode('ascii')}"


def parse_keys(text: str, source: str = "keys") -> tuple[PresharedKey, ...]:
    """Read a key file: lines ``name role base64key``; ``#`` begins a comment line.

    Args:
        source: name of the file for errors.

    Raises:
        CommandError: with every bad line as ``source:line: what``, never a key's bytes.
    """
    keys: list[PresharedKey] = []
    wrong: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            key = _parse_line(line)
            _refuse_duplicate(key, keys)
        except CommandError as error:
            wrong.append(f"{source}:{number}: {error.detail}")
        else:
            keys.append(key)
    if len(keys) > MAX_KEYS:
        wrong.append(f"{source}: {len(keys)} keys, at most {MAX_KEYS}")
    if wrong:
        raise CommandError("key", "\n".join(wrong))
    return tuple(keys)


def _parse_line(line: str) -> PresharedKey:
    words = line.split()
    if len(words) != 3:
        raise CommandError("key", f"{len(words)} words instead of `name role base64key`")
    name, role, encoded = words
    if role not in set(Role):
        raise CommandError("key", f"role of {name[:40]!r} is neither view nor operate")
    try:
        secret = base64.b64decode(encoded.encode("ascii"), validate=True)
    except (binascii.Error, UnicodeEncodeError, ValueError):
        raise CommandError("key", f"the key of {name[:40]!r} is not base64") from None
    return make_key(name, Role(role), secret)


def _refuse_duplicate(key: PresharedKey, keys: Iterable[PresharedKey]) -> None:
    for other in keys:
        if other.name == key.name:
            raise CommandError("key", f"name {key.name!r} is given twice")
        if other.secret == key.secret:
            raise CommandError("key", f"{key.name!r} has the key of {other.name!r}")
        if other.id == key.id:
            raise CommandError(
                "key", f"{key.name!r} and {other.name!r} have one id; make one of them again"
            )


def unsafe_file(mode: int, owner: int, user: int) -> str | None:
    """Return why a file may not hold keys, None if it may.

    Args:
        mode: ``st_mode`` of the file.
        owner: user id of its owner.
        user: effective user id of the process that reads it.
    """
    if not stat.S_ISREG(mode):
        return "not a regular file"
    if owner not in {0, user}:
        # Its owner could add keys.
        return f"owned by uid {owner}, should be uid {user} or root. chown it"
    if mode & 0o077:
        return f"mode {stat.S_IMODE(mode):04o} lets others in; chmod 0400 or 0600"
    return None


@dataclass(frozen=True, slots=True)
class SessionKeys:
    """Taggers of a session, one for each direction."""

    to_server: Tagger
    to_client: Tagger


def cookie(secret: bytes, key: int, session: int) -> bytes:
    """Return the cookie that proves freshness; the server computes it again instead of keeping it.

    Args:
        secret: of the server, for the present or the last epoch.
        key: id of the pre-shared key.
    """
    named = key.to_bytes(2, "big") + session.to_bytes(8, "big")
    return hashlib.blake2b(named, key=secret, digest_size=COOKIE_BYTES, person=b"proof").digest()


def session_keys(key: PresharedKey, session: int, proof: bytes) -> SessionKeys:
    """Derive the keys of a session from the pre-shared key and a cookie (16 bytes)."""
    named = key.id.to_bytes(2, "big") + session.to_bytes(8, "big") + proof
    shared = hashlib.blake2b(named, key=key.secret, digest_size=32, person=b"session").digest()
    to_server = hashlib.blake2b(key=shared, digest_size=32, person=b"c2s").digest()
    to_client = hashlib.blake2b(key=shared, digest_size=32, person=b"s2c").digest()
    return SessionKeys(Tagger(to_server), Tagger(to_client))


def hello_tagger(key: PresharedKey) -> Tagger:
    """Return the tagger of HELLO frames, with the pre-shared key."""
    return Tagger(key.secret, person=b"hello")


def cookie_tagger(key: PresharedKey) -> Tagger:
    """Return the tagger of COOKIE frames, with the pre-shared key."""
    return Tagger(key.secret, person=b"cookie")
