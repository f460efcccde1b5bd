"""Checks of the section ``fanuc``: what must fit between controller, arm and task.

Invariants:
- Values of the wrong kind are passed over. ``documents.fill`` refuses them.
"""

from collections.abc import Iterator

from linemate.daemon.config.controllers.signal_gates import waiting_gates
from linemate.daemon.config.documents import Complaint
from linemate.daemon.config.section_checks import PlainValues
from linemate.daemon.core.tracking.task import TaskFile


def complaints(values: PlainValues, task: TaskFile | None) -> Iterator[Complaint]:
    """Yield what a controller of this family lacks, or must not have.

    Args:
        values: of the whole configuration.
        task: None if it cannot be read.
    """
    if values.get("fanuc", "peer", kind=str) is None:
        yield Complaint(
            ("controller", "kind"),
            "fanuc needs the controller's address: the daemon speaks first. Set fanuc.peer.",
        )
    if task is None:
        return
    rail = values.get("fanuc", "rail", kind=bool, default=False)
    if task.arm.linear_axis and not rail:
        yield Complaint(
            ("fanuc",),
            "the task's arm stands on a linear axis, which Stream Motion has as external axis J7. "
            "Set fanuc.rail: true if J7 is that axis.",
        )
    if rail and not task.arm.linear_axis:
        yield Complaint(("fanuc", "rail"), "the task's arm has no linear axis. Set it to false.")
    if values.get("fanuc", "signals_byte", kind=int) is None:
        for waits, key in waiting_gates(task):
            yield Complaint(
                ("fanuc",),
                f"{waits}, and there are no signals. Set fanuc.signals_byte, or {key} in the task.",
            )
