"""The command server's key file: its path and its keys."""

import os
from pathlib import Path

from linemate.daemon.config.files import UnreadableError
from linemate.protocol.command.frame_codec import CommandError
from linemate.protocol.command.preshared_keys import PresharedKey, parse_keys, unsafe_file

CREDENTIAL = "credential:"
MAX_BYTES = 65_536


def key_path(name: str, base: Path) -> Path:
    """Return the path of a key file.

    Args:
        name: a path, or ``credential:NAME`` for systemd's LoadCredential.
        base: directory of the configuration file.

    Raises:
        ValueError: a credential outside a systemd service.
    """
    if not name.startswith(CREDENTIAL):
        return base / name
    directory = os.environ.get("CREDENTIALS_DIRECTORY")
    if directory is None:
        raise ValueError(
            "no credentials here: $CREDENTIALS_DIRECTORY is not set. "
            "Add LoadCredential= to the unit."
        )
    return Path(directory) / Path(name.removeprefix(CREDENTIAL)).name


def read_keys(path: Path) -> tuple[PresharedKey, ...]:
    """Read a key file, which must belong to the daemon's user or root.

    Raises:
        UnreadableError: missing, another user's, readable by others, or malformed: every line.
    """
    try:
        with open(path, encoding="utf-8", opener=_open) as file:
            status = os.fstat(file.fileno())
            unsafe = unsafe_file(status.st_mode, status.st_uid, os.geteuid())
            if unsafe is not None:
                raise UnreadableError(f"{path}: {unsafe}")
            return parse_keys(file.read(MAX_BYTES), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise UnreadableError(f"{path}: {error}") from error
    except CommandError as error:
        raise UnreadableError(error.detail) from error


def _open(name: str, flags: int) -> int:
    """Open a file; a fifo would block until another process writes to it."""
    return os.open(name, flags | os.O_NONBLOCK)
