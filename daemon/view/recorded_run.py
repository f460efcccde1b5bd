"""A recording for the page: its frames, its log, an overview and a summary.

Invariants:
    * A file is read once. After that everything is a look-up.
    * What is too long is shown as far as it goes, with the reason in ``trouble``.
"""

import json
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from linemate.daemon.recording import reader
from linemate.daemon.recording.format import (
    BAD_CONTENT,
    LOG,
    METADATA,
    PARAMETERS,
    STEP,
    TIMING,
    UnreadableRecordingError,
)
from linemate.daemon.view.cell import Cell, read_cell
from linemate.daemon.view.frames import Frame, Framer

if TYPE_CHECKING:
    from mcap.records import Message

    from linemate.daemon.recording.step_codec import StepRecord

SPACING_NS: Final = 30_000_000  # between two frames; a change of state has its own frame
MAX_FRAMES: Final = 120_000  # an hour
MAX_EVENTS: Final = 2000
MAX_ANSWER: Final = 500  # frames
OVERVIEW_LENGTH: Final = 1500
PROGRESS_EVERY: Final = 500  # records
MAX_HORIZON_AGE: Final = 12  # steps by which a horizon may be older than its frame

OF_STEPS: Final = ("state: ", "conveyor: ")  # log lines that the steps have too
OVERVIEW: Final = ("t", "k", "state", "phase", "scenario", "tentative", "confidence", "speed",
                   "errors", "margin_ms", "ages_ms")  # fmt: skip
MOVING: Final = frozenset({"track", "contact", "retreat"})
SENSORS: Final = ("distance", "camera", "wrench")
OUTPUTS: Final = ("phase", "task_time", "scenario", "scenario_state", "confidence", "speed",
                  "contact", "held", "overload", "target", "sensed", "part", "command")  # fmt: skip


@dataclass(slots=True)
class RecordedRun:
    """A recording that has been read.

    Attributes:
        frames: Oldest first, with the keys of OVERVIEW; ``t`` counts from the first one [s].
        events: Time [s] and text of the log.
        trouble: Why not all of it is here, empty if it is.
        steps: Number of steps in the file.
        horizons: Keys of a frame by step, as far as they have been computed again.
        inexact: How many of them differ from the recorded digest.
    """

    name: str
    cell: Cell
    frames: list[Frame] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)
    trouble: str = ""
    steps: int = 0
    horizons: dict[int, Frame] = field(default_factory=dict)
    inexact: int = 0
    _horizon_steps: list[int] = field(default_factory=list)
    _encoded: list[bytes] = field(default_factory=list)

    @property
    def length_s(self) -> float:
        """Time from the first frame to the last [s]."""
        return float(self.frames[-1]["t"]) if self.frames else 0.0

    def add(self, frame: Frame) -> None:
        """Append a frame, unless it is not later than the last one."""
        if not self.frames or frame["t"] > self.frames[-1]["t"]:
            # Encoded: an hour of frames as dictionaries needs 1 GB.
            self._encoded.append(json.dumps(frame, separators=(",", ":")).encode())
            self.frames.append({name: frame[name] for name in OVERVIEW if name in frame})

    def between(self, first: int, last: int) -> list[Frame]:
        """Return the frames ``first`` to ``last`` (exclusive), at most MAX_ANSWER."""
        first = max(0, first)
        last = min(last, first + MAX_ANSWER, len(self.frames))
        return [self._with_horizon(json.loads(data)) for data in self._encoded[first:last]]

    def add_horizon(
        self, k: int, ahead_ms: float, points: list[list[float]], *, exact: bool = True
    ) -> None:
        """Add the predicted horizon of a step; steps come in their order.

        Args:
            ahead_ms: Time from the step to the last point [ms].
            points: Positions of the tcp in base [m].
            exact: Whether all bits are the recorded ones.
        """
        self.horizons[k] = {"foreseen": points, "foreseen_ms": ahead_ms}
        self.inexact += not exact
        self._horizon_steps.append(k)

    def as_page(self) -> dict[str, Any]:
        """Return plain values of the whole recording for the page."""
        return {
            "name": self.name,
            "scene": self.cell.as_page(),
            "length_s": self.length_s,
            "steps": self.steps,
            "trouble": self.trouble,
            "times": [frame["t"] for frame in self.frames],
            "happened": [{"t": t, "text": text} for t, text in self.events],
            "overview": overview(self.frames),
            "summary": summary(self.frames),
        }

    def _with_horizon(self, frame: Frame) -> Frame:
        at = bisect_right(self._horizon_steps, frame["k"]) - 1
        if at < 0 or frame.get("state") == "idle":
            return frame
        if frame["k"] - self._horizon_steps[at] > MAX_HORIZON_AGE:
            return frame
        return frame | self.horizons[self._horizon_steps[at]]


