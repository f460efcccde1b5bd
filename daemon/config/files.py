"""Files: the path of a named one, its content within a limit, and a new content in one step.

Invariants:
- A relative name is searched next to the file that names it, then a bare name in the shipped files.
- Only regular files are read, and never more than a limit.
"""

import os
import stat
import tempfile
from pathlib import Path

import linemate.daemon
import linemate.protocol

DAEMON_DATA = Path(linemate.daemon.__path__[0]) / "data"
PROTOCOL_DATA = Path(linemate.protocol.__path__[0]) / "data"


class UnreadableError(Exception):
    """A file that cannot be read; the message gives the path and the reason."""


def find(name: str, base: Path, shipped: Path) -> Path:
    """Return the path of a named file.

    Args:
        base: directory of the file that names it.
        shipped: directory of the shipped files.

    Raises:
        UnreadableError: there is none.
    """
    path = base / name
    if os.path.lexists(path):  # a broken link too: a shipped file of that name is another arm
        return path
    bare = Path(name).name == name
    if bare and (shipped / name).is_file():
        return shipped / name
    if not bare:
        raise UnreadableError(f"no such file: {path}")
    suffix = Path(name).suffix
    known = sorted(file.name for file in shipped.iterdir() if file.suffix == suffix)
    raise UnreadableError(f"no such file: {path}; shipped are {', '.join(known) or 'none'}")


def read(path: Path, limit: int) -> bytes:
    """Return a file's bytes.

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
    """Return a file's text.

    Raises:
        UnreadableError: as ``read``, or not UTF-8.
    """
    try:
        return read(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UnreadableError(f"{path}: not UTF-8 at byte {error.start}") from error


def write(path: Path, text: str) -> None:
    """Write a file in one step, also against a power cut: all of it, or the one before stays.

    Raises:
        OSError: it cannot be written.
    """
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
