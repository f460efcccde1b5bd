"""``linemate.simulate`` and ``linemate.replay``: runs of the daemon's step as arrays."""

import json
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import Outputs
from linemate.daemon.recording import reader, step_codec, step_replay
from linemate.daemon.recording.format import DamageReport, UnreadableRecordingError
from linemate.daemon.recording.step_codec import StepRecord
from linemate.daemon.recording.step_replay import Overrides
from linemate.simulators.harness import lockstep, setup
from linemate.simulators.harness.cell import cell_files, plugins, variants
from linemate.simulators.harness.research import truth_recording
from linemate.simulators.harness.research.run_arrays import Run
from linemate.simulators.judge import joined
from linemate.simulators.judge import rows as columns
from linemate.simulators.judge.judge import judge
from linemate.simulators.judge.rows import DaemonEvent, Rows

Own = str | Callable[..., Any]
"""Name of a variant, an entry point or ``module:attribute``; or a factory."""


def simulate(
    task: str | Path | None = None,
    scenario: str | None = None,
    seed: int = 0,
    *,
    cell: str | None = None,
    config: str | Path | None = None,
    classifier: Own = "default",
    parameters: Mapping[str, Any] | None = None,
    cycle_ms: float | None = None,
    world: str = "own",
    controller: str | None = None,
    record: str | Path | None = None,
) -> Run:
    """Run one seed in virtual time, through all codecs, and judge it by the plant's truth.

    Args:
        task: task file; that of the cell without one.
        scenario: name of a shipped scenario, or a file; that of the cell without one.
        seed: of the plant's draws.
        cell: name of a shipped cell, or a folder with ``linemated.yaml`` and ``scenario.yaml``.
        config: configuration of the daemon, in place of the cell's.
        classifier: a variant of ``linemate-sim campaign``, an entry point of
            ``linemate.classifiers`` or ``linemate.predictors``, ``module:attribute``, or a
            factory called with the conveyor's classes and the tracking settings.
        parameters: values by key as of ``--set``, e.g. ``{"tracking.rule.tentative": 2e-3}``.
        cycle_ms: cycle of the controller [ms]; that of the cell or the scenario without one.
        world: what emulates the station, ``own`` plants or ``mujoco``.
        controller: ``rsi``, ``fanuc`` or ``egm``; that of the cell without one.
        record: leave a recording with the truth there.

    Raises:
        SetupError: it cannot be run; the message says why.
        FileError: a file of the cell cannot be read; the message has all its errors.
    """
    variant = classifier if isinstance(classifier, str) else "default"
    change = None if isinstance(classifier, str) else plugins.changed_by(classifier)
    files = cell_files.chosen(
        Namespace(
            cell=cell,
            config=None if config is None else Path(config),
            task=None if task is None else Path(task),
        )
    )
    run_setup = setup.make(
        cell_files.scenario(scenario, files),
        [f"{key}={json.dumps(value)}" for key, value in (parameters or {}).items()],
        variant=variant,
        cycle_ms=cycle_ms,
        world=world,
        controller=controller,
        cell=files,
    )
    if record is not None:
        path = Path(record)
        evidence, result = truth_recording.record(run_setup, seed, path, change=change)
        return Run(evidence.rows, result=_named(result, classifier), recording=path)
    run = lockstep.Lockstep(run_setup, seed, change=change)
    while run.turn():
        pass
    evidence = run.evidence()
    return Run(evidence.rows, result=_named(judge(evidence), classifier))


def replay(
    recording: str | Path,
    *,
    classifier: Own | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> Run:
    """Run a recording's inputs through the daemon's step again.

    The robot moves as it was recorded: another classifier or parameter changes the estimate and
    the target, not the measured joints.

    Args:
        recording: MCAP file of the daemon, or of ``simulate(record=...)`` with the truth.
        classifier: as of ``simulate``, but no variant; the recorded one without it.
        parameters: values by name as of ``linemate param list``.

    Raises:
        UnreadableRecordingError: the file cannot be read, or is damaged.
        ReplayError: it cannot be replayed, or the parameters do not fit.
        PluginError: the classifier cannot be used.
    """
    path = Path(recording)
    change = None if classifier is None else _change_of(classifier)
    changes = Overrides(values=dict(parameters or {}))
    differ: list[bool] = []
    outputs = step_replay.replay_outputs(step_replay.with_cycle(_undamaged(path)), changes, change)
    steps = list(_replayed(outputs, differ))
    truth = truth_recording.read_truth(path)
    rows = _rows_of(steps) if truth is None else joined.join(truth[0], iter(steps))
    is_plain = classifier is None and not parameters
    result = truth[1] if truth is not None and is_plain else None
    return Run(rows, truth is not None, result, path, is_identical=not any(differ))


def _named(result: dict[str, Any], classifier: Own) -> dict[str, Any]:
    """Return a result with the classifier's name as its variant."""
    if isinstance(classifier, str):
        return result
    return {**result, "variant": getattr(classifier, "__name__", type(classifier).__name__)}


def _change_of(classifier: Own) -> plugins.Change:
    if not isinstance(classifier, str):
        return plugins.changed_by(classifier)
    if classifier in variants.VARIANTS:
        raise plugins.PluginError(
            f"{classifier} is a variant of simulated runs. "
            "Use parameters={'tracking.classifier': ...} for a replay."
        )
    return plugins.change_of(classifier)


def _undamaged(path: Path) -> Iterator[step_replay.Piece]:
    """Yield the pieces of a recording.

    Raises:
        UnreadableRecordingError: it cannot be read, or is damaged.
    """
    for piece in reader.pieces(path):
        if isinstance(piece, DamageReport):
            raise UnreadableRecordingError(f"{path}: {piece}")
        yield piece


def _replayed(
    outputs: Iterable[tuple[StepRecord, Outputs, Parameters]], differ: list[bool]
) -> Iterator[StepRecord]:
    """Yield the steps with their replayed outputs; note whether each differs from the recorded."""
    for record, outputs_again, _ in islice(outputs, reader.MOST_STEPS):
        differ.append(bool(step_codec.differences(record, outputs_again)))
        yield replace(record, outputs=step_codec.plain(outputs_again))


def _rows_of(steps: list[StepRecord]) -> Rows:
    """Return the rows of steps that answered a telegram, without a truth."""
    answered = [step for step in steps if step.counter is not None]
    rows = columns.empty(len(answered))
    first_ns = answered[0].inputs.stamp_ns if answered else 0
    events = []
    for row, step in enumerate(answered):
        rows.t[row] = (step.inputs.stamp_ns - first_ns) * 1e-9
        rows.answered[row] = True
        robot = step.inputs.robot
        if robot is not None:
            axes = (*robot.joints, *robot.external)[: columns.AXES]
            rows.joints[row, : len(axes)] = axes
        joined.fill_row(rows, row, step)
        t = float(rows.t[row])
        events += [DaemonEvent(t, kind, what) for kind, what in step.outputs["events"]]
    return replace(rows, events=tuple(events))
