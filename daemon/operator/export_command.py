"""``linemate export FILE`` and ``linemate recover FILE``: recordings as tables, and made whole.

Law of this file: files only. A table a channel, a row a sample, numbers with all their digits; a
value that was not there is an empty cell. The file that is read is never changed, and none that
exists is written over. Exit codes: 0 done, 1 damaged, not a recording or not to be
written.
"""

import argparse
import csv
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from msgspec import structs

from linemate.daemon.recording.format import LAYOUT, METADATA, STEP, UnreadableRecordingError
from linemate.daemon.recording.reader import damage_report, layout_of, records

if TYPE_CHECKING:
    from mcap.records import Message

    from linemate.daemon.recording.format import DamageReport
    from linemate.daemon.recording.step_codec import StepRecord

OK, NOT_OK = 0, 1
TABLES = {
    "/linemate/timing": "timing",
    "/linemate/parameters": "parameters",
    "/log": "log",
}
"""Channels of their own beside the steps; what viewers are shown is in the steps, exactly."""

COLUMNS = {
    "timing": (
        "ipoc", "arrival_ns", "expected_ns", "woken_late_ns", "lead_ns", "step_ns",
        "turnaround_ns", "prepared", "state",
    ),
    "parameters": ("k", "who", "changed", "settings"),
    "log": ("message", "level"),
}  # fmt: skip
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
SAMPLES = ("robot", "distance", "camera", "wrench")
AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
_PARTS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("target", "sensed", "part"), POSE),
    **dict.fromkeys(("command", "joints"), AXES),
    "covariance": tuple(map(str, range(21))),
}

Cells = dict[str, Any]


def add_parsers(commands: Any) -> None:
    """Add the two commands to the tool's."""
    export = commands.add_parser("export", help="a recording as CSV, a file a channel")
    export.add_argument("file", type=Path, metavar="FILE")
    export.add_argument(
        "--out", type=Path, metavar="DIR", help="where; a directory named as the recording"
    )
    export.set_defaults(run=main_export)
    recover = commands.add_parser("recover", help="finish a recording that was cut short")
    recover.add_argument("file", type=Path, metavar="FILE")
    recover.add_argument(
        "--out", type=Path, metavar="FILE", help="the new file; FILE-recovered.mcap"
    )
    recover.set_defaults(run=main_recover)


def main_export(args: argparse.Namespace) -> int:
    """Write a recording's tables."""
    path: Path = args.file
    folder: Path = args.out or path.with_suffix("")
    try:
        written, damage = export(path, folder)
    except (UnreadableRecordingError, OSError) as error:
        return _failed(error)
    for name, rows in sorted(written.items()):
        print(f"{folder / name}  {rows} rows")
    if damage is not None:
        print(f"linemate: {path}: {damage}", file=sys.stderr)
        return NOT_OK
    return OK


def main_recover(args: argparse.Namespace) -> int:
    """Finish a recording that was cut short."""
    path: Path = args.file
    out: Path = args.out or path.with_name(f"{path.stem}-recovered.mcap")
    try:
        found = recover(path, out)
    except (UnreadableRecordingError, OSError) as error:
        return _failed(error)
    lost = f", {found.damaged} damaged chunks left out" if found.damaged else ""
    print(f"{out}: {found.messages} messages, {found.steps} steps{lost}")
    if found.reason is None and not found.damaged:
        print(f"linemate: {path} was whole already", file=sys.stderr)
    return OK


def _failed(error: Exception) -> int:
    text = str(error)
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    print(f"linemate: {text}", file=sys.stderr)
    return NOT_OK


# --- tables -------------------------------------------------------------------------------


def export(path: Path, folder: Path) -> "tuple[dict[str, int], DamageReport | None]":
    """Write a table for each channel.

    Args:
        folder: made if it is not there.

    Returns:
        Rows by the name of the file, and the recording's damage.

    Raises:
        UnreadableRecordingError: it is no recording.
        OSError: a file exists already, or cannot be written.
    """
    from mcap.records import Message, Metadata

    from linemate.daemon.recording.bounded_mcap import Damage
    from linemate.daemon.recording.step_codec import RecordingError, decode

    layout: Mapping[str, tuple[str, ...]] | None = None
    topics: dict[int, str] = {}
    damage: DamageReport | None = None
    with path.open("rb") as stream, _Tables(folder) as tables:
        try:
            for record in records(stream, topics):
                if isinstance(record, Metadata) and record.name == METADATA:
                    layout = layout_of(record.metadata)
                elif isinstance(record, Message) and layout is not None:
                    topic = topics[record.channel_id]
                    if topic == STEP:
                        _add_step(tables, decode(record.data, layout))
                    elif topic in TABLES:
                        _add_told(tables, TABLES[topic], record)
                elif isinstance(record, Damage):
                    damage = damage_report(record, tables.rows().get("steps.csv", 0))
        except (RecordingError, ValueError, KeyError) as error:
            raise UnreadableRecordingError(f"{path}: not a linemate recording: {error}") from error
        if layout is None:
            raise UnreadableRecordingError(f"{path}: not a linemate recording")
        return tables.rows(), damage


def _add_step(tables: "_Tables", record: "StepRecord") -> None:
    inputs = record.inputs
    head = {"k": inputs.k, "stamp_ns": inputs.stamp_ns}
    cells: Cells = {
        **head,
        "ipoc": record.ipoc,
        "state": record.state,
        "order": str(inputs.order),
        "start": inputs.start,
        "sent": inputs.sent,
    }
    for name, value in record.outputs.items():
        if name not in head:
            cells.update(_spread(name, value))
    tables.add("steps", cells)
    for name in SAMPLES:
        found = getattr(inputs, name)
        for sample in found if isinstance(found, tuple) else (found,):
            if sample is not None:
                own = structs.asdict(sample)
                flat: Cells = {"k": inputs.k}
                for key, value in own.items():
                    flat.update(_spread(key, value))
                tables.add(name, flat)


