"""Strict EGM controller: messages, judgement of corrections, guided motion.

Invariants:
    Pure: bytes in and out, time is counted in cycles.
    The controller sends one message a cycle. The newest good correction is in force.
    The sender's sequence number grows. A repeated or an older one is refused.
    Without a correction the last one holds; after CommTimeout the instruction ends.
    The first number of RAPIDtoRobot and RAPIDfromRobot is the tool's signals (RobotWare 7).
    With motors off, or without a running RAPID program, nothing moves.
"""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, cast

from linemate.protocol.egm import messages
from linemate.protocol.egm.egm_codec import EgmCodec
from linemate.protocol.egm.protobuf_wire import EgmError
from linemate.protocol.exchange_controller import ControllerCounts, Judgement
from linemate.protocol.stamped_samples import Vector6
from linemate.simulators.devices.egm.guidance import Guidance, GuidanceConfig
from linemate.simulators.devices.limit_judge import LIMITS, AxisLimit, LimitJudge
from linemate.simulators.devices.rsi_controller import Applied, RobotReading, Seven

AXES = 7
MESSAGES = 16
_REST = (0.0,) * AXES
_U32 = 2**32


@dataclass(frozen=True, slots=True)
class EgmConfig:
    """How the controller is set up.

    Attributes:
        cycle_s: 0.004 or a multiple of it [s].
        first_sequence: sequence number of the first message.
        comm_timeout_s: silence after which the instruction ends [s].
        patient: silence before the first good correction is not charged.
        robotware: generation of the message, 6 or 7.
        converge_range: of EGMRunJoint: deviation that counts as converged [rad, m].
        limits: of each axis, for the judge and for the setpoints.
    """

    cycle_s: float = 0.004
    first_sequence: int = 0
    comm_timeout_s: float = 1.0
    patient: bool = False
    robotware: Literal[6, 7] = 6
    guidance: GuidanceConfig = field(default_factory=GuidanceConfig)
    converge_range: float = 1e-3
    limits: tuple[AxisLimit, ...] = LIMITS

    @property
    def total_tolerated(self) -> int | None:
        """Cycles in all without a good answer that are tolerated; None: they count in a row."""
        return None


@dataclass(slots=True)
class _Run:
    """What EGMRunJoint begins again.

    Attributes:
        silent: cycles since the last good correction.
        sequence: of the newest message.
        is_answered: a good correction came.
        accepted: newest good correction of the open cycle.
        faulty: the open cycle got a message that was refused.
    """

    guidance: Guidance
    setpoints: Seven
    speeds: tuple[float, ...] = _REST
    digital_out: int = 0
    cycle: int = -1
    sequence: int = 0
    silent: int = 0
    is_answered: bool = False
    last_sequence: int | None = None
    accepted: messages.CorrectionMessage | None = None
    faulty: bool = False
    ended: str | None = None


