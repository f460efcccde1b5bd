"""Who has a UDP port that is taken.

Law of this file: the kernel's tables are read and nobody is asked; what may not be seen, or is
gone meanwhile, is no answer and no error.
"""

import errno
from pathlib import Path

PROC = Path("/proc")
TABLES = ("net/udp", "net/udp6")
_LOCAL, _INODE = 1, 9
"""Columns of the kernel's tables."""


def told(error: BaseException | None, port: int, proc: Path = PROC) -> str:
    """What to add to a complaint that a port cannot be had: who has it, empty if nobody is seen.

    It looks at every process: for the start, never in motion.

    Args:
        error: why it cannot; only of one that is in use there is somebody to name.
        proc: where the kernel's tables are.
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
    """The process that has a UDP port; None if there is none, or none that may be seen."""
    sockets = {f"socket:[{inode}]" for inode in _inodes(port, proc)}
    if not sockets:
        return None
    for entry in sorted(proc.iterdir()):
        if entry.name.isdigit() and _holds(entry / "fd", sockets):
            return int(entry.name)
    return None


def _inodes(port: int, proc: Path) -> set[str]:
    """Sockets that are bound to a port."""
    found = set()
    for table in TABLES:
        try:
            rows = (proc / table).read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue
        for row in map(str.split, rows):
            if int(row[_LOCAL].rpartition(":")[2], 16) == port:
                found.add(row[_INODE])
    return found


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
