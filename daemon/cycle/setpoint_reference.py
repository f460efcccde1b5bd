"""Proof of which correction a robot controller has in force.

An offset counts from the reference: the axis position at which the controller's program started
its exchange. A reply that counts from another reference moves the robot by the difference within
one cycle. So a reply carries corrections only with a proof. Without a proof it is bare (counter
only), and the controller keeps the correction that it has.

Invariants:
- A program that moved counts as going on only if counter and delay count account for the time.
- A start counts only after silence that a running program would have counted as delay.
- A counter that goes on where it stopped shows no start, whatever time has passed.
- A daemon that knows no program and heard no silence has no proof but the programmed position.
- A programmed position that differs from the known reference refutes that the program goes on.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from linemate.protocol.controller_link import ACCOUNTED_S
from linemate.protocol.stamped_samples import RobotSample

Axes = tuple[float, ...]
"""A1..A6 [rad], and E1 [m] where the arm has it."""

# A program needs longer to end its exchange, start it again, and come back [s].
RESTART_S = 0.1
# Time that the counter may leave unaccounted. Jitter and a controller that was stalled for a moment
# do not refute a program that goes on; a restart does [s].
UNACCOUNTED_S = ACCOUNTED_S
# Silence in which a running program would have raised the delay count visibly [cycles, s].
SILENT_CYCLES = 5
SILENT_S = 0.05
MARGIN = 2
# The same for a daemon that has moved the robot before: a wrong proof would take it back [s].
SILENT_AFTER_MOTION_S = 0.15
# A controller whose host was stalled for less goes on with its program [s].
STALLED_S = 10.0
# After a stall the counter has grown by the telegrams that were lost, and by no more than this [s].
COUNTED_S = 0.5
# Telegrams in a row that must agree before a start counts that one wrong digit could fake.
CONFIRMATIONS = 3
REST_S = 0.12  # the axes are at rest if all telegrams of so long are ...
STILL = 2e-4  # ... so near to each other [rad, m]
# A delayed telegram of the program's past: clock and counter agree at least so far [s].
DELAYED_S = 0.5
# The programmed position differs visibly from the actual one: it has no correction in it [rad, m].
APART = 0.01


class Known(StrEnum):
    """What the daemon knows of the program that it served last."""

    NONE = "no program was served, or one of another address that got zero only"
    UNMOVED = "this controller got no correction but zero since its program started"
    MOVED = "corrections were sent"


class Start(StrEnum):
    """Whether a program has just started."""

    NOT_SEEN = "telegrams were heard, or the delay count is as great as the silence"
    LIKELY = "silence, and the delay count is less than the silence"
    SEEN = "silence, and the delay count has no cycle of it"


class Programmed(StrEnum):
    """The programmed position against the actual one."""

    ABSENT = "not in the telegram"
    EQUAL = "equal to the actual position"
    APART = "differs from the actual position"


class Proof(StrEnum):
    """Why the correction in force is known."""

    CONTINUED = "the program goes on: counter and delay count account for the time since its reply"
    STARTED = "the start of the program was seen: the correction is zero"
    UNMOVED = "this daemon has sent zero only: the correction is zero"
    COMPUTED = "the correction is the actual position less the programmed one"
    REPORTED = "setpoints are positions: the first one is the reported position"
    PENDING = "waiting for telegrams that confirm it, or for the axes to rest"
    NONE = "the correction in force is unknown"


PROVEN = frozenset({Proof.CONTINUED, Proof.STARTED, Proof.UNMOVED, Proof.COMPUTED, Proof.REPORTED})


@dataclass(frozen=True, slots=True)
class ProofEvidence:
    """What speaks for a proof.

    Attributes:
        known: the program that was served last.
        goes_on: there is one, and counter and delay count account for the time since its reply.
        held: if so, it is known whether the controller applied that reply.
        start: whether a program has just started.
        confirmed: enough telegrams have agreed with a start that was likely.
        programmed: the programmed position against the actual one.
        refuted: the programmed position differs from the known reference.
        at_rest: the axes have not moved for some time.
    """

    known: Known
    goes_on: bool = False
    held: bool = False
    start: Start = Start.NOT_SEEN
    confirmed: bool = False
    programmed: Programmed = Programmed.ABSENT
    refuted: bool = False
    at_rest: bool = False


def decide(evidence: ProofEvidence) -> Proof:
    """Return the proof that the evidence gives; the first that holds."""
    e = evidence
    goes_on = e.goes_on and not e.refuted
    if goes_on and (e.held or e.at_rest):
        return Proof.CONTINUED
    is_zero = e.programmed is not Programmed.APART
    if is_zero and (e.confirmed or (e.start is Start.SEEN and e.known is not Known.MOVED)):
        return Proof.STARTED
    if is_zero and e.known is Known.UNMOVED:
        return Proof.UNMOVED
    if e.programmed is Programmed.APART and e.at_rest:
        return Proof.COMPUTED
    return Proof.PENDING if goes_on or e.start is not Start.NOT_SEEN else Proof.NONE


class Program(NamedTuple):
    """A controller's program as of its last telegram that was answered with a proof.

    Attributes:
        step: what the counter grows by each cycle; None while unknown.
        delay: bad cycles that the controller had counted.
        reference: the position that corrections count from.
        applied: the last command that the controller is known to have applied.
        pending: the command of the reply to this telegram.
        moved: a correction other than zero was sent since the program started.
        replies: replies since, that one included.
        heard: telegrams since, answered or not.
        silence_s: longest silence since [s].
    """

    counter: int
    step: int | None
    stamp_ns: int
    delay: int | None
    peer: Hashable
    reference: Axes
    applied: Axes
    pending: Axes
    moved: bool
    replies: int = 1
    heard: int = 0
    silence_s: float = 0.0


class Continuation(NamedTuple):
    """How a program has gone on since its last proven telegram.

    Attributes:
        cycles: of the controller since.
        held: where it holds the robot; None if it may have applied the last reply or not.
    """

    cycles: int
    held: Axes | None


def continuation(program: Program, robot: RobotSample, cycle_s: float) -> Continuation | None:
    """Return how a program has gone on, None if it cannot be proven that it has.

    The counter shows the cycles that passed. Where it has jumped, the telegrams that came show
    them, if they came without a pause. The delay count must hold each of these cycles that got no
    reply: a program that was restarted in between counts from zero.

    Args:
        program: the one that was answered last.
        robot: a telegram that may be its next, or of its past.
    """
    passed_s = (robot.stamp_ns - program.stamp_ns) * 1e-9
    by_counter = _cycles(program, robot.counter)
    continued = None
    if by_counter is not None and by_counter > 0:
        continued = _accounted(program, robot.delay, by_counter, passed_s, cycle_s)
    if continued is not None or program.silence_s > UNACCOUNTED_S:
        return continued
    by_telegrams = program.heard + 1
    if abs(passed_s - by_telegrams * cycle_s) <= UNACCOUNTED_S:
        continued = _accounted(program, robot.delay, by_telegrams, passed_s, cycle_s)
    if continued is None and by_counter is not None and by_counter <= 0:
        # A telegram of the past was delayed. Its delay count is of the past as well.
        is_delayed = abs(passed_s - by_counter * cycle_s) <= DELAYED_S
        continued = Continuation(0, program.pending) if is_delayed else None
    return continued


def _cycles(program: Program, counter: int) -> int | None:
    """Return the cycles since the program's last telegram by its counter, None if it jumped."""
    if program.step is None:
        return None
    cycles, rest = divmod(counter - program.counter, program.step)
    return None if rest else cycles


