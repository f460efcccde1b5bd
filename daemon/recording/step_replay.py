"""Recorded inputs through ``step`` once more, and what came out differently.

Law of this file: pure; pieces of a recording in their order in, one verdict a step out. The same
program with the same parameters gives the same bits; after a change of either, the differences
say which outputs moved, when and by how much. Nothing is guessed silently: where a step cannot be
made again, its verdict says why.
"""

import math
import statistics
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain, islice, pairwise
from typing import Any

import numpy as np

from linemate.daemon.config import documents, task_file
from linemate.daemon.config import settings_tree as tree
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.settings import RsiSettings
from linemate.daemon.config.settings_tree import SettingError, Settings
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core import parameters as compiling
from linemate.daemon.core import step as stepping
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.task import TaskFile
from linemate.daemon.recording import snapshot, step_codec
from linemate.daemon.recording.format import (
    CellTexts,
    DamageReport,
    ParametersInForce,
    StateBefore,
)
from linemate.daemon.recording.step_codec import StepRecord
from linemate.protocol.samples import RobotSample

FIRST_STEPS = 50
"""Steps whose stamps tell the cycle time where a recording does not."""


class ReplayError(ValueError):
    """A recording that cannot be replayed, or parameters that do not fit; the message says why."""


Piece = CellTexts | StateBefore | ParametersInForce | StepRecord | DamageReport


@dataclass(frozen=True, slots=True)
class ReplayedStep:
    """What became of one step.

    Attributes:
        k: number of the step.
        stamp_ns: of the step [ns].
        changes: the fields that are not bit for bit the recorded ones: as recorded, as made.
        unmade: why it could not be made again, None if it was.
        begun: why the state before it was made anew, None if it was the recorded one.
    """

    k: int
    stamp_ns: int
    changes: Mapping[str, tuple[Any, Any]]
    unmade: str | None = None
    begun: str | None = None


@dataclass(frozen=True, slots=True)
class Overrides:
    """Parameters to replay with, instead of the recorded ones.

    Attributes:
        sections: plain values by section, laid over the recorded ones.
        values: by dotted name, after that.
    """

    sections: Mapping[str, Any] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self.sections or self.values)

    def over(self, settings: Settings) -> Settings:
        """Return settings with the overrides laid over them.

        Raises:
            SettingError: they do not fit.
        """
        for section in self.sections:
            if section not in tree.SECTIONS:
                raise SettingError(f"no section {section}")
        made = {
            name: tree.read_section(
                name, tree.merge(tree.plain(getattr(settings, name)), self.sections[name])
            )
            if name in self.sections
            else getattr(settings, name)
            for name in tree.SECTIONS
        }
        whole = Settings(**made)
        return tree.change(whole, self.values) if self.values else whole


@dataclass(slots=True)
class Summary:
    """What changed of one field over a replay.

    Attributes:
        steps: in which it did.
        first: the verdict in which it first did.
        largest: greatest change of a number in it, None if it holds none.
        at: the verdict with the largest one.
    """

    steps: int
    first: ReplayedStep
    largest: float | None
    at: ReplayedStep


def replay(pieces: Iterable[Piece], overrides: Overrides | None = None) -> Iterator[ReplayedStep]:
    """Make every recorded step again.

    Args:
        pieces: of a recording, in its order.

    Raises:
        ReplayError: the texts of the cell are missing, or the parameters do not fit.
    """
    again = _Again(overrides or Overrides())
    for piece in pieces:
        if isinstance(piece, StepRecord):
            yield again.step(piece)
        else:
            again.hear(piece)


def again(
    pieces: Iterable[Piece],
) -> Iterator[tuple[StepRecord, stepping.Outputs, Parameters]]:
    """Make every recorded step again, for what a recording does not hold: its horizon.

    Args:
        pieces: of a recording, in its order.

    Returns:
        The steps that could be made, what came out, and the parameters they were made with.

    Raises:
        ReplayError: as ``replay``.
    """
    made = _Again(Overrides())
    for piece in pieces:
        if not isinstance(piece, StepRecord):
            made.hear(piece)
            continue
        made.step(piece)
        if made.outputs is not None and made.parameters is not None:
            yield piece, made.outputs, made.parameters


