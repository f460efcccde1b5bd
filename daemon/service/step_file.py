"""One recording: an MCAP file with every step, and what viewers and a replay need beside them.

Law of this file: synchronous, and no clock; items in, bytes out. A chunk ends when told to, so
that a sudden death loses no more than since then. Steps, states and parameters are exact and make
a replay; the rest is for people.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from enum import Enum, auto
from importlib.metadata import PackageNotFoundError, version
from typing import Any, BinaryIO, Final

import msgpack
from mcap.writer import CompressionType, Writer

from linemate.daemon import recording, snapshot
from linemate.daemon.parameters import Parameters
from linemate.daemon.service import viewer_messages
from linemate.daemon.service.cycle import LogEntry
from linemate.daemon.service.timing import COLUMNS, CycleTimes
from linemate.daemon.step import State

TOPIC: Final = "/linemate/step"
STATE: Final = "/linemate/state"
PARAMETERS: Final = "/linemate/parameters"
TIMING: Final = "/linemate/timing"
LOG: Final = "/log"
ENCODING: Final = "msgpack"
METADATA: Final = "linemate"
LAYOUT: Final = "layout"
SHOWN_NS: Final = 20_000_000
"""Between two steps that viewers are shown [ns]."""

STATE_NS: Final = 60_000_000_000
"""Between two states of a run that goes on, so that a replay may begin in the middle [ns]."""

_ANY: Final = {"type": "object"}


def _version() -> str:
    try:
        return version("linemate")
    except PackageNotFoundError:
        return ""


_PROGRAM: Final = _version()


class Kind(Enum):
    """What an item is; its payload in brackets."""

    STEP = auto()  # bytes of recording.encode
    STATE = auto()  # (k, State, whether it is not what the step before led to)
    PARAMETERS = auto()  # (k, Parameters, who, changed)
    SHOWN = auto()  # viewer_messages.Glimpse
    TIMING = auto()  # CycleTimes
    LINE = auto()  # (text, level)
    NEXT_FILE = auto()  # None


@dataclass(frozen=True, slots=True)
class Item:
    """Something to be written.

    Attributes:
        kind: what.
        stamp_ns: its time [ns].
        payload: as ``Kind`` says.
    """

    kind: Kind
    stamp_ns: int
    payload: Any = None


@dataclass(slots=True)
class Feed:
    """Makes items of steps: what a file must hold so that each of its steps can be made again.

    Attributes:
        unfit: steps that could not be made bytes of.
    """

    unfit: int = 0
    _after: State | None = None
    _parameters: Parameters | None = None
    _state: str = ""
    _shown_ns: int | None = None
    _state_ns: int = 0
    _why: tuple[Parameters, str, Mapping[str, Any]] | None = None

    def begin(self) -> None:
        """A new file begins: it must stand for itself."""
        self._after = self._parameters = self._shown_ns = None

    def lost(self) -> None:
        """A step was dropped: the next one cannot be made from the one before."""
        self._after = None

    def explain(self, parameters: Parameters, who: str, changed: Mapping[str, Any]) -> None:
        """Remember whose parameters these are, for the first step made with them."""
        self._why = (parameters, who, changed)

    def of(self, entry: LogEntry) -> Iterator[Item]:
        """Return the items of a step, in the order of writing.

        Raises:
            TypeError, ValueError, OverflowError: it cannot be made bytes of.
        """
        inputs, outputs = entry.inputs, entry.outputs
        stamp = inputs.stamp_ns
        data = recording.encode(entry.ipoc, entry.state, inputs, outputs)
        if entry.parameters is not None and entry.parameters is not self._parameters:
            yield Item(Kind.PARAMETERS, stamp, self._change(inputs.k, entry.parameters))
            self._parameters = entry.parameters
        anew = entry.before is not self._after
        if entry.before is not None and (anew or stamp - self._state_ns >= STATE_NS):
            self._state_ns = stamp
            yield Item(Kind.STATE, stamp, (inputs.k, entry.before, anew))
        self._after = entry.after
        yield Item(Kind.STEP, stamp, data)
        if self._state != entry.state:
            yield Item(Kind.LINE, stamp, (f"state: {entry.state}", viewer_messages.INFO))
            self._state = entry.state
        for what, how in outputs.events:
            yield Item(Kind.LINE, stamp, (f"conveyor: {what} {how}", viewer_messages.INFO))
        if self._shown_ns is None or not 0 <= stamp - self._shown_ns < SHOWN_NS:
            self._shown_ns = stamp
            yield Item(Kind.SHOWN, stamp, viewer_messages.glimpse(inputs, outputs))

    def _change(self, k: int, parameters: Parameters) -> tuple[Any, ...]:
        if self._why is not None and self._why[0] is parameters:
            return k, *self._why
        return k, parameters, "", {}


class StepFile:
    """One MCAP file; synchronous.

    Args:
        stream: open for writing, empty; it is closed with the file.
        metadata: text by name: whatever a replay needs.
        chunk_bytes: size of a chunk.
        wall_offset_ns: from monotonic stamps to the times of the file [ns].

    Attributes:
        written: steps.
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
        layout = json.dumps(recording.LAYOUT)
        told = {"program": _PROGRAM, **metadata, LAYOUT: layout}
        self._writer.add_metadata(METADATA, told)
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
            k, state, anew = payload
            try:
                data = msgpack.packb([k, snapshot.encode(state), anew])
            except snapshot.SnapshotError as error:
                self._say(stamp, f"steps from {k} on cannot be replayed: {error}")
            else:
                self._add(STATE, stamp, data)
        elif item.kind is Kind.PARAMETERS:
            self._add(PARAMETERS, stamp, viewer_messages.as_json(parameters_message(*payload)))
        elif item.kind is Kind.SHOWN:
            for topic, data in viewer_messages.shown(payload, stamp + self._offset_ns, self._root):
                self._add(topic, stamp, data)
        elif item.kind is Kind.TIMING:
            self._add(TIMING, stamp, _timing(payload))
        elif item.kind is Kind.LINE:
            text, level = payload
            self._add(LOG, stamp, viewer_messages.line(text, stamp + self._offset_ns, level))

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

    def _say(self, stamp_ns: int, text: str) -> None:
        line = viewer_messages.line(text, stamp_ns + self._offset_ns, viewer_messages.WARNING)
        self._add(LOG, stamp_ns, line)

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


def parameters_message(
    k: int, parameters: Parameters, who: str = "", changed: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return what is recorded of parameters that a step begins to be made with.

    Args:
        k: of the step.
        parameters: which.
        who: set them, empty for those from the start.
        changed: by name, the old and the new value.
    """
    settings = {
        "cycle_s": parameters.cycle_s,
        "tracking": asdict(parameters.tracker.settings),
        "control": asdict(parameters.settings),
    }
    return {"k": k, "who": who, "changed": dict(changed or {}), "settings": settings}


def _timing(times: CycleTimes) -> bytes:
    told = {name: getattr(times, name) for name in COLUMNS if getattr(times, name) is not None}
    return viewer_messages.as_json(told)
