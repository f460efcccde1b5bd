"""Sampling steps of the daemon: make one, finish one again, remember the last.

Invariants:
- The operating state is decided before the pure step is made.
- A step is planned once. It is finished again if the robot did not get the command as assumed.
- A step that is not read yet is kept, up to ``LONGEST_LOG``; the oldest is dropped.
"""

import math
from collections import deque

from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core import step as stepping
from linemate.daemon.core import wrench_frame
from linemate.daemon.core.control.command_limiter import LimiterState
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import Outputs, StepPlan, StepState
from linemate.daemon.core.tracking.estimation.tool_weight import carried_weights
from linemate.daemon.core.tracking.touch.touch_profile import force_limit
from linemate.daemon.cycle import states
from linemate.daemon.cycle.causes import Change
from linemate.daemon.cycle.handed_poses import HandedPoses
from linemate.daemon.cycle.in_sync import is_in_sync
from linemate.daemon.cycle.operating import Operating, Situation
from linemate.daemon.cycle.sensing.samples import NO_SAMPLES, DrainedSamples, SensorQueues
from linemate.daemon.cycle.sensing.sensor_health import Conditions
from linemate.daemon.cycle.session import Axes, Session, standing
from linemate.daemon.cycle.setpoint_reference import REST_S, STILL
from linemate.daemon.cycle.states import Machine, State
from linemate.daemon.cycle.step_log import LogEntry
from linemate.protocol.controller_link import ControllerLink, PreparedReply, SetpointKind
from linemate.protocol.stamped_samples import AXES, RobotSample

PROGRAMMED_S = 1000.0  # a blend this long lets the program alone lead the motion [s]
LONGEST_LOG = 256  # steps that are kept until they are read
CATCH_UP_S = 0.3  # steps made at once after a gap, at most [s]

OFF_START = 5e-4  # rest farther from the session's start is another place [rad, m]


class PreparedStep(Struct, frozen=True):
    """A step made before its telegram, what it planned, and its reply without the counter."""

    reply: PreparedReply
    entry: LogEntry
    plan: StepPlan


class FollowingCheck:
    """Compares the robot's position with its commands.

    A robot lags behind its commands. So its position is compared with all commands of the last
    moments, not with the newest one alone.

    Attributes:
        error: the axis beyond the tolerance, in words; None if there is none.
    """

    __slots__ = ("_at_start", "_commands", "_rest", "error")

    def __init__(self, lag_s: float, cycle_s: float) -> None:
        """Begin with no command.

        Args:
            lag_s: longest lag of the robot behind its commands [s].
        """
        self.error: str | None = None
        self._at_start = 0
        self._rest: deque[Axes] = deque(maxlen=max(2, round(REST_S / cycle_s)))
        self._commands: deque[Axes] = deque(maxlen=max(2, round(lag_s / cycle_s)))

    @property
    def is_resting(self) -> bool:
        """Whether a robot without a command has stayed where its session began."""
        return self._at_start >= (self._rest.maxlen or 0)

    def reset(self, held: Axes) -> None:
        """Begin a session with a robot that holds at a position."""
        self._rest.clear()
        self._commands.clear()
        self._commands.append(held)
        self.error = None
        self._at_start = 0

    def add_command(self, command: Axes) -> None:
        """Add the newest command."""
        self._commands.append(command)

    def check_moving(self, axes: Axes, tolerance: float) -> None:
        """Compare the position of a robot that has got a command.

        Args:
            tolerance: beyond the range of the last commands [rad, m].
        """
        self._rest.clear()
        self.error = None
        newest = self._commands[-1]
        for n, q in enumerate(axes):
            if newest[n] - tolerance <= q <= newest[n] + tolerance:
                continue
            commands = [command[n] for command in self._commands]
            if not min(commands) - tolerance <= q <= max(commands) + tolerance:
                self.error = f"{AXES[n]} is at {q:.3f}, it was sent to {newest[n]:.3f} (rad, m)"
                return

    def check_resting(self, axes: Axes, start: Axes) -> bool:
        """Return whether a robot without a command has come to rest away from the start.

        Args:
            start: its position when the session began.
        """
        self.error = None
        self._rest.append(axes)
        for q, s in zip(axes, start, strict=True):
            if not abs(q - s) <= OFF_START:
                break
        else:
            self._at_start += 1
            return False
        self._at_start = 0
        ranges = zip(*self._rest, strict=True)
        return len(self._rest) == self._rest.maxlen and all(max(r) - min(r) < STILL for r in ranges)


