"""A recording as the page plays it: all of its frames, its happenings, and a small overview.

Law of this file: one file in, plain values out. It is read once, by whoever may wait for it;
after that everything is a look-up. What is too long is shown as far as it goes, and that is said.
"""

import json
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from linemate.daemon.recording import reader
from linemate.daemon.recording.format import (
    LOG,
    METADATA,
    PARAMETERS,
    STEP,
    TIMING,
    UnreadableRecordingError,
)
from linemate.daemon.view.cell import Scene, of
from linemate.daemon.view.frames import Frame, Framer

if TYPE_CHECKING:
    from mcap.records import Message

    from linemate.daemon.recording.step_codec import StepRecord

SPACING_NS: Final = 30_000_000
"""Between two frames [ns]; a change of state or class has a frame of its own."""

MOST_FRAMES: Final = 120_000  # an hour
MOST_HAPPENINGS: Final = 2000
MOST_ASKED: Final = 500
"""Frames in one answer."""

OVERVIEW: Final = 1500
"""Points of the overview."""

TOLD_EVERY: Final = 1000  # records
NEAR: Final = 12
"""Steps by which a horizon may be older than the frame that shows it."""

OF_STEPS: Final = ("state: ", "conveyor: ")
LIGHT: Final = ("t", "k", "state", "phase", "scenario", "tentative", "confidence", "speed",
                "errors", "slack_ms", "ages_ms")  # fmt: skip
MOVING: Final = frozenset({"track", "contact", "retreat"})
SENSORS: Final = ("distance", "camera", "wrench")
SHOWN: Final = ("phase", "task_time", "scenario", "scenario_state", "confidence", "speed",
                "contact", "held", "overload", "target", "sensed", "part", "command")  # fmt: skip


@dataclass(slots=True)
class Tape:
    """A recording, read.

    Attributes:
        frames: oldest first, of each only what ``LIGHT`` names; ``t`` counts from the first [s].
        happened: time [s] and text.
        trouble: why not all of it is here, empty if it is.
        foreseen: parts of frames by step, as far as they have been made again.
        inexact: of them, how many are not bit for bit the recorded ones.
    """

    name: str
    scene: Scene
    frames: list[Frame] = field(default_factory=list)
    happened: list[tuple[float, str]] = field(default_factory=list)
    trouble: str = ""
    steps: int = 0
    foreseen: dict[int, Frame] = field(default_factory=dict)
    inexact: int = 0
    _numbers: list[int] = field(default_factory=list)
    _whole: list[bytes] = field(default_factory=list)

    @property
    def length_s(self) -> float:
        """From the first frame to the last [s]."""
        return float(self.frames[-1]["t"]) if self.frames else 0.0

    def add(self, frame: Frame) -> None:
        """Take in the next frame; one that is not later than the last is left out."""
        if not self.frames or frame["t"] > self.frames[-1]["t"]:
            # As bytes, for an hour of frames as maps is more than a machine has to spare.
            self._whole.append(json.dumps(frame, separators=(",", ":")).encode())
            self.frames.append({name: frame[name] for name in LIGHT if name in frame})

    def between(self, first: int, last: int) -> list[Frame]:
        """Return some frames.

        Args:
            first: number of the first one.
            last: number behind the last one; at most MOST_ASKED are given.
        """
        first = max(0, first)
        last = min(last, first + MOST_ASKED, len(self.frames))
        return [self._with_foresight(json.loads(data)) for data in self._whole[first:last]]

    def foresee(
        self, k: int, ahead_ms: float, points: list[list[float]], *, exact: bool = True
    ) -> None:
        """Take in what was foreseen at a step; steps come in their order.

        Args:
            k: number of the step.
            ahead_ms: how far ahead [ms].
            points: in base [m].
            exact: all bits are the recorded ones.
        """
        self.foreseen[k] = {"foreseen": points, "foreseen_ms": ahead_ms}
        self.inexact += not exact
        self._numbers.append(k)

    def told(self) -> dict[str, Any]:
        """What the page is told of all of it, plain values."""
        return {
            "name": self.name,
            "scene": self.scene.told(),
            "length_s": self.length_s,
            "steps": self.steps,
            "trouble": self.trouble,
            "times": [frame["t"] for frame in self.frames],
            "happened": [{"t": t, "text": text} for t, text in self.happened],
            "overview": overview(self.frames),
            "summary": summary(self.frames),
        }

    def _with_foresight(self, frame: Frame) -> Frame:
        at = bisect_right(self._numbers, frame["k"]) - 1
        if at < 0 or frame["k"] - self._numbers[at] > NEAR or frame.get("state") == "idle":
            return frame
        return frame | self.foreseen[self._numbers[at]]


