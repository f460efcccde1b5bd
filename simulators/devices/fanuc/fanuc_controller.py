"""Strict FANUC controller with Stream Motion: status packets, judgement of commands, alarms.

Invariants:
    Pure: bytes in and out, time is counted in cycles.
    The client speaks first. Status packets go out between START and STOP alone.
    A command of another version, style, number or axis, a second one in a cycle, and one beyond a
    limit raise an alarm, which ends the motion until the operator resets it.
    Without a command the setpoints go on at their speed; after ``silence_s`` an alarm stops them,
    whatever STOP and START a client that was started again has sent.
"""

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, cast

from linemate.protocol.exchange_controller import ControllerCounts, Judgement
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.packets import CommandPacket, FanucError, StatusPacket
from linemate.simulators.devices.fanuc.dialects import RequestKind, dialect
from linemate.simulators.devices.fanuc.setpoint_gate import SetpointGate
from linemate.simulators.devices.limit_judge import LIMITS, AxisLimit, LimitJudge
from linemate.simulators.devices.rsi_controller import Applied, RobotReading, Seven

AXES = 7
MESSAGES = 16
ANSWERS = 8
TAKES_COMMANDS, MOVES = 0x01, 0x08
ERROR, PENDANT, EMERGENCY_STOP = 0x01, 0x02, 0x04
HISTORY = 100  # an older command than that was never asked for
_MOVING = 1e-3  # speed of a setpoint that counts as motion [rad/s, m/s]
_U32 = 2**32
_MM = 1e-3
_AT_ZERO = 1e-9


@dataclass(frozen=True, slots=True)
class FanucConfig:
    """How the controller is set up.

    Attributes:
        cycle_s: 0.008 on an R-30iB, down to 0.001 on an R-50iA [s].
        version: of the protocol: 3 and 4, or 1 and 2 of the older generation.
        is_coupled: J3 on the wire is relative to the horizontal.
        has_rail: J7 is a linear axis. Without it, J7 has to stay at 0.
        signals_byte: place of the tool's signals in the inputs and outputs, None without.
        is_echoed: a command repeats the number of the packet that it answers. False: its numbers
            have to grow, and the newest command of a cycle counts.
        silence_s: without a command for so long, an alarm stops the motion [s].
        patient: silence before the first good command is not charged.
        limits: of each axis; a setpoint beyond one raises an alarm.
    """

    cycle_s: float = 0.008
    version: Literal[1, 2, 3, 4] = 3
    is_coupled: bool = False
    has_rail: bool = True
    signals_byte: int | None = 0
    is_echoed: bool = True
    silence_s: float = 0.12
    patient: bool = False
    limits: tuple[AxisLimit, ...] = LIMITS

    @property
    def total_tolerated(self) -> int | None:
        """Cycles in all without a good answer that are tolerated; None: they count in a row."""
        return None


@dataclass(slots=True)
class _Stream:
    """What START resets.

    Attributes:
        sequence: of the last status packet.
        silent: cycles since the last good command.
        is_answered: a good command came.
        answered: number of the last good command.
        accepted: good command of the open cycle.
        late: the open cycle got the command of an earlier one.
        faulty: the open cycle got a command that was refused.
        is_last: the client sent its last command.
    """

    is_open: bool = False
    sequence: int = 0
    silent: int = 0
    is_answered: bool = False
    answered: int | None = None
    accepted: CommandPacket | None = None
    late: bool = False
    faulty: bool = False
    is_last: bool = False


