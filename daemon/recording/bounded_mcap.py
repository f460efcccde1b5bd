"""MCAP files read within bounds of memory and time.

Invariants:
    * No record, chunk or message larger than its limit is read or unpacked.
    * All chunks together unpack to no more than ``SPARE_BYTES`` and ``RATIO`` for each byte read.
    * A file that is damaged yields its good records, and then one ``Damage``.
"""

import io
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

import zstandard
from lz4 import frame as lz4_frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    Message,
    Metadata,
    Schema,
    Statistics,
)

MIB: Final = 1_048_576
LARGEST_RECORD: Final = 16 * MIB
LARGEST_CHUNK: Final = 16 * MIB  # unpacked; the daemon writes at most 4 MiB and one message
LARGEST_MESSAGE: Final = MIB  # the largest that the daemon writes has some 10 KiB

SPARE_BYTES: Final = 8 * MIB  # unpacked bytes that any file may have
RATIO: Final = 100  # and so many for each byte read; real recordings reach 22

MAGIC: Final = b"\x89MCAP0\r\n"
_HEAD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_FOOTER_BYTES: Final = _HEAD.size + 20

_KINDS: Final[dict[int, Any]] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
    Opcode.DATA_END: DataEnd,
}
"""Records that are read; indexes and unknown records are passed over."""

_UNREADABLE: Final = (
    McapError, EOFError, RuntimeError, ValueError, KeyError, OverflowError, struct.error,
    zstandard.ZstdError,
)  # fmt: skip
"""What the packages raise for bytes that are no record."""


@dataclass(frozen=True, slots=True)
class Damage:
    """The file cannot be read further, or does not hold what its own statistics say.

    Attributes:
        reason: what is wrong, with value and limit.
        counts: messages by topic that the file should hold; None where its end is missing.
    """

    reason: str
    counts: Counter[str] | None


class _DamagedError(Exception):
    """A record that cannot be read; the message says why."""


class _DamagedChunkError(_DamagedError):
    """A chunk that cannot be unpacked; the record after it may be whole."""


def records(
    stream: BinaryIO, topics: dict[int, str] | None = None, skipped: list[str] | None = None
) -> Iterator[Any]:
    """Return the records of an MCAP file in their order, and its damage, if there is any.

    Args:
        stream: open for reading, seekable.
        topics: takes the topic of each channel as it comes.
        skipped: takes the reason of each damaged chunk, which is passed over; without it a
            damaged chunk ends the reading.

    Returns:
        Records of the package ``mcap``, those of chunks among them; one ``Damage`` at last.
    """
    reader = _Reader(stream, {} if topics is None else topics, skipped)
    try:
        yield from reader.records()
    except _DamagedError as error:
        yield Damage(str(error), promised(stream))
        return
    if not skipped and reader.missing:
        yield Damage(f"{reader.missing} messages are missing", promised(stream))


def promised(stream: BinaryIO) -> Counter[str] | None:
    """Return how many messages of each topic a file's own statistics name.

    Args:
        stream: of the file; it is left at another place.

    Returns:
        None where the end of the file is missing or damaged.
    """
    try:
        size = stream.seek(0, io.SEEK_END)
        stream.seek(max(0, size - _FOOTER_BYTES - len(MAGIC)))
        footer = _read_record(stream)
        if not isinstance(footer, Footer) or not 0 < footer.summary_start < size:
            return None
        stream.seek(footer.summary_start)
        summary = stream.read(min(size - footer.summary_start, LARGEST_RECORD))
        return _counts(io.BytesIO(summary))
    except (OSError, _DamagedError):
        return None


def _counts(summary: BinaryIO) -> Counter[str] | None:
    topics: dict[int, str] = {}
    statistics: Statistics | None = None
    while not isinstance(record := _read_record(summary), Footer):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Statistics):
            statistics = record
    if statistics is None:
        return None
    counts: Counter[str] = Counter()
    for number, count in statistics.channel_message_counts.items():
        counts[topics.get(number, "")] += count
    return counts


def _read_head(stream: BinaryIO) -> tuple[int, int, bytes]:
    """Return opcode, length and the bytes of a record's head.

    Raises:
        _DamagedError: the file ends, or the record is too large.
    """
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise _DamagedError("the file ends early")
    opcode, length = _HEAD.unpack(head)
    if length > LARGEST_RECORD:
        raise _DamagedError(f"a record is too large: {length} bytes, limit {LARGEST_RECORD}")
    return opcode, length, head


def _read_body(stream: BinaryIO, length: int) -> bytes:
    body = stream.read(length)
    if len(body) < length:
        raise _DamagedError("the file ends early, within a record")
    return body


def _read_record(stream: BinaryIO) -> Any:
    opcode, length, _ = _read_head(stream)
    return _parsed(opcode, _read_body(stream, length))