class EgmController:
    """The controller's side of EGM in joint mode.

    Example::

        data = controller.telegram()                 # at t_k
        controller.on_reply(correction)
        applied = controller.end_of_cycle()          # active from t_k on

    Attributes:
        config: how it is set up.
        judge: the emulator's own view of the setpoints.
        counts: messages sent, and what became of the cycles.
        refusals: corrections refused, by reason.
        clamped: cycles in which MaxSpeedDeviation held something back.
        messages: the newest texts for the pendant.
        delay: cycles without a good correction; no message of EGM says so.
    """

    def __init__(
        self, read: Callable[[], RobotReading], setpoints: Seven, config: EgmConfig | None = None
    ) -> None:
        """Begin before the first cycle.

        Args:
            read: gives the robot's state at a cycle's start.
            setpoints: where the robot stands, A1..A6 [rad], E1 [m].
        """
        self.config = config = config or EgmConfig()
        self.codec = EgmCodec(robotware=config.robotware)
        self.judge = LimitJudge(config.cycle_s, config.limits)
        self.counts = ControllerCounts()
        self.refusals: Counter[str] = Counter()
        self.messages: deque[str] = deque(maxlen=MESSAGES)
        self.clamped = self.delay = 0
        self.is_motors_on = self.is_rapid_running = True
        self._read = read
        self._timeout = round(config.comm_timeout_s / config.cycle_s)
        self._run = self._new_run(setpoints, config.first_sequence)

    @property
    def setpoints(self) -> Seven:
        """Setpoints in force, A1..A6 [rad], E1 [m]."""
        return self._run.setpoints

    @property
    def broken(self) -> str | None:
        """Why the instruction ended, None while it goes on."""
        return self._run.ended

    @property
    def standing(self) -> Seven:
        """Where the servos are sent behind filter and loop, A1..A6 [rad], E1 [m]."""
        return cast(Seven, self._run.guidance.position)

    def jump(self, cycles: int | None) -> None:
        """Let the sequence number of the messages jump; the run goes on.

        Args:
            cycles: how far, None: to 0.
        """
        run = self._run
        run.sequence = _U32 - 1 if cycles is None else (run.sequence + cycles) % _U32
        run.last_sequence = None

    def restart(self, setpoints: Seven | None = None) -> None:
        """Run EGMRunJoint again: the robot is guided from where it stands.

        Args:
            setpoints: where that is, A1..A6 [rad], E1 [m]; None: where it was sent last.
        """
        self._run = self._new_run(self.standing if setpoints is None else setpoints, 0)

    def begin(self) -> None:
        """Count and charge from the next cycle on, in the same run."""
        self.counts, self.delay = ControllerCounts(), 0
        self.refusals.clear()
        self._run.cycle, self._run.silent = -1, 0

    def telegram(self) -> bytes | None:
        """Open a cycle.

        Returns:
            Its message; None once the instruction has ended.
        """
        run = self._run
        run.cycle += 1
        run.accepted, run.faulty = None, False
        if run.ended is not None:
            return None
        self.counts.sent += 1
        run.sequence = (run.sequence + 1) % _U32
        return self.codec.format_robot(self._describe(run, self._read()))

    def on_reply(self, data: bytes, stamp_ns: int = 0, deadline_ns: int | None = None) -> Judgement:
        """Judge a correction; the newest good one of a cycle is applied.

        Args:
            deadline_ns: end of the open cycle [ns]. EGM knows no late message: it is applied when
                it comes.

        Returns:
            What the message is.
        """
        del stamp_ns, deadline_ns
        run = self._run
        try:
            message = self.codec.parse_correction(data)
        except EgmError as error:
            return self._refuse("malformed", str(error))
        if message.joints is None:
            return self._refuse("setpoint", "planned.joints missing")
        if run.last_sequence is not None and not _is_newer(message.sequence, run.last_sequence):
            self.refusals["sequence"] += 1
            self.counts.duplicate += 1
            return Judgement.DUPLICATE
        if why := self._beyond(message):
            run.ended = why
            return self._refuse("position", why)
        run.last_sequence, run.accepted, run.is_answered = message.sequence, message, True
        return Judgement.ACCEPTED

    def end_of_cycle(self) -> Applied:
        """Close the open cycle and move the robot by what it brought.

        Returns:
            Setpoints in force, where the servos are sent, and what became of the cycle.
        """
        run = self._run
        outcome = None if run.ended is not None else self._close(run)
        is_guided = run.ended is None and self.is_motors_on and self.is_rapid_running
        if is_guided:
            self._follow(run)
            motion = run.guidance.advance(run.setpoints, run.speeds)
        else:
            motion = run.guidance.hold()
            run.setpoints, run.speeds = cast(Seven, motion), _REST
        if is_guided and run.accepted is not None:
            self.judge.judge(run.setpoints)
        else:
            self.judge.hold(run.setpoints)
        self.clamped += run.guidance.is_clamped
        return Applied(
            run.cycle,
            run.sequence,
            run.setpoints,
            run.digital_out,
            outcome,
            run.guidance.is_clamped,
            cast(Seven, motion),
        )

    def _new_run(self, standing: Seven, sequence: int) -> _Run:
        self.judge.start(standing)
        guidance = Guidance(self.config.guidance, self.config.cycle_s, standing)
        return _Run(guidance, standing, sequence=sequence - 1)

    def _describe(self, run: _Run, reading: RobotReading) -> messages.RobotMessage:
        """Return the message's values at a cycle's start."""
        time_us = round(self.counts.sent * self.config.cycle_s * 1e6)
        planned = run.guidance.position
        deviation = max(abs(a - b) for a, b in zip(planned, reading.axes, strict=True))
        is_guided = self.is_motors_on and self.is_rapid_running
        return messages.RobotMessage(
            run.sequence,
            time_us // 1000 % _U32,
            _position(reading.axes, time_us),
            _position(planned, time_us),
            messages.MotorState.ON if self.is_motors_on else messages.MotorState.OFF,
            messages.GuidanceState.RUNNING if is_guided else messages.GuidanceState.STOPPED,
            messages.RapidState.RUNNING if self.is_rapid_running else messages.RapidState.STOPPED,
            deviation <= self.config.converge_range,
            0.0,
            robotware=self.config.robotware,
            rapid_data=(float(reading.digital_in),) if self.config.robotware == 7 else (),
        )

    def _refuse(self, kind: str, why: str) -> Judgement:
        self.refusals[kind] += 1
        self.counts.unreadable += 1
        self.messages.append(why)
        self._run.faulty = True
        return Judgement.REFUSED

    def _beyond(self, message: messages.CorrectionMessage) -> str | None:
        """Return which software limit a setpoint exceeds."""
        axes = (*(message.joints or ()), *message.external[:1])
        for n, (value, limit) in enumerate(zip(axes, self.config.limits, strict=False), 1):
            if not limit.low <= value <= limit.high:
                return (
                    f"joint position error: axis {n} at {value:.4f}, "
                    f"limit {limit.low:.4f}..{limit.high:.4f}"
                )
        return None

    def _close(self, run: _Run) -> Judgement:
        """Count the open cycle, and end the instruction after CommTimeout."""
        if run.accepted is not None:
            self.counts.answered += 1
            run.silent = 0
            return Judgement.ACCEPTED
        is_charged = run.is_answered or not self.config.patient
        run.silent += is_charged
        self.delay += is_charged
        if run.silent > self._timeout:
            run.ended = (
                f"EGMRunJoint: ERR_UDPUC_COMM, no message for {self.config.comm_timeout_s:g} s"
            )
        if run.faulty:
            self.counts.refused += 1
            return Judgement.REFUSED
        self.counts.lost += 1
        return Judgement.MISSING

    @staticmethod
    def _follow(run: _Run) -> None:
        """Put the cycle's correction in force. Without one the setpoint holds, at speed 0."""
        message = run.accepted
        if message is None:
            run.speeds = _REST
            return
        joints = cast(Vector6, message.joints)
        a, b, c, d, e, f = joints
        rail = message.external[0] if message.external else run.setpoints[6]
        run.setpoints = (a, b, c, d, e, f, rail)
        if message.rapid_data:
            run.digital_out = round(message.rapid_data[0])
        rail_speed = message.external_speeds[0] if message.external_speeds else 0.0
        run.speeds = (*(message.joint_speeds or (0.0,) * 6), rail_speed)


def _position(axes: tuple[float, ...], time_us: int) -> messages.EgmPosition:
    return messages.EgmPosition(cast(Vector6, axes[:6]), axes[6:], clock_us=time_us)


def _is_newer(sequence: int, last: int) -> bool:
    """Return whether a 32-bit counter has grown, by less than half its range."""
    return 0 < (sequence - last) % _U32 < _U32 // 2
