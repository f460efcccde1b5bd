"""What is wrong with a file, before its lines are known."""

from dataclasses import dataclass

Path = tuple[str | int, ...]  # keys and indices from the root of the values
Place = tuple[int, int]  # line and column, from 1


@dataclass(frozen=True, slots=True)
class Complaint:
    """One thing that is wrong.

    Attributes:
        path: where in the values.
        what: message for the author of the file.
        at_key: the key is wrong, not its value.
        place: where, if the path does not say it.
    """

    path: Path
    what: str
    at_key: bool = False
    place: Place | None = None
