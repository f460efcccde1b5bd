"""Join the emulator's truth and the daemon's recording by IPOC.

Invariants:
    The truth's rows are the rows; a step fills the columns of the telegram it answered.
    Only the instant of a step without a telegram is interpolated.
"""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mcap.records import Message, Metadata

from linemate.daemon.recording import step_codec
from linemate.daemon.recording.bounded_mcap import Damage, records
from linemate.daemon.recording.format import LAYOUT, LOG, METADATA, STATE_LOG, STEP
from linemate.daemon.recording.step_codec import RecordingError, StepRecord
from linemate.simulators.devices import truth
from linemate.simulators.judge import rows as columns
from linemate.simulators.judge.judge import RunEvidence, StateChange, Telegrams
from linemate.simulators.judge.rows import DaemonEvent, Rows
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.scenario_draw import sample

_PHASES = {name: i for i, name in enumerate(columns.PHASES)}
_CLASSES = {name: i for i, name in enumerate(columns.CLASSES)}
_STATES = {name: i for i, name in enumerate(columns.STATES)}
_CHANGE = re.compile(r"(\w+) -> (\w+): (.*)", re.DOTALL)
_POSES = ("command", "target", "sensed", "part")
_NUMBERS = ("task_time", "speed")


def read_steps(path: Path) -> Iterator[StepRecord]:
    """Read the steps of a recording in the order of writing.

    Raises:
        OSError: it cannot be read.
        RecordingError: it is no recording, or a broken one.
    """
    layout, topics = step_codec.LAYOUT, dict[int, str]()
    with path.open("rb") as stream:
        for record in records(stream, topics):
            if isinstance(record, Damage):
                raise RecordingError(f"{path}: damaged: {record.reason}")
            if isinstance(record, Metadata):
                layout = _layout(record, layout)
            elif isinstance(record, Message) and topics[record.channel_id] == STEP:
                yield step_codec.decode(record.data, layout)


def read_changes(path: Path) -> Iterator[StateChange]:
    """Read the changes of the operating state from a recording's log, oldest first.

    Raises:
        OSError: it cannot be read.
        RecordingError: it is no recording, or a broken one.
    """
    topics = dict[int, str]()
    with path.open("rb") as stream:
        for record in records(stream, topics):
            if isinstance(record, Damage):
                raise RecordingError(f"{path}: damaged: {record.reason}")
            if isinstance(record, Message) and topics[record.channel_id] == LOG:
                line = json.loads(record.data)
                match = _CHANGE.fullmatch(line["message"])
                if line["name"] == STATE_LOG and match is not None:
                    yield StateChange(*match.groups())


def evidence(truth_file: Path, recording_file: Path, scenario: Scenario) -> RunEvidence:
    """Join what the emulator and the daemon left behind.

    Args:
        scenario: of the run, before its seed's draws.

    Raises:
        OSError: a file that cannot be read.
        ValueError: a file that is not what it should be.
    """
    columns, facts = truth.load(truth_file)
    collision = facts["collision"]
    return RunEvidence(
        rows=join(columns, read_steps(recording_file)),
        scenario=scenario.name,
        seed=scenario.seed,
        cycle_s=scenario.cycle_s,
        events=sample(scenario.seed, scenario).events,
        telegrams=Telegrams(
            **{name: facts["telegrams"][name] for name in Telegrams.__dataclass_fields__}
        ),
        collision=None if collision is None else collision["reason"],
        broken=facts["broken"],
        turnaround_us=facts["turnaround_us"],
        tolerated=facts["tolerated"],
        changes=tuple(read_changes(recording_file)),
    )


def join(true_columns: Mapping[str, Any], steps: Iterator[StepRecord]) -> Rows:
    """Join the truth's columns and recorded steps.

    Args:
        steps: in order; those of telegrams that the truth does not have are left out.
    """
    n = len(true_columns["t"])
    rows = columns.empty(n)
    row_of = {int(ipoc): i for i, ipoc in enumerate(true_columns["ipoc"])}
    events: list[DaemonEvent] = []
    last: tuple[float, int] | None = None
    for record in steps:
        row = None if record.counter is None else row_of.get(record.counter)
        stamp_ns = record.inputs.stamp_ns
        if row is not None:
            last = (float(true_columns["t"][row]), stamp_ns)
            fill_row(rows, row, record)
        if last is not None:
            t = last[0] + (stamp_ns - last[1]) * 1e-9
            events += [DaemonEvent(t, kind, what) for kind, what in record.outputs["events"]]
    joined = replace(rows, events=tuple(events))
    return replace(joined, **{name: true_columns[name] for name in columns.TRUTH})


def fill_row(rows: Rows, row: int, record: StepRecord) -> None:
    """Fill the daemon's columns of a row with those of a step."""
    outputs = record.outputs
    for name in _POSES:
        if outputs[name] is not None:
            getattr(rows, name)[row, : len(outputs[name])] = outputs[name]
    for name in _NUMBERS:
        if outputs[name] is not None:
            getattr(rows, name)[row] = outputs[name]
    rows.phase[row] = _PHASES[outputs["phase"]]
    rows.scenario[row] = _CLASSES[outputs["scenario"]]
    rows.tentative[row] = outputs["scenario_state"] == "tentative"
    rows.state[row] = _STATES[record.state]
    rows.contact_seen[row] = outputs["contact"]


def _layout(
    record: Metadata, otherwise: Mapping[str, tuple[str, ...]]
) -> dict[str, tuple[str, ...]]:
    if record.name != METADATA or LAYOUT not in record.metadata:
        return dict(otherwise)
    fields: dict[str, list[str]] = json.loads(record.metadata[LAYOUT])
    return {name: tuple(names) for name, names in fields.items()}
