"""The section ``rsi``: the controller's own file that it names, and what must fit.

Invariants:
- Values of the wrong kind are passed over. ``documents.fill`` refuses them.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from linemate.daemon.config import files
from linemate.daemon.config.controllers import rsi_check
from linemate.daemon.config.documents import Complaint
from linemate.daemon.config.section_checks import PlainValues
from linemate.daemon.config.settings import Corrections
from linemate.daemon.core.tracking.task import TaskFile
from linemate.protocol.rsi.codec import RsiCodec
from linemate.protocol.rsi.ethernet_config import MAX_CONFIG_BYTES, RsiConfig, parse_config

DEFAULT_FILE = "rsi_joints.xml"


def read(values: PlainValues, base: Path) -> tuple[RsiConfig, str] | None:
    """Return the controller's file, parsed and as text; None if the section names none.

    Raises:
        UnreadableError: the file cannot be read.
        RsiError: it is not one.
    """
    name = DEFAULT_FILE
    if values.has("rsi"):
        name = values.get("rsi", "config", kind=str, default=DEFAULT_FILE) or ""
    if not name:
        return None
    data = files.read(files.find(name, base, files.PROTOCOL_DATA), MAX_CONFIG_BYTES)
    file = parse_config(data)
    RsiCodec(file)
    return file, data.decode("utf-8", errors="replace")


def complaints(values: PlainValues, file: RsiConfig, task: TaskFile | None) -> Iterator[Complaint]:
    """Yield what the controller's file must not hold, or lacks.

    Args:
        values: of the whole configuration.
        task: None if it cannot be read.
    """
    corrections = values.get("rsi", "corrections", kind=str, default=Corrections.ABSOLUTE.value)
    constants: dict[str, Any] = values.get("rsi", "constants", kind=dict, default={}) or {}
    errors = [*rsi_check.unfilled(file, constants)]
    if corrections in list(Corrections):
        errors = [*rsi_check.exchange_errors(file, Corrections(corrections)), *errors]
    if task is not None:
        missing = rsi_check.missing_axes(file, linear_axis=task.arm.linear_axis)
        if missing:
            errors = [f"the task's arm needs {', '.join(missing)}", *errors]
        errors += rsi_check.gate_errors(file, task)
    for what in errors:
        yield Complaint(("rsi", "config"), what)
    for tag, what in rsi_check.constant_errors(file, constants):
        yield Complaint(("rsi", "constants", tag), what)