def _accounted(
    program: Program, delay: int | None, cycles: int, passed_s: float, cycle_s: float
) -> Continuation | None:
    """Return the continuation if the delay count accounts for the cycles, None if it does not."""
    if delay is None or program.delay is None:
        return None
    unserved = cycles - program.replies
    # It is a running total on some controllers and counts cycles in a row on others.
    for bad in (delay - program.delay, delay):
        if max(0, unserved) <= bad <= cycles and passed_s - cycles * cycle_s <= UNACCOUNTED_S:
            return Continuation(cycles, _held(program, bad, cycles, unserved))
    return None


def _held(program: Program, bad: int, cycles: int, unserved: int) -> Axes | None:
    """Return the command in force: it depends on whether the last reply was applied."""
    if bad == cycles:
        return program.applied
    if bad <= unserved or program.pending == program.applied:
        return program.pending
    return None


def start_seen(
    delay: int | None, silence_s: float | None, since_s: float, cycle_s: float, known: Known
) -> Start:
    """Return whether a program has started during a silence that no reply has followed.

    A program that ran during the silence got no reply, so its delay count is at least the
    silence. Half of it is asked for.

    Args:
        delay: bad cycles that the controller has counted, None if not in the telegram.
        silence_s: before the first telegram after it; None if there was none [s].
        since_s: time since the silence [s].
        known: the program that was served last.
    """
    if delay is None or silence_s is None:
        return Start.NOT_SEEN
    least_s = SILENT_AFTER_MOTION_S if known is Known.MOVED else SILENT_S
    if silence_s < max(least_s, SILENT_CYCLES * cycle_s) - 1e-9:
        return Start.NOT_SEEN
    before = delay - round(since_s / cycle_s)
    if (before + MARGIN) * cycle_s > 0.5 * silence_s:
        return Start.NOT_SEEN
    return Start.SEEN if before <= 0 else Start.LIKELY