def overview(frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """Return at most OVERVIEW moments of a recording: the worst of each stretch."""
    stride = max(1, -(-len(frames) // OVERVIEW))
    return [_worst(frames[i : i + stride]) for i in range(0, len(frames), stride)]


def _worst(stretch: Sequence[Frame]) -> dict[str, Any]:
    last = stretch[-1]
    told: dict[str, Any] = {
        name: last[name] for name in ("state", "phase", "scenario", "speed") if name in last
    }
    told["t"] = stretch[0]["t"]
    if "ages_ms" in last:
        told["ages_ms"] = last["ages_ms"]
    told["tentative"] = any(frame["tentative"] for frame in stretch)
    for name, worst in (("confidence", max), ("slack_ms", min)):
        values = [frame[name] for frame in stretch if name in frame]
        if values:
            told[name] = worst(values)
    errors: dict[str, float] = {}
    for frame in stretch:
        for name, value in frame["errors"].items():
            errors[name] = max(value, errors.get(name, 0.0))
    told["errors"] = errors
    return told


def summary(frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """Return the root mean square and the largest error of the frames by operating state."""
    rows: dict[tuple[str, str], list[Frame]] = {}
    for frame in frames:
        if _moves(frame):
            rows.setdefault((frame["state"], frame.get("scenario", "")), []).append(frame)
    return [
        {"state": state, "scenario": scenario, "seconds": _seconds(found), **_table(found)}
        for (state, scenario), found in rows.items()
    ]


def total(tape: Tape) -> dict[str, Any]:
    """Return one line of a table of recordings: errors on the way, and the least slack."""
    moving = [frame for frame in tape.frames if _moves(frame)]
    slacks = [frame["slack_ms"] for frame in tape.frames if "slack_ms" in frame]
    told = {"name": tape.name, "length_s": tape.length_s, **_table(moving)}
    return told | ({"slack_ms": min(slacks)} if slacks else {})


def _moves(frame: Frame) -> bool:
    """Whether a frame's errors say something: the arm follows, and no longer waits."""
    return frame.get("state") in MOVING and frame.get("phase") != "wait"


def _seconds(frames: Sequence[Frame]) -> float:
    return round(len(frames) * SPACING_NS * 1e-9, 1)


def _table(frames: Sequence[Frame]) -> dict[str, Any]:
    told: dict[str, Any] = {}
    for name in ("control_mm", "plan_mm"):
        values = [frame["errors"][name] for frame in frames if name in frame["errors"]]
        if values:
            mean = sum(value * value for value in values) / len(values)
            told[name] = {"rms": round(mean**0.5, 3), "max": round(max(values), 3)}
    return told


def read(path: Path, tell: Callable[[float], None] = lambda _: None) -> Tape:
    """Read a recording.

    Args:
        tell: told how much of it has been read, 0 to 1, now and then.

    Raises:
        UnreadableRecordingError: it is none, or cannot be opened.
    """
    from mcap.records import Message, Metadata

    from linemate.daemon.recording.bounded_mcap import Damage
    from linemate.daemon.recording.step_codec import RecordingError

    reading: _Reading | None = None
    layout: dict[str, tuple[str, ...]] = {}
    topics: dict[int, str] = {}
    trouble = ""
    try:
        with path.open("rb") as stream:
            size = max(1, path.stat().st_size)
            for number, record in enumerate(reader.records(stream, topics)):
                if number % TOLD_EVERY == 0:
                    tell(stream.tell() / size)
                if isinstance(record, Damage):
                    steps = 0 if reading is None else reading.tape.steps
                    trouble = str(reader.damage_report(record, steps))
                elif isinstance(record, Metadata) and record.name == METADATA:
                    layout = reader.layout_of(record.metadata)
                    reading = reading or _Reading(Tape(path.name, of(record.metadata)))
                elif isinstance(record, Message) and reading is not None:
                    reading.take(topics[record.channel_id], record, layout)
                    if len(reading.tape.frames) >= MOST_FRAMES:
                        trouble = f"longer than {MOST_FRAMES} frames: shown as far as they go"
                        break
    except OSError as error:
        raise UnreadableRecordingError(f"{path}: {error.strerror}") from error
    except (RecordingError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UnreadableRecordingError(f"{path}: not a linemate recording: {error}") from error
    if reading is None:
        raise UnreadableRecordingError(f"{path}: not a linemate recording")
    if trouble and not reading.tape.steps:
        raise UnreadableRecordingError(f"{path}: {trouble}")
    return reading.end(trouble)


class _Reading:
    """A recording as it is read, record by record."""

    def __init__(self, tape: Tape) -> None:
        self.tape = tape
        self._framer = Framer(tape.scene)
        self._first_ns: int | None = None
        self._shown_ns = 0
        self._cycle_ms: float | None = None
        self._turnaround_us: float | None = None
        self._joints: tuple[float, ...] | None = None
        self._joints_ns = 0
        self._newest_ns: dict[str, int] = {}
        self._samples = dict.fromkeys((*SENSORS, "robot"), 0)
        self._marks: tuple[object, ...] = ()
        self._lines: list[tuple[int, str]] = []

    def take(self, topic: str, message: "Message", layout: Mapping[str, tuple[str, ...]]) -> None:
        """Take in a message, if it is one that is shown.

        Raises:
            RecordingError, ValueError, KeyError, TypeError: it is not what its topic says.
        """
        from linemate.daemon.recording.step_codec import decode

        if topic == STEP:
            self._step(decode(message.data, layout))
        elif topic == TIMING:
            turnaround_ns = json.loads(message.data).get("turnaround_ns")
            if turnaround_ns is not None:
                self._turnaround_us = turnaround_ns / 1e3
        elif topic == LOG:
            self._line(message.publish_time, str(json.loads(message.data)["message"]))
        elif topic == PARAMETERS:
            cycle_s = json.loads(message.data)["settings"].get("cycle_s")
            self._cycle_ms = None if cycle_s is None else round(1e3 * cycle_s, 6)

    def _line(self, stamp_ns: int, text: str) -> None:
        """Take in a line of the log; what the steps tell themselves is taken from them."""
        if not text.startswith(OF_STEPS):
            self._tell(stamp_ns, text)

    def _tell(self, stamp_ns: int, text: str) -> None:
        if len(self._lines) < MOST_HAPPENINGS:
            self._lines.append((stamp_ns, str(text)))

    def _step(self, record: "StepRecord") -> None:
        """Take in a step; some become frames."""
        inputs, outputs = record.inputs, record.outputs
        self.tape.steps += 1
        if record.state != (self._marks[0] if self._marks else None):
            self._tell(inputs.stamp_ns, f"state: {record.state}")
        for what, how in outputs.get("events", ()):
            self._tell(inputs.stamp_ns, f"conveyor: {what} {how}")
        if inputs.robot is not None:
            self._joints = (*inputs.robot.joints, *inputs.robot.external)
            self._joints_ns = inputs.robot.stamp_ns
            self._samples["robot"] += 1
        for name in SENSORS:
            found = getattr(inputs, name)
            if found:
                self._newest_ns[name] = found[-1].stamp_ns
                self._samples[name] += len(found)
        told = {name: outputs.get(name) for name in SHOWN}
        told |= {"stamp_ns": inputs.stamp_ns, "k": inputs.k, "state": record.state}
        marks = (record.state, told["phase"], told["scenario"], told["scenario_state"])
        due = not 0 <= inputs.stamp_ns - self._shown_ns < SPACING_NS
        if not due and marks == self._marks:
            self._framer.note(told)
            return
        self._marks, self._shown_ns = marks, inputs.stamp_ns
        self._show(told)

    def _show(self, told: dict[str, Any]) -> None:
        stamp_ns = told["stamp_ns"]
        if self._first_ns is None:
            self._first_ns = stamp_ns
        if self._joints is not None:
            told["measured"] = self._joints[: len(told["command"])]
            told["measured_ns"] = self._joints_ns
        told["ages_ms"] = {
            name: round(max(0, stamp_ns - newest_ns) / 1e6, 1)
            for name, newest_ns in self._newest_ns.items()
        }
        told["samples"] = dict(self._samples)
        told["cycle_ms"], told["turnaround_us"] = self._cycle_ms, self._turnaround_us
        frame = self._framer.frame(told)
        if frame is not None:
            frame["t"] = round((stamp_ns - self._first_ns) * 1e-9, 4)
            self.tape.add(frame)

    def end(self, trouble: str) -> Tape:
        """Return the tape: what happened is dated from its first frame."""
        first_ns = self._first_ns or 0
        lines = [(round(max(0, ns - first_ns) * 1e-9, 3), text) for ns, text in self._lines]
        self.tape.happened = sorted(lines, key=lambda one: one[0])
        self.tape.trouble = trouble
        return self.tape
