"""Resident memory of a process by part, from its ``smaps``."""

from __future__ import annotations

from pathlib import Path
from typing import Final

LIBRARIES: Final = (
    ("BLAS of numpy and scipy", ("openblas",)),
    ("numpy", ("numpy",)),
    ("scipy", ("scipy",)),
    ("pinocchio and what it needs", ("cmeel",)),
    ("Python", ("python", "lib-dynload")),
)
"""Part, and what the path of one of its mappings contains; the first that fits."""

OTHERS: Final = "other libraries and files"
ANONYMOUS: Final = "anonymous: heap, stacks, buffers"


def part_of(path: str) -> str:
    """Return the part of a mapping's path."""
    if not path.startswith("/"):
        return ANONYMOUS
    for part, words in LIBRARIES:
        if any(word in path for word in words):
            return part
    return OTHERS


def by_part(smaps: str) -> dict[str, float]:
    """Return the resident memory by part [MiB] of the text of ``/proc/PID/smaps``.

    Pages of a library that the process has written are private, and count for the library.
    """
    parts: dict[str, int] = {}
    part = ANONYMOUS
    for line in smaps.splitlines():
        words = line.split()
        if words and "-" in words[0] and not words[0].endswith(":"):
            part = part_of(words[5] if len(words) > 5 else "")
        elif words and words[0] == "Rss:":
            parts[part] = parts.get(part, 0) + int(words[1])
    return {part: round(kib / 1024, 1) for part, kib in sorted(parts.items()) if kib}


def resident() -> dict[str, float]:
    """Return the resident memory of this process by part [MiB]."""
    return by_part(Path("/proc/self/smaps").read_text(encoding="utf-8"))
