"""Values of the OPC UA server, from a daemon's status.

Invariants:
- Pure: a status in, plain values out. Without a status the cell is neither ready nor in sync.
"""

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

IN_SYNC_M: Final = 0.002  # distance of the tcp from its target below which the cell is in sync [m]
FOLLOWING: Final = frozenset({"track", "contact"})
MOVING: Final = frozenset({"track", "contact", "retreat", "home"})


class PlcValues(NamedTuple):
    """Variables of the server, in the order and with the names that it shows.

    Attributes:
        InSync: the tool follows the part, and is off its sensed target by 2 mm at most.
        Ready: production runs and the robot waits at the first pose.
        Busy: the robot is in motion, or a part is being assembled.
        Done: the last part has its result, and no other one is begun.
        Fault: a fault waits for its acknowledgement.
        Cause: why the operating state was entered.
        Held: why production begins no further part, empty while it runs.
        PartIn, VariantIn: the part that is being assembled, empty without one.
        PartOut, VariantOut, ResultOk, ResultReason: the last result.
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
        InSync=_is_in_sync(status, state),
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


def _is_in_sync(status: Mapping[str, Any], state: str) -> bool:
    """Return whether the tool follows the part within the tolerance."""
    target, sensed = status.get("target"), status.get("sensed")
    if state not in FOLLOWING or status.get("held") is not None or not target or not sensed:
        return False
    return math.dist(target[:3], sensed[:3]) <= IN_SYNC_M
