"""Replay of a recording: its inputs through ``step`` replay_outputs, and what differs.

Invariants:
- The same program with the same parameters gives the same bits.
- A step that cannot be replayed has its reason.
"""

import math
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, islice, pairwise
from typing import Any

import numpy as np

from linemate.daemon.config import documents, task_file, timeouts
from linemate.daemon.config import settings_tree as tree
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.settings import ControllerKind
from linemate.daemon.config.settings_tree import SettingError, Settings
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core import parameters as compiling
from linemate.daemon.core import step as stepping
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import Outputs, StepState
from linemate.daemon.core.tracking.classifiers.onset_bank import OnsetBank
from linemate.daemon.core.tracking.task import TaskFile
from linemate.daemon.recording import snapshot, step_codec
from linemate.daemon.recording.format import CellTexts, DamageReport, ParametersInForce, StateBefore
from linemate.daemon.recording.step_codec import StepRecord
from linemate.protocol.stamped_samples import RobotSample

FIRST_STEPS = 50  # steps whose stamps give the period of a recording without parameters


class ReplayError(ValueError):
    """A recording that cannot be replayed, or parameters that do not fit; the message says why."""


Piece = CellTexts | StateBefore | ParametersInForce | StepRecord | DamageReport


@dataclass(frozen=True, slots=True)
class ReplayedStep:
    """Result of one step.

    Attributes:
        changes: outputs that differ in any bit, by name: the recorded and the replayed value.
        failure: why the step cannot be replayed, None if it was.
        restart: why the state before it is not the recorded one, None if it is.
    """

    k: int
    stamp_ns: int
    changes: Mapping[str, tuple[Any, Any]]
    failure: str | None = None
    restart: str | None = None


@dataclass(frozen=True, slots=True)
class Overrides:
    """Parameters of a replay that replace the recorded ones.

    Attributes:
        sections: plain values by section, merged into the recorded ones.
        values: by dotted name, after the sections.
    """

    sections: Mapping[str, Any] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.sections or self.values)

    def over(self, settings: Settings) -> Settings:
        """Return settings with the overrides.

        Raises:
            SettingError: they do not fit.
        """
        for section in self.sections:
            if section not in tree.SECTIONS:
                raise SettingError(f"no section {section}")
        merged = {name: getattr(settings, name) for name in tree.SECTIONS}
        for name, section in self.sections.items():
            merged[name] = tree.read_section(name, tree.merge(tree.plain(merged[name]), section))
        changed = Settings(**merged)
        return tree.change(changed, self.values) if self.values else changed


@dataclass(slots=True)
class Summary:
    """Differences of one output over a replay.

    Attributes:
        steps: number of steps with a difference.
        largest: largest difference of a number, None without numbers.
        at: the step with the largest difference.
    """

    steps: int
    first: ReplayedStep
    largest: float | None
    at: ReplayedStep


def replay(pieces: Iterable[Piece], overrides: Overrides | None = None) -> Iterator[ReplayedStep]:
    """Replay every recorded step.

    Args:
        pieces: pieces of a recording, in its order.

    Raises:
        ReplayError: the texts of the cell are missing, or the parameters do not fit.
    """
    replayer = _Replayer(overrides or Overrides())
    for piece in pieces:
        if isinstance(piece, StepRecord):
            yield replayer.step(piece)
        else:
            replayer.read(piece)


def replay_outputs(
    pieces: Iterable[Piece],
    overrides: Overrides | None = None,
    change: Callable[[Parameters], Parameters] | None = None,
) -> Iterator[tuple[StepRecord, Outputs, Parameters]]:
    """Yield each step that can be replayed, its outputs and parameters.

    The outputs have what a recording has not: the horizon.

    Args:
        change: of the compiled parameters, for example another classifier.

    Raises:
        ReplayError: as ``replay``.
    """
    replayer = _Replayer(overrides or Overrides(), change)
    for piece in pieces:
        if not isinstance(piece, StepRecord):
            replayer.read(piece)
            continue
        replayer.step(piece)
        if replayer.outputs is not None and replayer.parameters is not None:
            yield piece, replayer.outputs, replayer.parameters


