"""Stream Motion behind the seam of controllers: setpoints are joint positions.

Invariants:
    Pure: bytes and stamps in, values and bytes out.
    A command has joints, never a pose.
    An axis that is not configured stays at zero. A robot that has it elsewhere gets no command.
    A controller that takes no commands gets none: silence leaves it as it is.
"""

import math
import struct
from typing import Final

from linemate.protocol.controller_family import refusal
from linemate.protocol.controller_link import (
    ControllerTelegram,
    ExchangeRules,
    IsLost,
    PreparedReply,
    SetpointKind,
)
from linemate.protocol.fanuc.packets import (
    AXES,
    IO_BYTES,
    STATUS_SIZES,
    VERSION_OF,
    CommandPacket,
    FanucError,
    PacketKind,
    StatusPacket,
    echo,
    read_status,
    write_command,
)
from linemate.protocol.stamped_samples import RobotSample, Vector6
from linemate.protocol.units import DEG, MM

# The controller goes on at the last speed without commands for so long, then it stops with an
# alarm [s]. Measured on a CRX by the authors of airo-fanuc 0.1.0.
COAST_S: Final = 0.12

TAKES_COMMANDS = 0x01
ERROR, PENDANT, EMERGENCY_STOP = 0x01, 0x02, 0x04

_UNUSED = 1e-3  # an axis that is not configured is at zero if it is nearer than this [deg, mm]
_COUNTER = slice(8, 12)
_JOINTS_AT = 56
_MATCHED = struct.Struct(">BB")
_JOINTS = struct.Struct(f">{AXES}f")


class ExpectedStatus:
    """Accepts one sequence number of a controller that takes commands, and a range for each joint.

    What it accepts, ``FanucLink.read`` accepts too.
    """

    __slots__ = ("_head", "_high", "_low", "_size")

    def __init__(self, head: bytes, size: int, low: list[float], high: list[float]) -> None:
        """Keep type, version and number, and open bounds of J1..J9 [deg, mm]."""
        self._head, self._size, self._low, self._high = head, size, low, high

    def matches(self, data: bytes) -> bool:
        """Return whether a datagram is the status packet."""
        if len(data) != self._size or not data.startswith(self._head):
            return False
        motion_bits, fault_bits = _MATCHED.unpack_from(data, 12)
        if not motion_bits & TAKES_COMMANDS or fault_bits & (ERROR | PENDANT | EMERGENCY_STOP):
            return False
        joints = _JOINTS.unpack_from(data, _JOINTS_AT)
        # NaN is within no bounds.
        return all(a < q < b for a, q, b in zip(self._low, joints, self._high, strict=True))


