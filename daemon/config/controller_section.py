"""The section of the controller's family: its file, its port, and what it lacks or must not have.

Invariants:
- Values of the wrong kind are passed over. ``documents.fill`` refuses them.
"""

from collections.abc import Iterator
from pathlib import Path

from linemate.daemon.config import rsi_section
from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.config.section_checks import PlainValues, waiting_gates
from linemate.daemon.config.settings import EGM_PORT, ControllerKind
from linemate.daemon.core.tracking.task import TaskFile
from linemate.protocol.rsi.ethernet_config import RsiConfig

ControllerFile = RsiConfig  # the one family whose controller has a file that both ends read


def kind_of(values: PlainValues) -> ControllerKind:
    """Return the family of a configuration; that of the default if it is none."""
    default = ControllerKind.RSI
    kind = values.get("controller", "kind", kind=str, default=default.value)
    return ControllerKind(kind) if kind in list(ControllerKind) else default


def read_file(
    kind: ControllerKind, values: PlainValues, base: Path
) -> tuple[ControllerFile, str] | None:
    """Return the controller's own file, parsed and as text; None for a family without one.

    Args:
        base: directory of the configuration file.

    Raises:
        UnreadableError: the file cannot be read.
        ProtocolError: it is not one.
    """
    return rsi_section.read(values, base) if kind is ControllerKind.RSI else None


def default_port(kind: ControllerKind, file: ControllerFile | None) -> int | None:
    """Return the port if the section names none; None if that cannot be read."""
    if kind is ControllerKind.RSI:
        return None if file is None else file.port
    return EGM_PORT if kind is ControllerKind.EGM else 0


def complaints(
    kind: ControllerKind, values: PlainValues, file: ControllerFile | None, task: TaskFile | None
) -> Iterator[Complaint]:
    """Yield what the family's section lacks, or must not have.

    Args:
        file: the controller's own, None if there is none or it cannot be read.
        task: None if it cannot be read.
    """
    for other in (ControllerKind.EGM, ControllerKind.FANUC):
        if values.has(other) and not values.has("controller"):
            yield Complaint((other,), f"not used: controller.kind is {kind}. Set kind: {other}.")
    if file is not None:
        yield from rsi_section.complaints(values, file, task)
    if kind is ControllerKind.EGM and task is not None:
        yield from _egm_complaints(values, task)
    if kind is ControllerKind.FANUC:
        yield from _fanuc_complaints(values, task)
    # Millimetres of a rotating E1 would be read as degrees.
    linear = values.get(kind, "linear_axes", kind=list)
    if linear is not None and task is not None and task.arm.linear_axis and "E1" not in linear:
        yield Complaint((kind, "linear_axes"), "the task's arm stands on E1, which is linear")


def _egm_complaints(values: PlainValues, task: TaskFile) -> Iterator[Complaint]:
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


def _fanuc_complaints(values: PlainValues, task: TaskFile | None) -> Iterator[Complaint]:
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