def _add_told(tables: "_Tables", name: str, message: "Message") -> None:
    """Add a JSON message: its known parts, lists and maps as JSON."""
    told = json.loads(message.data)
    cells: Cells = {"log_time_ns": message.log_time, "stamp_ns": message.publish_time}
    for column in COLUMNS[name]:
        value = told.get(column)
        cells[column] = json.dumps(value) if isinstance(value, (list, dict)) else value
    tables.add(name, cells)


def _spread(name: str, value: Any) -> Cells:
    """Return a value as cells: a pose as seven, a vector as many as it has."""
    if name in _PARTS:
        parts = _PARTS[name]
        values = value if value is not None else (None,) * len(parts)
        return {f"{name}_{part}": item for part, item in zip(parts, values, strict=False)}
    if name == "events":
        return {name: " ".join(":".join(event) for event in value)}
    if isinstance(value, bytes):
        return {name: value.hex()}
    if isinstance(value, (tuple, list)):
        return {f"{name}_{i}": item for i, item in enumerate(value)}
    return {name: value}


@dataclass(slots=True)
class _Table:
    stream: TextIO
    writer: "csv.DictWriter[str]"
    rows: int = 0


@dataclass(slots=True)
class _Tables:
    """CSV files of a folder, each opened with its first row, whose cells are its columns."""

    folder: Path
    _open: dict[str, _Table] = field(default_factory=dict)

    def __enter__(self) -> "_Tables":
        return self

    def __exit__(self, *_: object) -> None:
        for table in self._open.values():
            table.stream.close()

    def add(self, name: str, cells: Cells) -> None:
        """Write a row."""
        if name not in self._open:
            self._open[name] = self._begin(name, list(cells))
        table = self._open[name]
        table.writer.writerow({key: _cell(value) for key, value in cells.items()})
        table.rows += 1

    def rows(self) -> dict[str, int]:
        """Rows by the name of the file."""
        return {f"{name}.csv": table.rows for name, table in self._open.items()}

    def _begin(self, name: str, columns: Sequence[str]) -> _Table:
        self.folder.mkdir(parents=True, exist_ok=True)
        stream = (self.folder / f"{name}.csv").open("x", encoding="utf-8", newline="")
        # What only later rows have has no column: a table has one shape.
        writer = csv.DictWriter(stream, columns, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        return _Table(stream, writer)


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return int(value)
    return repr(value) if isinstance(value, float) else value


# --- recovery -----------------------------------------------------------------------------


@dataclass(slots=True)
class Recovered:
    """What a recovery found.

    Attributes:
        damaged: chunks that had to be left out.
        reason: why the file breaks off, None if it does not.
    """

    messages: int = 0
    steps: int = 0
    damaged: int = 0
    reason: str | None = None


def recover(path: Path, out: Path) -> Recovered:
    """Write a whole recording from what can be read of another.

    Args:
        path: of the one cut short.
        out: of the new one.

    Raises:
        UnreadableRecordingError: it is no recording.
        OSError: the new file exists, or cannot be written.
    """
    from mcap.writer import CompressionType, Writer

    found = Recovered()
    with path.open("rb") as stream:
        whole = _readable(stream, found)
        try:
            first = next(whole)
        except StopIteration:
            raise UnreadableRecordingError(f"{path}: not a recording") from None
        with out.open("xb") as target:
            writer = Writer(target, chunk_size=65_536, compression=CompressionType.ZSTD)
            copy = _Copy(writer, found)
            copy.add(first)
            for record in whole:
                copy.add(record)
            writer.finish()  # type: ignore[no-untyped-call]
    if not copy.is_ours:
        out.unlink()
        raise UnreadableRecordingError(f"{path}: not a linemate recording")
    return found


def _readable(stream: Any, found: Recovered) -> Iterator[Any]:
    """Return the records of a file without those of damaged chunks, which are counted."""
    from linemate.daemon.recording.bounded_mcap import Damage

    skipped: list[str] = []
    for record in records(stream, skipped=skipped):
        if isinstance(record, Damage):
            found.reason = record.reason
        else:
            yield record
    found.damaged = len(skipped)


class _Copy:
    """Puts records into a writer under new numbers."""

    def __init__(self, writer: Any, found: Recovered) -> None:
        self.is_ours = False
        self._writer = writer
        self._found = found
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._topics: dict[int, str] = {}
        self._has_begun = False

    def add(self, record: Any) -> None:
        """Copy a record; those that a writer makes by itself are left out."""
        from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema

        if not self._has_begun:
            self._has_begun = True
            profile = record.profile if isinstance(record, Header) else ""
            self._writer.start(profile=profile, library="linemate recover")
        if isinstance(record, Schema) and record.id not in self._schemas:
            self._schemas[record.id] = self._writer.register_schema(
                record.name, record.encoding, record.data
            )
        elif isinstance(record, Channel) and record.id not in self._channels:
            self._topics[record.id] = record.topic
            self._channels[record.id] = self._writer.register_channel(
                record.topic,
                record.message_encoding,
                self._schemas[record.schema_id],
                record.metadata,
            )
        elif isinstance(record, Message) and record.channel_id in self._channels:
            self._found.messages += 1
            self._found.steps += self._topics[record.channel_id] == STEP
            self._writer.add_message(
                self._channels[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )
        elif isinstance(record, Metadata):
            self.is_ours = self.is_ours or (record.name == METADATA and LAYOUT in record.metadata)
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