class FanucLink:
    """Reads status packets and writes commands.

    Attributes:
        rules: setpoints are positions, and the controller coasts.
    """

    def __init__(
        self,
        version: int,
        *,
        is_coupled: bool = False,
        on_rail: bool = False,
        signals_byte: int | None = None,
    ) -> None:
        """Keep what the site has.

        Args:
            version: of the protocol, 3 or 4.
            is_coupled: the controller's J3 is relative to the horizontal: q3 = J3 + J2.
            on_rail: J7 is the linear axis that the arm stands on.
            signals_byte: place of the tool's signals in the inputs and outputs, None without.

        Raises:
            FanucError: a version that there is not, a place beyond the inputs.
        """
        if version not in VERSION_OF.values():
            raise FanucError(f"version {version}: there are 3 and 4")
        if signals_byte is not None and not 0 <= signals_byte < IO_BYTES:
            raise FanucError(f"byte {signals_byte} of the inputs: there are 0..{IO_BYTES - 1}")
        self.rules = ExchangeRules(SetpointKind.POSITIONS, COAST_S, coasts=True)
        self._version = version
        self._is_coupled = is_coupled
        self._is_on_rail = on_rail
        self._signals_byte = signals_byte
        self._used = 7 if on_rail else 6
        self._scales = (*(DEG,) * 6, *((MM,) if on_rail else ()))
        kind = PacketKind.STATUS_V3 if version == 3 else PacketKind.STATUS_V4
        self._head = struct.pack(">II", kind, version)
        self._size = STATUS_SIZES[kind]

    def read(self, data: bytes, stamp_ns: int) -> ControllerTelegram:
        """Return the status packet in a datagram.

        Raises:
            ControllerError: it is none, of another version, or of another family.
        """
        try:
            status = read_status(data)
        except FanucError as error:
            raise refusal(error, data, "fanuc") from None
        if status.version != self._version:
            raise FanucError(
                f"status packet of version {status.version}, configured {self._version}. "
                f"Set fanuc.version: {status.version}.",
                status.sequence,
            )
        axes = self._positions(status.joints)
        a, b, c, d, e, f = axes[:6]
        signals = 0 if self._signals_byte is None else status.io[self._signals_byte]
        robot = RobotSample(
            stamp_ns, status.sequence, (a, b, c, d, e, f), axes[6:], None, digital_in=signals
        )
        return ControllerTelegram(
            status.sequence, data[_COUNTER], robot, unready=self._unready(status)
        )

    def expect(
        self,
        counter: int,
        delay: int | None,
        joints: Vector6,
        reach: float,
        is_lost: IsLost | None = None,
    ) -> tuple[ExpectedStatus, bytes]:
        """Return the status packet to expect next and its number.

        Args:
            delay: not counted by this controller.
            joints: the last measured joints [rad].
            reach: how far from there a joint may be [rad].
            is_lost: not shown by this controller.
        """
        del delay, is_lost
        number = echo(counter)
        wire = self._wire(joints)
        # A coupled J3 is a difference of two joints.
        reaches = [reach / DEG] * 6
        reaches[2] *= 2.0 if self._is_coupled else 1.0
        low = [q - r for q, r in zip(wire, reaches, strict=True)]
        high = [q + r for q, r in zip(wire, reaches, strict=True)]
        low += [-math.inf] * (self._used - 6) + [-_UNUSED] * (AXES - self._used)
        high += [math.inf] * (self._used - 6) + [_UNUSED] * (AXES - self._used)
        return ExpectedStatus(self._head + number, self._size, low, high), number

    def prepare(
        self, command: tuple[float, ...], origin: tuple[float, ...], digital_out: int
    ) -> PreparedReply:
        """Return the command but for its number.

        Args:
            command: position of the axes [rad, m].
            origin: of no use: setpoints are positions.

        Raises:
            FanucError: a joint that is not finite, or an axis too many.
        """
        del origin
        if len(command) != self._used:
            raise FanucError(f"{len(command)} axes, configured {self._used}. Set fanuc.rail.")
        wire = self._wire(command)
        io = bytes(IO_BYTES)
        if self._signals_byte is not None:
            place = self._signals_byte
            io = io[:place] + bytes((digital_out & 0xFF,)) + io[place + 1 :]
        data = write_command(
            CommandPacket(self._version, 0, (*wire, *(0.0,) * (AXES - len(wire))), io=io)
        )
        return PreparedReply(data[: _COUNTER.start], data[_COUNTER.stop :])

    def without_setpoint(self, digital_out: int, *, writes_zero: bool = False) -> None:
        """Return None: without a command the controller keeps to its own program."""
        del digital_out, writes_zero

    def _positions(self, wire: tuple[float, ...]) -> tuple[float, ...]:
        """Return the axes of the arm [rad, m] of J1..J9 [deg, mm]."""
        axes = [q * scale for q, scale in zip(wire, self._scales, strict=False)]
        if self._is_coupled:
            axes[2] += axes[1]
        return tuple(axes)

    def _wire(self, axes: tuple[float, ...]) -> list[float]:
        """Return J1.. [deg, mm] of the axes of the arm [rad, m]."""
        wire = [q / scale for q, scale in zip(axes, self._scales, strict=False)]
        if self._is_coupled:
            wire[2] -= wire[1]
        return wire

    def _unready(self, status: StatusPacket) -> str | None:
        """Return why the controller must not or cannot get a command, None if it takes one."""
        what = None
        if status.fault_bits & EMERGENCY_STOP:
            what = "emergency stop. Release it and reset the controller."
        elif status.fault_bits & PENDANT:
            what = "the teach pendant is enabled. Switch it off."
        elif status.fault_bits & ERROR:
            what = "an alarm. Read it on the pendant and reset it."
        elif not status.motion_bits & TAKES_COMMANDS:
            what = "no program waits for them. Run the program that starts Stream Motion."
        if what is not None:
            return f"the controller takes no setpoints: {what}"
        for n, position in enumerate(status.joints[self._used :], start=self._used + 1):
            if not abs(position) < _UNUSED:
                return (
                    f"external axis J{n} is at {position:.3f} and is not configured: a command "
                    "would move it to 0. Take it out of the motion group, or set fanuc.rail for J7."
                )
        return None
