"""Operating states of the daemon, as a table.

Time-outs and debounce come before the table (``watch``), the limits of commands after it.

Invariants:
- Pure. The first row of the present state that holds decides.
- A state's rows stand in the order of their priority: link, overload, retreat, stop, stale, start.
- A fault is latched until an operator acknowledges it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum

from linemate.daemon.core.inputs import MotionOrder


class State(StrEnum):
    """What the daemon is doing for its operator."""

    INIT = "init"
    IDLE = "idle"
    ARMED = "armed"
    TRACK = "track"
    CONTACT = "contact"
    RETREAT = "retreat"
    HOLD = "hold"
    FAULT = "fault"
    HOME = "home"
    FOLLOW = "follow"


class Link(StrEnum):
    """The robot link, judged by ``watch``."""

    LOST = "lost"
    UNPROVEN = "unproven"
    HEALTHY = "healthy"


MOVING = frozenset({State.TRACK, State.CONTACT, State.RETREAT, State.HOME, State.FOLLOW})
"""States whose order to the step is not to hold."""


@dataclass(frozen=True, slots=True)
class Signals:
    """What the machine sees in one cycle, debounced; the last seven are operators' edges.

    Attributes:
        link: the robot link; a new session of the controller shows as LOST for one cycle.
        position_fresh: distance sensor or camera are young enough for the present state.
        wrench_fresh: the force-torque sensor too, or there is none.
        ready: the estimate is consistent and the object may be tracked.
        object_left: the object is out of the robot's reach, or about to be, while it is tracked;
            on the way home, the way is.
        contact: the tool touches the object, or is so near that to stop would end there.
        overload: the force is beyond the tool's limit, or it swings in contact and does not fall
            though the contact is softened, or it answers no motion of the tool.
        outwaited: the tool has waited before contact for longer than the task allows.
        overdue: the tool has not done in its time what the programme needs: in contact and in a
            retreat the clamp has not opened; in TRACK no contact was found.
        done: the task has come to its own retreat, or to its end.
        clear: a retreat is over: free, away and at rest; or the way home, at the first pose; or
            the poses handed in have run out, at rest behind the last one.
        expired: the present state has lasted too long; in FAULT for the tool to be withdrawn from
            the object without an operator, or it may not be yet.
        fault: anything that must be acknowledged.
        arm, start, stop, retreat, ack, home, follow: accepted orders since the last cycle.
    """

    link: Link = Link.LOST
    position_fresh: bool = False
    wrench_fresh: bool = False
    ready: bool = False
    object_left: bool = False
    contact: bool = False
    overload: bool = False
    outwaited: bool = False
    overdue: bool = False
    done: bool = False
    clear: bool = False
    expired: bool = False
    fault: bool = False
    arm: bool = False
    start: bool = False
    stop: bool = False
    retreat: bool = False
    ack: bool = False
    home: bool = False
    follow: bool = False


@dataclass(frozen=True, slots=True)
class Machine:
    """Where the machine stands.

    Attributes:
        latched: a fault waits for its acknowledgement.
        programmed: in RETREAT, the task's own retreat and not an emergency.
        because: why the state was entered; never decides anything.
    """

    state: State = State.INIT
    latched: bool = False
    programmed: bool = False
    because: str = field(default="start of the daemon", compare=False)


Condition = Callable[[Signals, Machine], bool]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table.

    Attributes:
        source: the state it is for.
        target: the state it leads to.
        when: when, exactly; the machine given has this cycle's fault latched already.
        latches: entering this way must be acknowledged.
        programmed: the retreat is the task's own.
    """

    source: State
    target: State
    because: str
    when: Condition
    latches: bool = False
    programmed: bool = False


def _fresh(s: Signals) -> bool:
    return s.position_fresh and s.wrench_fresh


def fit(s: Signals) -> bool:
    """Everything is as it must be for a motion to begin."""
    healthy = s.link is Link.HEALTHY
    return healthy and _fresh(s) and s.ready and not (s.contact or s.overload or s.fault)


def may_go_home(s: Signals) -> bool:
    """Everything is as it must be for a motion that needs no sight of an object."""
    return s.link is Link.HEALTHY and s.wrench_fresh and not (s.contact or s.overload or s.fault)


