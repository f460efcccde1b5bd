"""The cyclic heart of the daemon: a telegram in, a reply out; no socket, no clock, no await.

Law of this file: it owns everything that changes from cycle to cycle (exchange, operating state,
the step's state, the samples that wait) and does the same in real and in virtual time. Whoever
calls it brings bytes and stamps and takes bytes away; the reply first, ``take_log`` after it.
"""

import math
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar
from xml.sax.saxutils import escape

from linemate.daemon import step as stepping
from linemate.daemon.inputs import Inputs, Order
from linemate.daemon.parameters import Parameters
from linemate.daemon.service import states, watch
from linemate.daemon.service.states import Machine, Signals, State
from linemate.daemon.tracking.task import Phase
from linemate.protocol.exchange import Exchange, Kind, Verdict
from linemate.protocol.rsi import PreparedReply, RobotTelegram, RsiCodec, RsiError, SensorTelegram
from linemate.protocol.samples import (
    CameraSample,
    DistanceSample,
    RobotSample,
    Vector6,
    WrenchSample,
)
from linemate.protocol.wrench_clock import WrenchClock

Sample = TypeVar("Sample")

Express = Callable[..., bytes | None]
"""Gives the reply to a datagram and its sender, or None."""
OnTransition = Callable[[Machine, Signals, Machine], None]

LONGEST_LOG = 256
AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
LONGEST_JUMP = 0.05
"""Of a joint from one telegram to the next, before a reply is looked at twice [rad]."""

RESTING = 10  # telegrams from which is told that a robot rests
STILL = 2e-4  # and how far apart they are [rad, m]
BESIDE = 5e-4  # from where it was when the session began [rad, m]
BRAKING = 1.0  # a tool that is told to hold slows down by so much at least [m/s^2]
STOPPING = 0.15  # and its robot is so long behind its commands, the jerk's time included [s]
SETTLED = 0.3  # a retreat is over when no axis is quicker [rad/s, m/s]; it may follow the object
CATCH_UP_S = 0.3  # steps made at once after a gap, at most
JOINED_S = 0.15  # unanswered for longer before its first telegram here: it was under way before
FOREIGN = "the robot's programme was under way before this daemon: start it anew"
PEERS = 4  # programmes that are remembered
SLACK = 4  # cycles by which counter and clock may disagree


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One step as the recorder wants it.

    Attributes:
        ipoc: the one it answered, None if it answered none.
        state: the operating state.
        inputs, outputs: in and out.
        before, after: the step's own state; where ``before`` is not the ``after`` of the entry
            before, a session began anew, or steps are missing.
        parameters: it was made with.
    """

    ipoc: int | None
    state: str
    inputs: Inputs
    outputs: stepping.Outputs
    before: stepping.State | None = None
    after: stepping.State | None = None
    parameters: Parameters | None = None


@dataclass(frozen=True, slots=True)
class _Swap:
    """Parameters that wait for the next step; ``anew``: the step begins anew where it stands."""

    parameters: Parameters
    anew: bool


@dataclass(frozen=True, slots=True)
class _Prepared:
    """A step made before its telegram, its reply but for the IPOC."""

    reply: PreparedReply
    entry: LogEntry


@dataclass(frozen=True, slots=True)
class _Programme:
    """What is remembered of a controller's programme, as of its last answered telegram."""

    ipoc: int
    step: int | None
    stamp_ns: int
    delay: int | None
    start: tuple[float, ...]
    taken: tuple[float, ...]
    given: tuple[float, ...]


class Inbox(Generic[Sample]):
    """Samples that wait for the next step: bounded, the oldest dropped and counted."""

    def __init__(self, size: int) -> None:
        self._samples: deque[Sample] = deque(maxlen=size)
        self.taken = 0
        self.dropped = 0

    def put(self, sample: Sample) -> None:
        """Add the newest sample."""
        if len(self._samples) == self._samples.maxlen:
            self.dropped += 1
        self._samples.append(sample)

    def take(self) -> tuple[Sample, ...]:
        """Return all that wait, oldest first."""
        if not self._samples:
            return ()
        samples = tuple(self._samples)
        self._samples.clear()
        self.taken += len(samples)
        return samples


