"""``linemate export`` and ``linemate recover``: recordings in other formats, damaged ones repaired.

Invariants:
    * A table for each channel, a row for each sample, numbers with all their digits.
    * A missing value is an empty cell.
    * The recording is never changed, and no existing file is overwritten.
"""

import argparse
import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from msgspec import structs

from linemate.daemon.command_line import (
    NO,
    OK,
    NegativeError,
    UsageError,
    check_output_file,
    make_folder,
)
from linemate.daemon.operator import console
from linemate.daemon.recording.format import (
    BAD_CONTENT,
    LAYOUT,
    METADATA,
    STEP,
    UnreadableRecordingError,
)
from linemate.daemon.recording.reader import damage_report, layout_of, records
from linemate.protocol.stamped_samples import AXES

if TYPE_CHECKING:
    from mcap.records import Message

    from linemate.daemon.recording.format import DamageReport
    from linemate.daemon.recording.step_codec import StepRecord

# Channels with a table of their own; the viewers' channels repeat what the steps have.
TABLES = {"/linemate/timing": "timing", "/linemate/parameters": "parameters", "/log": "log"}

COLUMNS = {
    "timing": (
        "counter", "arrival_ns", "expected_ns", "woken_late_ns", "lead_ns", "step_ns",
        "turnaround_ns", "prepared", "state",
    ),
    "parameters": ("k", "who", "changed", "settings"),
    "log": ("message", "level"),
}  # fmt: skip
# Names of columns in recordings of earlier versions.
_FORMER_COLUMNS = {"counter": "ipoc"}
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
SAMPLES = ("robot", "distance", "camera", "wrench")
_PARTS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("target", "sensed", "part"), POSE),
    **dict.fromkeys(("command", "joints"), AXES),
    "covariance": tuple(map(str, range(21))),
}

Cells = dict[str, Any]


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the two commands."""
    export = commands.add_parser("export", help="a recording as CSV, or for Foxglove")
    export.add_argument("file", type=Path, metavar="FILE")
    export.add_argument(
        "--out", type=Path, metavar="DIR", help="where; a directory named as the recording"
    )
    export.add_argument(
        "--foxglove", type=Path, metavar="FILE",
        help="no CSV, but standard channels in one MCAP file, for Foxglove and PlotJuggler "
        "(extra 'foxglove')",
    )  # fmt: skip
    export.set_defaults(run=main_export)
    recover = commands.add_parser("recover", help="finish a recording that was cut short")
    recover.add_argument("file", type=Path, metavar="FILE")
    recover.add_argument(
        "--out", type=Path, metavar="FILE", help="the new file; FILE-recovered.mcap"
    )
    recover.set_defaults(run=main_recover)


def main_export(args: argparse.Namespace) -> int:
    """Write a recording's tables; the exit code says whether the recording was complete."""
    path = _recording(args.file)
    if args.foxglove is not None:
        return _main_channels(path, args.foxglove)
    folder: Path = args.out or path.with_suffix("")
    if args.out is not None:
        make_folder(folder)
    try:
        written, damage = export(path, folder)
    except UnreadableRecordingError as error:
        raise NegativeError(str(error)) from error
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}") from error
    for name, rows in sorted(written.items()):
        print(f"{folder / name}  {rows} rows")
    return _code(path, damage)


def _recording(path: Path) -> Path:
    """Return the path of a recording, which has a name."""
    if path.is_dir():
        raise UsageError(f"{path}: Is a directory")
    return path


def _code(path: Path, damage: "DamageReport | None") -> int:
    """Return the exit code; complain of a recording that is damaged."""
    if damage is None:
        return OK
    console.complain(f"{path}: {damage}")
    return NO


def _main_channels(path: Path, out: Path) -> int:
    """Write a recording's standard channels, and name the layout that shows them."""
    check_output_file(out, "--foxglove")
    try:
        from linemate.daemon.view.channels.channel_export import export_channels
        from linemate.daemon.view.channels.channel_messages import LAYOUT_FILE
    except ImportError as error:
        raise UsageError(
            f"{error.name} is not installed; pip install linemate[foxglove]"
        ) from error
    try:
        written, damage = export_channels(path, out)
    except UnreadableRecordingError as error:
        raise NegativeError(str(error)) from error
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}") from error
    for topic, messages in sorted(written.items()):
        print(f"{topic}  {messages} messages")
    print(f"layout: {LAYOUT_FILE}")
    return _code(path, damage)


def main_recover(args: argparse.Namespace) -> int:
    """Write a complete recording from what can be read of a damaged one."""
    path = _recording(args.file)
    out: Path = args.out or path.with_name(f"{path.stem}-recovered.mcap")
    check_output_file(out)
    try:
        recovered = recover(path, out)
    except UnreadableRecordingError as error:
        raise NegativeError(str(error)) from error
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}") from error
    lost = f", {recovered.damaged} damaged chunks left out" if recovered.damaged else ""
    print(f"{out}: {recovered.messages} messages, {recovered.steps} steps{lost}")
    if recovered.reason is None and not recovered.damaged:
        console.complain(f"{path} was complete already")
    return OK


# --- tables -------------------------------------------------------------------------------