def with_cycle(pieces: Iterable[Piece]) -> Iterator[Piece]:
    """Return the pieces, after telling the cycle time where an older recording does not."""
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


def summarise(verdicts: Iterable[ReplayedStep], tolerance: float = 0.0) -> dict[str, Summary]:
    """Return what changed, by field, in the order in which it first did.

    Args:
        tolerance: numbers that are no further apart count as the same, and a field that has no
            numbers to compare (the horizon's digest) does not count.
    """
    found: dict[str, Summary] = {}
    for verdict in verdicts:
        for name, (was, made) in verdict.changes.items():
            apart = distance(was, made)
            if tolerance > 0.0 and ((apart is not None and apart <= tolerance) or _opaque(was)):
                continue
            one = found.setdefault(name, Summary(0, verdict, None, verdict))
            one.steps += 1
            if apart is not None and (one.largest is None or apart > one.largest):
                one.largest, one.at = apart, verdict
    return found


def distance(was: Any, made: Any) -> float | None:
    """Return the greatest difference of two values' numbers, None if they differ in kind."""
    if isinstance(was, (tuple, list)) and isinstance(made, (tuple, list)):
        if len(was) != len(made):
            return None
        parts = [distance(a, b) for a, b in zip(was, made, strict=True)]
        known = [part for part in parts if part is not None]
        return max(known, default=0.0) if len(known) == len(parts) else None
    if was == made and type(was) is type(made):
        return 0.0
    if not (_is_number(was) and _is_number(made)):
        return None
    apart = abs(float(was) - float(made))
    return apart if math.isfinite(apart) else math.inf


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _opaque(value: Any) -> bool:
    return isinstance(value, bytes)


