"""MCAP file of one recording: steps, messages for viewers, log lines and cycle times.

Invariants:
- Synchronous, without a clock. A chunk ends at ``flush``; a sudden end loses what came after it.
- Nothing of daemon.core is imported, so that the writer process starts with little.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any, BinaryIO, Final

from mcap.writer import CompressionType, Writer

from linemate.daemon.cycle.clock.timing import COLUMNS
from linemate.daemon.recording import viewer_messages
from linemate.daemon.recording.format import (
    ENCODING,
    LOG,
    METADATA,
    PARAMETERS,
    STATE,
    STEP,
    TIMING,
    Item,
    ItemKind,
)

_ANY: Final = {"type": "object"}
_BINARY: Final = frozenset({STEP, STATE})
_SCHEMA_OF: Final = {
    STEP: "linemate.Step",
    STATE: "linemate.State",
    PARAMETERS: "linemate.Parameters",
    TIMING: "linemate.Timing",
    **viewer_messages.TOPICS,
}
_TOPIC_OF: Final = {ItemKind.STEP: STEP, ItemKind.STATE: STATE, ItemKind.PARAMETERS: PARAMETERS}


def _version() -> str:
    try:
        return version("linemate")
    except PackageNotFoundError:
        return ""


_PROGRAM: Final = _version()


class StepFile:
    """One MCAP file.

    Args:
        stream: open for writing and empty; closed with the file.
        metadata: text by name, as ``step_items.metadata_of`` returns them.
        chunk_bytes: size of a chunk before compression.
        wall_offset_ns: from monotonic stamps to the times of the file [ns].
    """

    def __init__(
        self,
        stream: BinaryIO,
        metadata: Mapping[str, str],
        chunk_bytes: int = 65_536,
        wall_offset_ns: int = 0,
    ) -> None:
        self._stream = stream
        self._offset_ns = wall_offset_ns
        self._writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="linemate")
        self._writer.add_metadata(METADATA, {"program": _PROGRAM, **metadata})
        urdf = metadata.get("urdf", "")
        self._root = viewer_messages.root_link(urdf)
        if urdf:
            now_ns = max(wall_offset_ns, 0)
            self._writer.add_attachment(now_ns, now_ns, "arm.urdf", "text/xml", urdf.encode())
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences: dict[int, int] = {}
        self._channel(STEP)

    def write(self, stamp_ns: int, data: bytes) -> None:
        """Write the bytes of one step, of ``step_codec.encode``, at its time [ns]."""
        self._add(STEP, stamp_ns, data)

    def write_item(self, item: Item) -> None:
        """Write an item.

        Raises:
            OSError: the disk is full, or another error of the file system.
        """
        stamp_ns, payload = item.stamp_ns, item.payload
        wall_ns = stamp_ns + self._offset_ns
        if item.kind in _TOPIC_OF:
            self._add(_TOPIC_OF[item.kind], stamp_ns, payload)
        elif item.kind is ItemKind.SHOWN:
            view = viewer_messages.StepView(*payload)
            for topic, data in viewer_messages.encode_view(view, wall_ns, self._root):
                self._add(topic, stamp_ns, data)
        elif item.kind is ItemKind.TIMING:
            self._add(TIMING, stamp_ns, _encode_timing(payload))
        elif item.kind is ItemKind.LINE:
            text, *level_and_name = payload
            self._add(LOG, stamp_ns, viewer_messages.encode_line(text, wall_ns, *level_and_name))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach bytes of another format under a name."""
        now_ns = max(self._offset_ns, 0)
        self._writer.add_attachment(now_ns, now_ns, name, media_type, data)

    def flush(self) -> None:
        """Give everything written so far to the operating system, as a chunk of its own."""
        # The package ends a chunk by its size only and has no other call for it.
        finish_chunk: Callable[[], None] = getattr(self._writer, "_Writer__finalize_chunk")  # noqa: B009
        finish_chunk()
        self._stream.flush()

    def size(self) -> int:
        """Return the bytes in the file so far."""
        return self._stream.tell()

    def close(self) -> None:
        """Finish the file. The stream is closed even if that fails."""
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
            is_binary = topic in _BINARY
            if name not in self._schemas:
                definition = viewer_messages.SCHEMAS.get(name, _ANY)
                data = b"" if is_binary else json.dumps(definition).encode()
                kind = "" if is_binary else "jsonschema"
                self._schemas[name] = self._writer.register_schema(name, kind, data)
            encoding = ENCODING if is_binary else "json"
            self._channels[topic] = self._writer.register_channel(
                topic, encoding, self._schemas[name]
            )
        return self._channels[topic]


def _encode_timing(values: Sequence[Any]) -> bytes:
    named = zip(COLUMNS, values, strict=True)
    return viewer_messages.as_json({name: value for name, value in named if value is not None})
