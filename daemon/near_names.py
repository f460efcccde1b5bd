"""Suggest names that are near an unknown one."""

from collections.abc import Iterable

LIKENESS = 0.6  # of 1: what is less alike is not suggested


def near_names(name: str, known: Iterable[str]) -> str:
    """Return ``; near is a`` or ``; near are a, b``, empty if no known name is near."""
    import difflib  # Only a wrong name pays for it: a status must start at once.

    near = difflib.get_close_matches(name, dict.fromkeys(known), cutoff=LIKENESS)
    if not near:
        return ""
    return f"; near {'is' if len(near) == 1 else 'are'} {', '.join(near)}"
