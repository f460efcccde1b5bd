"""Users of the OPC UA server: a file of names, roles and salted password hashes.

Invariants:
- A line is ``name role salt hash``, the last two in hexadecimal; ``#`` begins a comment.
- A file that others may read is refused, as a key file is.
- A password is compared in constant time, and an unknown name costs as much as a known one.
"""

import hashlib
import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from linemate.daemon.transport.client import KeyFileError, read_private
from linemate.protocol.command.frame_codec import Role

SALT_BYTES: Final = 16
MOST_USERS: Final = 64
LEAST_LENGTH: Final = 8  # of a password
_COST: Final = {"n": 2**14, "r": 8, "p": 1, "dklen": 32}  # scrypt: 40 ms


@dataclass(frozen=True, slots=True)
class PlcUser:
    """A user.

    Attributes:
        digest: scrypt of the password with the salt.
    """

    name: str
    role: Role
    salt: bytes
    digest: bytes


_NO_ONE: Final = PlcUser("", Role.VIEW, bytes(SALT_BYTES), bytes(32))


def user_line(name: str, role: Role, password: str, salt: bytes) -> str:
    """Return the line of a user.

    Raises:
        ValueError: a name or a password that cannot be used.
    """
    if not name or len(name.split()) != 1 or name.startswith("#"):
        raise ValueError(f"{name!r} is not one word")
    if len(password) < LEAST_LENGTH:
        raise ValueError(f"the password has {len(password)} characters, at least {LEAST_LENGTH}")
    return f"{name} {role} {salt.hex()} {_digest(password, salt).hex()}"


def read_users(path: Path) -> dict[str, PlcUser]:
    """Return the users of a file by name.

    Raises:
        KeyFileError: what is wrong with the file.
    """
    users: dict[str, PlcUser] = {}
    for number, line in enumerate(read_private(path).splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        user = parse_line(line)
        if user is None or user.name in users or len(users) >= MOST_USERS:
            raise KeyFileError(f"{path}:{number}: should be a new NAME ROLE SALT HASH")
        users[user.name] = user
    if not users:
        raise KeyFileError(f"{path}: no users. Make a line with `linemate plc-user NAME ROLE`.")
    return users


def role_of(users: Mapping[str, PlcUser], name: str, password: str) -> Role | None:
    """Return the role of a user with the right password, None with a wrong one."""
    user = users.get(name, _NO_ONE)
    is_right = hmac.compare_digest(_digest(password, user.salt), user.digest)
    return user.role if is_right and user is not _NO_ONE else None


def parse_line(line: str) -> PlcUser | None:
    """Return the user of a line, None for one that is malformed."""
    try:
        name, role, salt, digest = line.split()
        return PlcUser(name, Role(role), bytes.fromhex(salt), bytes.fromhex(digest))
    except ValueError:
        return None


def _digest(password: str, salt: bytes) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, **_COST)
