"""The daemon's sampling schedule: which step is due when.

Law of this file: pure; stamps in, steps out. The controller is master: every telegram re-phases
the schedule, and without one the schedule makes the step by itself, on an absolute grid
(``next += T0``, never ``now + T0``), so that k stays right. Arrivals are late and never early, so
the phase follows the early ones at once and the late ones slowly. Source: reference/real-time.md.
"""

from enum import StrEnum

from msgspec import Struct
from msgspec.structs import replace

LATE_SHARE = 0.1
"""How much of an arrival's lateness enters the phase."""

ATTEND_NS = 250_000
"""How long before a telegram nothing else is begun [ns]: a wake of the clock and a rehearsal."""

MOST_AT_ONCE = 25
"""Steps made after a stall; what is older is skipped and counted."""


class Kind(StrEnum):
    """What is to be done."""

    PREPARE = "prepare"
    MISSING = "missing"


class Due(Struct, frozen=True):
    """One thing that is due.

    Attributes:
        kind: make the step ahead of its telegram, or because its telegram did not come.
        stamp_ns: the time of the telegram it is for [ns].
    """

    kind: Kind
    stamp_ns: int


class Schedule(Struct, frozen=True):
    """Where the schedule stands.

    Attributes:
        period_ns: T0 [ns].
        next_ns: when the next telegram is expected [ns].
        grace_ns: how long after that it counts as missing [ns].
        lead_ns: how long before that its step is prepared [ns], 0: never.
        attended: its telegram is or was waited for.
        locked: telegrams set the phase; else it runs free.
        skipped: cycles of which no step was made, after stalls.
    """

    period_ns: int
    next_ns: int
    grace_ns: int
    lead_ns: int = 0
    prepared: bool = False
    attended: bool = False
    locked: bool = False
    skipped: int = 0


def free(period_ns: int, now_ns: int, lead_ns: int = 0) -> Schedule:
    """A schedule that runs free from now on.

    Args:
        period_ns: T0 [ns].
        now_ns: monotonic time [ns].
        lead_ns: how long before a telegram its step is prepared [ns], 0: never. A telegram that is
            late is answered or given up before the next one's step is begun.

    Raises:
        ValueError: a lead of a cycle or more.
    """
    if not 0 <= lead_ns < period_ns:
        raise ValueError(f"a lead of {lead_ns} ns does not fit into a cycle of {period_ns} ns")
    return Schedule(period_ns, now_ns + period_ns, period_ns // 2, lead_ns)


def on_telegram(schedule: Schedule, stamp_ns: int) -> Schedule:
    """A telegram was answered.

    Args:
        stamp_ns: its arrival [ns].
    """
    period_ns = schedule.period_ns
    # The grid line it belongs to: the nearest one, which may be past already or to come.
    cycles = round((stamp_ns - schedule.next_ns) / period_ns)
    expected_ns = schedule.next_ns + cycles * period_ns
    late_ns = stamp_ns - expected_ns
    if schedule.locked and late_ns > 0:
        phase_ns = expected_ns + round(LATE_SHARE * late_ns)
    else:
        phase_ns = stamp_ns
    return replace(
        schedule, next_ns=phase_ns + period_ns, prepared=False, attended=False, locked=True
    )


def follow(schedule: Schedule, next_ns: int, period_ns: int, lead_ns: int) -> Schedule:
    """A telegram was answered, and somebody foresees the next one.

    Args:
        next_ns: when the next telegram is expected [ns].
        period_ns: the controller's cycle [ns].
        lead_ns: how long before it the step is prepared [ns], 0: never.
    """
    return Schedule(
        period_ns=period_ns,
        next_ns=next_ns,
        grace_ns=period_ns // 2,
        lead_ns=lead_ns,
        locked=True,
        skipped=schedule.skipped,
    )


def run_free(schedule: Schedule, period_ns: int) -> Schedule:
    """The robot is gone: the next telegram sets the phase, however late it seems.

    Args:
        period_ns: of the clock alone [ns].
    """
    return replace(schedule, locked=False, period_ns=period_ns, grace_ns=period_ns // 2)


def wake_ns(schedule: Schedule) -> int:
    """When something is due next [ns]."""
    if _prepares(schedule):
        return schedule.next_ns - schedule.lead_ns
    if _attends(schedule):
        return schedule.next_ns - ATTEND_NS
    return schedule.next_ns + schedule.grace_ns


def on_wake(schedule: Schedule, now_ns: int) -> tuple[Schedule, tuple[Due, ...]]:
    """Find what is due.

    Args:
        now_ns: monotonic time [ns].

    Returns:
        The schedule after it, and what is to be done, in this order.
    """
    due: list[Due] = []
    schedule = _skip(schedule, now_ns)
    while schedule.next_ns + schedule.grace_ns <= now_ns:
        due.append(Due(Kind.MISSING, schedule.next_ns))
        schedule = replace(
            schedule,
            next_ns=schedule.next_ns + schedule.period_ns,
            prepared=False,
            attended=False,
        )
    if _prepares(schedule) and wake_ns(schedule) <= now_ns:
        due.append(Due(Kind.PREPARE, schedule.next_ns))
        schedule = replace(schedule, prepared=True)
    return schedule, tuple(due)


def attend(schedule: Schedule, now_ns: int) -> tuple[Schedule, int | None]:
    """Find the telegram that is about to come and whose reply is ready.

    Args:
        now_ns: monotonic time [ns].

    Returns:
        The schedule after it, and when the telegram is expected [ns], once; None if it is not time.
    """
    if not _attends(schedule) or now_ns < schedule.next_ns - ATTEND_NS:
        return schedule, None
    return replace(schedule, attended=True), schedule.next_ns


def _attends(schedule: Schedule) -> bool:
    return schedule.prepared and not schedule.attended


def _prepares(schedule: Schedule) -> bool:
    """Nothing is prepared for a robot that is not there."""
    return schedule.locked and not schedule.prepared and schedule.lead_ns > 0


def _skip(schedule: Schedule, now_ns: int) -> Schedule:
    overdue = (now_ns - schedule.next_ns - schedule.grace_ns) // schedule.period_ns + 1
    excess = overdue - MOST_AT_ONCE
    if excess <= 0:
        return schedule
    return replace(
        schedule,
        next_ns=schedule.next_ns + excess * schedule.period_ns,
        skipped=schedule.skipped + excess,
    )