class Cycle:
    """What the daemon does each cycle."""

    def __init__(  # noqa: PLR0915 - all that changes, in one place
        self,
        parameters: Parameters,
        codec: RsiCodec,
        watch_settings: watch.WatchSettings | None = None,
        *,
        absolute: bool = True,
        wrench_expected: bool = True,
    ) -> None:
        """Wait for the first telegram.

        Args:
            parameters: of the step.
            codec: of the robot's telegrams.
            watch_settings: time-outs and debounce.
            absolute: corrections are offsets from the start (#ABSOLUTE), else increments.
            wrench_expected: there is a force-torque sensor.
        """
        self.parameters = parameters
        self.codec = codec
        self.exchange = Exchange(parameters.cycle_s)
        self.machine = Machine()
        self.distance: Inbox[DistanceSample] = Inbox(32)
        self.camera: Inbox[CameraSample] = Inbox(16)
        self.wrench: Inbox[WrenchSample] = Inbox(64)
        self.refused = 0
        self.last_refusal: str | None = None
        self.inline = 0
        self.prepared = 0
        self.replies_lost = self.remade = self.openings = 0
        self.is_foreign = False
        self.astray: str | None = None
        self.steps = 0
        self.log_dropped = 0
        self.last: LogEntry | None = None
        self.on_transition: OnTransition | None = None
        self.verdict: Verdict | None = None
        self._wrench_clock = WrenchClock()
        self._settings = watch_settings or watch.WatchSettings()
        self._absolute = absolute
        self._wrench_expected = wrench_expected
        self._watch = watch.Watch()
        self._signals = states.Signals()
        self._orders: set[str] = set()
        self._state: stepping.State | None = None
        self._robot: RobotSample | None = None
        self._joints: Vector6 | None = None
        self._start: tuple[float, ...] = ()
        # The command of the last reply while its fate is open, and the last one that was taken.
        self._given: tuple[float, ...] | None = None
        self._taken: tuple[float, ...] = ()
        self._delay: int | None = None
        self._was_lost = False
        self._is_loss_untold = False
        self._pace = 0.0
        self._gap: float | None = None
        lag = round(self._settings.follow_s / parameters.cycle_s)
        self._rest: deque[tuple[float, ...]] = deque(maxlen=RESTING)
        self._lately: deque[tuple[float, ...]] = deque(maxlen=max(2, lag))
        self._bearable = parameters.tracker.settings.tactile.overload_force
        self._was_much = self._is_overloaded = False
        self._programmes: dict[Hashable, _Programme] = {}
        self._was_sent = True
        self._new_session = False
        self._stamp_ns = 0
        self._distance_ns: int | None = None
        self._camera_ns: int | None = None
        self._wrench_ns: int | None = None
        self._ready: _Prepared | None = None
        self._swap: _Swap | None = None
        self._log: deque[LogEntry] = deque(maxlen=LONGEST_LOG)
        tags = {element.tag for element in codec.config.receive}
        self._writes_external = any(tag.startswith(("EK.", "EKorr.")) for tag in tags)
        self._writes_signals = "DiO" in tags
        sentype = escape(codec.config.sentype)
        self._bare = PreparedReply(f'<Sen Type="{sentype}"><IPOC>'.encode(), b"</IPOC></Sen>")

    # Samples.

    def feed_distance(self, sample: DistanceSample) -> None:
        """Take a sample of the distance sensor for the next step."""
        self.distance.put(sample)

    def feed_camera(self, sample: CameraSample) -> None:
        """Take a camera's pose for the next step."""
        self.camera.put(sample)

    def feed_wrench(self, sample: WrenchSample) -> None:
        """Take a wrench for the next step."""
        self.wrench.put(self._wrench_clock.date(sample))

    # Orders.

    def order(self, op: str, who: str = "") -> str | None:
        """Take an operator's order for the next step.

        Args:
            op: arm, start, stop, retreat or ack.
            who: gave it; for the log of the caller.

        Returns:
            None, or why it is refused.
        """
        del who
        reason = states.refusal(self.machine, self._signals, op)
        if reason is not None and op == "arm" and self.last is not None:
            reason = self.last.outputs.ready or reason
        if reason is None:
            self._orders.add(op)
        return reason

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

    def watch_by(self, settings: watch.WatchSettings) -> None:
        """Take other time-outs and debounce from the next step on."""
        self._settings = settings

    @property
    def stands(self) -> bool:
        """Whether the robot is at rest and nothing is about to move it."""
        at_rest = self.machine.state in {State.INIT, State.IDLE, State.HOLD, State.FAULT}
        return at_rest and not self._orders and (self._state is None or not self._state.moving)

    def trial(self) -> tuple[stepping.State, Inputs] | None:
        """Return the state and the inputs of the last step, to try parameters on."""
        if self.last is None or self.last.before is None:
            return None
        return self.last.before, self.last.inputs

    def _apply_swap(self) -> None:
        """Between two steps: what was to be swapped is."""
        swap, self._swap = self._swap, None
        if swap is None:
            return
        self.parameters = swap.parameters
        if swap.anew and self._state is not None:
            held = tuple(self._state.control.gate.position.tolist())
            there = RobotSample(self._stamp_ns, 0, held[:6], held[6:])
            self._state = stepping.initial(self.parameters, there)

    # The cycle.

    def on_telegram(self, data: bytes, stamp_ns: int, peer: Hashable = None) -> bytes | None:
        """Return the reply to one telegram, None if it is not to be answered.

        Args:
            data: the datagram.
            stamp_ns: its arrival [ns].
            peer: who sent it.
        """
        try:
            telegram = self.codec.parse_robot(data)
            robot = self._robot_sample(telegram, stamp_ns)
        except RsiError as error:
            self.refused += 1
            self.last_refusal = str(error)
            return None
        verdict = self.verdict = self.exchange.on_telegram(telegram.ipoc, stamp_ns, peer)
        if not verdict.answer:
            return None
        if verdict.kind in {Kind.FIRST, Kind.NEW_SESSION}:
            self._meet(robot, peer)
        if self.is_foreign:
            return self._reply_bare(telegram, stamp_ns)
        self._settle(telegram.delay, verdict.missed + 1)
        self._look_where(robot)
        reply = self._answer(telegram, stamp_ns, verdict.steps)
        self._robot = robot
        self._joints = robot.joints
        self._remember(robot, peer)
        return reply

    def express(self) -> Express | None:
        """Return what answers in the least time the telegram that the ready reply was made for.

        ``on_telegram`` has to follow at once, and returns the same reply.

        Returns:
            Takes a datagram and its sender and gives the reply; None if counter, sender, shape,
            Delay (the controller may have thrown the last reply away) or the robot's place are
            not what was assumed. None at once if nothing is ready or foreseen.
        """
        ready, foreseen = self._ready, self.exchange.foreseen()
        if ready is None or not ready.entry.inputs.sent or foreseen is None:
            return None
        ipoc, expected_peer = foreseen
        if self._joints is None:
            return None
        is_expected = self.codec.expect_robot(ipoc, self._delay, self._joints, LONGEST_JUMP)
        if is_expected is None:
            return None
        reply = ready.reply.with_ipoc(b"%d" % ipoc)

        def answer(data: bytes, peer: Hashable = None) -> bytes | None:
            return reply if peer == expected_peer and is_expected(data) else None

        return answer

    def prepare(self, stamp_ns: int) -> bool:
        """Make the step of a telegram that is expected at ``stamp_ns``; True if it is ready."""
        if self._state is None or self._ready is not None:
            return False
        entry = self._step(stamp_ns, telegram=True)
        self._ready = _Prepared(self._reply(entry), entry)
        return True

    def on_missing(self, stamp_ns: int) -> None:
        """Make the step of a cycle whose telegram did not come, as its deadline passes."""
        self.exchange.on_missing()
        if self._state is None:
            return
        if self._ready is not None:
            self._note(self._ready.entry, None)
            self._ready = None
        else:
            self._note(self._step(stamp_ns, telegram=False), None)
        self._was_sent = False

    def take_log(self) -> list[LogEntry]:
        """Return the steps since the last call, oldest first; to be called after the reply."""
        entries = list(self._log)
        self._log.clear()
        return entries

    def _robot_sample(self, telegram: RobotTelegram, stamp_ns: int) -> RobotSample:
        """Return what a telegram says of the robot.

        Raises:
            RsiError: the configuration sends no joints, or no linear axis that the arm has.
        """
        external = telegram.external or ()
        if telegram.joints is None:
            raise RsiError("the telegram has no AIPos: the daemon needs the joints")
        if self.parameters.controller.arm.linear_axis and not external:
            raise RsiError("the telegram has no EIPos: the task's arm has a linear axis")
        signals = telegram.channels.get("DiL", 0)
        return RobotSample(
            stamp_ns=stamp_ns,
            ipoc=telegram.ipoc,
            joints=telegram.joints,
            external=external,
            delay=telegram.delay,
            digital_in=int(signals) if isinstance(signals, (int, float)) else 0,
        )

    def _meet(self, robot: RobotSample, peer: Hashable) -> None:
        """Find out whether a programme has begun, and open a session with it.

        Absolute corrections count from where a programme began. One that was under way before
        this process cannot be told where that was; it is only asked to hold.
        """
        known = self._programmes.get(peer)
        cycle_s = self.parameters.cycle_s
        if known is not None and (held := _goes_on(known, robot, cycle_s)) is not None:
            self._open_session(robot, known.start, held)
            return
        unanswered_s = (robot.delay or 0) * cycle_s
        self.is_foreign = self._absolute and known is None and unanswered_s > JOINED_S
        if not self.is_foreign:
            axes = self._axes(robot)
            self._open_session(robot, axes, axes)

    def _open_session(
        self, robot: RobotSample, start: tuple[float, ...], held: tuple[float, ...]
    ) -> None:
        """Begin anew with a robot that holds; arming is needed."""
        self.is_foreign = False
        self.openings += 1
        self._new_session = self._state is not None
        external = (held[6], *robot.external[1:]) if len(held) > 6 else robot.external
        there = replace(robot, joints=held[:6], external=external)  # type: ignore[arg-type]
        self._state = stepping.initial(self.parameters, there)
        self._start = start
        self._given = None
        self._taken = held
        self._rest.clear()
        self._lately.clear()
        self._lately.append(held)
        self.astray = None
        self._delay = robot.delay
        self._was_lost = False
        self._robot = robot
        self._ready = None
        self._was_sent = True

    def _remember(self, robot: RobotSample, peer: Hashable) -> None:
        """Remember a programme as of a telegram that was answered."""
        if peer not in self._programmes and len(self._programmes) == PEERS:
            self._programmes.pop(next(iter(self._programmes)))
        self._programmes[peer] = _Programme(
            robot.ipoc,
            self.exchange.step,
            robot.stamp_ns,
            robot.delay,
            self._start,
            self._taken,
            self._held,
        )

    def _reply_bare(self, telegram: RobotTelegram, stamp_ns: int) -> bytes:
        """Return a reply without corrections: the controller keeps those that it has."""
        if self._state is not None:
            self._note(self._step(stamp_ns, telegram=False), None)
            self._was_sent = False
        return self._bare.with_ipoc(telegram.ipoc_text)

    def _axes(self, robot: RobotSample) -> tuple[float, ...]:
        """Return a telegram's axes in the controller's order."""
        if self.parameters.controller.arm.linear_axis:
            return (*robot.joints, robot.external[0])
        return robot.joints

    def _settle(self, delay: int | None, cycles: int) -> None:
        """Find out whether the controller took the last reply.

        It counts every cycle without a good one. If as many are new as have passed, then the
        last reply was not taken either: the robot holds, and the gate must begin from there.
        """
        given, self._given = self._given, None
        before, self._delay = self._delay, delay
        if given is None:
            return
        self._was_lost = None not in {delay, before} and (delay or 0) - (before or 0) == cycles
        if self._was_lost:
            self.replies_lost += 1
            self._is_loss_untold = True
        else:
            self._taken = given

    def _answer(self, telegram: RobotTelegram, stamp_ns: int, steps: int) -> bytes:
        """Return the reply after as many steps as the controller made cycles."""
        if steps == 0 and not self._was_sent and not self._was_lost and self.last is not None:
            # The clock was ahead of a late telegram: its step is made, only not yet sent.
            self.last = replace(self.last, ipoc=telegram.ipoc)
            return self._give(self.last, self._reply(self.last), telegram)
        ready, self._ready = self._ready, None
        if ready is not None and steps <= 1:
            self.prepared += 1
            ready = self._confirmed(ready)
            entry, reply = ready.entry, ready.reply
        else:
            if ready is not None:
                self._note(ready.entry, None)
                self._was_sent = False
                steps -= 1
            self._catch_up(stamp_ns, steps)
            self.inline += 1
            entry = self._step(stamp_ns, telegram=True)
            reply = self._reply(entry)
        self._note(entry, telegram.ipoc)
        return self._give(entry, reply, telegram)

    def _give(self, entry: LogEntry, reply: PreparedReply, telegram: RobotTelegram) -> bytes:
        """Return a reply as it goes to the wire; its fate is open."""
        self._was_sent, self._was_lost = True, False
        self._given = entry.outputs.command
        return reply.with_ipoc(telegram.ipoc_text)

    def _confirmed(self, ready: _Prepared) -> _Prepared:
        """Return a prepared step, made once more if what it assumed of the robot is not so."""
        sent, applied = self._fate()
        inputs = ready.entry.inputs
        if (inputs.sent, inputs.applied) == (sent, applied):
            return ready
        self.remade += 1
        inputs = replace(inputs, sent=sent, applied=applied)
        before, made_with = ready.entry.before, ready.entry.parameters
        assert before is not None and made_with is not None  # noqa: PT018, S101 - as _step made it
        self._state, outputs = stepping.step(before, inputs, made_with)
        entry = replace(ready.entry, inputs=inputs, outputs=outputs, after=self._state)
        return _Prepared(self._reply(entry), entry)

    def _fate(self) -> tuple[bool, tuple[float, ...] | None]:
        """Return whether the last step's command is the robot's, and where it holds if not."""
        arrived = self._was_sent and not self._was_lost
        return arrived, None if arrived else self._held

    def _catch_up(self, stamp_ns: int, steps: int) -> None:
        """Make the steps of cycles whose telegrams did not come and were not missed yet."""
        period = round(self.parameters.cycle_s * 1e9)
        most = max(1, round(CATCH_UP_S / self.parameters.cycle_s))
        for back in range(min(steps, most) - 1, 0, -1):
            self._note(self._step(stamp_ns - back * period, telegram=False), None)
            self._was_sent = False

    @property
    def _held(self) -> tuple[float, ...]:
        """Where the robot is, as far as is known: an open reply counts as taken."""
        return self._taken if self._given is None else self._given

    def _step(self, stamp_ns: int, *, telegram: bool) -> LogEntry:
        """Make one sampling step: operating state first, then the pure step."""
        distance, camera, wrench = self.distance.take(), self.camera.take(), self.wrench.take()
        self._see(distance, camera, wrench)
        self._apply_swap()
        before = self.machine
        self._decide(stamp_ns, telegram=telegram)
        started = self.machine is not before and self.machine.state is states.State.TRACK
        sent, applied = self._fate()
        inputs = Inputs(
            k=self.steps,
            stamp_ns=stamp_ns,
            robot=self._robot,
            distance=distance,
            camera=camera,
            wrench=wrench,
            order=states.order(self.machine),
            start=started,
            sent=sent,
            applied=applied,
        )
        self._robot = None
        assert self._state is not None  # noqa: S101 - a session is open
        told, made_with = self._state, self.parameters
        self._state, outputs = stepping.step(told, inputs, made_with)
        self.steps += 1
        self._stamp_ns = stamp_ns
        state = self.machine.state.value
        return LogEntry(None, state, inputs, outputs, told, self._state, made_with)

    @property
    def _heard(self) -> tuple[int, ...]:
        """When each of the sensors of the position was heard last [ns]."""
        times = (self._distance_ns, self._camera_ns)
        return tuple(stamp_ns for stamp_ns in times if stamp_ns is not None)

    def _see(
        self,
        distance: tuple[DistanceSample, ...],
        camera: tuple[CameraSample, ...],
        wrench: tuple[WrenchSample, ...],
    ) -> None:
        """Note when each sensor was heard last, and whether two forces in a row were too great."""
        if distance:
            self._distance_ns = distance[-1].stamp_ns
        if camera:
            self._camera_ns = camera[-1].stamp_ns
        if wrench:
            self._wrench_ns = wrench[-1].stamp_ns
        self._is_overloaded = False
        for sample in wrench:
            x, y, z = sample.force
            much = x * x + y * y + z * z > self._bearable**2
            self._is_overloaded |= much and self._was_much
            self._was_much = much

    def _look_where(self, robot: RobotSample) -> None:
        """Note an axis that is not where it was sent; look for a better start before motion.

        A session may begin while the robot still comes to rest; corrections count from there.
        """
        axes = self._axes(robot)
        if self._held != self._start or states.order(self.machine) is not Order.HOLD:
            self._rest.clear()
            self._stray(axes)
            return
        self.astray = None
        self._rest.append(axes)
        if len(self._rest) < RESTING:
            return
        still = all(max(ways) - min(ways) < STILL for ways in zip(*self._rest, strict=True))
        beside = any(abs(q - start) > BESIDE for q, start in zip(axes, self._start, strict=True))
        if still and beside:
            self._open_session(robot, axes, axes)

    def _stray(self, axes: tuple[float, ...]) -> None:
        """Note which axis is not where the commands of the last moments led it."""
        far = self._settings.follow_tolerance
        self.astray = None
        for n, ways in enumerate(zip(*self._lately, axes, strict=True)):
            *sent, q = ways
            if not min(sent) - far <= q <= max(sent) + far:
                self.astray = f"{AXES[n]} is at {q:.3f}, it was sent to {sent[-1]:.3f} (rad, m)"
                return

    def _decide(self, stamp_ns: int, *, telegram: bool) -> None:
        """Move the operating state on what was seen up to now."""
        outputs = self.last.outputs if self.last is not None else None
        before = self.machine
        under_way = outputs is not None and (outputs.task_time or 0.0) > 0.0 and self._heard
        facts = watch.Facts(
            stamp_ns=stamp_ns,
            # A link that carries telegrams but no replies is no link.
            telegram=telegram and not self._is_loss_untold,
            new_session=self._new_session,
            position_ns=max(self._heard, default=None),
            slower_ns=min(self._heard) if under_way else None,
            wrench_ns=self._wrench_ns,
            wrench_expected=self._wrench_expected,
            ready=outputs is not None and outputs.ready is None,
            contact=outputs is not None and outputs.contact,
            gap_m=self._gap,
            astray=self.astray is not None,
            overload=self._is_overloaded,
            done=outputs is not None and outputs.phase is Phase.RETREAT,
            clear=outputs is not None and outputs.finished and self._pace < SETTLED,
            orders=frozenset(self._orders),
        )
        self._orders.clear()
        self._new_session = self._is_loss_untold = False
        self._watch, self._signals = watch.observe(self._watch, facts, self.machine, self._settings)
        self.machine = states.transition(before, self._signals)
        if self.on_transition is not None:
            self.on_transition(before, self._signals, self.machine)

    def _reply(self, entry: LogEntry) -> PreparedReply:
        """Return the reply to a step but for the IPOC: corrections, or increments."""
        command = entry.outputs.command
        origin = self._start if self._absolute else self._held
        offsets = tuple(c - o for c, o in zip(command, origin, strict=True))
        return self.codec.prepare_sensor(
            SensorTelegram(
                ipoc=0,
                joints=offsets[:6],  # type: ignore[arg-type]
                external=offsets[6:] if self._writes_external else None,
                channels={"DiO": entry.outputs.digital_out} if self._writes_signals else {},
            )
        )

    def _note(self, entry: LogEntry, ipoc: int | None) -> None:
        """Remember a step for the log."""
        if ipoc is not None:
            entry = LogEntry(
                ipoc,
                entry.state,
                entry.inputs,
                entry.outputs,
                entry.before,
                entry.after,
                entry.parameters,
            )
        if self.last is not None:
            moved = zip(self.last.outputs.command, entry.outputs.command, strict=True)
            self._pace = max(abs(b - a) for a, b in moved) / self.parameters.cycle_s
            self._gap = _gap(self.last.outputs, entry.outputs, self.parameters.cycle_s)
        self.last = entry
        self._lately.append(entry.outputs.command)
        if len(self._log) == LONGEST_LOG:
            self.log_dropped += 1
        self._log.append(entry)

    # What others may know.

    def status(self) -> dict[str, Any]:
        """Return what an operator wants to know; plain values only."""
        entry = self.last
        status: dict[str, Any] = {
            "state": self.machine.state.value,
            "because": self.machine.because,
            "latched": self.machine.latched,
            "link": self._signals.link.value,
            "steps": self.steps,
            "prepared": self.prepared,
            "inline": self.inline,
            "replies_lost": self.replies_lost,
            "astray": self.astray,
            "foreign": FOREIGN if self.is_foreign else None,
            "telegrams": {**self.exchange.counters, "unreadable": self.refused},
            "last_refusal": self.last_refusal,
            "unfit": states.unfit(self._signals),
            "dropped": {
                "distance": self.distance.dropped,
                "camera": self.camera.dropped,
                "wrench": self.wrench.dropped,
                "log": self.log_dropped,
            },
            "ages_s": {
                "position": self._age(max(self._heard, default=None)),
                "distance": self._age(self._distance_ns),
                "camera": self._age(self._camera_ns),
                "wrench": self._age(self._wrench_ns),
            },
        }
        if entry is not None:
            outputs = entry.outputs
            status |= {
                "phase": outputs.phase.value,
                "task_time": outputs.task_time,
                "scenario": outputs.scenario,
                "scenario_state": outputs.scenario_state,
                "confidence": outputs.confidence,
                "speed": outputs.speed,
                "contact": outputs.contact,
                "overload": outputs.overload,
                "held": outputs.held,
                "ready": outputs.ready,
                "target": outputs.target,
                "sensed": outputs.sensed,
                "part": outputs.part,
                "command": outputs.command,
            }
        return status

    def _age(self, stamp_ns: int | None) -> float | None:
        """Return how old a stamp is at the last step [s]."""
        return None if stamp_ns is None else (self._stamp_ns - stamp_ns) * 1e-9


def _gap(before: stepping.Outputs, now: stepping.Outputs, period: float) -> float | None:
    """Return what a stop would leave between tool and object [m], None while it is not seen."""
    if now.part is None or now.task_time is None:
        return None
    gap = math.dist(now.target[:3], now.part[:3])
    speed = max(0.0, (math.dist(before.target[:3], now.part[:3]) - gap) / period)
    return gap - speed * STOPPING - speed * speed / (2.0 * BRAKING)


def _goes_on(known: _Programme, robot: RobotSample, cycle_s: float) -> tuple[float, ...] | None:
    """Return where the robot holds if a programme is the one remembered, None if it is not.

    One that goes on has counted on in the time that passed, and has every cycle since in its
    Delay, as a running total or in a row.
    """
    if known.step is None or known.delay is None or robot.delay is None:
        return None
    cycles, rest = divmod(robot.ipoc - known.ipoc, known.step)
    passed = (robot.stamp_ns - known.stamp_ns) * 1e-9 / cycle_s
    if rest or abs(passed - cycles) > SLACK:
        return None
    if robot.delay == known.delay + cycles:
        return known.taken
    if robot.delay in {cycles - 1, known.delay + cycles - 1}:
        return known.given
    return None
