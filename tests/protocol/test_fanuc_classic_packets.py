"""Packets of the older Stream Motion: sizes, fields, refusals."""

import struct
from collections.abc import Callable

import pytest

from linemate.protocol.fanuc import classic_packets as classic
from linemate.protocol.fanuc.classic_packets import ClassicKind, LimitKind, LimitRequest
from linemate.protocol.fanuc.packets import CommandPacket, FanucError, StatusPacket

JOINTS = (10.0, -20.5, 30.25, 0.0, -45.0, 90.0, 1250.0, 0.0, 0.0)


def test_a_status_has_its_documented_size_and_places() -> None:
    status = StatusPacket(2, 0x01020304, 0x0D, 0, JOINTS, (1.0,) * 9, (0.5,) * 9, 77)
    data = classic.write_status(status)
    assert len(data) == 132
    assert data[:13] == struct.pack(">IIIB", 0, 2, 0x01020304, 0x0D)
    assert struct.unpack_from(">I", data, 20) == (77,)
    assert struct.unpack_from(">9f", data, 60) == JOINTS
    assert classic.read_status(data) == status


@pytest.mark.parametrize(("version", "kind", "size"), [(1, 1, 64), (2, 5, 104)])
def test_a_command_has_the_size_of_its_version(version: int, kind: int, size: int) -> None:
    command = CommandPacket(version, 0x0A0B0C0D, JOINTS, is_last=True)
    data = classic.write_command(command)
    assert len(data) == size
    assert data[:13] == struct.pack(">IIIB", kind, version, 0x0A0B0C0D, 1)
    assert data[18] == 1  # joints, not a pose
    assert classic.read_command(data) == command
    pose = data[:18] + b"\0" + data[19:]
    assert classic.read_command(pose).style == 0


def test_a_pose_is_never_written() -> None:
    with pytest.raises(FanucError, match="data style"):
        classic.write_command(CommandPacket(2, 1, JOINTS, style=0))


def test_a_joint_that_is_not_finite_is_neither_written_nor_read() -> None:
    joints = (float("nan"), *JOINTS[1:])
    with pytest.raises(FanucError, match="not finite"):
        classic.write_command(CommandPacket(2, 1, joints))
    data = classic.write_status(StatusPacket(2, 9, 1, 0, joints))
    with pytest.raises(FanucError, match="not finite") as caught:
        classic.read_status(data)
    assert caught.value.sequence == 9


@pytest.mark.parametrize("cut", [0, 3, 8, 63, 65, 103])
def test_a_command_of_another_length_is_refused(cut: int) -> None:
    data = (classic.write_command(CommandPacket(1, 1, JOINTS)) + bytes(60))[:cut]
    with pytest.raises(FanucError):
        classic.read_command(data)


def test_a_request_for_limits_is_answered_with_two_tables() -> None:
    data = struct.pack(">IIII", 3, 2, 4, 2)
    request = classic.read_limit_request(data)
    assert request == LimitRequest(2, 4, LimitKind.JERK)
    table = classic.write_limits(request, 2000, 8, range(20))
    assert len(table) == 184
    assert struct.unpack_from(">IIIIII", table) == (3, 2, 4, 2, 2000, 8)
    assert struct.unpack_from(">20f20f", table, 24) == (*map(float, range(20)),) * 2
    for bad in (data[:-1], struct.pack(">IIII", 3, 2, 0, 2), struct.pack(">IIII", 3, 2, 4, 3)):
        with pytest.raises(FanucError):
            classic.read_limit_request(bad)


def test_short_packets_and_the_commanded_position_are_written_as_documented() -> None:
    data = classic.write_short(ClassicKind.VERSION, 2)
    assert (data, classic.read_short(data)) == (struct.pack(">II", 6, 2), (6, 2))
    with pytest.raises(FanucError):
        classic.read_short(data + b"\0")
    answer = classic.write_position(StatusPacket(2, 9, 1, 0, JOINTS, (1.0,) * 9, time_ms=77))
    assert answer == struct.pack(">III9f9f", 4, 2, 77, *(1.0,) * 9, *JOINTS)


@pytest.mark.parametrize(
    "write",
    [
        lambda: classic.write_status(StatusPacket(2, -1, 1, 0, JOINTS)),
        lambda: classic.write_position(StatusPacket(2, 1, 1, 0, (1e300,) * 9)),
        lambda: classic.write_command(CommandPacket(1, 1, (1e300,) * 9)),
        lambda: classic.write_limits(LimitRequest(2, 1, LimitKind.SPEED), -1, 8, [0.0] * 20),
    ],
    ids=["status", "position", "command", "limits"],
)
def test_a_value_that_the_wire_cannot_carry_is_refused(write: Callable[[], bytes]) -> None:
    with pytest.raises(FanucError):
        write()


@pytest.mark.parametrize("size", [0, 131, 132])
def test_what_is_no_status_is_refused(size: int) -> None:
    with pytest.raises(FanucError):
        classic.read_status(b"\xff" * size)
