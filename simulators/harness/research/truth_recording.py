"""Recording of a simulated run: the daemon's steps, and the plant's truth as an attachment.

Invariants:
    The steps are those that the daemon's own recorder would write.
    The truth is an attachment. No reader of the daemon uses it.
    The same run gives the same steps. Times of the file begin at the run's own epoch.
"""

import io
import json
from pathlib import Path
from typing import Any

from mcap.records import Attachment
from pydantic import TypeAdapter

from linemate.daemon.config import task_file
from linemate.daemon.core.tracking.task import TaskFile
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording import reader
from linemate.daemon.recording.bounded_mcap import LARGEST_RECORD
from linemate.daemon.recording.step_file import StepFile
from linemate.daemon.recording.step_items import StepItems, metadata_of
from linemate.simulators.devices import truth
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.lockstep import Change, Lockstep
from linemate.simulators.harness.setup import Setup
from linemate.simulators.judge.judge import RunEvidence, judge

FILE = "run.mcap"
TRUTH = "truth.npz"
"""Name of the attachment: the archive of ``devices.truth`` with ``result`` in its facts."""

FLUSH_STEPS = 500

_TASK = TypeAdapter(TaskFile)


def record(
    setup: Setup, seed: int, path: Path, *, timing: bool = False, change: Change | None = None
) -> tuple[RunEvidence, dict[str, Any]]:
    """Run one seed to its end and record it.

    Args:
        path: the recording, made or overwritten; its folder is made.
        change: of the compiled parameters, as in ``Lockstep``.

    Returns:
        The evidence, and the judge's result.

    Raises:
        SetupError: the run cannot be made, or is too long for an attachment.
        OSError: the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        file = StepFile(stream, metadata_of(_texts(setup)))
        items, steps = StepItems(), 0

        def write(entry: LogEntry) -> None:
            nonlocal steps
            for item in items.convert(entry):
                file.write_item(item)
            steps += 1
            if steps % FLUSH_STEPS == 0:
                file.flush()

        lockstep = Lockstep(setup, seed, timing=timing, on_step=write, change=change)
        while lockstep.turn():
            pass
        evidence = lockstep.evidence()
        result = judge(evidence)
        file.attach(TRUTH, "application/zip", _truth_bytes(lockstep.truth, result))
        file.close()
    return evidence, result


def read_truth(path: Path) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Return the columns of a recording's truth and the run's result, None if it has none.

    Raises:
        OSError: the file cannot be read.
        ValueError: the attachment is not a truth.
    """
    with path.open("rb") as stream:
        for piece in reader.records(stream):
            if isinstance(piece, Attachment) and piece.name == TRUTH:
                columns, facts = truth.load(io.BytesIO(piece.data))
                return columns, facts["result"]
    return None


def _truth_bytes(log: truth.TruthLog, result: dict[str, Any]) -> bytes:
    stream = io.BytesIO()
    log.write(stream, {"result": result})
    data = stream.getvalue()
    if len(data) > LARGEST_RECORD // 2:
        raise SetupError(
            f"the truth has {len(data)} bytes, limit {LARGEST_RECORD // 2}. "
            "Shorten scenario.duration_s."
        )
    return data


def _texts(setup: Setup) -> dict[str, str]:
    """Return the texts of the cell that a replay needs."""
    task = json.dumps(_TASK.dump_python(setup.task, mode="json"), indent=1)
    texts = {"task": task, "urdf": setup.urdf, "config": "{}", "variant": setup.variant}
    return texts | task_file.geometry_text(setup.control.geometry)
