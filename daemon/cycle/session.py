"""A controller's program: where its corrections count from, and which command it applied last.

The controller's delay count shows the replies that it threw away. ``setpoint_reference`` decides
whether a program may get corrections at all. No step is made here and no byte is read.
"""

from collections import deque
from collections.abc import Hashable

from msgspec.structs import replace

from linemate.daemon.cycle import setpoint_reference as proving
from linemate.daemon.cycle.setpoint_delivery import DeliveryCheck
from linemate.daemon.cycle.setpoint_reference import (
    CONFIRMATIONS,
    REST_S,
    STILL,
    Axes,
    Continuation,
    Known,
    Program,
    Proof,
    ProofEvidence,
    Start,
)
from linemate.protocol.controller_link import ExchangeRules, SetpointKind
from linemate.protocol.stamped_samples import RobotSample

__all__ = ["RESTART_PROGRAM", "Axes", "Session", "standing"]

RESTART_PROGRAM = "Restart the controller's program: it must start while the daemon listens."
_OFFSETS = ExchangeRules()
# A reply that left so short before the next telegram came was superseded on its way [cycles].
SUPERSEDED = 1 / 16


class Session:
    """The program that is served now.

    Attributes:
        reference: absolute corrections count from there.
        pending: the command of the last reply while its delivery status is open.
        applied: the last command that the controller applied.
        was_lost: the last reply was not applied.
        was_sent: the last step's command went out in a reply.
        cycles_since_command: of the controller since the last command went out.
        moves: the controller got a command in its last cycle, as far as is known.
        proof: why the correction in force is known.
        unproven: why it is not, and what to do; None while it is, and before any telegram.
        unserved: telegrams that were accepted since and got no reply, because the daemon failed.
        stalled_s: for so long the controller counted cycles and this process's clock did not [s].
        replies_lost: replies that were not applied.
        unled: cycles of the controller in a row in which it got no setpoint.
        turnaround_ns: from the arrival of the last answered telegram to its reply [ns].
    """

    __slots__ = (
        "_candidate",
        "_cycle_s",
        "_delay",
        "_delivery",
        "_heard_ns",
        "_is_interrupted",
        "_is_refuted",
        "_lately",
        "_listening_ns",
        "_longest_s",
        "_pause_s",
        "_program",
        "_rules",
        "_silence_s",
        "_silent_until_ns",
        "_telegrams",
        "applied",
        "cycles_since_command",
        "moves",
        "openings",
        "pending",
        "proof",
        "reference",
        "replies_lost",
        "stalled_s",
        "turnaround_ns",
        "unled",
        "unproven",
        "unserved",
        "was_lost",
        "was_sent",
    )

    def __init__(self, cycle_s: float, rules: ExchangeRules = _OFFSETS) -> None:
        """Wait for the first program.

        Args:
            rules: how its family exchanges setpoints.
        """
        self.reference: Axes = ()
        self.pending: Axes | None = None
        self.applied: Axes = ()
        self.was_lost = False
        self.was_sent = True
        self.moves = False
        self.cycles_since_command = 0
        self.proof = Proof.NONE
        self.unproven: str | None = None
        self.stalled_s = 0.0
        self.turnaround_ns = 0
        self.unserved = 0
        self.openings = self.replies_lost = self.unled = 0
        self._rules = rules
        self._cycle_s = cycle_s
        self._delay: int | None = None
        self._delivery: DeliveryCheck | None = None  # for a controller that says where it sends
        self._heard_ns: int | None = None
        self._listening_ns: int | None = None
        self._program: Program | None = None
        self._candidate: Program | None = None
        self._telegrams = 0
        self._pause_s = self._longest_s = 0.0
        self._silent_until_ns = 0
        self._is_refuted = False
        self._silence_s: float | None = None
        self._is_interrupted = False
        self._lately: deque[Axes] = deque(maxlen=max(2, round(REST_S / cycle_s)))

    @property
    def delay(self) -> int | None:
        """What the controller has counted of bad cycles."""
        return self._delay

    @property
    def held(self) -> Axes:
        """Where the robot is, as far as is known: an open reply counts as applied."""
        return self.applied if self.pending is None else self.pending

    @property
    def is_proven(self) -> bool:
        """Whether the correction in force is known."""
        return self.proof in proving.PROVEN

    @property
    def step(self) -> int | None:
        """What the counter of the known program grows by each cycle; None while unknown."""
        return None if self._program is None else self._program.step

    def listen(self, now_ns: int) -> None:
        """Note that telegrams can arrive from now on [ns]; before, none could be heard."""
        self._listening_ns = now_ns

    def note_telegram(self, stamp_ns: int) -> None:
        """Note a telegram, readable or not [ns]."""
        since = [ns for ns in (self._heard_ns, self._listening_ns) if ns is not None]
        self._heard_ns = stamp_ns
        self._telegrams += 1
        self._pause_s = (stamp_ns - max(since)) * 1e-9 if since else 0.0
        if self._pause_s >= proving.SILENT_S:
            self._silence_s, self._silent_until_ns = self._pause_s, stamp_ns
        self._longest_s = max(self._longest_s, self._pause_s)

    @property
    def accounted_until_ns(self) -> int:
        """When the time since the last proven telegram needs a proof again [ns]."""
        passed_ns = round(self._rules.accounted_s * 1e9)
        return 0 if self._program is None else self._program.stamp_ns + passed_ns - 1

    @property
    def is_interrupted(self) -> bool:
        """A bare reply went out since the last one with corrections."""
        return self._is_interrupted or not self.is_proven

    @property
    def may_be_late(self) -> bool:
        """The last reply may have gone out after the next telegram, and no telegram shows it."""
        return self._rules.newest_acts and self.turnaround_ns > 0.5e9 * self._cycle_s

    def needs_proof(self, robot: RobotSample, missed: int) -> bool:
        """Return whether a telegram of the running exchange must be proven to be the program's.

        Args:
            missed: cycles before it without a telegram, by the counter.
        """
        if self._rules.setpoints is SetpointKind.INCREMENTS:
            return False
        if not self.is_proven or self._program is None:
            return True
        # A setpoint that is a position is known without the replies that were left out.
        is_position = self._rules.setpoints is SetpointKind.POSITIONS
        if self._is_interrupted and not is_position:
            return True
        passed_s = (robot.stamp_ns - self._program.stamp_ns) * 1e-9
        if max(passed_s, missed * self._cycle_s) >= self._rules.accounted_s:
            return True
        if is_position:
            return False
        # Missed cycles got no reply. If the delay count differs, the counter has jumped.
        bad = 0 if robot.delay is None or self._delay is None else robot.delay - self._delay
        return missed > 0 and bad not in {missed, missed + 1}

    def jumped(self, robot: RobotSample, missed: int) -> int:
        """Return how many missed cycles the counter alone shows: it has jumped, or was flipped.

        Such a cycle takes no time, and the controller has not counted it as bad.
        """
        program = self._program
        if program is None or self._is_interrupted or robot.delay is None or self._delay is None:
            return 0
        if robot.delay > self._delay:
            return 0
        passed_s = (robot.stamp_ns - program.stamp_ns) * 1e-9
        return min(max(missed + 1 - round(passed_s / self._cycle_s), 0), missed)

    def prove(
        self, robot: RobotSample, axes: Axes, programmed: Axes | None, peer: Hashable
    ) -> tuple[Axes, Axes] | None:
        """Find out which correction is in force.

        Args:
            axes: where it says the axes are.
            programmed: the programmed position of the same axes, None if not in the telegram.

        Returns:
            The reference, and where the robot holds; None if that is unknown. ``proof`` and
            ``unproven`` say why.
        """
        if self._rules.setpoints is SetpointKind.INCREMENTS:
            self.proof, self.unproven = Proof.STARTED, None
            return axes, axes
        if self._rules.setpoints is SetpointKind.POSITIONS:
            return self._prove_position(axes, peer)
        program, continued = self._program, None
        if program is not None and not self._is_refuted:
            program = program._replace(heard=self._telegrams - 1, silence_s=self._longest_s)
            continued = proving.continuation(program, robot, self._cycle_s)
        evidence = self._evidence(robot, axes, programmed, peer, continued)
        self.proof = proving.decide(evidence)
        if not self.is_proven:
            self._refuse_proof(robot, peer, goes_on=continued is not None)
            return None
        self.unproven, self._candidate = None, None
        self._lately.clear()
        if self.proof is Proof.CONTINUED:
            assert program is not None and continued is not None  # noqa: PT018, S101 - as decided
            passed_s = (robot.stamp_ns - program.stamp_ns) * 1e-9
            self.stalled_s = max(0.0, continued.cycles * self._cycle_s - passed_s)
            return program.reference, axes if continued.held is None else continued.held
        if self.proof is Proof.COMPUTED:
            assert programmed is not None  # noqa: S101 - as decided
            return programmed, axes
        return axes, axes

    def _evidence(
        self,
        robot: RobotSample,
        axes: Axes,
        programmed: Axes | None,
        peer: Hashable,
        continued: Continuation | None,
    ) -> ProofEvidence:
        program, known = self._program, Known.NONE
        if program is not None and program.moved:
            known = Known.MOVED
        elif program is not None and program.peer == peer:
            known = Known.UNMOVED
        since_s = (robot.stamp_ns - self._silent_until_ns) * 1e-9
        start = proving.start_seen(robot.delay, self._silence_s, since_s, self._cycle_s, known)
        if (
            program is not None
            and known is Known.MOVED
            and proving.goes_on_after_stall(program, robot, self._cycle_s)
        ):
            start = Start.NOT_SEEN
        confirmations = self._follow_candidate(robot, axes, peer, start)
        at_rest = self._has_rested(axes)
        self._lately.append(axes)
        return ProofEvidence(
            known=known,
            goes_on=continued is not None,
            held=continued is not None and continued.held is not None,
            start=Start.LIKELY if start is Start.NOT_SEEN and confirmations else start,
            confirmed=confirmations >= CONFIRMATIONS,
            programmed=proving.compare(axes, programmed),
            refuted=program is not None and proving.refutes(program, programmed),
            at_rest=at_rest,
        )

    def _has_rested(self, axes: Axes) -> bool:
        """Return whether the axes have not moved for some time until now."""
        way = [*self._lately, axes][-(self._lately.maxlen or 0) :]
        spread = max(max(places) - min(places) for places in zip(*way, strict=True))
        return len(way) == self._lately.maxlen and spread < STILL

    def _prove_position(self, axes: Axes, peer: Hashable) -> tuple[Axes, Axes] | None:
        """Return the reported position as the setpoint in force, None while the robot moves.

        A robot that was moved may coast to a stop. Its position then is not its setpoint. Without a
        program, telegrams that came at once may be those of a robot that another daemon has led.
        """
        program = self._program
        was_led = self._silence_s is None if program is None else proving.was_led(program, axes)
        if was_led and not self._has_rested(axes):
            why = "the setpoint in force is unknown: the robot still moves. Wait."
            self.decline(why, axes, peer)
            self.proof = Proof.PENDING
            return None
        self._lately.clear()
        self.proof, self.unproven = Proof.REPORTED, None
        return axes, axes

    def decline(self, reason: str, axes: Axes, peer: Hashable) -> None:
        """Note a telegram that gets no setpoint; the next one that may needs a proof.

        Args:
            axes: where it says the axes are.
        """
        self._lately.append(axes)
        self.proof, self.unproven = Proof.NONE, reason
        self.refuse(peer)

    def _follow_candidate(
        self, robot: RobotSample, axes: Axes, peer: Hashable, start: Start
    ) -> int:
        """Return how many telegrams in a row agree with a start, the first of them included."""
        candidate = self._candidate
        if start is not Start.NOT_SEEN:
            count = 1
        elif candidate is not None and proving.agrees(candidate, robot, self._cycle_s):
            count = candidate.replies + 1
        else:
            self._candidate = None
            return 0
        step = None if candidate is None or count == 1 else robot.counter - candidate.counter
        self._candidate = Program(
            robot.counter, step, robot.stamp_ns, robot.delay, peer, axes, axes, axes, False, count
        )
        return count

    def _refuse_proof(self, robot: RobotSample, peer: Hashable, *, goes_on: bool) -> None:
        """Note why the correction in force is unknown; a bare reply follows."""
        program = self._program
        self.refuse(peer)
        if program is not None and peer == program.peer and not goes_on:
            # Later telegrams cannot show any more which of the bare replies were applied.
            self._is_refuted = True
        if self.proof is Proof.PENDING:
            self.unproven = "a program has started: waiting for telegrams that confirm it"
            return
        what = "no start of its program was seen"
        if program is not None:
            passed_s = (robot.stamp_ns - program.stamp_ns) * 1e-9
            what = f"{passed_s:.2f} s since the last proven telegram are not accounted for"
        self.unproven = (
            f"the correction in force is unknown: {what} (its delay count is {robot.delay}). "
            f"{RESTART_PROGRAM}"
        )

    def open(self, start: Axes, held: Axes, delay: int | None) -> None:
        """Begin with a robot that holds."""
        self.openings += 1
        self.reference, self._program = start, None
        self.resume(held, delay)
        self.was_sent, self.unled = True, 0

    def resume(self, held: Axes, delay: int | None) -> bool:
        """Go on with a program whose controller has held the robot since its last reply.

        Returns:
            Whether that reply is lost.
        """
        is_lost = self.pending is not None and self.pending != held
        self.replies_lost += is_lost
        self.unled += self.cycles_since_command - (not is_lost)
        self.pending, self.applied = None, held
        self._delay = delay
        self.was_lost, self.was_sent, self.moves = False, False, False
        return is_lost

    def refuse(self, peer: Hashable) -> None:
        """Note that a bare reply goes out to a controller.

        After a pause it may be another program's. What others get says nothing of this one's.
        """
        self._silence_s = None
        program = self._program
        if program is not None and program.peer == peer:
            self._is_refuted |= self._pause_s > proving.UNACCOUNTED_S
            self._program = program._replace(replies=program.replies + 1)
            self._is_interrupted = True

    def would_be_lost(self, sent_to: Axes) -> bool:
        """Return whether the last setpoint is lost, by where the servos are sent [rad, m]."""
        if self.pending is None or self._delivery is None:
            return False
        return self._delivery.would_be_lost(self.pending, sent_to)

    def settle(
        self, delay: int | None, cycles: int, stamp_ns: int, sent_to: Axes | None = None
    ) -> bool:
        """Find out whether the controller applied the last reply.

        It counts every cycle without a good one. If as many are new as have passed, then the
        last reply was not applied either: the robot holds, and the gate must begin from there.
        More than have passed is a flipped digit where the clock agrees with the counters; where
        it does not, a counter was flipped, and the next good one seems nearer than it is.

        Args:
            delay: what it has counted now.
            cycles: since its last telegram, by their counters.
            stamp_ns: arrival of the present one [ns].
            sent_to: where it sends its servos [rad, m], None if it does not say so.

        Returns:
            Whether a reply is lost, or it is doubtful whether replies arrive.
        """
        cycles += self.unserved
        self.unserved = 0
        given, self.pending = self.pending, None
        before, self._delay = self._delay, delay
        program = self._program
        answered_ns = stamp_ns if program is None else program.stamp_ns
        passed = (stamp_ns - answered_ns) * 1e-9 / self._cycle_s
        if given is None:
            self._compare(None, sent_to)
            return False
        bad = 0 if delay is None or before is None else delay - before
        self.was_lost = bad == cycles or (bad > cycles and abs(passed - cycles) >= 1.0)
        # The controller has this cycle's reply when it looks again, and the late one never acted.
        replied_ns = answered_ns + self.turnaround_ns + round(SUPERSEDED * 1e9 * self._cycle_s)
        self.was_lost |= self._rules.newest_acts and replied_ns > stamp_ns
        is_lost = self._compare(given if cycles == 1 and not self.was_lost else None, sent_to)
        if is_lost and sent_to is not None:
            self.was_lost, self.applied = True, sent_to
        if self.was_lost:
            self.moves = False
            self.replies_lost += 1
            self.unled += cycles
        else:
            self.applied = given
            self.unled = cycles - 1
        return self.was_lost or (self._delivery is not None and self._delivery.is_doubtful)

    def _compare(self, given: Axes | None, sent_to: Axes | None) -> bool:
        """Return whether setpoints are lost, by where the servos are sent; None ends a motion."""
        if given is None or sent_to is None:
            if self._delivery is not None:
                self._delivery.reset()
            return False
        if self._delivery is None:
            self._delivery = DeliveryCheck(self._cycle_s)
        self._delivery.add(given, sent_to)
        return self._delivery.is_lost

    def note_reply(
        self, command: Axes, robot: RobotSample, peer: Hashable, step: int | None
    ) -> None:
        """Note the reply that goes to the wire, and the program as of the telegram it answers.

        Args:
            command: its delivery status is open.
            step: of the telegrams' counter, None while it is not sure.
        """
        self.was_sent, self.was_lost, self.moves = True, False, True
        self.pending, self.cycles_since_command = command, 0
        program, start = self._program, self.reference
        moved = command != start or (program is not None and program.moved)
        self._telegrams, self._silence_s, self._longest_s = 0, None, 0.0
        self._is_interrupted = self._is_refuted = False
        self._program = Program(
            robot.counter,
            step,
            robot.stamp_ns,
            robot.delay,
            peer,
            start,
            self.applied,
            command,
            moved,
        )

    def give_unread(self, command: Axes) -> None:
        """Note a reply that went out to a telegram that could not be judged afterwards."""
        self.pending, self.cycles_since_command = command, 0
        program = self._program
        if program is not None:
            self._program = program._replace(pending=command, replies=program.replies + 1)

    def refrain(self) -> None:
        """A cycle passed, or passes, without a command: the robot holds in it."""
        self.was_sent = self.moves = False


def standing(robot: RobotSample, held: Axes) -> RobotSample:
    """Return a robot's sample as if its axes were where it holds."""
    external = (held[6], *robot.external[1:]) if len(held) > 6 else robot.external
    return replace(robot, joints=held[:6], external=external)