class FanucController:
    """The controller's side of Stream Motion.

    Attributes:
        config: how it is set up.
        judge: the emulator's own view of the setpoints.
        counts: status packets sent, and what became of the cycles.
        refusals: packets refused, by reason.
        clamped: always 0: a command beyond a limit raises an alarm.
        messages: texts of the newest alarms.
        delay: cycles of the stream without a good command; no packet says so.
        alarm: what stopped the motion, None without one.
        is_program_running: the program that starts Stream Motion waits for commands.
        is_emergency_stop: the emergency stop is pressed.
        is_pendant_enabled: the teach pendant is enabled.
    """

    def __init__(
        self, read: Callable[[], RobotReading], setpoints: Seven, config: FanucConfig | None = None
    ) -> None:
        """Begin before the first packet.

        Args:
            read: gives the robot's state at a cycle's start.
            setpoints: where the robot stands, A1..A6 [rad], E1 [m].
        """
        self.config = config = config or FanucConfig()
        self.judge = LimitJudge(config.cycle_s, config.limits)
        self.judge.start(setpoints)
        self.counts = ControllerCounts()
        self.refusals: Counter[str] = Counter()
        self.messages: deque[str] = deque(maxlen=MESSAGES)
        self.clamped = self.delay = 0
        self.alarm: str | None = None
        self.is_program_running = True
        self.is_emergency_stop = self.is_pendant_enabled = False
        self._read = read
        self._dialect = dialect(config.version, config.cycle_s, config.limits)
        self._gate = SetpointGate(setpoints, config.limits, config.cycle_s)
        self._stream = _Stream()
        self._answers: deque[bytes] = deque(maxlen=ANSWERS)
        self._tolerated = round(config.silence_s / config.cycle_s)
        self._coasted = 0  # cycles that the setpoints went on at their speed
        self._cycle = -1
        self._signals = 0

    @property
    def setpoints(self) -> Seven:
        """Setpoints in force, A1..A6 [rad], E1 [m]."""
        return cast(Seven, self._gate.position)

    @property
    def broken(self) -> str | None:
        """What stopped the motion, None while it goes on."""
        return self.alarm

    @property
    def takes_commands(self) -> bool:
        """Whether the status says that motion is possible."""
        is_safe = not (self.is_emergency_stop or self.is_pendant_enabled)
        ready = self.is_program_running and self.alarm is None and is_safe
        return self._stream.is_open and ready and not self._stream.is_last

    def take_answers(self) -> list[bytes]:
        """Return the answers to the client's requests, oldest first."""
        answers = list(self._answers)
        self._answers.clear()
        return answers

    def reset(self) -> None:
        """Reset the alarm, as the operator does."""
        self.alarm = None

    def restart(self, setpoints: Seven | None = None) -> None:
        """Reset the alarm and run the program again; the stream goes on.

        Args:
            setpoints: where the robot stands, A1..A6 [rad], E1 [m]; None: where it was sent last.
        """
        pose = self.setpoints if setpoints is None else setpoints
        self.alarm, self.is_program_running = None, True
        self._gate = SetpointGate(pose, self.config.limits, self.config.cycle_s)
        self.judge.start(pose)
        stream = self._stream
        stream.is_answered, stream.silent, stream.accepted = False, 0, None

    def jump(self, cycles: int | None) -> None:
        """Let the number of the packets jump; the stream goes on.

        Args:
            cycles: how far, None: to 0.
        """
        stream = self._stream
        stream.sequence = _U32 - 1 if cycles is None else (stream.sequence + cycles) % _U32
        stream.answered = None

    def begin(self) -> None:
        """Count and charge from the next cycle on, in the same stream."""
        self.counts, self.delay = ControllerCounts(), 0
        self.refusals.clear()
        self._cycle, self._stream.silent = -1, 0

    def telegram(self) -> bytes | None:
        """Open a cycle.

        Returns:
            Its status packet, None without a stream.
        """
        stream = self._stream
        self._cycle += 1
        stream.accepted, stream.faulty, stream.late = None, False, False
        if not stream.is_open:
            return None
        stream.sequence = (stream.sequence + 1) % _U32
        self.counts.sent += 1
        return self._dialect.write_status(self._describe(self._read()))

    def on_reply(self, data: bytes, stamp_ns: int = 0, deadline_ns: int | None = None) -> Judgement:
        """Judge a packet of the client.

        Args:
            deadline_ns: end of the open cycle [ns], None if the caller closes it in time.

        Returns:
            What a command is. A request is no reply: MISSING.
        """
        try:
            if packets.kind_of(data) in self._dialect.command_kinds:
                is_late = deadline_ns is not None and stamp_ns >= deadline_ns
                return self._on_command(self._dialect.read_command(data), is_late=is_late)
            request = self._dialect.request(data)
        except FanucError:
            return self._refuse("malformed")
        if request.answer is not None:
            self._answers.append(request.answer)
        if request.kind is RequestKind.START:
            self._on_start(request.version)
        elif request.kind is RequestKind.STOP:
            self._on_stop()
        elif request.kind is RequestKind.POSITION:
            commanded = self._describe(RobotReading(self.setpoints, self._read().tcp))
            self._answers.append(self._dialect.write_position(commanded))
        return Judgement.MISSING

    def end_of_cycle(self) -> Applied:
        """Close the open cycle and apply what it brought.

        Returns:
            Where the axes go during it, and what became of it.
        """
        stream, gate = self._stream, self._gate
        outcome = self._close(stream) if stream.is_open else None
        if not self.takes_commands:
            # The program that is started again waits for its first command.
            stream.is_answered, stream.silent = False, 0
            self._coasted = 0
            gate.stop()
            self.judge.hold(gate.position)
        elif stream.accepted is not None:
            self._coasted = 0
            gate.accept(self._positions(stream.accepted))
            self.judge.judge(gate.position)
        else:
            gate.coast()
            self.judge.slip()
            self.judge.judge(gate.position)
            self._coasted = self._coasted + 1 if self._moves else 0
            if self._coasted > self._tolerated:
                self._raise("silence", f"no command for {self.config.silence_s:g} s")
        if stream.accepted is not None and stream.accepted.is_last:
            stream.is_last = True
        return Applied(
            self._cycle, stream.sequence, self.setpoints, self._signals, outcome, clamped=False
        )

    @property
    def _moves(self) -> bool:
        """Whether the setpoints move."""
        return any(abs(v) > _MOVING for v in self._gate.speed)

    def _on_start(self, version: int | None) -> None:
        if version not in {None, self.config.version}:
            self._raise("version", f"START of version {version}, not {self.config.version}")
            return
        self._stream = _Stream(is_open=True)

    def _on_stop(self) -> None:
        stream = self._stream
        is_last = stream.is_last or (stream.accepted is not None and stream.accepted.is_last)
        if stream.is_open and stream.is_answered and not is_last:
            self.refusals["unclean_stop"] += 1
        stream.is_open = False

    def _describe(self, reading: RobotReading) -> StatusPacket:
        """Return the status packet's values at a cycle's start."""
        config, stream = self.config, self._stream
        x, y, z, a, b, c = reading.tcp
        io = bytearray(packets.NO_IO)
        if config.signals_byte is not None:
            io[config.signals_byte] = reading.digital_in & 0xFF
        return StatusPacket(
            config.version,
            stream.sequence,
            (TAKES_COMMANDS if self.takes_commands else 0) | (MOVES if self._moves else 0),
            (ERROR if self.alarm is not None else 0)
            | (PENDANT if self.is_pendant_enabled else 0)
            | (EMERGENCY_STOP if self.is_emergency_stop else 0),
            self._wire(reading.axes),
            (x / _MM, y / _MM, z / _MM, *map(math.degrees, (a, b, c)), 0.0, 0.0, 0.0),
            time_ms=round(self._cycle * config.cycle_s * 1e3) % _U32,
            io=bytes(io),
        )

    def _on_command(self, command: CommandPacket, *, is_late: bool) -> Judgement:
        stream = self._stream
        if not stream.is_open or not self.takes_commands:
            return self._refuse("not_ready" if stream.is_open else "no_stream")
        fault = self._fault(command) or self._wrong_number(command)
        behind = (stream.sequence - command.sequence) % _U32
        if fault is None and self.config.is_echoed and (behind or is_late):
            stream.late = True
            return Judgement.LATE
        if fault is None:
            excess = self._gate.excess(self._positions(command))
            fault = None if excess is None else ("limit", excess)
        if fault is not None:
            self._raise(*fault)
            return self._refuse(fault[0])
        stream.accepted, stream.is_answered = command, True
        stream.answered = command.sequence
        if self.config.signals_byte is not None:
            self._signals = command.io[self.config.signals_byte]
        return Judgement.ACCEPTED

    def _wrong_number(self, command: CommandPacket) -> tuple[str, str] | None:
        """Return why a command is for no cycle that waits for one, None if it is."""
        stream, number = self._stream, command.sequence
        if stream.answered is not None and (stream.answered - number) % _U32 < HISTORY:
            self.counts.duplicate += 1
            return "double", f"command {number} although {stream.answered} has one"
        if self.config.is_echoed and (stream.sequence - number) % _U32 >= HISTORY:
            return "sequence", f"command {number}, not {stream.sequence}"
        return None

    def _fault(self, command: CommandPacket) -> tuple[str, str] | None:
        """Return why a command is wrong in itself: reason and text, None if it is not."""
        if command.version != self.config.version:
            return "version", f"command of version {command.version}, not {self.config.version}"
        if command.style != packets.JOINT_STYLE:
            return "style", f"data style {command.style:#06x}: a Cartesian pose"
        if not command.moves:
            return "no_motion", "a command without motion control"
        if not all(map(math.isfinite, command.joints)):
            return "not_finite", "a joint is not finite"
        used = AXES if self.config.has_rail else AXES - 1
        if any(abs(q) > _AT_ZERO for q in command.joints[used:]):
            return "axis", f"an axis beyond J{used} is commanded"
        return None

    def _raise(self, reason: str, what: str) -> None:
        """Raise an alarm; the first one stays until it is reset."""
        if self.alarm is None:
            self.alarm = f"alarm {reason}: {what}"
        self.messages.append(what)

    def _refuse(self, reason: str) -> Judgement:
        self.refusals[reason] += 1
        self.counts.unreadable += 1
        self._stream.faulty = True
        return Judgement.REFUSED

    def _close(self, stream: _Stream) -> Judgement:
        """Count the open cycle, and raise the alarm of silence."""
        if stream.accepted is not None:
            self.counts.answered += 1
            stream.silent = 0
            return Judgement.ACCEPTED
        if self.takes_commands and (stream.is_answered or not self.config.patient):
            stream.silent += 1
            self.delay += 1
            if stream.silent > self._tolerated and stream.is_answered:
                self._raise("silence", f"no command for {self.config.silence_s:g} s")
        if stream.late:
            self.counts.late += 1
            return Judgement.LATE
        if stream.faulty:
            self.counts.refused += 1
            return Judgement.REFUSED
        self.counts.lost += 1
        return Judgement.MISSING

    def _wire(self, axes: Seven) -> tuple[float, ...]:
        """Return J1..J9 [deg, mm] of A1..A6 [rad], E1 [m]."""
        joints = [math.degrees(q) for q in axes[:6]]
        if self.config.is_coupled:
            joints[2] -= joints[1]
        rail = axes[6] / _MM if self.config.has_rail else 0.0
        return (*joints, rail, 0.0, 0.0)

    def _positions(self, command: CommandPacket) -> tuple[float, ...]:
        """Return A1..A6 [rad], E1 [m] of a command."""
        joints = list(command.joints[:6])
        if self.config.is_coupled:
            joints[2] += joints[1]
        rail = command.joints[6] * _MM if self.config.has_rail else self._gate.position[6]
        return (*map(math.radians, joints), rail)
