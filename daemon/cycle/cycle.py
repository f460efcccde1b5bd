"""The daemon's cycle: a telegram in, a reply out; no socket, no clock, no await.

One reply path. ``prepare`` makes the step before its telegram and leaves ``ready_reply``: the
expected telegram and the reply's bytes. The driver compares and sends. ``on_telegram`` is the
ordinary way: it reads every telegram, decides what it means, and returns the reply, which is the
same if the ready one was sent.

Invariants:
- The same in real and in virtual time.
- A telegram of another counter, delay, peer or place than expected is answered after all checks.
- A reply carries a setpoint only if it is proven which setpoint is in force (``session``).
"""

from collections.abc import Callable, Hashable
from operator import sub
from typing import Any

from msgspec.structs import replace

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import StepState
from linemate.daemon.cycle import states
from linemate.daemon.cycle.in_sync import is_in_sync
from linemate.daemon.cycle.resting import STILL, RestingStepper
from linemate.daemon.cycle.session import Axes
from linemate.daemon.cycle.setpoint_reference import RESTART_S, Proof
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.cycle.steps import PreparedStep
from linemate.protocol.controller_link import (
    ControllerError,
    ControllerLink,
    ControllerTelegram,
    ExchangeRules,
    PreparedReply,
    ReadyReply,
)
from linemate.protocol.exchange import Exchange, ExchangeState, TelegramDecision, TelegramKind
from linemate.protocol.stamped_samples import AXES, RobotSample

LONGEST_JUMP = 0.05  # of a joint in the expected telegram [rad]
OVERSPEED = 2.0  # of an axis over its limit: servos overshoot a command by up to a third

_OPENS = frozenset({TelegramKind.FIRST, TelegramKind.NEW_SESSION})
_SHOWN = (
    "task_time",
    "scenario",
    "scenario_state",
    "confidence",
    "speed",
    "contact",
    "overload",
    "held",
    "waiting",
    "ready",
    "target",
    "sensed",
    "part",
    "command",
)