class Stepper:
    """Makes the sampling steps.

    Attributes:
        operating: decides what the daemon may do.
        samples: of the sensors, for the next step.
        following: compares the robot's position with its commands.
        prepared: telegrams answered with a prepared step.
        inline: telegrams answered with a step made for them.
        repeated: telegrams answered with a step that the timer had made, finished again.
        log_dropped: steps that were not read from the log in time.
    """

    def __init__(
        self,
        parameters: Parameters,
        link: ControllerLink,
        settings: WatchSettings,
        *,
        wrench_expected: bool,
    ) -> None:
        self.parameters = parameters
        self.operating = Operating(settings, parameters.cycle_s, wrench_expected=wrench_expected)
        self.samples = SensorQueues()
        self.session = Session(parameters.cycle_s, link.rules)
        self.following = FollowingCheck(settings.follow_s, parameters.cycle_s)
        self.last: LogEntry | None = None
        self.steps = self.prepared = self.inline = self.repeated = self.log_dropped = 0
        self._poses = HandedPoses()
        self._link = link
        self._log: deque[LogEntry] = deque(maxlen=LONGEST_LOG)
        self._state: StepState | None = None
        self._before: Outputs | None = None  # of the step before ``last``
        self._plan: StepPlan | None = None  # of ``last``, None if the session is new
        self._given: LogEntry | None = None  # the last step that a reply carried
        self._ready: PreparedStep | None = None
        self._robot: RobotSample | None = None  # for the next step
        self._stamp_ns = 0
        self._new_parameters: Parameters | None = None
        self._restarts_state = False

    @property
    def machine(self) -> Machine:
        """The operating state."""
        return self.operating.machine

    def take_changes(self) -> list[Change]:
        """Return the changes of the operating state since the last call, oldest first."""
        return self.operating.take_changes()

    def take_log(self) -> list[LogEntry]:
        """Return the steps since the last call, oldest first; to be called after the reply."""
        entries = list(self._log)
        self._log.clear()
        return entries

    def swap(self, parameters: Parameters, *, restarts: bool = False) -> None:
        """Use other parameters from the next step on.

        Args:
            parameters: of the same cycle time.
            restarts: the step's state does not fit them and begins again where the robot stands.
                Only for a robot that does (``stands``).
        """
        self._new_parameters = parameters
        self._restarts_state |= restarts

    def begin_object(self, parameters: Parameters, distance_offset: float) -> None:
        """Forget the last object and expect another one; only for a robot that stands.

        Args:
            parameters: of the task for it, of the same arm and cycle time.
            distance_offset: added to each reading of the distance sensor from now on [m].
        """
        self.swap(parameters, restarts=True)
        self.samples.distance_offset = distance_offset

    @property
    def is_home(self) -> bool:
        """Whether the robot stands at the task's first pose."""
        return self._state is not None and stepping.is_home(self._state, self.parameters)

    def set_watch(self, settings: WatchSettings) -> None:
        """Use other time-outs and debounce from the next step on."""
        self.operating.settings = settings

    @property
    def stands(self) -> bool:
        """Whether the robot is at rest and nothing is about to move it."""
        return self.operating.rests and (self._state is None or not self._state.moving)

    def trial(self) -> tuple[StepState, Inputs] | None:
        """Return the state and the inputs of the last step, to try parameters on."""
        if self.last is None or self.last.before is None:
            return None
        return self.last.before, self.last.inputs

    def _apply_swap(self, parameters: Parameters) -> None:
        self.parameters, self._new_parameters = parameters, None
        if self._restarts_state and self._state is not None:
            held = tuple(self._state.control.limiter.position.tolist())
            robot = RobotSample(self._stamp_ns, 0, held[:6], held[6:])
            self._state = stepping.initial(self.parameters, robot, self._state)
            self._plan = None
        self._restarts_state = False

    def _restart(self, robot: RobotSample, held: Axes) -> None:
        """Begin a session with a robot that holds."""
        self.following.reset(held)
        self.operating.has_new_session = self._state is not None
        position, before = standing(robot, held), self._state
        if before is not None and stepping.is_engaged(before, self.parameters, position):
            self._state = stepping.resumed(self.parameters, before, position)
        else:
            self._state = stepping.initial(self.parameters, position, before)
        self._robot = robot
        self._ready = self._plan = self._given = None

    def _rest(self) -> bool:
        """Forget the state of a robot that has gone, unless its task has begun.

        The next session begins with a new state, as the first one does.
        """
        state, last = self._state, self.last
        if state is None or last is None or self.machine.state is not State.INIT:
            return False
        tracker = state.tracker
        is_engaged = tracker.started or tracker.contact or tracker.clamped
        if state.moving or is_engaged or last.outputs.digital_out:
            return False
        self._state = self._plan = self._ready = None
        return True

    def _finish_again(self, last: LogEntry, plan: StepPlan, counter: int) -> LogEntry:
        """Finish the last step again, with the robot's position from the telegram.

        The timer has made the step of this telegram, or of a later one. One more step than the
        controller has cycles would predict the object too far ahead.
        """
        sent, applied, pace = self._delivery(last.inputs.k, answering=True)
        before, made_with = last.before, last.parameters
        assert before is not None and made_with is not None and last.after is not None  # noqa: PT018, S101
        if sent:
            # The robot has the command of this step, and goes on towards its target.
            gate = last.after.control.limiter
            before = replace(before, control=replace(before.control, limiter=gate))
        inputs = replace(last.inputs, sent=sent, applied=applied, pace=pace)
        self._state, outputs = stepping.finish(before, plan, inputs, made_with)
        entry = replace(
            last, counter=counter, inputs=inputs, outputs=outputs, before=before, after=self._state
        )
        self.repeated += 1
        self._replan_ready()
        self._add(entry, plan)
        return entry

    def _replan_ready(self) -> None:
        """Make the prepared step again, because the state before it has changed."""
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
        self._ready = PreparedStep(self._reply(entry), entry, plan)

    def _opened(self) -> StepState:
        assert self._state is not None  # noqa: S101 - a session is open
        return self._state

    def _confirmed(self, ready: PreparedStep, *, answering: bool = False) -> PreparedStep:
        """Return a prepared step, finished again if the robot did not get the last command."""
        inputs = ready.entry.inputs
        sent, applied, pace = self._delivery(inputs.k, answering=answering)
        if (inputs.sent, inputs.applied, inputs.pace) == (sent, applied, pace):
            return ready
        inputs = replace(inputs, sent=sent, applied=applied, pace=pace)
        before, made_with = ready.entry.before, ready.entry.parameters
        assert before is not None and made_with is not None  # noqa: PT018, S101 - as _step made it
        self._state, outputs = stepping.finish(before, ready.plan, inputs, made_with)
        entry = replace(ready.entry, inputs=inputs, outputs=outputs, after=self._state)
        return PreparedStep(self._reply(entry), entry, ready.plan)

    def _delivery(
        self, k: int, *, answering: bool
    ) -> tuple[bool, Axes | None, tuple[Axes, Axes] | None]:
        """Return the delivery status of the last step's command.

        Args:
            k: number of the step that asks.
            answering: a telegram shows that no cycle has passed. Without one, a robot that got no
                command holds, or coasts if its controller does so.

        Returns:
            Whether the robot has the command; else where it is, and its speed and acceleration.
        """
        session, given = self.session, self._given
        if session.was_sent and not session.was_lost:
            return True, None, None
        if given is None or given.after is None:
            return False, session.held, None
        gate = given.after.control.limiter
        if not (answering and session.moves):
            if not self._link.rules.coasts:
                return False, session.held, None
            cycles = session.cycles_since_command if answering else k - given.inputs.k
            return False, *self._coasted(gate, cycles - 1)
        return False, session.held, (tuple(gate.speed.tolist()), tuple(gate.acceleration.tolist()))

    def _coasted(self, gate: LimiterState, cycles: int) -> tuple[Axes, tuple[Axes, Axes]]:
        """Return setpoint, speed and acceleration of a controller that goes on by itself.

        q + n T0 q', for n cycles without a command, until it stops with an alarm.
        """
        cycle_s = self.parameters.cycle_s
        longest = round(self._link.rules.accounted_s / cycle_s)
        speed = gate.speed if cycles <= longest else 0.0 * gate.speed
        position = gate.position + min(max(0, cycles), longest) * cycle_s * gate.speed
        rest = (0.0,) * len(position)
        return tuple(position.tolist()), (tuple(speed.tolist()), rest)

    def _catch_up(self, stamp_ns: int, steps: int) -> None:
        """Make the steps of cycles whose telegrams did not come, unless the timer made them."""
        period = round(self.parameters.cycle_s * 1e9)
        limit = max(1, round(CATCH_UP_S / self.parameters.cycle_s))
        for back in range(min(steps, limit) - 1, 0, -1):
            due_ns, last_ns = stamp_ns - back * period, self._stamp_ns
            # A clock that stood dates no sample in the cycles that it has not counted.
            self._step_unsent(self._opened(), max(due_ns, last_ns), is_dated=due_ns > last_ns)

    def _step_unsent(self, state: StepState, stamp_ns: int, *, is_dated: bool = True) -> None:
        """Make the step of a cycle that gets no corrections.

        Args:
            is_dated: the clock has counted the cycle.
        """
        self._add(*self._step(state, stamp_ns, telegram=False, is_dated=is_dated))
        self.session.was_sent = False

    def _add_unsent(self, ready: PreparedStep) -> None:
        ready = self._confirmed(ready)
        self._add(ready.entry, ready.plan)
        self.session.was_sent = False

    def _step(
        self,
        state: StepState,
        stamp_ns: int,
        *,
        telegram: bool,
        answering: bool = False,
        counter: int | None = None,
        is_dated: bool = True,
    ) -> tuple[LogEntry, StepPlan]:
        """Make one sampling step: operating state first, then the pure step."""
        samples = self._drain_samples(state) if is_dated else NO_SAMPLES
        if self._new_parameters is not None:
            self._apply_swap(self._new_parameters)
            state = self._opened()
        operating, before = self.operating, self.machine
        operating.decide(stamp_ns, self.samples, self._situation(), telegram=telegram)
        machine = operating.machine
        started = machine is not before and machine.state is State.TRACK
        sent, applied, pace = self._delivery(self.steps, answering=answering)
        inputs = Inputs(
            self.steps,
            stamp_ns,
            self._robot,
            samples.distance,
            samples.camera,
            samples.wrench,
            states.order(machine),
            started,
            sent,
            applied,
            pace,
            self._poses.drain(follows=machine.state is State.FOLLOW),
        )
        self._robot = None
        made_with = self.parameters
        plan = stepping.plan(state, inputs, made_with)
        self._state, outputs = stepping.finish(state, plan, inputs, made_with)
        if not outputs.contact:
            self.samples.camera_health.add_result(len(samples.camera), outputs.refused)
        self.steps += 1
        self._stamp_ns = stamp_ns
        shown = machine.state.value
        entry = LogEntry(counter, shown, inputs, outputs, state, self._state, made_with)
        return entry, plan

    def _step_answering(
        self, ready: PreparedStep | None, stamp_ns: int, counter: int
    ) -> PreparedReply:
        """Return the reply to a telegram, after its step is confirmed or made."""
        if ready is not None:
            self.prepared += 1
            ready = self._confirmed(ready, answering=True)
            entry, plan, reply = replace(ready.entry, counter=counter), ready.plan, ready.reply
        else:
            self.inline += 1
            entry, plan = self._step(
                self._opened(), stamp_ns, telegram=True, answering=True, counter=counter
            )
            reply = self._reply(entry)
        self._add(entry, plan)
        return reply

    def _drain_samples(self, state: StepState) -> DrainedSamples:
        """Return the accepted samples since the last step; their force is judged by the way."""
        settings = self.parameters.tracker.settings
        moving = self.machine.state in states.MOVING
        conditions = Conditions(moving, settings.distance.deviation, self._in_last_approach)
        weights = carried_weights(self.parameters.tracker, state.tracker)
        frame = self.parameters.wrench_frame
        if frame is not None:
            weights = tuple(wrench_frame.force_in_sensor(frame, weight) for weight in weights)
        limit = settings.tactile.overload_force
        if self.machine.state is State.TRACK:
            limit = force_limit(settings.payload.bolts, state.tracker.distance, limit)
        return self.samples.drain(conditions, limit, weights)

    def _situation(self) -> Situation:
        """Return the robot and the task for a decision."""
        last = None if self.last is None else self.last.outputs
        settings = self.parameters.tracker.settings
        return Situation(
            last,
            self._before,
            following_error=self.following.error,
            # Where corrections count from is not known before the robot rests.
            settling=self.session.held == self.session.reference and not self.following.is_resting,
            sensed=settings.merge.blend < PROGRAMMED_S,
            longest_wait_s=self.parameters.tracker.task.guard.wait,
            last_approach=self._in_last_approach,
            closing=self._is_closing,
            home=self._home_refusal(),
            declined=self.session.unproven,
        )

    def _home_refusal(self) -> str | None:
        """Return why the robot cannot go home from where it is; only IDLE asks."""
        if self._state is None or self.last is None or self.machine.state is not State.IDLE:
            return "the robot does not stand idle"
        return stepping.home_refusal(self._state, self.last.outputs, self.parameters)

    @property
    def _in_last_approach(self) -> bool:
        """Whether the tool has left the last waypoint from which the camera sees the object."""
        task_time = 0.0 if self.last is None else self.last.outputs.task_time or 0.0
        return task_time > self.parameters.tracker.sight_time

    @property
    def _is_closing(self) -> bool:
        """Whether a wait cannot prevent the touch any more, and the tool does not wait."""
        last, final_time = self.last, self.parameters.tracker.final_time
        if last is None or not math.isfinite(final_time):
            return False
        return last.outputs.waiting is None and (last.outputs.task_time or 0.0) > final_time

    def _axes(self, robot: RobotSample) -> Axes:
        """Return a telegram's axes in the controller's order."""
        if self.parameters.controller.arm.linear_axis:
            return (*robot.joints, robot.external[0])
        return robot.joints

    def _reply(self, entry: LogEntry) -> PreparedReply:
        """Return the reply to a step without its counter."""
        is_offset = self._link.rules.setpoints is SetpointKind.OFFSETS
        origin = self.session.reference if is_offset else self.session.held
        outputs, watch = entry.outputs, self.operating.settings
        signals = outputs.digital_out
        if watch.in_sync_bit is not None:
            is_set = is_in_sync(entry.state, outputs, watch.in_sync_tolerance)
            signals |= is_set << watch.in_sync_bit
        return self._link.prepare(outputs.command, origin, signals)

    def _add(self, entry: LogEntry, plan: StepPlan) -> None:
        """Remember a step, for the next decision and for the log."""
        self._before = None if self.last is None else self.last.outputs
        self.last, self._plan = entry, plan
        self.following.add_command(entry.outputs.command)
        self.log_dropped += len(self._log) == LONGEST_LOG
        self._log.append(entry)
