"""Time-outs and debounce counts of the operating states, and their order."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le

Count = Annotated[int, Ge(1), Le(10_000)]
Duration = Annotated[float, Gt(0.0), Le(2.0)]  # without telegrams, a session ends after 2 s

# The first time-out of a pair must not outlast the second, or it would never act.
_ORDERED = (
    ("missed_s", "link_lost_s"),
    ("missed_in_contact_s", "link_lost_in_contact_s"),
    ("missed_s", "missed_in_contact_s"),
    ("link_lost_s", "link_lost_in_contact_s"),
)


LONGEST_DEBOUNCE_S = 0.15
"""For which the tool moves on after a touch: what counts later is no reaction to it."""


@dataclass(frozen=True, slots=True)
class WatchSettings:
    """When something counts as lost, stale, healthy or too long.

    Attributes:
        link_lost_s: without a telegram for this long the robot link is lost [s].
        link_lost_in_contact_s: the same in contact, where the tool has to be released [s].
        healthy_cycles: answered in a row before a new link is trusted.
        missed_s: without a telegram for this long the link is unproven [s].
        missed_in_contact_s: the same in contact [s].
        leak_s: level of the leaky bucket at which the link is unproven too, in free space [s]. A
            cycle without a telegram adds twice its time, one with a telegram takes its time off.
            In contact the limit is twice ``missed_in_contact_s``.
        position_s: age of the newest position beyond which tracking stops [s].
        position_in_contact_s: the same in contact [s]. The prediction bridges a camera outage of
            140 ms and a cycle.
        one_sensor_s: age of the older of distance and camera beyond which tracking stops [s]. In
            contact the force-torque sensor replaces it.
        wrench_s: age of the newest force beyond which tracking stops [s].
        cycles_of_contact: cycles in a row with contact before it counts.
        cycles_of_overload: cycles in a row with overload before it counts. The contact detection
            needs two samples in a row for each.
        near_m: gap between tool and object below which a stop becomes a retreat [m], for the
            object goes on moving.
        follow_s: longest delay of the robot behind its commands [s].
        follow_tolerance: largest distance to the commands of that time [rad, m].
        cycles_astray: cycles in a row with a following error before it is a fault (drives off).
        longest_hold_s: longest HOLD before a fault [s]. For as long after a fault by a lost link an
            object that comes near makes the tool withdraw.
        longest_retreat_s: longest RETREAT before a fault [s].
        longest_home_s: longest way home before a fault [s].
        in_sync_tolerance: largest distance of the commanded tcp from the sensed one at which the
            cell is in sync [m].
        in_sync_bit: bit of the tool's signals that reports it, 2..7; bits 0 and 1 are
            the tool's. None: no bit.
    """

    link_lost_s: Duration = 0.1
    link_lost_in_contact_s: Duration = 0.3
    healthy_cycles: Count = 80
    missed_s: Duration = 0.03
    missed_in_contact_s: Duration = 0.15
    leak_s: Duration = 0.11
    position_s: Annotated[float, Gt(0.0), Le(5.0)] = 0.3
    position_in_contact_s: Annotated[float, Gt(0.0), Le(1.0)] = 0.16
    one_sensor_s: Annotated[float, Gt(0.0), Le(10.0)] = 1.0
    wrench_s: Annotated[float, Gt(0.0), Le(2.0)] = 0.16
    cycles_of_contact: Count = 2
    cycles_of_overload: Count = 1
    near_m: Annotated[float, Gt(0.0), Le(0.5)] = 0.03
    follow_s: Annotated[float, Gt(0.0), Le(2.0)] = 0.25
    follow_tolerance: Annotated[float, Gt(0.0), Le(0.2)] = 0.01
    cycles_astray: Count = 5
    longest_hold_s: Annotated[float, Gt(0.0), Le(3600.0)] = 60.0
    longest_retreat_s: Annotated[float, Gt(0.0), Le(600.0)] = 20.0
    longest_home_s: Annotated[float, Gt(0.0), Le(600.0)] = 60.0
    in_sync_tolerance: Annotated[float, Gt(0.0), Le(0.1)] = 0.002
    in_sync_bit: Annotated[int, Ge(2), Le(7)] | None = None


def timeout_error(settings: WatchSettings, cycle_s: float) -> tuple[str, str] | None:
    """Return the key of a time-out that acts never or late and the reason, None if all act.

    Args:
        cycle_s: period of the controller [s].
    """
    if settings.missed_s < cycle_s:
        why = f"{settings.missed_s:g} s is shorter than a cycle of {cycle_s:g} s"
        return "missed_s", f"{why}: every late telegram would stop the robot"
    for name in ("cycles_of_contact", "cycles_of_overload"):
        count = getattr(settings, name)
        if count * cycle_s > LONGEST_DEBOUNCE_S:
            why = f"{count} cycles are {count * cycle_s:g} s, at most {LONGEST_DEBOUNCE_S:g} s"
            return name, f"{why}: the tool moves on in that time"
    for first, second in _ORDERED:
        value, limit = getattr(settings, first), getattr(settings, second)
        if value > limit:
            return first, f"{value:g} s is longer than watch.{second}: {limit:g} s"
    return None
