"""Causes of state changes: the row of the state table in words, with the facts that decided.

Invariants:
- Pure. Called when the state changes, never in an ordinary cycle.
- Driven by the table: a new row needs no code here. A signal without an entry in ``EXPLAINED`` is
  named by its own name.
- Format: ``what is wrong: value, limit. what to do.``
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from typing import Any, Final

from msgspec import Struct

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.cycle import watch
from linemate.daemon.cycle.sensing.samples import SensorFact
from linemate.daemon.cycle.states import Link, Machine, Row, Signals, State, deciding_row

Explanation = tuple[str, str]
"""What is wrong with its value and limit, and what to do; the second may be empty."""

QUIET: Final = Signals(Link.HEALTHY, position_fresh=True, wrench_fresh=True, ready=True)
"""Signals that end no motion and begin none."""

SIGNALS: Final = tuple(field.name for field in fields(Signals))

POSITION: Final = ("distance", "camera")
"""Sensors of the object's position."""

LATCHED: Final = "latched"
"""Name of the machine's own condition, next to the signals'."""


class Evidence(Struct, frozen=True, eq=False):
    """What a decision was made from.

    Attributes:
        facts, counts, settings: of the watch, the counts after this cycle.
        sensors: ``distance``, ``camera`` and ``force_torque``.
        unready: why the task cannot start, None if it can.
        following_error: the axis that is not where it was sent, in words.
        overload_n: the last force beyond the limit, and the limit [N].
        fault: the cause of the latched fault.
        waiting: why the tool waits before contact, None if it does not.
        swinging_n: rms force of an oscillation that softening does not end [N], None if none.
        unanswered_n: mean force of a contact that has answered no test [N], None if none.
        declined: why telegrams get no setpoint and what to do, None if they get one.
    """

    facts: watch.Facts
    counts: watch.Watch
    settings: WatchSettings
    sensors: Mapping[str, SensorFact]
    unready: str | None
    following_error: str | None
    overload_n: tuple[float, float] | None
    ordered_by: Mapping[str, str]
    fault: str | None
    waiting: str | None = None
    swinging_n: float | None = None
    unanswered_n: float | None = None
    declined: str | None = None


class Change(Struct, frozen=True):
    """A change of the operating state.

    Attributes:
        before, after: the states; equal if a fault was latched and the state stayed.
    """

    stamp_ns: int
    before: State
    after: State
    cause: str

    def __str__(self) -> str:
        return f"{self.before} -> {self.after}: {self.cause}"


def cause(row: Row, machine: Machine, signals: Signals, evidence: Evidence) -> str:
    """Return why a row was taken.

    Args:
        machine: before the change, with this cycle's fault latched.
        evidence: what the signals were made from.
    """
    names = decisive(row, machine, signals)
    return _sentence(row.because, [_explain(name, signals, evidence) for name in names])


def fault(signals: Signals, evidence: Evidence) -> str:
    """Return the cause of a fault that was latched in this cycle."""
    what, todo = _explain("fault", signals, evidence)
    return f"{what}. {todo}" if todo else what


def refusal(reason: str, signals: Signals, evidence: Evidence) -> str:
    """Return the state table's reason for a refusal, with the sensors that are not fresh."""
    stale = [name for name in ("position_fresh", "wrench_fresh") if not getattr(signals, name)]
    return _sentence(reason, [_explain(name, signals, evidence) for name in stale])


def decisive(row: Row, machine: Machine, signals: Signals) -> tuple[str, ...]:
    """Return the names of the signals that made a row decide.

    A signal is needed if the row would not decide with its quiet value. If several would do each
    by itself, all of them are named.
    """
    loud = tuple(_loud(machine, signals))

    def holds(names: tuple[str, ...]) -> bool:
        quieter, quieter_signals = _only(names, machine, signals)
        return deciding_row(quieter, quieter_signals) is row

    needed = tuple(n for n in loud if not holds(tuple(other for other in loud if other != n)))
    if holds(needed):
        return needed or _conditions(row, machine, signals)
    sufficient = tuple(n for n in loud if n not in needed and holds((*needed, n)))
    rest = tuple(n for n in loud if n not in needed)
    return tuple(n for n in loud if n in needed or n in (sufficient or rest))


def _loud(machine: Machine, signals: Signals) -> Iterator[str]:
    """Yield the names of what is not quiet."""
    yield from (name for name in SIGNALS if getattr(signals, name) != getattr(QUIET, name))
    if machine.latched:
        yield LATCHED


def _only(names: tuple[str, ...], machine: Machine, signals: Signals) -> tuple[Machine, Signals]:
    """Return the signals and the machine with everything quiet but the names."""
    kept: dict[str, Any] = {name: getattr(signals, name) for name in names if name != LATCHED}
    return replace(machine, latched=LATCHED in names), replace(QUIET, **kept)


