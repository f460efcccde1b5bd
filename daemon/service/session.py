"""A controller's programme: where its corrections count from, and which command it took last.

Law of this file: the controller's word decides. It throws replies away and says so only in its
Delay; a programme that was under way before this process cannot say where it began. What is not
known is not guessed: such a robot is asked to hold. No step is made here and no byte is read.
"""

from collections.abc import Hashable
from dataclasses import replace
from typing import NamedTuple

from linemate.protocol.samples import RobotSample

Axes = tuple[float, ...]
"""A1..A6 [rad], and E1 [m] where the arm has it."""

JOINED_S = 0.15  # unanswered for longer before its first telegram here: it was under way before
FOREIGN = "the robot's programme was under way before this daemon: start it anew"
PEERS = 4  # programmes that are remembered
DELAYED_S = 0.5  # counter and clock may disagree: telegrams that were held up come at last


class Programme(NamedTuple):
    """What is remembered of a controller's programme, as of its last answered telegram."""

    ipoc: int
    step: int | None
    stamp_ns: int
    delay: int | None
    start: Axes
    taken: Axes
    given: Axes


class Session:
    """The programme that is served now, and those that were before it.

    Attributes:
        start: where absolute corrections count from.
        given: the command of the last reply while its fate is open.
        taken: the last command that the controller took.
        was_lost: the last reply was not taken.
        was_sent: the last step's command went out in a reply.
        moves: the controller got a command in its last cycle, as far as is known.
        is_foreign: the programme was under way before this process.
        openings: sessions begun.
        replies_lost: replies that were not taken.
    """

    __slots__ = (
        "_cycle_s",
        "_delay",
        "_heard_ns",
        "_programmes",
        "given",
        "is_foreign",
        "moves",
        "openings",
        "replies_lost",
        "start",
        "taken",
        "was_lost",
        "was_sent",
    )

    def __init__(self, cycle_s: float) -> None:
        """Wait for the first programme; ``cycle_s`` is the controller's cycle [s]."""
        self.start: Axes = ()
        self.given: Axes | None = None
        self.taken: Axes = ()
        self.was_lost = False
        self.was_sent = True
        self.moves = False
        self.is_foreign = False
        self.openings = self.replies_lost = 0
        self._cycle_s = cycle_s
        self._delay: int | None = None
        self._heard_ns = 0
        self._programmes: dict[Hashable, Programme] = {}

    @property
    def delay(self) -> int | None:
        """What the controller has counted of bad cycles."""
        return self._delay

    @property
    def held(self) -> Axes:
        """Where the robot is, as far as is known: an open reply counts as taken."""
        return self.taken if self.given is None else self.given

    @property
    def arrived(self) -> bool:
        """The last step's command is the robot's."""
        return self.was_sent and not self.was_lost

    def meet(
        self, robot: RobotSample, axes: Axes, peer: Hashable, *, absolute: bool
    ) -> tuple[Axes, Axes] | None:
        """Find out whether a programme has begun or goes on.

        Args:
            robot: its first telegram.
            axes: where it says its axes are.
            peer: who sent it.
            absolute: corrections count from where the programme began. One that was under way
                before this process cannot be told where that was; it is only asked to hold.

        Returns:
            Where corrections count from and where the robot holds, to be given to ``open``;
            None if that cannot be known.
        """
        known = self._programmes.get(peer)
        if known is not None and (held := goes_on(known, robot, self._cycle_s)) is not None:
            return known.start, held
        unanswered_s = (robot.delay or 0) * self._cycle_s
        self.is_foreign = absolute and known is None and unanswered_s > JOINED_S
        return None if self.is_foreign else (axes, axes)

    def open(self, start: Axes, held: Axes, delay: int | None) -> None:
        """Begin anew with a robot that holds."""
        self.is_foreign = False
        self.openings += 1
        self.start, self.given, self.taken = start, None, held
        self._delay = delay
        self.was_lost, self.was_sent, self.moves = False, True, False

    def settle(self, delay: int | None, cycles: int, stamp_ns: int) -> bool:
        """Find out whether the controller took the last reply.

        It counts every cycle without a good one. If as many are new as have passed, then the
        last reply was not taken either: the robot holds, and the gate must begin from there. More
        than have passed is a flipped digit where the clock agrees with the counters; where it does
        not, a counter was flipped, and the next good one seems nearer than it is.

        Args:
            delay: what it has counted now.
            cycles: since its last telegram, by their counters.
            stamp_ns: arrival of the present one [ns].

        Returns:
            Whether a reply is lost.
        """
        given, self.given = self.given, None
        before, self._delay = self._delay, delay
        passed = (stamp_ns - self._heard_ns) * 1e-9 / self._cycle_s
        self._heard_ns = stamp_ns
        if given is None:
            return False
        bad = 0 if delay is None or before is None else delay - before
        self.was_lost = bad == cycles or (bad > cycles and abs(passed - cycles) >= 1.0)
        if self.was_lost:
            self.moves = False
            self.replies_lost += 1
        else:
            self.taken = given
        return self.was_lost

    def give(self, command: Axes) -> None:
        """A reply goes to the wire; its fate is open."""
        self.was_sent, self.was_lost, self.moves = True, False, True
        self.given = command

    def refrain(self) -> None:
        """A cycle passed, or passes, without a command: the robot holds in it."""
        self.was_sent = self.moves = False

    def remember(self, robot: RobotSample, peer: Hashable, step: int | None) -> None:
        """Remember the programme as of a telegram that was answered; ``step`` is its IPOC's."""
        known = self._programmes
        if peer not in known and len(known) == PEERS:
            known.pop(next(iter(known)))
        known[peer] = Programme(
            robot.ipoc, step, robot.stamp_ns, robot.delay, self.start, self.taken, self.held
        )


def standing(robot: RobotSample, held: Axes) -> RobotSample:
    """Return a robot's sample as if its axes were where it holds."""
    external = (held[6], *robot.external[1:]) if len(held) > 6 else robot.external
    return replace(robot, joints=held[:6], external=external)  # type: ignore[arg-type]


def goes_on(known: Programme, robot: RobotSample, cycle_s: float) -> Axes | None:
    """Return where the robot holds if a programme is the one remembered, None if it is not.

    One that goes on has counted on in the time that passed, and has every cycle since in its
    Delay, as a running total or in a row. A counter of its own past was held up on its way,
    whatever Delay it tells: corrections count from where the programme began all the same.

    Args:
        known: the one remembered.
        robot: a telegram that may be its next, or of its past.
        cycle_s: the controller's cycle [s].
    """
    if known.step is None:
        return None
    cycles, rest = divmod(robot.ipoc - known.ipoc, known.step)
    passed_s = (robot.stamp_ns - known.stamp_ns) * 1e-9
    if rest or abs(passed_s - cycles * cycle_s) > DELAYED_S:
        return None
    if cycles <= 0:
        return known.given
    if known.delay is None or robot.delay is None:
        return None
    if robot.delay == known.delay + cycles:
        return known.taken
    is_given = robot.delay in {cycles - 1, known.delay + cycles - 1}
    return known.given if is_given else None