def goes_on_after_stall(program: Program, robot: RobotSample, cycle_s: float) -> bool:
    """Return whether the counter goes on where it stopped, as after a stall of the controller.

    The counter of a restarted program has run on for the time that passed, or begins elsewhere.

    Args:
        program: the one that was answered last.
        robot: the first telegram after a silence.
    """
    cycles = _cycles(program, robot.counter)
    if cycles is None or cycles <= 0:
        return False
    passed_s, counted_s = (robot.stamp_ns - program.stamp_ns) * 1e-9, cycles * cycle_s
    return counted_s <= COUNTED_S and UNACCOUNTED_S < passed_s - counted_s <= STALLED_S


def compare(actual: Axes, programmed: Axes | None) -> Programmed:
    """Return how the programmed position compares with the actual one [rad, m]."""
    if programmed is None:
        return Programmed.ABSENT
    return Programmed.APART if _differ(actual, programmed) else Programmed.EQUAL


def refutes(program: Program, programmed: Axes | None) -> bool:
    """Return whether the programmed position shows that the known reference is wrong."""
    return programmed is not None and _differ(program.reference, programmed)


def _differ(first: Axes, other: Axes) -> bool:
    return any(abs(a - b) > APART for a, b in zip(first, other, strict=True))


def was_led(program: Program, axes: Axes) -> bool:
    """Return whether a robot was led since a program began, by this daemon or by its controller."""
    ways = zip(axes, program.pending, strict=True)
    return program.moved or any(abs(now - sent) >= STILL for now, sent in ways)


def agrees(candidate: Program, robot: RobotSample, cycle_s: float) -> bool:
    """Return whether a telegram follows those of a start that is likely, answered all."""
    passed_s = (robot.stamp_ns - candidate.stamp_ns) * 1e-9
    step = robot.counter - candidate.counter
    if step <= 0 or (candidate.step is not None and step % candidate.step):
        return False
    if robot.delay is None or candidate.delay is None:
        return False
    # Less: it counts cycles in a row, and the bare reply was one that counts.
    return (robot.delay - candidate.delay) * cycle_s <= passed_s + 2.0 * cycle_s