class Cycle(RestingStepper):
    """Answers telegrams with steps.

    Attributes:
        ready_reply: the reply to the one telegram that is expected next, None if none is ready.
        decision: on the last telegram whose counter could be read.
        date: returns the beginning of the controller's cycle from its telegram's arrival [ns] and
            the cycles since the telegram before. Without one, telegrams have no delay.
        refused: telegrams that could not be read.
        last_refusal: why the last of them could not.
    """

    def __init__(
        self,
        parameters: Parameters,
        link: ControllerLink,
        watch_settings: WatchSettings | None = None,
        *,
        wrench_expected: bool = True,
    ) -> None:
        """Wait for the first telegram.

        Args:
            link: codec and rules of the robot's controller.
            wrench_expected: there is a force-torque sensor.
        """
        settings = watch_settings or WatchSettings()
        super().__init__(parameters, link, settings, wrench_expected=wrench_expected)
        self.exchange = Exchange(parameters.cycle_s)
        self.decision: TelegramDecision | None = None
        self.date: Callable[[int, int], int] = lambda stamp_ns, _cycles: stamp_ns
        self.ready_reply: ReadyReply | None = None
        self.refused = 0
        self.last_refusal: str | None = None
        self._is_running = self._was_preparing = False
        self._sent_ahead: Axes | None = None  # command of a reply that preceded on_telegram
        self._state_at_begin: StepState | None = None
        self._arrived: RobotSample | None = None  # the last telegram that was followed

    def on_telegram(
        self, data: bytes, stamp_ns: int, peer: Hashable = None, *, is_answered: bool = False
    ) -> bytes | None:
        """Return the reply to one telegram.

        Args:
            is_answered: ``ready_reply`` is sent already.

        Returns:
            Its bytes. Empty: the telegram counts, and nothing is to be sent. None: it does not.
        """
        sent = self.ready_reply if is_answered else None
        self._begin()
        if is_answered and self._ready is not None:
            self._sent_ahead = self._ready.entry.outputs.command
        elif sent is not None and self._rest_now is not None:
            self._sent_ahead = self._rest_now.command
            if self._note_rested(stamp_ns, peer):
                self._end()
                return sent.data
        try:
            telegram = self._link.read(data, stamp_ns)
        except ControllerError as error:
            self.refused += 1
            self.last_refusal = str(error)
            reply = self._answer_unreadable(error.counter, stamp_ns, peer)
        else:
            reply = self._decide(telegram, peer)
        self._end()
        return reply

    def listen(self, now_ns: int) -> None:
        """Note that telegrams can arrive from now on.

        A program whose start is to be seen must start after that.

        Args:
            now_ns: when the link was opened [ns].
        """
        self.session.listen(now_ns)

    def restart_exchange(self) -> None:
        """Note that the controller's counter begins again, as after a new start of its stream."""
        self.exchange.reset()

    def prepare(self, stamp_ns: int) -> bool:
        """Make the step of a telegram that is expected at ``stamp_ns``; True if it is ready."""
        if self._state is None or self._ready is not None or self.is_resting:
            return False
        self._begin(preparing=True)
        entry, plan = self._step(self._state, stamp_ns, telegram=True)
        self._ready = PreparedStep(self._reply(entry), entry, plan)
        self._end()
        return True

    def on_missing(self, stamp_ns: int, *, may_rest: bool = False) -> None:
        """Make the step of a cycle whose telegram did not come, as its deadline passes.

        Args:
            may_rest: the robot has been gone for long, and no one looks.
        """
        if self._has_failed_after_step(stamp_ns):
            return
        self.end_rest()
        self.exchange.on_missing()
        if self._state is None or (may_rest and self._rest()):
            return
        self._begin()
        ready, self._ready = self._ready, None
        if ready is None:
            self._step_unsent(self._state, stamp_ns)
        else:
            # The telegram before may have come, and been answered, since this one was made.
            self._add_unsent(ready)
            # The step was decided on as if its telegram would come.
            self.operating.is_reply_lost = True
        self._end()

    def _has_failed_after_step(self, stamp_ns: int) -> bool:
        """Return whether a cycle's telegram came, and failed between its step and its reply.

        A second step with the same stamp would date all measurements a cycle late.
        """
        if not self._is_running or self._was_preparing or self._state is self._state_at_begin:
            return False
        return stamp_ns - self._stamp_ns < round(0.5e9 * self.parameters.cycle_s)

    def _begin(self, *, preparing: bool = False) -> None:
        """Notice that the last call raised, which is a fault.

        Its reply did not go out, unless it was the ready one. A preparation that failed before its
        step owed none.
        """
        if self._is_running:
            self.operating.has_failed = True
            if not self._was_preparing or self._state is not self._state_at_begin:
                self.session.refrain()
            if self._sent_ahead is not None:
                self.session.give_unread(self._sent_ahead)
            elif self._owes_reply:
                self.session.unserved += 1
        self._is_running, self._was_preparing, self._owes_reply = True, preparing, False
        self._state_at_begin = self._state
        self._sent_ahead = self.ready_reply = None

    def _end(self) -> None:
        """Note that the call did not raise, and predict the next telegram."""
        self.ready_reply = self._predict()
        self._sent_ahead, self._is_running = None, False

    def _predict(self) -> ReadyReply | None:
        """Return the ready reply and the telegram that would be the ordinary next one."""
        ready, rest = self._ready, self._rest_now
        if self._arrived is None or (ready is None and rest is None):
            return None
        if ready is not None and not ready.entry.inputs.sent:
            return None
        foreseen = self.exchange.foreseen()
        if foreseen is None or self.session.is_interrupted or self.session.may_be_late:
            return None
        counter, peer = foreseen
        joints = self._arrived.joints if rest is None else rest.robot.joints
        reach = LONGEST_JUMP if rest is None else STILL
        expected = self._link.expect(
            counter, self.session.delay, joints, reach, self.session.would_be_lost
        )
        if expected is None:
            return None
        pattern, echo = expected
        held = rest or ready
        assert held is not None  # noqa: S101 - as seen above
        reply = held.reply.with_counter(echo)
        return ReadyReply(pattern, peer, self.session.accounted_until_ns, reply)

    def _decide(self, telegram: ControllerTelegram, peer: Hashable) -> bytes | None:
        robot = telegram.robot
        stamp_ns = robot.stamp_ns
        is_far = self._jump(robot, 1) is not None
        self.session.note_telegram(stamp_ns)
        decision = self.decision = self.exchange.on_telegram(telegram.counter, stamp_ns, peer)
        self._owes_reply = decision.answer
        if not decision.answer:
            return None
        if self._rest_now is not None:
            self._end_rest_by(self._rest_now, telegram, decision)
        self.session.cycles_since_command += decision.missed + 1
        if is_far and self._refuse_jump(robot, peer, decision):
            return self._reply_bare(telegram.echo, stamp_ns, decision.steps)
        if telegram.unready is not None:
            self.session.decline(telegram.unready, self._axes(robot), peer)
            return self._reply_bare(telegram.echo, stamp_ns, decision.steps)
        is_unproven = self._state is None or decision.kind in _OPENS
        is_unproven = is_unproven or self.session.needs_proof(robot, decision.missed)
        if is_unproven:
            proven = self._prove(telegram, peer, decision)
            if proven is None:
                return self._reply_bare(telegram.echo, stamp_ns, decision.steps)
            decision = self.decision = proven
        if self.session.settle(robot.delay, decision.missed + 1, stamp_ns, telegram.sent_to):
            self.operating.is_reply_lost = True
        self.operating.unled_s = self.session.unled * self.parameters.cycle_s
        arrived = robot
        if decision.kind not in _OPENS:
            stamp_ns = self.date(stamp_ns, decision.missed + 1)
            robot = replace(robot, stamp_ns=stamp_ns)
        self._check_position(robot)
        reply = self._answer(telegram, stamp_ns, decision)
        self._note_reply(arrived, peer)
        self._robot = robot
        self._arrived = arrived
        return reply.head + telegram.echo + reply.tail

    def _jump(self, robot: RobotSample, cycles: int) -> str | None:
        """Return which axis has moved farther than it can, None if there is none.

        Args:
            cycles: since the telegram before, by their counters.
        """
        before, period = self._arrived, self.parameters.cycle_s
        if before is None:
            return None
        old_axes, new_axes = ((*each.joints, *each.external[:1]) for each in (before, robot))
        # One comparison for all axes of an ordinary telegram; NaN fails it too.
        if sum(map(abs, map(sub, new_axes, old_axes))) <= LONGEST_JUMP:
            return None
        speeds = self.parameters.controller.limits.speed.tolist()  # of the axes that there are
        for name, old, new, speed in zip(AXES, old_axes, new_axes, speeds, strict=False):
            reach = cycles * max(LONGEST_JUMP, OVERSPEED * speed * period)
            if not abs(new - old) <= reach:
                return f"{name} jumps from {old:.3f} to {new:.3f} in {cycles} cycles (rad, m)"
        return None

    def _refuse_jump(self, robot: RobotSample, peer: Hashable, decision: TelegramDecision) -> bool:
        """Return whether a telegram counts as unreadable: an axis that is led jumps."""
        if decision.kind in _OPENS or not (self._is_led and self.session.is_proven):
            return False
        jump = self._jump(robot, decision.missed + 1)
        if jump is not None:
            self.refused += 1
            self.last_refusal = jump
            self.session.refuse(peer)
        return jump is not None

    @property
    def _is_led(self) -> bool:
        """Whether the robot has got a command of its session, or is to get one."""
        was_led = self.session.applied != self.session.reference
        return was_led or states.order(self.operating.machine) is not MotionOrder.HOLD

    def _note_reply(self, arrived: RobotSample, peer: Hashable) -> None:
        """Note the reply to a telegram that is proven to be the program's."""
        last, exchange = self.last, self.exchange
        assert last is not None  # noqa: S101 - its command is in the reply
        step = exchange.step if exchange.state is ExchangeState.RUNNING else None
        self.session.note_reply(last.outputs.command, arrived, peer, step)
        self._given = last
        self._owes_reply = False  # what is lost from here on is this reply

    def _note_rested(self, stamp_ns: int, peer: Hashable) -> bool:
        """Note a telegram of a rest that has got the ready reply; False: it must be read.

        Its counter, its delay and its joints are those expected. The rest is read at each look.
        """
        rest, foreseen, robot = self._rest_now, self.exchange.foreseen(), self._robot
        if rest is None or foreseen is None or robot is None or foreseen[1] != peer:
            return False
        if self.looks_at(stamp_ns) or stamp_ns > self.session.accounted_until_ns:
            return False
        if not self._is_quiet():
            return False
        self.session.note_telegram(stamp_ns)
        self.decision = self.exchange.on_telegram(foreseen[0], stamp_ns, peer)
        robot = self._robot = replace(robot, counter=foreseen[0], stamp_ns=stamp_ns)
        self.session.settle(robot.delay, 1, stamp_ns)
        self.rested += 1
        self._note_reply(robot, peer)
        return True

    def _answer_unreadable(
        self, counter: tuple[int, bytes] | None, stamp_ns: int, peer: Hashable
    ) -> bytes | None:
        """Return a bare reply to a telegram of which only the counter could be read, or None."""
        if counter is None:
            return None
        number, echo = counter
        self.session.note_telegram(stamp_ns)
        if self.exchange.would_open(stamp_ns, peer):
            return self._reply_bare(echo, stamp_ns, 0)
        decision = self.decision = self.exchange.on_telegram(number, stamp_ns, peer)
        if not decision.answer:
            return None
        self.session.cycles_since_command += decision.missed + 1
        self.session.refuse(peer)
        return self._reply_bare(echo, stamp_ns, decision.steps)

    def _prove(
        self, telegram: ControllerTelegram, peer: Hashable, decision: TelegramDecision
    ) -> TelegramDecision | None:
        """Open or resume the session if it is proven which setpoint is in force.

        Returns:
            The decision with the cycles that are proven; None if the setpoint is not.
        """
        robot = telegram.robot
        session, axes = self.session, self._axes(robot)
        opens = decision.kind in _OPENS
        proof = session.prove(robot, axes, telegram.programmed, peer)
        if proof is None:
            return None
        if not opens:
            decision = self._without_jump(robot, decision)
        is_resumed = opens or session.is_interrupted or decision.missed > 0
        reference, held = proof
        # After an unnoticed stall of this process, its estimate of the object is too old.
        is_old = session.stalled_s >= RESTART_S or self._state is None
        if session.proof is not Proof.CONTINUED or is_old:
            self._open_session(robot, reference, held)
        elif is_resumed:
            self.operating.is_reply_lost |= session.resume(held, robot.delay)
            self.operating.has_resynchronised |= opens
            if session.step is not None and self.exchange.state is not ExchangeState.RUNNING:
                self.exchange.resume(session.step)
            if opens:
                # The object went on in cycles that the clock has not counted.
                stood = round(session.stalled_s / self.parameters.cycle_s)
                decision = self.decision = replace(decision, steps=decision.steps + stood)
        return decision

    def _without_jump(self, robot: RobotSample, decision: TelegramDecision) -> TelegramDecision:
        """Return the decision without the cycles that the counter has and the time has not.

        A step for each of them would predict the object too far ahead: 1.3 mm at 106 mm/s.
        """
        jumped = self.session.jumped(robot, decision.missed)
        if not jumped:
            return decision
        self.session.cycles_since_command -= jumped
        unmade = min(jumped, decision.steps)
        self.exchange.note_jump(unmade)
        missed, steps = decision.missed - jumped, decision.steps - unmade
        return replace(decision, missed=missed, steps=steps)

    def _open_session(self, robot: RobotSample, reference: Axes, held: Axes) -> None:
        """Begin a session with a robot that holds; arming is needed."""
        self.session.open(reference, held, robot.delay)
        self._restart(robot, held)

    def _check_position(self, robot: RobotSample) -> None:
        """Check the following error; before motion, open the session again where the robot rests.

        A session may begin while the robot still comes to rest.
        """
        is_led, axes = self._is_led, self._axes(robot)
        if is_led:
            self.following.check_moving(axes, self.operating.settings.follow_tolerance)
        elif self.following.check_resting(axes, self.session.reference):
            self._open_session(robot, axes, axes)

    def _reply_bare(self, echo: bytes, stamp_ns: int, steps: int) -> bytes:
        """Return a reply without a setpoint: the controller keeps the one that it has."""
        self.end_rest()
        ready, self._ready = self._ready, None
        # The step was decided on as if the robot would be led in this cycle.
        self.operating.is_reply_lost |= ready is not None
        if ready is not None and steps > 0:
            self._add_unsent(ready)
            ready, steps = None, steps - 1
        if self._state is not None and steps > 0:
            self._catch_up(stamp_ns, steps)
            self._step_unsent(self._state, stamp_ns)
        self.session.refrain()
        if ready is not None:
            # The clock made the step of this telegram. The prepared one is the next cycle's.
            self._ready = self._confirmed(ready)
        signals = 0 if self.last is None or self._state is None else self.last.outputs.digital_out
        # A bit that says in sync must not stay set while the robot is not led.
        has_bit = self.operating.settings.in_sync_bit is not None
        reply = self._link.without_setpoint(signals, writes_zero=has_bit)
        return b"" if reply is None else reply.with_counter(echo)

    def _answer(
        self, telegram: ControllerTelegram, stamp_ns: int, decision: TelegramDecision
    ) -> PreparedReply:
        """Return the reply, after as many steps as the controller made cycles."""
        rest = self._rest_now
        if rest is not None and self._goes_on(telegram.robot.stamp_ns):
            self.rested += 1
            return rest.reply
        session, last, steps = self.session, self.last, decision.steps
        if decision.missed:
            session.moves = False
        ahead = steps == 0 and not session.was_sent and not session.was_lost
        if ahead and last is not None and last.inputs.sent == session.moves:
            # The timer made the step of this late telegram, but did not send it.
            self.last = replace(last, counter=telegram.counter)
            return self._reply(last)
        if decision.missed:
            # The robot has held, even if the timer had no step left to make for it: a controller
            # that was stalled itself counts fewer cycles than the time has.
            session.was_sent = False
        if steps == 0 and last is not None and self._plan is not None:
            return self._reply(self._finish_again(last, self._plan, telegram.counter))
        ready, self._ready = self._ready, None
        if ready is not None and steps > 1:
            self._add_unsent(ready)
            ready, steps = None, steps - 1
        if ready is None:
            self._catch_up(stamp_ns, steps)
            if decision.missed:
                session.was_sent = False
        return self._step_answering(ready, stamp_ns, telegram.counter)

    @property
    def rules(self) -> ExchangeRules:
        """How the controller's family exchanges setpoints."""
        return self._link.rules

    @property
    def is_unproven(self) -> bool:
        """Whether it is unknown which setpoint the controller has in force."""
        return self.session.unproven is not None

    @property
    def openings(self) -> int:
        """Sessions begun."""
        return self.session.openings

    def status(self) -> dict[str, Any]:
        """Return what an operator wants to know; plain values only."""
        sensors = self.samples.status(self._stamp_ns)
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
            "rested": self.rested,
            "settles_s": self.settles_s,
            "replies_lost": self.session.replies_lost,
            "astray": self.following.error,
            "correction": {
                "proof": self.session.proof.name.lower(),
                "unproven": self.session.unproven,
            },
            "foreign": self.session.unproven,
            "telegrams": {**self.exchange.counters, "unreadable": self.refused},
            "last_refusal": self.last_refusal,
            "unfit": states.unfit(self.operating.signals),
            "home": self.refusal("home"),
            "sensors": sensors["sensors"],
            "redated": sensors["redated"],
            "dropped": {**sensors["dropped"], "log": self.log_dropped},
            "ages_s": sensors["ages_s"],
        }
        if self.last is not None:
            outputs = self.last.outputs
            status["phase"] = outputs.phase.value
            tolerance = self.operating.settings.in_sync_tolerance
            status["measured"] = _measured(self.last)
            status["in_sync"] = is_in_sync(self.machine.state.value, outputs, tolerance)
            status |= {name: getattr(outputs, name) for name in _SHOWN}
        return status


def _measured(entry: LogEntry) -> tuple[float, ...] | None:
    """Return A1..A6 [rad] and E1 [m] of the telegram before a step, None if it was missing."""
    robot = entry.inputs.robot
    return None if robot is None else (*robot.joints, *robot.external[:1])