def _conditions(row: Row, machine: Machine, signals: Signals) -> tuple[str, ...]:
    """Return the quiet signals without which a row would not hold."""
    return tuple(
        name
        for name in SIGNALS
        if deciding_row(machine, replace(signals, **{name: _opposite(name)})) is not row
    )


def _opposite(name: str) -> Any:
    quiet = getattr(QUIET, name)
    return Link.LOST if isinstance(quiet, Link) else not quiet


def _sentence(because: str, explanations: list[Explanation]) -> str:
    whats = "; ".join(dict.fromkeys(what for what, _ in explanations if what))
    advice = " ".join(dict.fromkeys(todo for _, todo in explanations if todo))
    text = f"{because}: {whats}" if whats else because
    return f"{text}. {advice}" if advice else text


def _explain(name: str, signals: Signals, evidence: Evidence) -> Explanation:
    explain = EXPLAINED.get(name)
    if explain is None:
        return name.replace("_", " "), ""
    return explain(signals, evidence)


# One explanation for each signal.


def _link(signals: Signals, evidence: Evidence) -> Explanation:
    counts, settings, facts = evidence.counts, evidence.settings, evidence.facts
    advice = evidence.declined or "Check the robot's network and the controller's programme."
    advice = advice[0].upper() + advice[1:]
    if signals.link is Link.HEALTHY:
        return f"{counts.good} answered cycles in a row, {settings.healthy_cycles} needed", ""
    touches = counts.state in watch.IN_CONTACT
    silent = _silence(counts.telegram_ns, facts.stamp_ns)
    if signals.link is Link.LOST:
        if facts.new_session:
            return "the controller's programme began again", "Arm and start again."
        lost_s = settings.link_lost_in_contact_s if touches else settings.link_lost_s
        return f"no answered telegram {silent}, limit {lost_s:.2f} s", advice
    missed_s = settings.missed_in_contact_s if touches else settings.missed_s
    if _age_s(counts.telegram_ns, facts.stamp_ns) >= missed_s:
        return f"no answered telegram {silent}, limit {missed_s:.2f} s", advice
    most_ns = watch.largest_leak_ns(settings, counts.state)
    if counts.leak_ns >= most_ns:
        level = f"level {counts.leak_ns * 1e-9:.2f} s, limit {most_ns * 1e-9:.2f} s"
        return f"telegrams missed too often: {level}", advice
    return _not_proven(evidence), advice


def _not_proven(evidence: Evidence) -> str:
    if evidence.facts.wrong_cycle is not None:
        return evidence.facts.wrong_cycle.removesuffix(".")
    limit_s = 0.5e-9 * watch.largest_leak_ns(evidence.settings, evidence.counts.state)
    if evidence.facts.unled_s >= limit_s:
        unled = f"{evidence.facts.unled_s:.3f} s, limit {limit_s:.3f} s"
        return f"the robot got no setpoint for {unled}"
    good, needed = evidence.counts.good, evidence.settings.healthy_cycles
    return f"robot link not proven: {good} answered cycles in a row, {needed} needed"


def _position(_: Signals, evidence: Evidence) -> Explanation:
    facts, settings = evidence.facts, evidence.settings
    if facts.contradicted:
        return (
            "camera and distance contradict each other: "
            f"{_heard('camera', evidence)}, {_heard('distance', evidence)}",
            "Check the camera's pose and clock, object.nominal, and the axes' signs in the URDF.",
        )
    if facts.distance_lost:
        return (
            "the distance sensor alone shows the object in the last approach: "
            f"{_heard('distance', evidence)}",
            "Check the sensor's target, mount and cable.",
        )
    limit = watch.largest_position_age(settings, evidence.counts.state, facts)
    if _age_s(facts.position_ns, facts.stamp_ns) <= limit:
        # The newest is young enough, so the older of the two is the trouble.
        limit = settings.one_sensor_s
    young = [name for name in POSITION if _sensor_age_s(name, evidence) <= limit]
    late = [name for name in POSITION if name not in young] or list(POSITION)
    heard = [_heard(name, evidence) for name in late]
    heard += [f"{name} {_sensor_age_s(name, evidence):.2f} s" for name in young]
    todo = f"Check the link of {' and '.join(late)}."
    return f"{', '.join(heard)} (limit {limit:.2f} s)", todo


def _wrench(_: Signals, evidence: Evidence) -> Explanation:
    limit = evidence.settings.wrench_s
    return (
        f"{_heard('force_torque', evidence)} (limit {limit:.2f} s)",
        "Check the force-torque sensor's cable and its streaming mode.",
    )


def _ready(_: Signals, evidence: Evidence) -> Explanation:
    return evidence.unready or "the estimate of the object is not ready", ""


def _object_left(_signals: Signals, evidence: Evidence) -> Explanation:
    if evidence.counts.state is State.HOME:
        return "the arm does not reach a pose of the way", "Drive the robot home by hand."
    if evidence.counts.state is State.FOLLOW:
        return "the arm does not reach a pose handed in", "Hand in poses within its reach."
    return "the object leaves the reach of the linear axis or the arm", "Wait for the next object."