def with_cycle(pieces: Iterable[Piece]) -> Iterator[Piece]:
    """Yield the pieces, with the period measured from stamps if the recording lacks it."""
    rest = iter(pieces)
    first = list(islice(rest, FIRST_STEPS))
    if not any(isinstance(piece, ParametersInForce) for piece in first):
        steps = [piece.inputs for piece in first if isinstance(piece, StepRecord)]
        spans = [(b.stamp_ns - a.stamp_ns) / (b.k - a.k) for a, b in pairwise(steps) if b.k > a.k]
        if spans:
            cycle_s = max(1, round(statistics.median(spans) * 1e-6)) * 1e-3
            at = 1 if isinstance(first[0], CellTexts) else 0
            first.insert(at, ParametersInForce(steps[0].k, {"cycle_s": cycle_s}))
    return chain(first, rest)


def summarise(steps: Iterable[ReplayedStep], tolerance: float = 0.0) -> dict[str, Summary]:
    """Return the differences by output, in the order in which they begin.

    Args:
        tolerance: largest difference of numbers that counts as none. An output without numbers,
            the digest of the horizon, is left out then.
    """
    summaries: dict[str, Summary] = {}
    for step in steps:
        for name, (recorded, replayed) in step.changes.items():
            apart = distance(recorded, replayed)
            is_small = apart is not None and apart <= tolerance
            if tolerance > 0.0 and (is_small or isinstance(recorded, bytes)):
                continue
            summary = summaries.setdefault(name, Summary(0, step, None, step))
            summary.steps += 1
            if apart is not None and (summary.largest is None or apart > summary.largest):
                summary.largest, summary.at = apart, step
    return summaries


def distance(recorded: Any, replayed: Any) -> float | None:
    """Return the largest difference of two values' numbers, None if they differ in kind."""
    if isinstance(recorded, (tuple, list)) and isinstance(replayed, (tuple, list)):
        if len(recorded) != len(replayed):
            return None
        parts = [distance(a, b) for a, b in zip(recorded, replayed, strict=True)]
        known = [part for part in parts if part is not None]
        return max(known, default=0.0) if len(known) == len(parts) else None
    if recorded == replayed and type(recorded) is type(replayed):
        return 0.0
    if not (_is_number(recorded) and _is_number(replayed)):
        return None
    apart = abs(float(recorded) - float(replayed))
    return apart if math.isfinite(apart) else math.inf


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