def overview(frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """Return at most OVERVIEW_LENGTH moments of a recording: the worst of each stretch."""
    stride = max(1, -(-len(frames) // OVERVIEW_LENGTH))
    return [_worst(frames[i : i + stride]) for i in range(0, len(frames), stride)]


def _worst(stretch: Sequence[Frame]) -> dict[str, Any]:
    last = stretch[-1]
    worst: dict[str, Any] = {
        name: last[name] for name in ("state", "phase", "scenario", "speed") if name in last
    }
    worst["t"] = stretch[0]["t"]
    if "ages_ms" in last:
        worst["ages_ms"] = last["ages_ms"]
    worst["tentative"] = any(frame["tentative"] for frame in stretch)
    for name, extreme in (("confidence", max), ("margin_ms", min)):
        values = [frame[name] for frame in stretch if name in frame]
        if values:
            worst[name] = extreme(values)
    errors: dict[str, float] = {}
    for frame in stretch:
        for name, value in frame["errors"].items():
            errors[name] = max(value, errors.get(name, 0.0))
    worst["errors"] = errors
    return worst


def summary(frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """Return rms and worst errors of the frames by operating state and class."""
    groups: dict[tuple[str, str], list[Frame]] = {}
    for frame in frames:
        if _is_moving(frame):
            groups.setdefault((frame["state"], frame.get("scenario", "")), []).append(frame)
    return [
        {"state": state, "scenario": scenario, "seconds": _seconds(group), **_errors(group)}
        for (state, scenario), group in groups.items()
    ]


def total(run: RecordedRun) -> dict[str, Any]:
    """Return the line of one recording: errors while it moved, and the least margin."""
    moving = [frame for frame in run.frames if _is_moving(frame)]
    margins = [frame["margin_ms"] for frame in run.frames if "margin_ms" in frame]
    line = {"name": run.name, "length_s": run.length_s, **_errors(moving)}
    return line | ({"margin_ms": min(margins)} if margins else {})


def _is_moving(frame: Frame) -> bool:
    """Return whether the arm follows the part: only then an error has a meaning."""
    return frame.get("state") in MOVING and frame.get("phase") != "wait"


def _seconds(frames: Sequence[Frame]) -> float:
    return round(len(frames) * SPACING_NS * 1e-9, 1)


def _errors(frames: Sequence[Frame]) -> dict[str, Any]:
    errors: dict[str, Any] = {}
    for name in ("control_mm", "plan_mm"):
        values = [frame["errors"][name] for frame in frames if name in frame["errors"]]
        if values:
            mean = sum(value * value for value in values) / len(values)
            errors[name] = {"rms": round(mean**0.5, 3), "max": round(max(values), 3)}
    return errors


def read_run(path: Path, on_progress: Callable[[float], None] = lambda _: None) -> RecordedRun:
    """Read a recording.

    Args:
        on_progress: Called with the share that has been read, 0 to 1; it may raise to stop.

    Raises:
        UnreadableRecordingError: The file is not a recording, or cannot be opened.
    """
    from mcap.records import Message, Metadata

    from linemate.daemon.recording.bounded_mcap import Damage

    reading: _Reading | None = None
    layout: dict[str, tuple[str, ...]] = {}
    topics: dict[int, str] = {}
    trouble = ""
    try:
        with path.open("rb") as stream:
            size = max(1, path.stat().st_size)
            for number, record in enumerate(reader.records(stream, topics)):
                if number % PROGRESS_EVERY == 0:
                    on_progress(stream.tell() / size)
                if isinstance(record, Damage):
                    steps = 0 if reading is None else reading.run.steps
                    trouble = str(reader.damage_report(record, steps))
                elif isinstance(record, Metadata) and record.name == METADATA:
                    layout = reader.layout_of(record.metadata)
                    run = RecordedRun(path.name, read_cell(record.metadata))
                    reading = reading or _Reading(run)
                elif isinstance(record, Message) and reading is not None:
                    reading.add(topics[record.channel_id], record, layout)
                    if len(reading.run.frames) >= MAX_FRAMES:
                        trouble = f"longer than {MAX_FRAMES} frames: shown as far as they go"
                        break
    except OSError as error:
        raise UnreadableRecordingError(f"{path}: {error.strerror}") from error
    except BAD_CONTENT as error:
        raise UnreadableRecordingError(f"{path}: not a linemate recording: {error}") from error
    if reading is None:
        raise UnreadableRecordingError(f"{path}: not a linemate recording")
    if trouble and not reading.run.steps:
        raise UnreadableRecordingError(f"{path}: {trouble}")
    return reading.finish(trouble)


class _Reading:
    """A recording while it is read, record by record."""

    def __init__(self, run: RecordedRun) -> None:
        self.run = run
        self._framer = Framer(run.cell)
        self._first_ns: int | None = None
        self._shown_ns = 0
        self._cycle_ms: float | None = None
        self._turnaround_us: float | None = None
        self._joints: tuple[float, ...] | None = None
        self._joints_ns = 0
        self._newest_ns: dict[str, int] = {}
        self._samples = dict.fromkeys((*SENSORS, "robot"), 0)
        self._marks: tuple[object, ...] = ()
        self._events: list[tuple[int, str]] = []

    def add(self, topic: str, message: "Message", layout: Mapping[str, tuple[str, ...]]) -> None:
        """Add a message of any topic.

        Raises:
            BAD_CONTENT: It does not fit its topic.
        """
        from linemate.daemon.recording.step_codec import decode

        if topic == STEP:
            self._add_step(decode(message.data, layout))
        elif topic == TIMING:
            turnaround_ns = json.loads(message.data).get("turnaround_ns")
            if turnaround_ns is not None:
                self._turnaround_us = turnaround_ns / 1e3
        elif topic == LOG:
            text = str(json.loads(message.data)["message"])
            if not text.startswith(OF_STEPS):
                self._add_event(message.publish_time, text)
        elif topic == PARAMETERS:
            cycle_s = json.loads(message.data)["settings"].get("cycle_s")
            self._cycle_ms = None if cycle_s is None else round(1e3 * cycle_s, 6)

    def _add_event(self, stamp_ns: int, text: str) -> None:
        if len(self._events) < MAX_EVENTS:
            self._events.append((stamp_ns, str(text)))

    def _add_step(self, record: "StepRecord") -> None:
        inputs, outputs = record.inputs, record.outputs
        self.run.steps += 1
        if record.state != (self._marks[0] if self._marks else None):
            self._add_event(inputs.stamp_ns, f"state: {record.state}")
        for what, how in outputs.get("events", ()):
            self._add_event(inputs.stamp_ns, f"conveyor: {what} {how}")
        if inputs.robot is not None:
            self._joints = (*inputs.robot.joints, *inputs.robot.external)
            self._joints_ns = inputs.robot.stamp_ns
            self._samples["robot"] += 1
        for name in SENSORS:
            samples = getattr(inputs, name)
            if samples:
                self._newest_ns[name] = samples[-1].stamp_ns
                self._samples[name] += len(samples)
        moment = {name: outputs.get(name) for name in OUTPUTS}
        moment |= {"stamp_ns": inputs.stamp_ns, "k": inputs.k, "state": record.state}
        marks = (record.state, moment["phase"], moment["scenario"], moment["scenario_state"])
        is_due = not 0 <= inputs.stamp_ns - self._shown_ns < SPACING_NS
        if not is_due and marks == self._marks:
            self._framer.remember(moment)
            return
        self._marks, self._shown_ns = marks, inputs.stamp_ns
        self._add_frame(moment)

    def _add_frame(self, moment: dict[str, Any]) -> None:
        stamp_ns = moment["stamp_ns"]
        if self._first_ns is None:
            self._first_ns = stamp_ns
        if self._joints is not None:
            moment["measured"] = self._joints[: len(moment["command"])]
            moment["measured_ns"] = self._joints_ns
        moment["ages_ms"] = {
            name: round(max(0, stamp_ns - newest_ns) / 1e6, 1)
            for name, newest_ns in self._newest_ns.items()
        }
        moment["samples"] = dict(self._samples)
        moment["cycle_ms"], moment["turnaround_us"] = self._cycle_ms, self._turnaround_us
        frame = self._framer.frame(moment)
        if frame is not None:
            frame["t"] = round((stamp_ns - self._first_ns) * 1e-9, 4)
            self.run.add(frame)

    def finish(self, trouble: str) -> RecordedRun:
        """Return the run, its events dated from its first frame."""
        first_ns = self._first_ns or 0
        events = [(round(max(0, ns - first_ns) * 1e-9, 3), text) for ns, text in self._events]
        self.run.events = sorted(events, key=lambda event: event[0])
        self.run.trouble = trouble
        return self.run
