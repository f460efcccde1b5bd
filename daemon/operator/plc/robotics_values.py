"""Values of OPC 40010-1 (OPC UA for Robotics 1.01), from a daemon's status.

Invariants:
- Pure: a status in, plain values out.
- A value that the daemon does not know has no place here: override, drives, safety states.

Reference: https://reference.opcfoundation.org/specs/OPC-40010-1/full, sections 7.2, 7.3 and 7.21.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

CYCLE, CONTINUOUS = 0, 1  # of ExecutionModeEnumeration: once, or part after part


class RoboticsValues(NamedTuple):
    """Values that the daemon knows of a motion device system.

    Attributes:
        on_path: no axis has a following error, and no fault waits for its acknowledgement.
        positions: measured A1..A6 [rad], E1 [m], empty if not known.
        program: variant of the part that is assembled, else the task.
        mode: of execution, ``CYCLE`` or ``CONTINUOUS``.
    """

    on_path: bool = False
    positions: tuple[float, ...] = ()
    program: str = ""
    is_loaded: bool = False
    mode: int = CYCLE


def robotics_values(status: Mapping[str, Any] | None) -> RoboticsValues:
    """Return the values of a status, None for a daemon that does not answer."""
    if status is None:
        return RoboticsValues()
    production = status.get("production")
    part = (production or {}).get("part") or {}
    is_faulty = status.get("state") == "fault" or bool(status.get("latched"))
    return RoboticsValues(
        on_path=not is_faulty and status.get("astray") is None and status.get("link") == "healthy",
        positions=tuple(status.get("measured") or ()),
        program=str(part.get("variant") or status.get("task") or ""),
        is_loaded=True,
        mode=CYCLE if production is None else CONTINUOUS,
    )
