"""Settings of production: variants, tracking window and records."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Le, Len

Text = Annotated[str, Len(1, 4096)]
VariantName = Annotated[str, Len(1, 32)]
Along = Annotated[float, Ge(-30.0), Le(30.0)]


@dataclass(frozen=True, slots=True)
class TrackingWindow:
    """Where on the conveyor a part may be started and must be left.

    Positions are of the object relative to ``conveyor.start_position`` of its task [m]: 0 as the
    task's clock starts, negative before.

    Attributes:
        start: from here on the cell prepares for the part.
        latest_start: a part that is farther when the cell is ready is let go.
        abort: a part that is farther is left.
    """

    start: Along = -2.0
    latest_start: Along = -0.05
    abort: Along = 4.0


@dataclass(frozen=True, slots=True)
class ProductionSettings:
    """Car after car.

    Attributes:
        variants: task file by variant. A bare name may be a shipped one.
        window: where a part may be started and must be left.
        announced_at: position of a part as it is announced, relative to
            ``conveyor.start_position`` [m].
        records: directory of the quality records. It must exist. None keeps none.
        days: days whose records are kept.
        goes_home: the daemon brings the robot home after each part. Off for a KRL program that
            drives home by itself.
        name: of the station, for the records.
    """

    variants: Annotated[dict[VariantName, Text], Len(1, 32)]
    window: TrackingWindow = TrackingWindow()
    announced_at: Along = -3.0
    records: Text | None = None
    days: Annotated[int, Ge(1), Le(3650)] = 90
    goes_home: bool = True
    name: Annotated[str, Len(1, 64)] = "station"


def window_error(window: TrackingWindow, announced_at: float) -> tuple[str, str] | None:
    """Return the key of a position that is out of order and the reason, None if all are in order.

    Args:
        announced_at: position of a part as it is announced [m].
    """
    if not announced_at <= window.latest_start:
        return "announced_at", f"{announced_at:g} m is beyond window.latest_start"
    if not window.start < window.latest_start:
        return "window.start", f"{window.start:g} m is not before window.latest_start"
    if not window.latest_start < window.abort:
        return "window.abort", f"{window.abort:g} m is not behind window.latest_start"
    return None