class _Replayer:
    """State of a replay.

    Attributes:
        outputs: outputs of the last step, None if it failed.
        parameters: the parameters in force, None before they are known.
    """

    def __init__(
        self, overrides: Overrides, change: Callable[[Parameters], Parameters] | None = None
    ) -> None:
        self.outputs: Outputs | None = None
        self.parameters: Parameters | None = None
        self._overrides = overrides
        self._change = change
        self._cell: tuple[TaskFile, str] | None = None
        self._written: Settings | None = None
        self._built_from: tuple[Settings, float] | None = None
        self._state: StepState | None = None
        self._next: int | None = None
        self._recorded: StateBefore | None = None

    def read(self, piece: CellTexts | StateBefore | ParametersInForce | DamageReport) -> None:
        """Read a piece that is not a step."""
        if isinstance(piece, CellTexts):
            self._read_cell(piece.texts)
        elif isinstance(piece, ParametersInForce):
            self._build(piece.settings)
        elif isinstance(piece, StateBefore):
            self._recorded = piece

    def step(self, record: StepRecord) -> ReplayedStep:
        """Replay a step."""
        inputs = record.inputs
        self.outputs = None
        if self.parameters is None:
            raise ReplayError("the recording does not have the parameters of its first step")
        restart = self._enter(record, self.parameters)
        if self._state is None:
            why = restart or "the state before it is not known"
            return ReplayedStep(inputs.k, inputs.stamp_ns, {}, failure=why)
        try:
            self._state, outputs = stepping.step(self._state, inputs, self.parameters)
        except (ValueError, IndexError, TypeError, ArithmeticError) as error:
            self._state = self._next = None
            why = f"{type(error).__name__}: {error}"
            return ReplayedStep(inputs.k, inputs.stamp_ns, {}, failure=why, restart=restart)
        self._next = inputs.k + 1
        self.outputs = outputs
        changes = {}
        names = step_codec.differences(record, outputs)
        if names:
            replayed = step_codec.plain(outputs)
            changes = {name: (record.outputs.get(name), replayed.get(name)) for name in names}
        return ReplayedStep(inputs.k, inputs.stamp_ns, changes, restart=restart)

    def _enter(self, record: StepRecord, parameters: Parameters) -> str | None:
        """Set the state before a step; return why it is not the recorded one, None if it is."""
        recorded, self._recorded = self._recorded, None
        k = record.inputs.k
        continues = self._state is not None and self._next == k
        if recorded is None or recorded.k != k:
            if continues:
                return None
            self._state = None
            return self._begin_at(record.inputs.robot, "the recording has no state before it")
        if continues and not recorded.is_new:
            return None
        try:
            state = snapshot.decode(recorded.data)
        except snapshot.SnapshotError as error:
            self._state = None
            return self._begin_at(record.inputs.robot, str(error))
        is_own = not self._overrides and self._change is None
        if is_own or _fits(state, parameters):
            self._state = state
            return None
        held = tuple(state.control.limiter.position.tolist())
        robot = RobotSample(record.inputs.stamp_ns, 0, held[:6], held[6:])
        return self._begin_at(robot, "the recorded state is not one of these parameters")

    def _begin_at(self, robot: RobotSample | None, why: str) -> str:
        if robot is None or self.parameters is None:
            return why
        axes = (*robot.joints, *robot.external)
        try:
            self._state = stepping.initial(self.parameters, robot)
        except (ValueError, IndexError) as error:
            return f"{why}; and {error}"
        return f"{why}; begun at rest at {', '.join(f'{axis:.4f}' for axis in axes[:7])}"

    def _read_cell(self, texts: Mapping[str, str]) -> None:
        missing = [name for name in ("task", "urdf") if name not in texts]
        if missing:
            raise ReplayError(f"the recording holds no {' and no '.join(missing)}")
        try:
            task = task_file.parse(texts["task"].encode(), "task")
            document = documents.read(texts.get("config", "").encode(), "config")
            value = document.value if isinstance(document.value, dict) else {}
            self._written = Settings(
                tracking=tree.read_section("tracking", value.get("tracking") or {}),
                control=tree.read_section("control", value.get("control") or {}),
                watch=WatchSettings(),
            )
        except (FileError, SettingError) as error:
            raise ReplayError(str(error)) from error
        self._cell = (task, texts["urdf"])
        if "task" in value or any(isinstance(value.get(kind), dict) for kind in ControllerKind):
            self._build({"cycle_s": 1e-3 * timeouts.cycle_ms(value)})

    def _build(self, recorded: Mapping[str, Any]) -> None:
        """Compile parameters, unless they are those in force."""
        if self._cell is None or self._written is None:
            raise ReplayError("the recording has parameters before its cell")
        try:
            sections = {
                name: tree.read_section(name, recorded[name])
                for name in ("tracking", "control")
                if name in recorded
            }
            settings = self._overrides.over(replace(self._written, **sections))
            source = (settings, float(recorded["cycle_s"]))
            if source == self._built_from:
                return
            task, urdf = self._cell
            self.parameters = compiling.build(
                task, urdf, settings.tracking, settings.control, source[1]
            )
            if self._change is not None:
                self.parameters = self._change(self.parameters)
        except (ValueError, KeyError, TypeError) as error:
            raise ReplayError(f"parameters: {error}") from error
        self._built_from = source


def _fits(state: StepState, parameters: Parameters) -> bool:
    """Return whether a state has the shapes that these parameters give."""
    tracker, control = state.tracker, state.control
    joints = control.limiter.position
    if len(joints) != parameters.controller.arm.axes:
        return False
    robot = RobotSample(0, 0, tuple(joints[:6].tolist()), tuple(joints[6:].tolist()))
    fresh = stepping.initial(parameters, robot)
    pairs = (
        (tracker.poses, fresh.tracker.poses),
        (control.past_poses, fresh.control.past_poses),
        (control.past_joints, fresh.control.past_joints),
        (control.joints, fresh.control.joints),
    )
    if any(np.shape(a) != np.shape(b) for a, b in pairs):
        return False
    if (control.drift is None) is not (fresh.control.drift is None):
        return False
    if control.drift is not None and not _same_shapes(fresh.control.drift, control.drift):
        return False
    estimate = tracker.conveyor
    if estimate is not None:
        initial = parameters.tracker.classifier.initial(0.0)
        if type(initial) is not type(estimate) or not _same_shapes(initial, estimate):
            return False
    return (
        tracker.transverse is None
        or len(tracker.transverse.x) == parameters.tracker.transverse.size
    )


def _same_shapes(first: Any, second: Any) -> bool:
    for name in first.__struct_fields__:
        a, b = getattr(first, name), getattr(second, name)
        if isinstance(a, np.ndarray) and np.shape(a) != np.shape(b):
            return False
        # How many hypotheses a bank holds differs from step to step.
        if isinstance(a, OnsetBank) and len(a.sums) != len(b.sums):
            return False
    return True
