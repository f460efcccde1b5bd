"""Stream Motion behind the seam: positions both ways, what is refused, what is expected."""

import math
import struct
from dataclasses import dataclass
from typing import Any

import pytest

from linemate.protocol.controller_link import SetpointKind
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.fanuc_link import FanucLink
from linemate.protocol.fanuc.packets import FanucError, StatusPacket

JOINTS = (10.0, -20.0, 30.0, 0.0, -45.0, 90.0)
READY = 0x01


@dataclass
class Packet:
    """A status packet with a few values of its own."""

    version: int = 3
    sequence: int = 7
    motion_bits: int = READY
    fault_bits: int = 0
    joints: tuple[float, ...] = JOINTS
    rail: float = 0.0
    io: bytes = packets.NO_IO

    def data(self) -> bytes:
        joints = (*self.joints, self.rail, 0.0, 0.0)[:9]
        return packets.write_status(
            StatusPacket(
                self.version, self.sequence, self.motion_bits, self.fault_bits, joints, io=self.io
            )
        )


def test_positions_are_read_in_si_with_their_number() -> None:
    telegram = FanucLink(3, on_rail=True).read(Packet(rail=1250.0).data(), 99)
    assert (telegram.counter, telegram.echo) == (7, b"\0\0\0\x07")
    assert telegram.robot.joints == pytest.approx([math.radians(q) for q in JOINTS])
    assert telegram.robot.external == pytest.approx((1.25,))
    assert (telegram.robot.stamp_ns, telegram.robot.delay) == (99, None)
    assert telegram.unready is None


@pytest.mark.parametrize("is_coupled", [False, True])
def test_a_reported_position_commands_itself(is_coupled: bool) -> None:
    link = FanucLink(3, is_coupled=is_coupled, on_rail=True)
    telegram = link.read(Packet(rail=-300.0).data(), 0)
    axes = (*telegram.robot.joints, *telegram.robot.external)
    reply = link.prepare(axes, (), 0).with_counter(telegram.echo)
    command = packets.read_command(reply)
    assert command.sequence == 7
    assert command.joints == pytest.approx((*JOINTS, -300.0, 0.0, 0.0))


def test_a_coupled_elbow_counts_from_the_horizontal() -> None:
    telegram = FanucLink(3, is_coupled=True).read(Packet().data(), 0)
    assert telegram.robot.joints[2] == pytest.approx(math.radians(30.0 - 20.0))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"fault_bits": 4}, "emergency stop"),
        ({"fault_bits": 2}, "teach pendant"),
        ({"fault_bits": 1}, "alarm"),
        ({"motion_bits": 0}, "starts Stream Motion"),
        ({"motion_bits": 8}, "starts Stream Motion"),
        ({"rail": 0.5}, "external axis J7 is at 0.500 and is not configured"),
    ],
)
def test_a_controller_that_takes_no_commands_says_why(changes: dict[str, Any], says: str) -> None:
    link = FanucLink(3)
    data = Packet(**changes).data()
    telegram = link.read(data, 0)
    assert telegram.unready is not None
    assert says in telegram.unready
    pattern, _ = link.expect(7, None, telegram.robot.joints, 0.05)
    assert not pattern.matches(data)
    assert link.without_setpoint(1) is None  # type: ignore[func-returns-value]


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("is_coupled", [False, True])
def test_the_expected_packet_is_the_next_one_near_the_last(version: int, is_coupled: bool) -> None:
    link = FanucLink(version, is_coupled=is_coupled, on_rail=True)
    packet = Packet(version=version, rail=100.0)
    robot = link.read(packet.data(), 0).robot
    pattern, echo = link.expect(7, None, robot.joints, 0.05)
    assert echo == b"\0\0\0\x07"
    assert pattern.matches(packet.data())
    assert pattern.matches(Packet(version, motion_bits=9, rail=-900.0).data())
    assert not pattern.matches(Packet(version, sequence=8, rail=100.0).data())
    for n in range(6):
        off = tuple(q + 10.0 * (i == n) for i, q in enumerate(JOINTS))
        assert not pattern.matches(Packet(version, joints=off).data())
    assert not pattern.matches(packet.data()[:-1])
    not_a_number = bytearray(packet.data())
    struct.pack_into(">f", not_a_number, 56, math.nan)
    assert not pattern.matches(bytes(not_a_number))


def test_the_tools_signals_ride_on_one_byte() -> None:
    link = FanucLink(3, signals_byte=5)
    io = bytes((0, 0, 0, 0, 0, 3)) + bytes(250)
    assert link.read(Packet(io=io).data(), 0).robot.digital_in == 3
    reply = packets.read_command(link.prepare((0.0,) * 6, (), 2).with_counter(b"\0\0\0\1"))
    assert reply.io == bytes((0, 0, 0, 0, 0, 2)) + bytes(250)
    silent = FanucLink(3).prepare((0.0,) * 6, (), 2).with_counter(b"\0\0\0\1")
    assert packets.read_command(silent).io == packets.NO_IO


def test_another_version_is_refused_with_both_named() -> None:
    with pytest.raises(FanucError, match="version 4, configured 3") as caught:
        FanucLink(3).read(Packet(version=4).data(), 0)
    assert caught.value.counter == (7, b"\0\0\0\x07")
    with pytest.raises(FanucError, match="there are 3 and 4"):
        FanucLink(5)
    with pytest.raises(FanucError, match="byte 256 of the inputs"):
        FanucLink(3, signals_byte=256)


def test_a_command_of_another_number_of_axes_is_refused() -> None:
    with pytest.raises(FanucError, match="7 axes, configured 6"):
        FanucLink(3).prepare((0.0,) * 7, (), 0)


def test_setpoints_are_positions_and_the_controller_coasts() -> None:
    rules = FanucLink(3).rules
    assert rules.setpoints is SetpointKind.POSITIONS
    assert rules.coasts
    assert rules.accounted_s == 0.12
