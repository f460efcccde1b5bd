"""Checks of the section ``egm``: what must fit between controller and task.

Invariants:
- Values of the wrong kind are passed over. ``documents.fill`` refuses them.
"""

from collections.abc import Iterator

from linemate.daemon.config.controllers.signal_gates import waiting_gates
from linemate.daemon.config.documents import Complaint
from linemate.daemon.config.section_checks import PlainValues
from linemate.daemon.core.tracking.task import TaskFile


def complaints(values: PlainValues, task: TaskFile) -> Iterator[Complaint]:
    """Yield gates that wait for a signal which an ABB controller does not carry."""
    robotware = values.get("egm", "robotware", kind=int, default=7)
    carries = values.get("egm", "signals", kind=bool, default=True)
    if robotware != 6 and carries:
        return
    for waits, key in waiting_gates(task):
        yield Complaint(
            ("egm", "robotware" if carries else "signals"),
            f"{waits}: signals need RobotWare 7 and signals: true. Set them, or set {key}.",
        )