def _parsed(opcode: int, body: bytes) -> Any:
    """Return a record, None for one that is passed over."""
    if opcode == Opcode.MESSAGE:
        return _message(body)
    kind = _KINDS.get(opcode)
    if kind is None:
        return None
    try:
        return kind.read(ReadDataStream(io.BytesIO(body)))
    except _UNREADABLE as error:
        raise _DamagedError(f"{kind.__name__} cannot be read: {_text(error)}") from error


def _message(body: bytes) -> Message:
    if not _MESSAGE.size <= len(body) <= LARGEST_MESSAGE:
        raise _DamagedError(f"a message of {len(body)} bytes, limit {LARGEST_MESSAGE}")
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
    return Message(
        channel_id=channel,
        log_time=log_time,
        data=body[_MESSAGE.size :],
        publish_time=publish_time,
        sequence=sequence,
    )


class _Reader:
    """One pass over a file.

    Attributes:
        missing: messages that the statistics name and the file did not hold.
    """

    def __init__(self, stream: BinaryIO, topics: dict[int, str], skipped: list[str] | None) -> None:
        self.missing = 0
        self._stream = stream
        self._topics = topics
        self._skipped = skipped
        self._read = 0
        self._crc = 0
        self._unpacked = 0
        self._messages = 0

    def records(self) -> Iterator[Any]:
        """Return records up to the footer.

        Raises:
            _DamagedError: the file cannot be read further.
        """
        if self._stream.read(len(MAGIC)) != MAGIC:
            raise _DamagedError("not an MCAP file")
        self._crc = zlib.crc32(MAGIC)
        while True:
            record = self._next()
            if isinstance(record, Chunk):
                yield from self._of_chunk(record)
            elif record is not None:
                self._note(record)
                yield record
            if isinstance(record, Footer):
                return

    def _next(self) -> Any:
        opcode, length, head = _read_head(self._stream)
        body = _read_body(self._stream, length)
        self._read += len(head) + len(body)
        record = _parsed(opcode, body)
        if isinstance(record, DataEnd) and record.data_section_crc not in {0, self._crc}:
            raise _DamagedError("the checksum of the data is wrong")
        self._crc = zlib.crc32(body, zlib.crc32(head, self._crc))
        return record

    def _note(self, record: Any) -> None:
        if isinstance(record, Message):
            if record.channel_id not in self._topics:
                raise _DamagedError(f"a message of channel {record.channel_id}, which is not there")
            self._messages += 1
        elif isinstance(record, Channel):
            self._topics[record.id] = record.topic
        elif isinstance(record, Statistics):
            self.missing = max(0, record.message_count - self._messages)

    def _of_chunk(self, chunk: Chunk) -> Iterator[Any]:
        try:
            data = self._unpack(chunk)
        except _DamagedChunkError as error:
            if self._skipped is None:
                raise
            self._skipped.append(str(error))
            return
        # The checksum holds, or there is none: what is wrong from here on was written so.
        stream = io.BytesIO(data)
        while stream.tell() < len(data):
            record = _read_record(stream)
            if isinstance(record, Schema | Channel | Message):
                self._note(record)
                yield record

    def _unpack(self, chunk: Chunk) -> bytes:
        """Return the records of a chunk as bytes.

        Raises:
            _DamagedChunkError: they are too many, or not those that were written.
        """
        size = chunk.uncompressed_size
        if size > LARGEST_CHUNK:
            raise _DamagedChunkError(f"a chunk is too large: {size} bytes, limit {LARGEST_CHUNK}")
        self._unpacked += size
        limit = SPARE_BYTES + RATIO * self._read
        if self._unpacked > limit:
            raise _DamagedChunkError(
                f"the file unpacks too large: {self._unpacked} bytes from {self._read}, "
                f"limit {limit}"
            )
        try:
            data = _decompress(chunk.compression, chunk.data, size)
        except _UNREADABLE as error:
            raise _DamagedChunkError(f"a chunk cannot be unpacked: {_text(error)}") from error
        if len(data) != size:
            raise _DamagedChunkError(f"a chunk does not unpack to its {size} bytes")
        if chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
            raise _DamagedChunkError("the checksum of a chunk is wrong")
        return data


def _decompress(compression: str, data: bytes, size: int) -> bytes:
    """Return at most ``size`` + 1 bytes, however many there are."""
    if compression == "zstd":
        # The package's one-call function allocates whatever the data claims.
        limited = zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK)
        with limited.stream_reader(data) as reader:
            return reader.read(size + 1)
    if compression == "lz4":
        unpacked: bytes = lz4_frame.LZ4FrameDecompressor().decompress(data, size + 1)
        return unpacked
    if compression:
        raise ValueError(f"compression {compression!r} is not known")
    return data


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(": ")
