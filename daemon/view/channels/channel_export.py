"""Recordings as MCAP files of standard channels: Foxglove, PlotJuggler and Rerun read them.

Invariants:
    * The recording is not changed. An existing file is not overwritten.
    * Every sample is in the file. Messages come in the order of the recording.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mcap.records import Attachment, Message, Metadata
from mcap.writer import CompressionType, Writer

from linemate.daemon.recording import reader
from linemate.daemon.recording.bounded_mcap import Damage
from linemate.daemon.recording.format import (
    BAD_CONTENT,
    LOG,
    METADATA,
    SHOWN_OUTPUTS,
    STEP,
    TIMING,
    UnreadableRecordingError,
)
from linemate.daemon.recording.step_codec import decode
from linemate.daemon.recording.viewer_messages import INFO, root_link
from linemate.daemon.view.cell import read_cell
from linemate.daemon.view.channels.channel_messages import (
    TOPICS,
    ChannelMessage,
    StandardChannels,
    descriptor,
)

if TYPE_CHECKING:
    from linemate.daemon.recording.format import DamageReport
    from linemate.daemon.recording.step_codec import StepRecord

CHUNK_BYTES: Final = 1_048_576
_DURATIONS: Final = ("turnaround", "step", "lead", "woken_late")


def export_channels(path: Path, out: Path) -> "tuple[dict[str, int], DamageReport | None]":
    """Write a recording's standard channels to a new MCAP file.

    Returns:
        Messages by topic, and the recording's damage.

    Raises:
        UnreadableRecordingError: the file is not a recording.
        OSError: the new file exists, or cannot be written.
    """
    topics: dict[int, str] = {}
    damage: DamageReport | None = None
    with path.open("rb") as stream, out.open("xb") as target:
        file = _ChannelFile(Writer(target, CHUNK_BYTES, CompressionType.ZSTD))
        conversion: _Conversion | None = None
        try:
            for record in reader.records(stream, topics):
                if isinstance(record, Metadata) and record.name == METADATA:
                    conversion = conversion or _conversion(record.metadata)
                elif isinstance(record, Attachment):
                    file.attach(record)
                elif isinstance(record, Message) and conversion is not None:
                    for message in conversion.convert(topics[record.channel_id], record):
                        file.add(message)
                elif isinstance(record, Damage):
                    steps = 0 if conversion is None else conversion.steps
                    damage = reader.damage_report(record, steps)
        except BAD_CONTENT as error:
            out.unlink()
            raise UnreadableRecordingError(f"{path}: not a linemate recording: {error}") from error
        if conversion is None:
            out.unlink()
            raise UnreadableRecordingError(f"{path}: not a linemate recording")
        file.finish()
    return file.counts, damage


def _conversion(texts: Mapping[str, str]) -> "_Conversion":
    channels = StandardChannels(read_cell(texts), root_link(texts.get("urdf", "")))
    return _Conversion(channels, reader.layout_of(texts))


@dataclass(slots=True)
class _Conversion:
    """Conversion of recorded messages to those of standard channels."""

    channels: StandardChannels
    layout: Mapping[str, tuple[str, ...]]
    steps: int = 0
    _joints: tuple[float, ...] | None = None
    _joints_ns: int = 0

    def convert(self, topic: str, message: Message) -> Iterator[ChannelMessage]:
        """Yield the standard messages of a recorded one.

        Raises:
            BAD_CONTENT: it does not fit its topic.
        """
        offset_ns = message.log_time - message.publish_time
        if topic == STEP:
            self.steps += 1
            yield from self._step(decode(message.data, self.layout), offset_ns)
        elif topic == TIMING:
            times = json.loads(message.data)
            durations = {name: times.get(f"{name}_ns") for name in _DURATIONS}
            yield self.channels.durations(message.log_time, durations)
        elif topic == LOG:
            line = json.loads(message.data)
            level, name = int(line.get("level", INFO)), str(line.get("name", ""))
            yield self.channels.line(message.log_time, str(line["message"]), level, name)

    def _step(self, record: "StepRecord", offset_ns: int) -> Iterator[ChannelMessage]:
        inputs, channels = record.inputs, self.channels
        for wrench in inputs.wrench:
            yield channels.wrench(wrench.stamp_ns + offset_ns, wrench.force, wrench.torque)
        for distance in inputs.distance:
            wall_ns = distance.stamp_ns + offset_ns
            yield channels.distance(wall_ns, distance.position, distance.strength)
        for seen in inputs.camera:
            pose = (*seen.position, *seen.quaternion)
            yield channels.camera(seen.exposure_ns + offset_ns, seen.frame, pose)
        moment = {name: record.outputs.get(name) for name in SHOWN_OUTPUTS}
        moment |= {"stamp_ns": inputs.stamp_ns, "k": inputs.k, "state": record.state}
        if inputs.robot is not None:
            self._joints = (*inputs.robot.joints, *inputs.robot.external)
            self._joints_ns = inputs.robot.stamp_ns
        if self._joints is not None:
            moment["measured"] = self._joints[: len(record.outputs["command"])]
            moment["measured_ns"] = self._joints_ns
        yield from channels.moment(moment, inputs.stamp_ns + offset_ns)


@dataclass(slots=True)
class _ChannelFile:
    """MCAP file whose channels are registered with their first message."""

    writer: Writer
    counts: dict[str, int] = field(default_factory=dict)
    _schemas: dict[str, int] = field(default_factory=dict)
    _channels: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.writer.start(profile="", library="linemate export")

    def add(self, message: ChannelMessage) -> None:
        """Write a message."""
        topic, wall_ns, data = message
        number = self.counts.get(topic, 0)
        self.counts[topic] = number + 1
        time_ns = max(wall_ns, 0)
        self.writer.add_message(self._channel(topic), time_ns, data, time_ns, number & 0xFFFFFFFF)

    def attach(self, attachment: Any) -> None:
        """Copy an attachment: the arm's URDF."""
        self.writer.add_attachment(
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )

    def finish(self) -> None:
        """Write the file's end."""
        self.writer.finish()  # type: ignore[no-untyped-call]

    def _channel(self, topic: str) -> int:
        if topic not in self._channels:
            schema = TOPICS[topic]
            if schema not in self._schemas:
                self._schemas[schema] = self.writer.register_schema(
                    schema, "protobuf", descriptor(schema)
                )
            self._channels[topic] = self.writer.register_channel(
                topic, "protobuf", self._schemas[schema]
            )
        return self._channels[topic]
