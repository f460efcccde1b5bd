"""Recordings read back: the texts of the cell, the steps and what a replay needs, from MCAP files.

Invariants:
    * Every reader of recordings reads through ``records``, which is bounded.
    * A damaged recording is read as far as it is good, and says that it is damaged.
    * Heavy imports come with the first file.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mcap.records import Message

    from linemate.daemon.recording.bounded_mcap import Damage
    from linemate.daemon.recording.recording import StepRecord
    from linemate.daemon.recording.replay import Broken, Piece

TOPIC = "/linemate/step"
STATE = "/linemate/state"
PARAMETERS = "/linemate/parameters"
METADATA = "linemate"
LAYOUT = "layout"
MOST_STEPS = 2_000_000


class UnreadableRecordingError(Exception):
    """A file that is no recording; the message says which and why."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One file.

    Attributes:
        texts: by name, as the daemon left them.
        damage: why not all of it could be read, and how many steps were; None if it is whole.
    """

    texts: dict[str, str]
    steps: tuple["StepRecord", ...]
    damage: "Broken | None" = None

    @property
    def whole(self) -> bool:
        """All of it was read."""
        return self.damage is None


def read(path: Path) -> Recording:
    """Return what a file holds.

    Raises:
        UnreadableRecordingError: it cannot be opened, or is no recording.
    """
    from linemate.daemon.recording.recording import StepRecord
    from linemate.daemon.recording.replay import Broken, Texts

    texts: dict[str, str] = {}
    steps: list[StepRecord] = []
    damage: Broken | None = None
    for piece in pieces(path):
        if isinstance(piece, Texts):
            texts = dict(piece.texts)
        elif isinstance(piece, Broken):
            damage = piece
        elif isinstance(piece, StepRecord) and len(steps) < MOST_STEPS:
            steps.append(piece)
    return Recording(texts, tuple(steps), damage)


def pieces(path: Path) -> Iterator["Piece"]:
    """Return what a replay needs, in its order, as it is read.

    Raises:
        UnreadableRecordingError: it cannot be opened, or is no recording.
    """
    from mcap.records import Message, Metadata

    from linemate.daemon.recording.bounded_mcap import Damage
    from linemate.daemon.recording.recording import RecordingError
    from linemate.daemon.recording.replay import Texts

    layout: dict[str, tuple[str, ...]] | None = None
    topics: dict[int, str] = {}
    steps = 0
    try:
        with path.open("rb") as stream:
            for record in records(stream, topics):
                if isinstance(record, Metadata) and record.name == METADATA:
                    layout = layout_of(record.metadata)
                    yield Texts(dict(record.metadata))
                elif isinstance(record, Message) and layout is not None:
                    topic = topics[record.channel_id]
                    yield from _piece(topic, record, layout)
                    steps += topic == TOPIC
                elif isinstance(record, Damage):
                    yield broken(record, steps)
    except OSError as error:
        raise UnreadableRecordingError(f"{path}: {error.strerror}") from error
    except (RecordingError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UnreadableRecordingError(f"{path}: not a linemate recording: {error}") from error
    if layout is None:
        raise UnreadableRecordingError(f"{path}: not a linemate recording")


def broken(damage: "Damage", steps: int) -> "Broken":
    """Return a file's damage as a piece of a recording.

    Args:
        damage: as ``records`` tells it.
    """
    from linemate.daemon.recording.replay import Broken

    return Broken(damage.reason, steps, None if damage.counts is None else damage.counts[TOPIC])


def records(
    stream: Any, topics: dict[int, str] | None = None, skipped: list[str] | None = None
) -> Iterator[Any]:
    """Return the records of an MCAP file in their order, and at last its ``Damage``, if any.

    Args:
        stream: open for reading, seekable.
        topics: takes the topic of each channel as it comes.
        skipped: takes the reason of each damaged chunk, which is passed over.
    """
    from linemate.daemon.recording import bounded_mcap

    return bounded_mcap.records(stream, topics, skipped)


def _piece(
    topic: str, message: "Message", layout: Mapping[str, tuple[str, ...]]
) -> "Iterable[Piece]":
    import json

    import msgpack

    from linemate.daemon.recording.recording import decode
    from linemate.daemon.recording.replay import InForce, StateBefore

    if topic == TOPIC:
        yield decode(message.data, layout)
    elif topic == STATE:
        k, data, anew = msgpack.unpackb(message.data)
        yield StateBefore(k, data, anew)
    elif topic == PARAMETERS:
        told = json.loads(message.data)
        yield InForce(told["k"], told["settings"])


def layout_of(metadata: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Return the fields of a recording's steps, as it tells them itself.

    Raises:
        KeyError, ValueError: it does not.
    """
    import json

    return {name: tuple(fields) for name, fields in json.loads(metadata[LAYOUT]).items()}