def _lost(s: Signals, _: Machine) -> bool:
    return s.link is Link.LOST


def _latched(_: Signals, m: Machine) -> bool:
    return m.latched


def _overload(s: Signals, _: Machine) -> bool:
    return s.overload


def _contact(s: Signals, _: Machine) -> bool:
    return s.contact


def _retreat(s: Signals, _: Machine) -> bool:
    return s.retreat


def _stop(s: Signals, _: Machine) -> bool:
    return s.stop


def _overdue(s: Signals, _: Machine) -> bool:
    return s.overdue


def _expired(s: Signals, _: Machine) -> bool:
    return s.expired


def _left(s: Signals, _: Machine) -> bool:
    return s.object_left


def _done(s: Signals, _: Machine) -> bool:
    return s.done


def _stale(s: Signals, _: Machine) -> bool:
    return not _fresh(s)


def _shaky(s: Signals, _: Machine) -> bool:
    return s.link is not Link.HEALTHY


def _may_start(s: Signals, _: Machine) -> bool:
    return s.start and fit(s)


INIT, IDLE, ARMED, TRACK = State.INIT, State.IDLE, State.ARMED, State.TRACK
CONTACT, RETREAT, HOLD, FAULT = State.CONTACT, State.RETREAT, State.HOLD, State.FAULT
HOME, FOLLOW = State.HOME, State.FOLLOW

CLAMP_CLOSED = "the clamp is not reported open (open it by hand)"
"""The tool follows the object then, and withdraws as soon as the clamp is reported open."""

