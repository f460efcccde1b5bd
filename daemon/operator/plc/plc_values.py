"""Values of the OPC UA server, from a daemon's status.

Invariants:
- Pure: a status in, plain values out. Without a status the cell is neither ready nor in sync.
"""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

MOVING: Final = frozenset({"track", "contact", "retreat", "home", "follow"})


class PlcValues(NamedTuple):
    """Variables of the server, in the order and with the names that it shows.

    Attributes:
        InSync: the tool follows the part, within ``watch.in_sync_tolerance``.
        Ready: production runs and the robot waits at the first pose.
        Busy: the robot is in motion, or a part is being assembled.
        Done: the last part has its result, and no other one is begun.
        Fault: a fault waits for its acknowledgement.
        Cause: why the operating state was entered.
        Held: why production begins no further part, empty while it runs.
        PartIn, VariantIn: the part that is being assembled, empty without one.
        Waiting: parts in the queue.
        Good, Bad: results since the start of the daemon.
    """

    Connected: bool = False
    State: str = ""
    InSync: bool = False
    Ready: bool = False
    Busy: bool = False
    Done: bool = False
    Fault: bool = False
    Cause: str = ""
    Held: str = ""
    PartIn: str = ""
    VariantIn: str = ""
    PartOut: str = ""
    VariantOut: str = ""
    ResultOk: bool = False
    ResultReason: str = ""
    Waiting: int = 0
    Good: int = 0
    Bad: int = 0


def values_of(status: Mapping[str, Any] | None) -> PlcValues:
    """Return the values of a status, None for a daemon that does not answer."""
    if status is None:
        return PlcValues()
    state = str(status.get("state", ""))
    production = status.get("production") or {}
    part, last = production.get("part") or {}, production.get("last") or {}
    counts = production.get("counts") or {}
    is_busy = state in MOVING or bool(part)
    is_running = bool(production) and production.get("held") is None
    return PlcValues(
        Connected=True,
        State=state,
        InSync=status.get("in_sync") is True,
        Ready=is_running and state == "idle" and not part and bool(production.get("at_home")),
        Busy=is_busy,
        Done=bool(last) and not part,
        Fault=state == "fault" or bool(status.get("latched")),
        Cause=str(status.get("cause") or ""),
        Held=str(production.get("held") or ""),
        PartIn=str(part.get("part", "")),
        VariantIn=str(part.get("variant", "")),
        PartOut=str(last.get("part", "")),
        VariantOut=str(last.get("variant", "")),
        ResultOk=bool(last.get("ok")),
        ResultReason=str(last.get("reason", "")),
        Waiting=len(production.get("queue") or ()),
        Good=int(counts.get("good", 0)),
        Bad=int(counts.get("bad", 0)),
    )
