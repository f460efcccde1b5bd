"""Find the process that has a UDP port, from the kernel's tables in /proc.

Invariants:
    What cannot be read, or has ended, gives no answer and no error.
"""

import errno
from pathlib import Path

PROC = Path("/proc")
TABLES = ("net/udp", "net/udp6")
_LOCAL, _INODE = 1, 9  # columns of those tables


def describe_holder(error: BaseException | None, port: int, proc: Path = PROC) -> str:
    """Return `` (process 12, name)`` of a port that is in use, empty for any other error.

    It reads the tables of every process: call it at the start only.

    Args:
        error: why the port cannot be bound.
        proc: folder of the kernel's tables.
    """
    is_taken = getattr(error, "errno", None) == errno.EADDRINUSE
    pid = holder(port, proc) if is_taken else None
    if pid is None:
        return ""
    try:
        name = (proc / str(pid) / "comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return f" (process {pid})"
    return f" (process {pid}, {name})"


def holder(port: int, proc: Path = PROC) -> int | None:
    """Return the process that has a UDP port, None if none can be seen."""
    sockets = {f"socket:[{inode}]" for inode in _inodes(port, proc)}
    if not sockets:
        return None
    for entry in sorted(proc.iterdir()):
        if entry.name.isdigit() and _holds(entry / "fd", sockets):
            return int(entry.name)
    return None


def _inodes(port: int, proc: Path) -> set[str]:
    """Return the sockets that are bound to a port."""
    inodes = set()
    for table in TABLES:
        try:
            rows = (proc / table).read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue
        for row in map(str.split, rows):
            if int(row[_LOCAL].rpartition(":")[2], 16) == port:
                inodes.add(row[_INODE])
    return inodes


def _holds(folder: Path, sockets: set[str]) -> bool:
    try:
        return any(_target(descriptor) in sockets for descriptor in folder.iterdir())
    except OSError:
        return False


def _target(descriptor: Path) -> str:
    try:
        return str(descriptor.readlink())
    except OSError:
        return ""
