"""Recordings read back: the texts of the cell and the steps, from MCAP files.

Law of this file: only reading. A recording that ends early is read as far as it goes; what is no
recording is refused with its place. Heavy imports come with the first file.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from linemate.daemon.recording import StepRecord

TOPIC = "/linemate/step"
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
    import json

    from linemate.daemon.recording import RecordingError, decode

    texts: dict[str, str] = {}
    steps: list[StepRecord] = []
    layout = None
    whole = True
    try:
        with path.open("rb") as stream:
            for record in _records(stream):
                if record is None:
                    whole = False
                elif isinstance(record, dict):
                    texts = record
                    layout = {
                        name: tuple(fields) for name, fields in json.loads(texts[LAYOUT]).items()
                    }
                elif layout is not None and len(steps) < MOST_STEPS:
                    steps.append(decode(record, layout))
    except OSError as error:
        raise UnreadableRecordingError(f"{path}: {error.strerror}") from error
    except (RecordingError, ValueError, KeyError, AttributeError) as error:
        raise UnreadableRecordingError(f"{path}: not a linemate recording: {error}") from error
    if layout is None:
        raise UnreadableRecordingError(f"{path}: not a linemate recording")
    return Recording(texts, tuple(steps), whole)


def _records(stream: Any) -> Iterator[dict[str, str] | bytes | None]:
    """Return metadata as dict, messages as bytes, and None if the file breaks off."""
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message, Metadata
    from mcap.stream_reader import StreamReader

    topics: set[int] = set()
    try:
        for record in StreamReader(stream).records:
            if isinstance(record, Metadata) and record.name == METADATA:
                yield dict(record.metadata)
            elif isinstance(record, Channel) and record.topic == TOPIC:
                topics.add(record.id)
            elif isinstance(record, Message) and record.channel_id in topics:
                yield record.data
    except (McapError, EOFError, RuntimeError):
        yield None
