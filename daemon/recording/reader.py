"""Reader of recordings: cell texts, steps, states and parameters from an MCAP file.

Invariants:
- Every reader of recordings uses ``records``, which bounds memory and time.
- A damaged file yields its good records and then its damage.
- numpy, msgpack and mcap are imported with the first file, not with the operator's tool.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from linemate.daemon.recording.format import (
    BAD_CONTENT,
    LAYOUT,
    METADATA,
    PARAMETERS,
    STATE,
    STEP,
    CellTexts,
    DamageReport,
    ParametersInForce,
    StateBefore,
    UnreadableRecordingError,
)

if TYPE_CHECKING:
    from mcap.records import Message

    from linemate.daemon.recording.bounded_mcap import Damage
    from linemate.daemon.recording.step_codec import StepRecord
    from linemate.daemon.recording.step_replay import Piece

MOST_STEPS = 2_000_000


@dataclass(frozen=True, slots=True)
class Recording:
    """One file.

    Attributes:
        texts: texts of the cell by name.
        steps: at most MOST_STEPS, oldest first.
        damage: None if the file is whole.
    """

    texts: dict[str, str]
    steps: tuple["StepRecord", ...]
    damage: DamageReport | None = None

    @property
    def whole(self) -> bool:
        """All of it was read."""
        return self.damage is None


def read(path: Path) -> Recording:
    """Read a whole file.

    Raises:
        UnreadableRecordingError: it cannot be opened, or is not a recording.
    """
    from linemate.daemon.recording.step_codec import StepRecord

    texts: dict[str, str] = {}
    steps: list[StepRecord] = []
    damage: DamageReport | None = None
    for piece in pieces(path):
        if isinstance(piece, CellTexts):
            texts = dict(piece.texts)
        elif isinstance(piece, DamageReport):
            damage = piece
        elif isinstance(piece, StepRecord) and len(steps) < MOST_STEPS:
            steps.append(piece)
    return Recording(texts, tuple(steps), damage)


def pieces(path: Path) -> Iterator["Piece"]:
    """Yield what a replay needs, in the order of the file.

    Raises:
        UnreadableRecordingError: it cannot be opened, or is not a recording.
    """
    from mcap.records import Message, Metadata

    from linemate.daemon.recording.bounded_mcap import Damage

    layout: dict[str, tuple[str, ...]] | None = None
    topics: dict[int, str] = {}
    steps = 0
    try:
        with path.open("rb") as stream:
            for record in records(stream, topics):
                if isinstance(record, Metadata) and record.name == METADATA:
                    layout = layout_of(record.metadata)
                    yield CellTexts(dict(record.metadata))
                elif isinstance(record, Message) and layout is not None:
                    topic = topics[record.channel_id]
                    piece = _piece(topic, record, layout)
                    if piece is not None:
                        yield piece
                    steps += topic == STEP
                elif isinstance(record, Damage):
                    yield damage_report(record, steps)
    except OSError as error:
        raise UnreadableRecordingError(f"{path}: {error.strerror}") from error
    except BAD_CONTENT as error:
        raise UnreadableRecordingError(f"{path}: not a linemate recording: {error}") from error
    if layout is None:
        raise UnreadableRecordingError(f"{path}: not a linemate recording")


def damage_report(damage: "Damage", steps: int) -> DamageReport:
    """Return a file's damage as a piece of a recording.

    Args:
        steps: number of steps that were read before it.
    """
    return DamageReport(
        damage.reason, steps, None if damage.counts is None else damage.counts[STEP]
    )


def records(
    stream: Any, topics: dict[int, str] | None = None, skipped: list[str] | None = None
) -> Iterator[Any]:
    """Yield the records of an MCAP file as ``bounded_mcap.records`` does."""
    from linemate.daemon.recording import bounded_mcap

    return bounded_mcap.records(stream, topics, skipped)


def _piece(topic: str, message: "Message", layout: Mapping[str, tuple[str, ...]]) -> "Piece | None":
    import msgpack

    from linemate.daemon.recording.step_codec import decode

    if topic == STEP:
        return decode(message.data, layout)
    if topic == STATE:
        return StateBefore(*msgpack.unpackb(message.data))
    if topic == PARAMETERS:
        content = json.loads(message.data)
        return ParametersInForce(content["k"], content["settings"])
    return None


def layout_of(metadata: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Return the field names of a recording's steps from its metadata.

    Raises:
        KeyError, ValueError: the metadata has none.
    """
    return {name: tuple(fields) for name, fields in json.loads(metadata[LAYOUT]).items()}