TABLE: tuple[Row, ...] = (
    Row(INIT, FAULT, "fault", _latched),
    Row(INIT, IDLE, "robot link healthy", lambda s, _: s.link is Link.HEALTHY),
    Row(IDLE, FAULT, "fault", _latched),
    Row(IDLE, INIT, "robot link lost", _lost),
    Row(IDLE, ARMED, "armed", lambda s, _: s.arm and fit(s) and not (s.stop or s.retreat)),
    Row(
        IDLE,
        HOME,
        "ordered home",
        lambda s, _: s.home and may_go_home(s) and not (s.stop or s.retreat or s.arm),
    ),
    Row(
        IDLE,
        FOLLOW,
        "ordered to follow poses",
        lambda s, _: s.follow and may_go_home(s) and not (s.stop or s.retreat or s.arm or s.home),
    ),
    Row(ARMED, FAULT, "fault", _latched),
    Row(ARMED, INIT, "robot link lost", _lost),
    Row(
        ARMED,
        IDLE,
        "another order",
        lambda s, _: s.retreat or s.stop or s.ack or s.arm or s.home or s.follow,
    ),
    Row(ARMED, IDLE, "no longer fit to start", lambda s, _: not fit(s)),
    Row(ARMED, TRACK, "started", lambda s, _: s.start),
    Row(TRACK, FAULT, "robot link lost in motion", _lost, latches=True),
    Row(TRACK, RETREAT, "overload", _overload),
    Row(TRACK, RETREAT, "ordered to retreat", _retreat),
    Row(TRACK, RETREAT, "stopped in contact", lambda s, _: s.stop and s.contact),
    Row(TRACK, HOLD, "stopped", _stop),
    Row(TRACK, RETREAT, "fault in contact", lambda s, m: m.latched and s.contact),
    Row(TRACK, HOLD, "fault", _latched),
    Row(
        TRACK,
        RETREAT,
        "contact without fresh sensors",
        lambda s, _: s.contact and not _fresh(s),
        latches=True,
    ),
    Row(TRACK, HOLD, "no fresh position", lambda s, _: not s.position_fresh),
    Row(TRACK, HOLD, "no fresh force", lambda s, _: not s.wrench_fresh),
    Row(TRACK, HOLD, "the object has left", lambda s, _: s.object_left and not s.contact),
    Row(TRACK, RETREAT, "the object leaves in contact", _left),
    Row(TRACK, HOLD, "telegrams missing", lambda s, m: _shaky(s, m) and not s.contact),
    Row(TRACK, RETREAT, "telegrams missing in contact", _shaky),
    Row(
        TRACK,
        RETREAT,
        "no contact up to the largest overrun (check the object and the camera's calibration)",
        _overdue,
        latches=True,
    ),
    Row(TRACK, RETREAT, "waited too long before contact", lambda s, _: s.outwaited),
    Row(TRACK, RETREAT, "the task retreats", _done, programmed=True),
    Row(TRACK, CONTACT, "contact", _contact),
    Row(CONTACT, FAULT, "robot link lost in motion", _lost, latches=True),
    Row(CONTACT, RETREAT, "overload", _overload),
    Row(CONTACT, RETREAT, "ordered to retreat", _retreat),
    Row(CONTACT, RETREAT, "stopped in contact", _stop),
    Row(CONTACT, RETREAT, "fault in contact", _latched),
    Row(CONTACT, RETREAT, "contact without fresh sensors", _stale, latches=True),
    Row(CONTACT, RETREAT, "the object leaves in contact", _left),
    Row(CONTACT, RETREAT, "telegrams missing in contact", _shaky),
    Row(CONTACT, RETREAT, CLAMP_CLOSED, _overdue, latches=True),
    Row(CONTACT, RETREAT, "the task retreats", _done, programmed=True),
    Row(RETREAT, FAULT, "robot link lost in motion", _lost, latches=True),
    Row(RETREAT, FAULT, "retreated with a fault", lambda s, m: s.clear and m.latched),
    Row(RETREAT, IDLE, "retreated", lambda s, _: s.clear),
    Row(
        RETREAT,
        FAULT,
        "the clamp is not reported open and no sensor shows the object",
        lambda s, _: s.expired and s.overdue,
        latches=True,
    ),
    Row(RETREAT, FAULT, "retreat takes too long", _expired, latches=True),
    Row(
        RETREAT,
        RETREAT,
        CLAMP_CLOSED,
        lambda s, m: s.overdue and m.because != CLAMP_CLOSED,
        latches=True,
    ),
    Row(
        RETREAT,
        RETREAT,
        "trouble in the task's retreat",
        lambda s, m: m.programmed and (s.overload or s.retreat or s.stop or m.latched),
    ),
    Row(HOLD, FAULT, "robot link lost in motion", _lost, latches=True),
    Row(HOLD, RETREAT, "overload", _overload),
    Row(HOLD, RETREAT, "contact while holding", _contact),
    Row(HOLD, RETREAT, "ordered to retreat", _retreat),
    Row(HOLD, FAULT, "fault", _latched),
    Row(HOLD, FAULT, "held too long", _expired, latches=True),
    Row(HOLD, IDLE, "stopped", _stop),
    Row(HOLD, TRACK, "started again", _may_start),
    Row(HOME, FAULT, "robot link lost in motion", _lost, latches=True),
    Row(HOME, FAULT, "overload on the way home", _overload, latches=True),
    Row(HOME, FAULT, "contact on the way home", _contact, latches=True),
    Row(HOME, FAULT, "fault", _latched),
    Row(HOME, FAULT, "the way home is out of reach", _left, latches=True),
    Row(HOME, FAULT, "the way home takes too long", _expired, latches=True),
    Row(HOME, IDLE, "stopped on the way home", lambda s, _: s.stop or s.retreat),
    Row(HOME, IDLE, "no fresh force on the way home", lambda s, _: not s.wrench_fresh),
    Row(HOME, IDLE, "telegrams missing on the way home", _shaky),
    Row(HOME, IDLE, "at the first pose", lambda s, _: s.clear),
    Row(FOLLOW, FAULT, "robot link lost in motion", _lost, latches=True),
    Row(FOLLOW, FAULT, "overload on the way of the poses", _overload, latches=True),
    Row(FOLLOW, FAULT, "contact on the way of the poses", _contact, latches=True),
    Row(FOLLOW, FAULT, "fault", _latched),
    Row(FOLLOW, FAULT, "a pose is out of reach", _left, latches=True),
    Row(FOLLOW, IDLE, "stopped while following poses", lambda s, _: s.stop or s.retreat),
    Row(FOLLOW, IDLE, "no fresh force while following poses", lambda s, _: not s.wrench_fresh),
    Row(FOLLOW, IDLE, "telegrams missing while following poses", _shaky),
    Row(FOLLOW, IDLE, "the poses have run out", lambda s, _: s.clear),
    Row(
        FAULT,
        RETREAT,
        "contact after a lost link",
        lambda s, _: s.contact and s.link is not Link.LOST and not s.expired,
    ),
    Row(
        FAULT,
        IDLE,
        "acknowledged",
        lambda s, _: s.ack and s.link is not Link.LOST and not (s.overload or s.fault),
    ),
)