def _clear(_: Signals, evidence: Evidence) -> Explanation:
    if evidence.counts.state is State.HOME:
        return "the way home is over", ""
    if evidence.counts.state is State.FOLLOW:
        return "no pose is left, and the robot stands behind the last one", ""
    return "the tool is free, away and at rest", ""


def _contact(_: Signals, evidence: Evidence) -> Explanation:
    counts, settings, gap_m = evidence.counts, evidence.settings, evidence.facts.gap_m
    if counts.contact >= settings.cycles_of_contact or gap_m is None:
        return f"contact felt for {counts.contact} cycles, limit {settings.cycles_of_contact}", ""
    return f"a stop would leave {gap_m:.3f} m to the object, limit {settings.near_m:.3f} m", ""


def _outwaited(_: Signals, evidence: Evidence) -> Explanation:
    return (evidence.waiting or "go was not given").removesuffix("."), ""


def _overload(_: Signals, evidence: Evidence) -> Explanation:
    if evidence.swinging_n is not None:
        swing = f"an oscillation of {evidence.swinging_n:.0f} N rms does not fall in contact"
        return swing, "Check the mount's stiffness and the hanger."
    if evidence.unanswered_n is not None:
        pull = f"a force of {evidence.unanswered_n:.0f} N answered no motion of the tool in contact"
        return pull, "Check the sign and the axes of the force-torque sensor."
    todo = "Check that nothing is jammed."
    if evidence.counts.state is State.CONTACT:
        todo = "Check that nothing is jammed, and what holds the object (tracking.tactile.holds)."
    if evidence.overload_n is None:
        return "force beyond the limit", todo
    force, limit = evidence.overload_n
    return f"force {force:.0f} N, limit {limit:.0f} N", todo


def _expired(_: Signals, evidence: Evidence) -> Explanation:
    counts, settings = evidence.counts, evidence.settings
    limits = {State.HOLD: settings.longest_hold_s, State.HOME: settings.longest_home_s}
    limit = limits.get(counts.state, settings.longest_retreat_s)
    lasted = _age_s(counts.since_ns, evidence.facts.stamp_ns)
    return f"in {counts.state} for {lasted:.1f} s, limit {limit:.1f} s", "Acknowledge the fault."


def _fault(_: Signals, evidence: Evidence) -> Explanation:
    counts, limit = evidence.counts, evidence.settings.cycles_astray
    if counts.following_error >= limit:
        error = evidence.following_error or "an axis is not where it was sent"
        return (
            f"following error: {error} for {counts.following_error} cycles, limit {limit}",
            "Check that the drives are on and the programme runs.",
        )
    if evidence.facts.fault:
        return "the daemon failed in a cycle", "Read the error in the journal."
    return evidence.fault or "a fault is present", ""


def _latched(signals: Signals, evidence: Evidence) -> Explanation:
    if evidence.fault is not None:
        return evidence.fault.removesuffix("."), ""
    return _fault(signals, evidence)


def _ordered(op: str) -> Callable[[Signals, Evidence], Explanation]:
    def explain(_: Signals, evidence: Evidence) -> Explanation:
        return f"{op} ordered by {evidence.ordered_by.get(op) or 'an operator'}", ""

    return explain


EXPLAINED: Final[Mapping[str, Callable[[Signals, Evidence], Explanation]]] = {
    "link": _link,
    "position_fresh": _position,
    "wrench_fresh": _wrench,
    "ready": _ready,
    "object_left": _object_left,
    "contact": _contact,
    "overload": _overload,
    "outwaited": _outwaited,
    "done": lambda _signals, _evidence: ("the task's retreat has begun", ""),
    "clear": _clear,
    "expired": _expired,
    "fault": _fault,
    **{op: _ordered(op) for op in watch.OPERATIONS},
    LATCHED: _latched,
}
"""Explanations by signal."""


def _heard(name: str, evidence: Evidence) -> str:
    """Return how a sensor was heard: silent or excluded with its age, or how young it is."""
    sensor, now_ns = evidence.sensors[name], evidence.facts.stamp_ns
    if sensor.excluded is not None:
        return f"{name} excluded ({sensor.excluded}) {_silence(sensor.stamp_ns, now_ns)}"
    return f"{name} silent {_silence(sensor.stamp_ns, now_ns)}"


def _silence(then_ns: int | None, now_ns: int) -> str:
    return "since the start" if then_ns is None else f"for {_age_s(then_ns, now_ns):.2f} s"


def _sensor_age_s(name: str, evidence: Evidence) -> float:
    return _age_s(evidence.sensors[name].stamp_ns, evidence.facts.stamp_ns)


def _age_s(then_ns: int | None, now_ns: int) -> float:
    return float("inf") if then_ns is None else max(0.0, (now_ns - then_ns) * 1e-9)
