"""Files that other files name: found, and read within a limit.

Law of this file: a relative name is looked for beside the file that names it, and a bare name
among the shipped files after that. Only regular files are read, and never more than a limit.
"""

import stat
from pathlib import Path

import linemate.daemon
import linemate.protocol

DAEMON_DATA = Path(linemate.daemon.__path__[0]) / "data"
PROTOCOL_DATA = Path(linemate.protocol.__path__[0]) / "data"


class UnreadableError(Exception):
    """A file that cannot be had; the message says which and why."""


def find(name: str, base: Path, shipped: Path) -> Path:
    """Where a named file is.

    Args:
        base: directory of the file that names it.
        shipped: directory of the shipped files.

    Raises:
        UnreadableError: there is none.
    """
    beside = base / name
    if beside.exists():
        return beside
    bare = Path(name).name == name
    if bare and (shipped / name).is_file():
        return shipped / name
    if not bare:
        raise UnreadableError(f"no such file: {beside}")
    suffix = Path(name).suffix
    known = sorted(path.name for path in shipped.iterdir() if path.suffix == suffix)
    raise UnreadableError(f"no such file: {beside}; shipped are {', '.join(known) or 'none'}")


def read(path: Path, limit: int) -> bytes:
    """A file's bytes.

    Args:
        limit: longest file accepted [bytes].

    Raises:
        UnreadableError: missing, not a regular file, not permitted, or too long.
    """
    try:
        # A fifo or a device would block or never end.
        if not stat.S_ISREG(path.stat().st_mode):
            raise UnreadableError(f"not a regular file: {path}")
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UnreadableError(f"{path}: {reason}") from error
    if len(data) > limit:
        raise UnreadableError(f"longer than {limit} bytes: {path}")
    return data


def read_text(path: Path, limit: int) -> str:
    """A file's text.

    Raises:
        UnreadableError: as ``read``, or not UTF-8.
    """
    try:
        return read(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UnreadableError(f"{path}: not UTF-8 at byte {error.start}") from error