_ROWS = {state: tuple(row for row in TABLE if row.source is state) for state in State}


def transition(machine: Machine, signals: Signals) -> Machine:
    """One cycle of the machine.

    Returns:
        Where it stands after it; the same object when nothing changed.
    """
    if signals.fault and not machine.latched:
        machine = replace(machine, latched=True)
    row = deciding_row(machine, signals)
    return machine if row is None else _enter(machine, row)


def deciding_row(machine: Machine, signals: Signals) -> Row | None:
    """Return the row that decides, None if none holds.

    Args:
        machine: where it stands, with this cycle's fault latched.
    """
    for row in _ROWS[machine.state]:
        if row.when(signals, machine):
            return row
    return None


def _enter(machine: Machine, row: Row) -> Machine:
    acknowledged = row.source is FAULT and row.target is IDLE
    latched = (machine.latched and not acknowledged) or row.latches
    return Machine(row.target, latched, row.programmed, row.because)


def order(machine: Machine) -> MotionOrder:
    """What the step may do.

    Returns:
        TRACK also in the task's own retreat, which the reference trajectory describes.
    """
    if machine.state is RETREAT and not machine.programmed:
        return MotionOrder.RETREAT
    if machine.state is HOME:
        return MotionOrder.HOME
    if machine.state is FOLLOW:
        return MotionOrder.FOLLOW
    return MotionOrder.TRACK if machine.state in MOVING else MotionOrder.HOLD


_EXPECTED: dict[str, frozenset[State]] = {
    "arm": frozenset({IDLE}),
    "start": frozenset({ARMED, HOLD}),
    "stop": frozenset(State),
    "retreat": frozenset({TRACK, CONTACT, RETREAT, HOLD, HOME, FOLLOW}),
    "ack": frozenset({FAULT}),
    "home": frozenset({IDLE}),
    "follow": frozenset({IDLE}),
}
"""In which states an order means something; stop is always taken."""

_CHECKED = frozenset({"arm", "start"})


def refusal(machine: Machine, signals: Signals, op: str) -> str | None:
    """Why an order cannot be taken now.

    Args:
        op: arm, start, stop, retreat, ack, home or follow.

    Returns:
        A reason for the operator, None if the order may be passed on.
    """
    if op not in _EXPECTED:
        return f"no such order: {op}"
    if machine.state not in _EXPECTED[op]:
        expected = ", ".join(sorted(state.upper() for state in _EXPECTED[op]))
        return f"{op} needs {expected}; the state is {machine.state.upper()}"
    if op in _CHECKED:
        return unfit(signals)
    if op == "ack":
        return _still_faulty(signals)
    if op in {"home", "follow"}:
        return _missing(signals, ("link", "wrench_fresh", "contact", "overload", "fault"))
    return None


def unfit(s: Signals) -> str | None:
    """What is missing for a motion to begin, in words.

    Args:
        s: what the machine saw last.

    Returns:
        Everything that is missing, None if nothing is.
    """
    return _missing(
        s, ("link", "position_fresh", "wrench_fresh", "ready", "contact", "overload", "fault")
    )


def _missing(s: Signals, names: tuple[str, ...]) -> str | None:
    """Return in words which of some signals are not as a motion needs them, None if all are."""
    wants = {
        "link": (s.link is Link.HEALTHY, f"the robot link is {s.link}"),
        "position_fresh": (s.position_fresh, "no fresh position of the object"),
        "wrench_fresh": (s.wrench_fresh, "no fresh force"),
        "ready": (s.ready, "the estimate of the object is not ready"),
        "contact": (not s.contact, "the tool is in contact"),
        "overload": (not s.overload, "overload"),
        "fault": (not s.fault, "a fault is present"),
    }
    missing = [what for holds, what in map(wants.__getitem__, names) if not holds]
    return "; ".join(missing) or None


def _still_faulty(s: Signals) -> str | None:
    if s.link is Link.LOST:
        return "the robot link is lost"
    if s.overload or s.fault:
        return "overload" if s.overload else "the fault is still present"
    return None
