"""Recordings read back: the texts of the cell, the steps and what a replay needs, from MCAP files.

Law of this file: only reading. A recording that ends early is read as far as it goes; what is no
recording is refused with its place. Heavy imports come with the first file.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mcap.records import Message

    from linemate.daemon.recording import StepRecord
    from linemate.daemon.replay import Piece

TOPIC = "/linemate/step"
STATE = "/linemate/state"
PARAMETERS = "/linemate/parameters"
METADATA = "linemate"
LAYOUT = "layout"
MOST_STEPS = 2_000_000
LONGEST_RECORD = 64 * 1_048_576


class UnreadableRecordingError(Exception):
    """A file that is no recording; the message says which and why."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One file.

    Attributes:
        texts: by name, as the daemon left them.
        steps: oldest first.
        whole: the file was finished.
    """

    texts: dict[str, str]
    steps: tuple["StepRecord", ...]
    whole: bool


def read(path: Path) -> Recording:
    """Return what a file holds.

    Raises:
        UnreadableRecordingError: it cannot be opened, or is no recording.
    """
    from linemate.daemon.recording import StepRecord
    from linemate.daemon.replay import Broken, Texts

    texts: dict[str, str] = {}
    steps: list[StepRecord] = []
    whole = True
    for piece in pieces(path):
        if isinstance(piece, Texts):
            texts = dict(piece.texts)
        elif isinstance(piece, Broken):
            whole = False
        elif isinstance(piece, StepRecord) and len(steps) < MOST_STEPS:
            steps.append(piece)
    return Recording(texts, tuple(steps), whole)


def pieces(path: Path) -> Iterator["Piece"]:
    """Return what a replay needs, in its order, as it is read.

    Raises:
        UnreadableRecordingError: it cannot be opened, or is no recording.
    """
    from mcap.records import Message, Metadata

    from linemate.daemon.recording import RecordingError
    from linemate.daemon.replay import Broken, Texts

    layout: dict[str, tuple[str, ...]] | None = None
    topics: dict[int, str] = {}
    try:
        with path.open("rb") as stream:
            for record in records(stream, topics):
                if isinstance(record, Metadata) and record.name == METADATA:
                    layout = layout_of(record.metadata)
                    yield Texts(dict(record.metadata))
                elif isinstance(record, Message) and layout is not None:
                    yield from _piece(topics[record.channel_id], record, layout)
                elif isinstance(record, str):
                    yield Broken(record)
    except OSError as error:
        raise UnreadableRecordingError(f"{path}: {error.strerror}") from error
    except (RecordingError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UnreadableRecordingError(f"{path}: not a linemate recording: {error}") from error
    if layout is None:
        raise UnreadableRecordingError(f"{path}: not a linemate recording")


def records(
    stream: Any, topics: dict[int, str] | None = None, *, chunks: bool = False
) -> Iterator[Any]:
    """Return the records of an MCAP file in their order, and why it breaks off, if it does.

    Args:
        stream: open for reading.
        topics: takes the topic of each channel as it comes.
        chunks: leave chunks as they are.

    Returns:
        Records of the package ``mcap``; a text at last where the file breaks off.
    """
    import struct

    from mcap.exceptions import McapError
    from mcap.records import Channel
    from mcap.stream_reader import CRCValidationError, StreamReader
    from zstandard import ZstdError

    try:
        reader = StreamReader(
            stream,
            emit_chunks=chunks,
            validate_crcs=True,
            record_size_limit=LONGEST_RECORD,
        )
        for record in reader.records:
            if isinstance(record, Channel) and topics is not None:
                topics[record.id] = record.topic
            yield record
    except (
        McapError,
        EOFError,
        RuntimeError,
        ValueError,
        struct.error,  # a record cut short: the package unpacks what is not there
        ZstdError,
        CRCValidationError,
    ) as error:
        yield f"{type(error).__name__}: {error}".rstrip(": ")


def _piece(
    topic: str, message: "Message", layout: Mapping[str, tuple[str, ...]]
) -> "Iterable[Piece]":
    import json

    import msgpack

    from linemate.daemon.recording import decode
    from linemate.daemon.replay import InForce, StateBefore

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
