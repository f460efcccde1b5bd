"""One recording: an MCAP file with every step, and what viewers and a replay need beside them.

Law of this file: synchronous, and no clock; items in, bytes out. A chunk ends when told to, so
that a sudden death loses no more than since then. It knows nothing of a step, so that the process
that writes has nothing of it to load.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum, auto
from typing import Any, BinaryIO, Final, NamedTuple

from mcap.writer import CompressionType, Writer

from linemate.daemon.cycle.clock.timing import COLUMNS
from linemate.daemon.recording import viewer_messages

TOPIC: Final = "/linemate/step"
STATE: Final = "/linemate/state"
PARAMETERS: Final = "/linemate/parameters"
TIMING: Final = "/linemate/timing"
LOG: Final = "/log"
STATE_LOG: Final = "linemated.state"
"""Name of the lines in ``/log`` that tell changes of the operating state."""

ENCODING: Final = "msgpack"
METADATA: Final = "linemate"
LAYOUT: Final = "layout"

_ANY: Final = {"type": "object"}


class Kind(IntEnum):
    """What an item is; its payload in brackets, plain values throughout."""

    STEP = auto()  # bytes of recording.encode
    STATE = auto()  # bytes of msgpack: k, the state, whether the step before led elsewhere
    PARAMETERS = auto()  # bytes of JSON
    SHOWN = auto()  # the fields of viewer_messages.Glimpse
    TIMING = auto()  # those of CycleTimes
    LINE = auto()  # (text, level), and the name of who writes it if it is not the daemon
    NEXT_FILE = auto()  # None
    END = auto()  # None: of the recording


class Item(NamedTuple):
    """Something to be written.

    Attributes:
        stamp_ns: its time [ns].
    """

    kind: Kind
    stamp_ns: int
    payload: Any = None


class StepFile:
    """One MCAP file; synchronous.

    Args:
        stream: open for writing, empty; it is closed with the file.
        metadata: text by name: whatever a replay needs, ``step_feed.described`` among it.
        chunk_bytes: size of a chunk.
        wall_offset_ns: from monotonic stamps to the times of the file [ns].

    Attributes:
        bytes: of payload, before compression.
    """

    def __init__(
        self,
        stream: BinaryIO,
        metadata: Mapping[str, str],
        chunk_bytes: int = 65_536,
        wall_offset_ns: int = 0,
    ) -> None:
        self.written = 0
        self._stream = stream
        self._offset_ns = wall_offset_ns
        self._writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="linemate")
        self._writer.add_metadata(METADATA, dict(metadata))
        urdf = metadata.get("urdf", "")
        self._root = viewer_messages.root_link(urdf)
        if urdf:
            now_ns = max(wall_offset_ns, 0)
            self._writer.add_attachment(now_ns, now_ns, "arm.urdf", "text/xml", urdf.encode())
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences: dict[int, int] = {}
        self._channel(TOPIC)

    def write(self, stamp_ns: int, data: bytes) -> None:
        """Add one step.

        Args:
            stamp_ns: of the step [ns].
            data: as ``recording.encode`` made it.
        """
        self._add(TOPIC, stamp_ns, data)
        self.written += 1

    def put(self, item: Item) -> None:
        """Add an item.

        Raises:
            OSError: the disk refuses.
        """
        stamp, payload = item.stamp_ns, item.payload
        if item.kind is Kind.STEP:
            self.write(stamp, payload)
        elif item.kind is Kind.STATE:
            self._add(STATE, stamp, payload)
        elif item.kind is Kind.PARAMETERS:
            self._add(PARAMETERS, stamp, payload)
        elif item.kind is Kind.SHOWN:
            seen = viewer_messages.Glimpse(*payload)
            for topic, data in viewer_messages.shown(seen, stamp + self._offset_ns, self._root):
                self._add(topic, stamp, data)
        elif item.kind is Kind.TIMING:
            self._add(TIMING, stamp, _timing(payload))
        elif item.kind is Kind.LINE:
            self._add(LOG, stamp, _line(stamp + self._offset_ns, *payload))

    def flush(self) -> None:
        """Give everything written so far to the operating system, as a chunk of its own."""
        # The package ends a chunk by its size alone and offers no other way.
        finish_chunk: Callable[[], None] = getattr(self._writer, "_Writer__finalize_chunk")  # noqa: B009
        finish_chunk()
        self._stream.flush()

    def size(self) -> int:
        """Bytes in the file so far."""
        return self._stream.tell()

    def close(self) -> None:
        """Finish the file; the stream is closed whatever happens."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._stream.close()

    def _add(self, topic: str, stamp_ns: int, data: bytes) -> None:
        channel = self._channel(topic)
        number = self._sequences.get(channel, 0)
        self._sequences[channel] = number + 1
        wall_ns = max(stamp_ns + self._offset_ns, 0)
        self._writer.add_message(channel, wall_ns, data, max(stamp_ns, 0), number & 0xFFFFFFFF)

    def _channel(self, topic: str) -> int:
        if topic not in self._channels:
            name = _SCHEMA_OF[topic]
            binary = topic in {TOPIC, STATE}
            if name not in self._schemas:
                definition = viewer_messages.SCHEMAS.get(name, _ANY)
                data = b"" if binary else json.dumps(definition).encode()
                kind = "" if binary else "jsonschema"
                self._schemas[name] = self._writer.register_schema(name, kind, data)
            encoding = ENCODING if binary else "json"
            self._channels[topic] = self._writer.register_channel(
                topic, encoding, self._schemas[name]
            )
        return self._channels[topic]


_SCHEMA_OF: Final = {
    TOPIC: "linemate.Step",
    STATE: "linemate.State",
    PARAMETERS: "linemate.Parameters",
    TIMING: "linemate.Timing",
    **viewer_messages.TOPICS,
}


def _line(wall_ns: int, text: str, level: int, name: str = "linemated") -> bytes:
    return viewer_messages.line(text, wall_ns, level, name)


def _timing(values: Sequence[Any]) -> bytes:
    named = zip(COLUMNS, values, strict=True)
    return viewer_messages.as_json({name: value for name, value in named if value is not None})