def export(path: Path, folder: Path) -> "tuple[dict[str, int], DamageReport | None]":
    """Write a table for each channel.

    Returns:
        Rows by the name of the file, and the recording's damage.

    Raises:
        UnreadableRecordingError: The file is not a recording.
        OSError: A file exists already, or cannot be written.
    """
    from mcap.records import Message, Metadata

    from linemate.daemon.recording.bounded_mcap import Damage
    from linemate.daemon.recording.step_codec import decode

    layout: Mapping[str, tuple[str, ...]] | None = None
    topics: dict[int, str] = {}
    damage: DamageReport | None = None
    with path.open("rb") as stream, _CsvFolder(folder) as tables:
        try:
            for record in records(stream, topics):
                if isinstance(record, Metadata) and record.name == METADATA:
                    layout = layout_of(record.metadata)
                elif isinstance(record, Message) and layout is not None:
                    topic = topics[record.channel_id]
                    if topic == STEP:
                        _add_step(tables, decode(record.data, layout))
                    elif topic in TABLES:
                        _add_json(tables, TABLES[topic], record)
                elif isinstance(record, Damage):
                    damage = damage_report(record, tables.rows().get("steps.csv", 0))
        except BAD_CONTENT as error:
            raise UnreadableRecordingError(f"{path}: not a linemate recording: {error}") from error
        if layout is None:
            raise UnreadableRecordingError(f"{path}: not a linemate recording")
        return tables.rows(), damage


def _add_step(tables: "_CsvFolder", record: "StepRecord") -> None:
    inputs = record.inputs
    head = {"k": inputs.k, "stamp_ns": inputs.stamp_ns}
    cells: Cells = {
        **head,
        "counter": record.counter,
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
        value = getattr(inputs, name)
        for sample in value if isinstance(value, tuple) else (value,):
            if sample is not None:
                own = structs.asdict(sample)
                flat: Cells = {"k": inputs.k}
                for key, value in own.items():
                    flat.update(_spread(key, value))
                tables.add(name, flat)


def _add_json(tables: "_CsvFolder", name: str, message: "Message") -> None:
    """Add the known columns of a JSON message; lists and maps stay JSON."""
    data = json.loads(message.data)
    cells: Cells = {"log_time_ns": message.log_time, "stamp_ns": message.publish_time}
    for column in COLUMNS[name]:
        value = data.get(column, data.get(_FORMER_COLUMNS.get(column, column)))
        cells[column] = json.dumps(value) if isinstance(value, (list, dict)) else value
    tables.add(name, cells)


def _spread(name: str, value: Any) -> Cells:
    """Return a value as cells: one for each part of a pose or a vector."""
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
class _CsvFile:
    stream: TextIO
    writer: "csv.DictWriter[str]"
    rows: int = 0


@dataclass(slots=True)
class _CsvFolder:
    """CSV files of a folder, each opened with its first row, whose keys are its columns."""

    folder: Path
    _open: dict[str, _CsvFile] = field(default_factory=dict)

    def __enter__(self) -> "_CsvFolder":
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

    def _begin(self, name: str, columns: Sequence[str]) -> _CsvFile:
        self.folder.mkdir(parents=True, exist_ok=True)
        stream = (self.folder / f"{name}.csv").open("x", encoding="utf-8", newline="")
        # Keys that only later rows have get no column: a CSV file has one header.
        writer = csv.DictWriter(stream, columns, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        return _CsvFile(stream, writer)


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return int(value)
    return repr(value) if isinstance(value, float) else value


# --- recovery -----------------------------------------------------------------------------


@dataclass(slots=True)
class Recovered:
    """Result of a recovery.

    Attributes:
        steps: Messages of the channel of steps.
        damaged: Chunks that had to be left out.
        reason: Why the file breaks off, None if it does not.
    """

    messages: int = 0
    steps: int = 0
    damaged: int = 0
    reason: str | None = None


def recover(path: Path, out: Path) -> Recovered:
    """Write a complete recording from what can be read of another.

    Raises:
        UnreadableRecordingError: The file is not a recording.
        OSError: The new file exists, or cannot be written.
    """
    from mcap.writer import CompressionType, Writer

    recovered = Recovered()
    with path.open("rb") as stream:
        readable = _readable(stream, recovered)
        try:
            first = next(readable)
        except StopIteration:
            raise UnreadableRecordingError(f"{path}: not a recording") from None
        with out.open("xb") as target:
            writer = Writer(target, chunk_size=65_536, compression=CompressionType.ZSTD)
            copy = _Copy(writer, recovered)
            copy.add(first)
            for record in readable:
                copy.add(record)
            writer.finish()  # type: ignore[no-untyped-call]
    if not copy.is_linemate:
        out.unlink()
        raise UnreadableRecordingError(f"{path}: not a linemate recording")
    return recovered


def _readable(stream: Any, recovered: Recovered) -> Iterator[Any]:
    """Yield the records of a file without those of damaged chunks, and count these."""
    from linemate.daemon.recording.bounded_mcap import Damage

    skipped: list[str] = []
    for record in records(stream, skipped=skipped):
        if isinstance(record, Damage):
            recovered.reason = record.reason
        else:
            yield record
    recovered.damaged = len(skipped)


class _Copy:
    """Copies records to a writer, which gives them new ids."""

    def __init__(self, writer: Any, recovered: Recovered) -> None:
        self.is_linemate = False
        self._writer = writer
        self._recovered = recovered
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._topics: dict[int, str] = {}
        self._has_begun = False

    def add(self, record: Any) -> None:
        """Copy a record, unless the writer makes it by itself."""
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
            self._recovered.messages += 1
            self._recovered.steps += self._topics[record.channel_id] == STEP
            self._writer.add_message(
                self._channels[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )
        elif isinstance(record, Metadata):
            self.is_linemate = self.is_linemate or (
                record.name == METADATA and LAYOUT in record.metadata
            )
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