class _Again:
    """Goes through a recording.

    Attributes:
        outputs: of the last step, None if it could not be made.
    """

    def __init__(self, overrides: Overrides) -> None:
        self.outputs: stepping.Outputs | None = None
        self._overrides = overrides
        self._cell: tuple[TaskFile, str] | None = None
        self._written: Settings | None = None
        self._parameters: Parameters | None = None
        self._made_of: tuple[Settings, float] | None = None
        self._state: stepping.StepState | None = None
        self._next: int | None = None
        self._told: StateBefore | None = None

    @property
    def parameters(self) -> Parameters | None:
        """In force."""
        return self._parameters

    def hear(self, piece: CellTexts | StateBefore | ParametersInForce | DamageReport) -> None:
        """Take what is not a step."""
        if isinstance(piece, CellTexts):
            self._read_cell(piece.texts)
        elif isinstance(piece, ParametersInForce):
            self._build(piece.settings)
        elif isinstance(piece, StateBefore):
            self._told = piece

    def step(self, record: StepRecord) -> ReplayedStep:
        """Make a step again."""
        inputs = record.inputs
        self.outputs = None
        if self._parameters is None:
            raise ReplayError("the recording does not tell the parameters of its first step")
        begun = self._enter(record)
        if self._state is None:
            why = begun or "the state before it is not known"
            return ReplayedStep(inputs.k, inputs.stamp_ns, {}, unmade=why)
        try:
            self._state, outputs = stepping.step(self._state, inputs, self._parameters)
        except (ValueError, IndexError, TypeError, ArithmeticError) as error:
            self._state = self._next = None
            why = f"{type(error).__name__}: {error}"
            return ReplayedStep(inputs.k, inputs.stamp_ns, {}, unmade=why, begun=begun)
        self._next = inputs.k + 1
        self.outputs = outputs
        changes = {}
        names = step_codec.differences(record, outputs)
        if names:
            made = step_codec.plain(outputs)
            changes = {name: (record.outputs.get(name), made.get(name)) for name in names}
        return ReplayedStep(inputs.k, inputs.stamp_ns, changes, begun=begun)

    def _enter(self, record: StepRecord) -> str | None:
        """Have the state before a step; why it had to be made anew, None if it did not."""
        told, self._told = self._told, None
        k = record.inputs.k
        goes_on = self._state is not None and self._next == k
        if told is None or told.k != k:
            if goes_on:
                return None
            self._state = None
            return self._begin_at(record.inputs.robot, "the recording has no state before it")
        if goes_on and not told.anew:
            return None
        try:
            state = snapshot.decode(told.data)
        except snapshot.SnapshotError as error:
            self._state = None
            return self._begin_at(record.inputs.robot, str(error))
        assert self._parameters is not None  # noqa: S101 - a step comes after its parameters
        if not self._overrides or _fits(state, self._parameters):
            self._state = state
            return None
        held = tuple(state.control.gate.position.tolist())
        there = RobotSample(record.inputs.stamp_ns, 0, held[:6], held[6:])
        return self._begin_at(there, "the recorded state is not one of these parameters")

    def _begin_at(self, robot: RobotSample | None, why: str) -> str:
        if robot is None or self._parameters is None:
            return why
        axes = (*robot.joints, *robot.external)
        try:
            self._state = stepping.initial(self._parameters, robot)
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
        rsi = value.get("rsi")
        written = rsi.get("cycle_ms") if isinstance(rsi, dict) else None
        if isinstance(rsi, dict) or "task" in value:
            self._build({"cycle_s": 1e-3 * (written or RsiSettings().cycle_ms)})

    def _build(self, told: Mapping[str, Any]) -> None:
        """Compile parameters, unless they are those in force."""
        if self._cell is None or self._written is None:
            raise ReplayError("the recording tells parameters before its cell")
        try:
            settings = Settings(
                tracking=tree.read_section("tracking", told["tracking"])
                if "tracking" in told
                else self._written.tracking,
                control=tree.read_section("control", told["control"])
                if "control" in told
                else self._written.control,
                watch=self._written.watch,
            )
            wanted = (self._overrides.over(settings), float(told["cycle_s"]))
            if wanted == self._made_of:
                return
            task, urdf = self._cell
            whole = wanted[0]
            self._parameters = compiling.build(task, urdf, whole.tracking, whole.control, wanted[1])
        except (ValueError, KeyError, TypeError) as error:
            raise ReplayError(f"parameters: {error}") from error
        self._made_of = wanted


def _fits(state: stepping.StepState, parameters: Parameters) -> bool:
    """Whether a state is one that these parameters could have come to."""
    tracker, control = state.tracker, state.control
    joints = control.gate.position
    if len(joints) != parameters.controller.arm.axes:
        return False
    there = RobotSample(0, 0, tuple(joints[:6].tolist()), tuple(joints[6:].tolist()))
    fresh = stepping.initial(parameters, there)
    pairs = (
        (tracker.poses, fresh.tracker.poses),
        (control.smooth, fresh.control.smooth),
        (control.passed, fresh.control.passed),
        (control.desired, fresh.control.desired),
    )
    if any(np.shape(a) != np.shape(b) for a, b in pairs):
        return False
    if tracker.belief is not None:
        born = parameters.tracker.classifier.initial(0.0)
        if type(born) is not type(tracker.belief) or not _alike(born, tracker.belief):
            return False
    return tracker.across is None or len(tracker.across.x) == parameters.tracker.transverse.size


def _alike(born: Any, belief: Any) -> bool:
    """Whether two beliefs have arrays of the same shapes."""
    for name in born.__struct_fields__:
        a, b = getattr(born, name), getattr(belief, name)
        if isinstance(a, np.ndarray) and np.shape(a) != np.shape(b):
            return False
    return True
