"""The cyclic heart of the daemon: a telegram in, a reply out; no socket, no clock, no await.

Law of this file: it puts the parts of a cycle in their order and does the same in real and in
virtual time. Whoever calls it brings bytes and stamps and takes bytes away; the reply first,
``take_log`` after it. What a part remembers is in its own room: the samples that wait in
``feeds``, the controller's programme in ``session``, the robot's obedience in ``following``, the
operating state in ``operating``, a reply's bytes in ``replies``.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core import step as stepping
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle import states
from linemate.daemon.cycle.causes import Change
from linemate.daemon.cycle.correction_reference import RESTART_S, Proof
from linemate.daemon.cycle.feeds import Feeds, Inbox
from linemate.daemon.cycle.following import Following
from linemate.daemon.cycle.operating import Operating, Situation
from linemate.daemon.cycle.replies import Replies
from linemate.daemon.cycle.session import Axes, Session, standing
from linemate.daemon.cycle.states import Machine, State
from linemate.daemon.cycle.step_log import LONGEST_LOG, LogEntry, StepLog
from linemate.protocol.exchange import Exchange, TelegramDecision, TelegramKind
from linemate.protocol.rsi.codec import PreparedReply, RobotTelegram, RsiCodec, RsiError
from linemate.protocol.rsi.expected_telegram import ReadyReply
from linemate.protocol.samples import (
    CameraSample,
    DistanceSample,
    RobotSample,
    Vector6,
    WrenchSample,
)

__all__ = ["CATCH_UP_S", "LONGEST_JUMP", "LONGEST_LOG", "Cycle", "Inbox", "LogEntry"]

LONGEST_JUMP = 0.05  # of a joint in the expected telegram [rad]

PROGRAMMED_S = 1000.0  # a blend as long as that is none [s]
CATCH_UP_S = 0.3  # steps made at once after a gap, at most

_OPENS = frozenset({TelegramKind.FIRST, TelegramKind.NEW_SESSION})
_MOVES = frozenset({"arm", "start"})
_SHOWN = (
    "task_time",
    "scenario",
    "scenario_state",
    "confidence",
    "speed",
    "contact",
    "overload",
    "held",
    "ready",
    "target",
    "sensed",
    "part",
    "command",
)


@dataclass(frozen=True, slots=True)
class _Swap:
    """Parameters that wait for the next step; ``anew``: the step begins anew where it stands."""

    parameters: Parameters
    anew: bool


class _Prepared(Struct, frozen=True):
    """A step made before its telegram, what it planned, and its reply but for the IPOC."""

    reply: PreparedReply
    entry: LogEntry
    plan: stepping.StepPlan


class Cycle:
    """What the daemon does each cycle.

    Attributes:
        parameters, codec: of the step, of the robot's telegrams.
        exchange, operating, feeds, session, following: the parts, each with its own memory.
        ready_reply: the reply to the one telegram that is expected next, None if none is ready.
        verdict: on the last telegram that could be read.
        date: gives the beginning of a controller's cycle from its telegram's arrival [ns] and the
            cycles since the telegram before; without one a telegram is taken to come at once.
        steps, prepared, inline: made in all, sent as prepared, made in line.
        remade: steps that were finished once more, the last command's fate not being as assumed.
        repeated: telegrams answered with a step that the clock had made, finished once more.
        refused, last_refusal: telegrams that could not be read, and why the last one was not.
    """

    def __init__(
        self,
        parameters: Parameters,
        codec: RsiCodec,
        watch_settings: WatchSettings | None = None,
        *,
        absolute: bool = True,
        wrench_expected: bool = True,
    ) -> None:
        """Wait for the first telegram.

        Args:
            codec: of the robot's telegrams.
            absolute: corrections are offsets from the start (#ABSOLUTE), else increments.
            wrench_expected: there is a force-torque sensor.
        """
        self.parameters = parameters
        self.codec = codec
        settings = watch_settings or WatchSettings()
        self.exchange = Exchange(parameters.cycle_s)
        self.operating = Operating(settings, parameters.cycle_s, wrench_expected=wrench_expected)
        self.feeds = Feeds()
        self.session = Session(parameters.cycle_s, absolute=absolute)
        self.following = Following(settings.follow_s, parameters.cycle_s)
        self.verdict: TelegramDecision | None = None
        self.date: Callable[[int, int], int] = lambda stamp_ns, _cycles: stamp_ns
        self.last: LogEntry | None = None
        self._given: LogEntry | None = None
        self.refused = self.inline = self.prepared = self.remade = self.steps = self.repeated = 0
        self.last_refusal: str | None = None
        self._replies = Replies(codec, absolute=absolute)
        self._log = StepLog()
        self._is_under_way = self._was_preparing = self._is_judged = False
        self.ready_reply: ReadyReply | None = None
        self._sent_ahead: Axes | None = None  # command of a reply that preceded on_telegram
        self._state: stepping.StepState | None = None
        self._began_with: stepping.StepState | None = None
        self._before: stepping.Outputs | None = None  # of the step before ``last``
        self._robot: RobotSample | None = None
        self._joints: Vector6 | None = None
        self._stamp_ns = 0
        self._ready: _Prepared | None = None
        self._plan: stepping.StepPlan | None = (
            None  # of ``last``, None where the state is another's
        )
        self._swap: _Swap | None = None

    # Samples.

    def feed_distance(self, sample: DistanceSample) -> None:
        """Take a sample of the distance sensor for the next step."""
        self.feeds.distance.put(sample)

    def feed_camera(self, sample: CameraSample) -> None:
        """Take a camera's pose for the next step."""
        self.feeds.camera.put(sample)

    def feed_wrench(self, sample: WrenchSample) -> None:
        """Take a wrench for the next step."""
        self.feeds.put_wrench(sample)

    # Orders.

    def order(self, op: str, who: str = "") -> str | None:
        """Take an operator's order for the next step.

        Args:
            op: arm, start, stop, retreat or ack.

        Returns:
            None, or why it is refused.
        """
        if op in _MOVES and self.session.unproven is not None:
            return self.session.unproven
        return self.operating.order(op, self._found(), who)

    # Parameters.

    def swap(self, parameters: Parameters, *, anew: bool = False) -> None:
        """Take other parameters from the next step on.

        Args:
            parameters: of the step; of the same cycle time.
            anew: the step's state does not fit them: begin anew where the robot stands. Only
                for one that does (``stands``).
        """
        anew = anew or (self._swap is not None and self._swap.anew)
        self._swap = _Swap(parameters, anew)

    def watch_by(self, settings: WatchSettings) -> None:
        """Take other time-outs and debounce from the next step on."""
        self.operating.settings = settings

    @property
    def stands(self) -> bool:
        """Whether the robot is at rest and nothing is about to move it."""
        return self.operating.rests and (self._state is None or not self._state.moving)

    def trial(self) -> tuple[stepping.StepState, Inputs] | None:
        """Return the state and the inputs of the last step, to try parameters on."""
        if self.last is None or self.last.before is None:
            return None
        return self.last.before, self.last.inputs

    def _apply_swap(self, swap: _Swap) -> None:
        """Between two steps: what was to be swapped is."""
        self._swap = None
        self.parameters = swap.parameters
        if swap.anew and self._state is not None:
            held = tuple(self._state.control.gate.position.tolist())
            there = RobotSample(self._stamp_ns, 0, held[:6], held[6:])
            self._state = stepping.initial(self.parameters, there)
            self._plan = None

    # The cycle.

    def on_telegram(
        self, data: bytes, stamp_ns: int, peer: Hashable = None, *, is_answered: bool = False
    ) -> bytes | None:
        """Return the reply to one telegram, None if it is not to be answered.

        Args:
            stamp_ns: its arrival [ns].
            is_answered: ``ready_reply`` is sent already.
        """
        self._begin()
        if is_answered and self._ready is not None:
            self._sent_ahead = self._ready.entry.outputs.command
        try:
            telegram = self.codec.parse_robot(data)
            robot = self._robot_sample(telegram, stamp_ns)
        except RsiError as error:
            self.refused += 1
            self.last_refusal = str(error)
            reply = self._answer_unreadable(error.ipoc_text, stamp_ns, peer)
        else:
            reply = self._exchange(telegram, robot, peer)
        self._end()
        return reply

    def listen(self, now_ns: int) -> None:
        """Note that telegrams can arrive from now on.

        A program whose start is to be seen must start after that.

        Args:
            now_ns: when the link was opened [ns].
        """
        self.session.listen(now_ns)

    def _begin(self, *, preparing: bool = False) -> None:
        """Notice that what was begun before did not end: it raised, which is a fault.

        Its reply never went out, unless it went out before its telegram was read. A preparation
        that failed before its step owed none.
        """
        if self._is_under_way:
            self.operating.has_failed = True
            if not self._was_preparing or self._state is not self._began_with:
                self.session.refrain()
            if self._sent_ahead is not None:
                self.session.give_unread(self._sent_ahead)
            elif self._is_judged:
                self.session.unserved += 1
        self._is_under_way, self._was_preparing, self._is_judged = True, preparing, False
        self._began_with = self._state
        self._sent_ahead = self.ready_reply = None

    def _end(self) -> None:
        """Note that nothing failed, and foresee the next telegram."""
        self.ready_reply = self._foresee()
        self._sent_ahead, self._is_under_way = None, False

    def _foresee(self) -> ReadyReply | None:
        """Return the ready reply and the telegram that goes on as everything did."""
        ready, foreseen = self._ready, self.exchange.foreseen()
        if ready is None or foreseen is None or self._joints is None:
            return None
        if not ready.entry.inputs.sent or self.session.is_interrupted:
            return None
        ipoc, peer = foreseen
        telegram = self.codec.expect_robot(ipoc, self.session.delay, self._joints, LONGEST_JUMP)
        if telegram is None:
            return None
        reply = ready.reply.with_ipoc(b"%d" % ipoc)
        return ReadyReply(telegram, peer, self.session.accounted_until_ns, reply)

    def _exchange(
        self, telegram: RobotTelegram, robot: RobotSample, peer: Hashable
    ) -> bytes | None:
        stamp_ns = robot.stamp_ns
        self.session.hear(stamp_ns)
        verdict = self.verdict = self.exchange.on_telegram(telegram.ipoc, stamp_ns, peer)
        self._is_judged = verdict.answer
        if not verdict.answer:
            return None
        is_in_doubt = verdict.kind in _OPENS or self.session.needs_proof(robot, verdict.missed)
        if is_in_doubt and not self._prove(telegram, robot, peer, verdict):
            return self._reply_bare(telegram.ipoc_text, stamp_ns, verdict.steps)
        if self.session.settle(telegram.delay, verdict.missed + 1, stamp_ns):
            self.operating.is_loss_untold = True
        arrived = robot
        if verdict.kind not in _OPENS:
            stamp_ns = self.date(stamp_ns, verdict.missed + 1)
            robot = replace(robot, stamp_ns=stamp_ns)
        self._look_where(robot)
        reply = self._answer(telegram, stamp_ns, verdict)
        self._robot = robot
        self._joints = robot.joints
        self.session.remember(arrived, peer, self.exchange.settled_step)
        return reply

    def _answer_unreadable(
        self, ipoc_text: bytes | None, stamp_ns: int, peer: Hashable
    ) -> bytes | None:
        """Return a bare reply to a telegram of which only the counter could be read, or None."""
        if ipoc_text is None:
            return None
        self.session.hear(stamp_ns)
        if self.exchange.would_open(stamp_ns, peer):
            return self._reply_bare(ipoc_text, stamp_ns, 0)
        verdict = self.verdict = self.exchange.on_telegram(int(ipoc_text), stamp_ns, peer)
        if not verdict.answer:
            return None
        self.session.refuse(peer)
        return self._reply_bare(ipoc_text, stamp_ns, verdict.steps)

    def prepare(self, stamp_ns: int) -> bool:
        """Make the step of a telegram that is expected at ``stamp_ns``; True if it is ready."""
        if self._state is None or self._ready is not None:
            return False
        self._begin(preparing=True)
        entry, plan = self._step(self._state, stamp_ns, telegram=True)
        self._ready = _Prepared(self._reply(entry), entry, plan)
        self._end()
        return True

    def on_missing(self, stamp_ns: int) -> None:
        """Make the step of a cycle whose telegram did not come, as its deadline passes."""
        self.exchange.on_missing()
        if self._state is None:
            return
        self._begin()
        ready, self._ready = self._ready, None
        if ready is None:
            self._step_unsent(self._state, stamp_ns)
        else:
            # The telegram before may have come, and been answered, since this one was made.
            self._note_unsent(self._confirmed(ready))
            # The step was decided on as if its telegram would come.
            self.operating.is_loss_untold = True
        self._end()

    def take_changes(self) -> list[Change]:
        """Return the changes of the operating state since the last call, oldest first."""
        return self.operating.take_changes()

    def take_log(self) -> list[LogEntry]:
        """Return the steps since the last call, oldest first; to be called after the reply."""
        return self._log.take()

    def _robot_sample(self, telegram: RobotTelegram, stamp_ns: int) -> RobotSample:
        """Return what a telegram says of the robot.

        Raises:
            RsiError: the configuration sends no joints, or no linear axis that the arm has.
        """
        external = telegram.external or ()
        if telegram.joints is None:
            raise RsiError(
                "the telegram has no AIPos: the daemon needs the joints",
                ipoc_text=telegram.ipoc_text,
            )
        if self.parameters.controller.arm.linear_axis and not external:
            raise RsiError(
                "the telegram has no EIPos: the task's arm has a linear axis",
                ipoc_text=telegram.ipoc_text,
            )
        signals = telegram.channels.get("DiL", 0)
        return RobotSample(
            stamp_ns=stamp_ns,
            ipoc=telegram.ipoc,
            joints=telegram.joints,
            external=external,
            delay=telegram.delay,
            digital_in=int(signals) if isinstance(signals, (int, float)) else 0,
        )

    def _axes(self, robot: RobotSample) -> Axes:
        """Return a telegram's axes in the controller's order."""
        if self.parameters.controller.arm.linear_axis:
            return (*robot.joints, robot.external[0])
        return robot.joints

    def _programmed(self, telegram: RobotTelegram) -> Axes | None:
        """Return the programmed position of the axes, None if the telegram does not have it."""
        if telegram.joint_setpoints is None:
            return None
        if not self.parameters.controller.arm.linear_axis:
            return telegram.joint_setpoints
        external = telegram.external_setpoints
        return None if not external else (*telegram.joint_setpoints, external[0])

    def _prove(
        self,
        telegram: RobotTelegram,
        robot: RobotSample,
        peer: Hashable,
        verdict: TelegramDecision,
    ) -> bool:
        """Find out which correction is in force, and open or resume the session if it is known."""
        session, axes = self.session, self._axes(robot)
        opens = verdict.kind in _OPENS
        is_resumed = opens or session.is_interrupted or verdict.missed > 0
        found = session.prove(robot, axes, self._programmed(telegram), peer)
        if found is None:
            return False
        reference, held = found
        # Where this process stood still without noticing, its estimate of the object is too old.
        if session.proof is not Proof.CONTINUED or session.stalled_s >= RESTART_S:
            self._open_session(robot, reference, held)
        elif is_resumed:
            self.operating.is_loss_untold |= session.resume(held, robot.delay)
            self.operating.has_resynchronised |= opens
            if session.step is not None and self.exchange.settled_step is None:
                self.exchange.resume(session.step)
        return True

    def _open_session(self, robot: RobotSample, start: Axes, held: Axes) -> None:
        """Begin anew with a robot that holds; arming is needed."""
        self.session.open(start, held, robot.delay)
        self.following.begin(held)
        self.operating.has_new_session = self._state is not None
        there, before = standing(robot, held), self._state
        if before is not None and stepping.is_engaged(before, self.parameters, there):
            self._state = stepping.resumed(self.parameters, before, there)
        else:
            self._state = stepping.initial(self.parameters, there)
        self._robot = robot
        self._ready = self._plan = None

    def _look_where(self, robot: RobotSample) -> None:
        """Note an axis that is not where it was sent; look for a better start before motion.

        A session may begin while the robot still comes to rest; corrections count from there.
        """
        axes, start = self._axes(robot), self.session.start
        if self.session.held != start or states.order(self.machine) is not MotionOrder.HOLD:
            self.following.moving(axes, self.operating.settings.follow_tolerance)
        elif self.following.resting(axes, start):
            self._open_session(robot, axes, axes)

    def _reply_bare(self, ipoc_text: bytes, stamp_ns: int, steps: int) -> bytes:
        """Return a reply without corrections: the controller keeps those that it has."""
        ready, self._ready = self._ready, None
        if ready is not None:
            self._note_unsent(self._confirmed(ready))
            steps -= 1
            # The step was decided on as if the robot would be led in this cycle.
            self.operating.is_loss_untold = True
        if self._state is not None and steps > 0:
            self._catch_up(stamp_ns, steps)
            self._step_unsent(self._state, stamp_ns)
        self.session.refrain()
        signals = 0 if self.last is None or self._state is None else self.last.outputs.digital_out
        return self._replies.without_corrections(signals).with_ipoc(ipoc_text)

    def _answer(self, telegram: RobotTelegram, stamp_ns: int, verdict: TelegramDecision) -> bytes:
        """Return the reply after as many steps as the controller made cycles."""
        session, last, steps = self.session, self.last, verdict.steps
        if verdict.missed:
            session.moves = False
        ahead = steps == 0 and not session.was_sent and not session.was_lost
        if ahead and last is not None and last.inputs.sent == session.moves:
            # The clock was ahead of a late telegram: its step is made, only not yet sent.
            self.last = last.answering(telegram.ipoc)
            return self._give(last, self._reply(last), telegram)
        if verdict.missed:
            # The robot held meanwhile, also where the clock had no step left to make for it: a
            # controller that was held up itself counts fewer cycles than the time has.
            session.was_sent = False
        if steps == 0 and last is not None and self._plan is not None:
            entry = self._finish_again(last, self._plan, telegram.ipoc)
            return self._give(entry, self._reply(entry), telegram)
        ready, self._ready = self._ready, None
        if ready is not None and steps > 1:
            self._note_unsent(self._confirmed(ready))
            ready, steps = None, steps - 1
        if ready is None:
            self._catch_up(stamp_ns, steps)
            if verdict.missed:
                session.was_sent = False
        if ready is not None:
            self.prepared += 1
            ready = self._confirmed(ready, answering=True)
            entry, plan, reply = ready.entry.answering(telegram.ipoc), ready.plan, ready.reply
        else:
            self.inline += 1
            entry, plan = self._step(
                self._opened(), stamp_ns, telegram=True, answering=True, ipoc=telegram.ipoc
            )
            reply = self._reply(entry)
        self._note(entry, plan)
        return self._give(entry, reply, telegram)

    def _finish_again(self, last: LogEntry, plan: stepping.StepPlan, ipoc: int) -> LogEntry:
        """Return the last step once more, with what the telegram tells of the robot.

        The clock has made the step of this telegram, or of a later one. Another step would be one
        more than the controller has cycles, and the object would be predicted farther and farther
        ahead.
        """
        sent, applied, pace = self._fate(answering=True)
        before, made_with = last.before, last.parameters
        assert before is not None and made_with is not None and last.after is not None  # noqa: PT018, S101
        if sent:
            # The robot has the command of this very step, and goes on towards what it desired.
            gate = last.after.control.gate
            before = replace(before, control=replace(before.control, gate=gate))
        inputs = replace(last.inputs, sent=sent, applied=applied, pace=pace)
        self._state, outputs = stepping.finish(before, plan, inputs, made_with)
        entry = replace(
            last, ipoc=ipoc, inputs=inputs, outputs=outputs, before=before, after=self._state
        )
        self.repeated += 1
        self._replan_ready()
        self._note(entry, plan)
        return entry

    def _replan_ready(self) -> None:
        """Make the step that is ready once more: the state before it is another one."""
        ready = self._ready
        if ready is None:
            return
        inputs, made_with = ready.entry.inputs, ready.entry.parameters
        assert made_with is not None  # noqa: S101 - as _step made it
        before = self._opened()
        inputs = replace(inputs, sent=True, applied=None, pace=None)
        plan = stepping.plan(before, inputs, made_with)
        self._state, outputs = stepping.finish(before, plan, inputs, made_with)
        entry = replace(
            ready.entry, inputs=inputs, outputs=outputs, before=before, after=self._state
        )
        self._ready = _Prepared(self._reply(entry), entry, plan)

    def _opened(self) -> stepping.StepState:
        assert self._state is not None  # noqa: S101 - a session is open
        return self._state

    def _give(self, entry: LogEntry, reply: PreparedReply, telegram: RobotTelegram) -> bytes:
        """Return a reply as it goes to the wire."""
        self.session.give(entry.outputs.command)
        self._is_judged = False  # what is lost from here on is this reply
        self._given = entry
        return reply.with_ipoc(telegram.ipoc_text)

    def _confirmed(self, ready: _Prepared, *, answering: bool = False) -> _Prepared:
        """Return a prepared step, finished once more if what it assumed of the robot is not so."""
        sent, applied, pace = self._fate(answering=answering)
        inputs = ready.entry.inputs
        if (inputs.sent, inputs.applied, inputs.pace) == (sent, applied, pace):
            return ready
        self.remade += 1
        inputs = replace(inputs, sent=sent, applied=applied, pace=pace)
        before, made_with = ready.entry.before, ready.entry.parameters
        assert before is not None and made_with is not None  # noqa: PT018, S101 - as _step made it
        self._state, outputs = stepping.finish(before, ready.plan, inputs, made_with)
        entry = replace(ready.entry, inputs=inputs, outputs=outputs, after=self._state)
        return _Prepared(self._reply(entry), entry, ready.plan)

    def _fate(self, *, answering: bool) -> tuple[bool, Axes | None, tuple[Axes, Axes] | None]:
        """Return whether the last step's command is the robot's, where it is if not, and its pace.

        Args:
            answering: a telegram tells that no cycle has passed. Until then a robot that got no
                command is one that holds.
        """
        session, given = self.session, self._given
        if session.arrived:
            return True, None, None
        if not (answering and session.moves) or given is None or given.after is None:
            return False, session.held, None
        gate = given.after.control.gate
        return False, session.held, (tuple(gate.speed.tolist()), tuple(gate.acceleration.tolist()))

    def _catch_up(self, stamp_ns: int, steps: int) -> None:
        """Make the steps of cycles whose telegrams did not come and were not missed yet."""
        period = round(self.parameters.cycle_s * 1e9)
        most = max(1, round(CATCH_UP_S / self.parameters.cycle_s))
        for back in range(min(steps, most) - 1, 0, -1):
            self._step_unsent(self._opened(), stamp_ns - back * period)

    def _step_unsent(self, state: stepping.StepState, stamp_ns: int) -> None:
        """Make the step of a cycle that gets no corrections."""
        self._note(*self._step(state, stamp_ns, telegram=False))
        self.session.was_sent = False

    def _note_unsent(self, ready: _Prepared) -> None:
        self._note(ready.entry, ready.plan)
        self.session.was_sent = False

    def _step(
        self,
        state: stepping.StepState,
        stamp_ns: int,
        *,
        telegram: bool,
        answering: bool = False,
        ipoc: int | None = None,
    ) -> tuple[LogEntry, stepping.StepPlan]:
        """Make one sampling step: operating state first, then the pure step."""
        settings = self.parameters.tracker.settings
        bearable, deviation = settings.tactile.overload_force, settings.distance.deviation
        moving = self.machine.state in states.MOVING
        taken = self.feeds.take(bearable, deviation, moving=moving)
        if self._swap is not None:
            self._apply_swap(self._swap)
            state = self._opened()
        before = self.machine
        self.operating.decide(stamp_ns, self.feeds, self._found(), telegram=telegram)
        started = self.machine is not before and self.machine.state is State.TRACK
        sent, applied, pace = self._fate(answering=answering)
        inputs = Inputs(
            self.steps,
            stamp_ns,
            self._robot,
            taken.distance,
            taken.camera,
            taken.wrench,
            states.order(self.machine),
            started,
            sent,
            applied,
            pace,
        )
        self._robot = None
        made_with = self.parameters
        plan = stepping.plan(state, inputs, made_with)
        self._state, outputs = stepping.finish(state, plan, inputs, made_with)
        if not outputs.contact:
            self.feeds.camera_health.answered(len(taken.camera), outputs.refused)
        self.steps += 1
        self._stamp_ns = stamp_ns
        shown = self.machine.state.value
        entry = LogEntry(ipoc, shown, inputs, outputs, state, self._state, made_with)
        return entry, plan

    def _found(self) -> Situation:
        """Return how a decision finds the robot and the task."""
        return Situation(
            None if self.last is None else self.last.outputs,
            self._before,
            astray=self.following.astray,
            # Where corrections count from is not known before the robot rests.
            settling=self.session.held == self.session.start and not self.following.rests,
            sensed=self.parameters.tracker.settings.merge.blend < PROGRAMMED_S,
            last_approach=self._task_time > self.parameters.tracker.sight_time,
        )

    @property
    def _task_time(self) -> float:
        """The task's clock as of the last step [s], 0 before its start."""
        return 0.0 if self.last is None else self.last.outputs.task_time or 0.0

    def _reply(self, entry: LogEntry) -> PreparedReply:
        """Return the reply to a step but for the IPOC: corrections, or increments."""
        origin = self.session.start if self._replies.absolute else self.session.held
        outputs = entry.outputs
        return self._replies.prepare(outputs.command, origin, outputs.digital_out)

    def _note(self, entry: LogEntry, plan: stepping.StepPlan) -> None:
        """Remember a step, for the next decision and for the log."""
        self._before = None if self.last is None else self.last.outputs
        self.last, self._plan = entry, plan
        self.following.sent(entry.outputs.command)
        self._log.put(entry)

    # What others may know.

    @property
    def machine(self) -> Machine:
        """The operating state."""
        return self.operating.machine

    @property
    def is_unproven(self) -> bool:
        """Whether it is unknown which correction the controller has in force."""
        return self.session.unproven is not None

    @property
    def openings(self) -> int:
        """Sessions begun."""
        return self.session.openings

    @property
    def log_dropped(self) -> int:
        """Steps that nobody took from the log in time."""
        return self._log.dropped

    def status(self) -> dict[str, Any]:
        """Return what an operator wants to know; plain values only."""
        heard = self.feeds.status(self._stamp_ns)
        status: dict[str, Any] = {
            "state": self.machine.state.value,
            "because": self.machine.because,
            "cause": self.operating.cause,
            "latched": self.machine.latched,
            "link": self.operating.signals.link.value,
            "steps": self.steps,
            "prepared": self.prepared,
            "inline": self.inline,
            "repeated": self.repeated,
            "replies_lost": self.session.replies_lost,
            "astray": self.following.astray,
            "correction": {
                "proof": self.session.proof.name.lower(),
                "unproven": self.session.unproven,
            },
            "foreign": self.session.unproven,
            "telegrams": {**self.exchange.counters, "unreadable": self.refused},
            "last_refusal": self.last_refusal,
            "unfit": states.unfit(self.operating.signals),
            "sensors": heard["sensors"],
            "redated": heard["redated"],
            "dropped": {**heard["dropped"], "log": self.log_dropped},
            "ages_s": heard["ages_s"],
        }
        if self.last is not None:
            outputs = self.last.outputs
            status["phase"] = outputs.phase.value
            status |= {name: getattr(outputs, name) for name in _SHOWN}
        return status
