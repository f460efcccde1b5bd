"""Packets of Stream Motion: sizes, fields, refusals."""

import struct
from collections.abc import Callable

import pytest

from linemate.protocol.controller_link import ControllerError
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.packets import (
    CapabilityPacket,
    CommandPacket,
    FanucError,
    PacketKind,
    StatusPacket,
)

JOINTS = (10.0, -20.5, 30.25, 0.0, -45.0, 90.0, 1250.0, 0.0, 0.0)


def status(version: int, **changes: object) -> StatusPacket:
    values: dict[str, object] = {
        "version": version,
        "sequence": 0x01020304,
        "motion_bits": 0x09,
        "fault_bits": 0x04,
        "joints": JOINTS,
        "pose": (1.0,) * 9,
        "current": (0.5,) * 9,
        "time_ms": 77,
        "contact_stop": 1,
        "safety_scale": 0.5,
        "wrench": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0) if version == 4 else None,
        "force_sensor": 2 if version == 4 else None,
        "io": bytes(range(256)),
    }
    return StatusPacket(**(values | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(("version", "kind", "size"), [(3, 202, 388), (4, 204, 416)])
def test_a_status_packet_has_its_documented_type_and_size(
    version: int, kind: int, size: int
) -> None:
    data = packets.write_status(status(version))
    assert (len(data), packets.kind_of(data)) == (size, kind)
    assert data[4:12] == struct.pack(">II", version, 0x01020304)
    assert data[12:16] == bytes((0x09, 0x04, 1, 0))
    assert struct.unpack_from(">9f", data, 56) == JOINTS
    assert data[-256:] == bytes(range(256))
    assert packets.read_status(data) == status(version)


def test_a_command_echoes_the_number_and_commands_joints() -> None:
    command = CommandPacket(3, 0x0A0B0C0D, JOINTS, is_last=True)
    data = packets.write_command(command)
    assert len(data) == 344
    assert data[:16] == struct.pack(">IIIBBH", 201, 3, 0x0A0B0C0D, 1, 1, 0xFFFF)
    assert struct.unpack_from(">9d", data, 16) == JOINTS
    assert packets.read_command(data) == command


@pytest.mark.parametrize("style", [0, 1, 0xFFFE])
def test_a_command_of_a_pose_is_never_written(style: int) -> None:
    with pytest.raises(FanucError, match="data style"):
        packets.write_command(CommandPacket(3, 1, JOINTS, style=style))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_joint_that_is_not_finite_is_neither_written_nor_read(bad: float) -> None:
    joints = (bad, *JOINTS[1:])
    with pytest.raises(FanucError, match="not finite"):
        packets.write_command(CommandPacket(3, 1, joints))
    data = packets.write_status(status(3, joints=joints))
    with pytest.raises(FanucError, match="not finite") as caught:
        packets.read_status(data)
    assert caught.value.counter == (0x01020304, b"\x01\x02\x03\x04")


@pytest.mark.parametrize("cut", [0, 3, 8, 387, 389])
def test_a_status_packet_of_another_length_is_refused(cut: int) -> None:
    data = (packets.write_status(status(3)) + b"\0")[:cut]
    with pytest.raises(FanucError):
        packets.read_status(data)


def test_a_version_that_does_not_fit_the_type_is_refused() -> None:
    data = bytearray(packets.write_status(status(3)))
    data[7] = 4
    with pytest.raises(FanucError, match="version 4 in a packet of type 202"):
        packets.read_status(bytes(data))


def test_capability_start_and_stop_are_read_as_written() -> None:
    packet = CapabilityPacket(3, 8, 1, 3)
    data = packets.write_capability(packet)
    assert (len(data), packets.read_capability(data)) == (28, packet)
    for kind in (PacketKind.START, PacketKind.STOP):
        short = packets.write_short(kind, 4)
        assert (short, packets.read_short(short, kind)) == (struct.pack(">II", kind, 4), 4)
    with pytest.raises(FanucError, match="not 200"):
        packets.read_short(packets.write_short(PacketKind.STOP, 3), PacketKind.START)


@pytest.mark.parametrize(
    "write",
    [
        lambda: packets.write_capability(CapabilityPacket(-1)),
        lambda: packets.write_status(status(5)),
        lambda: packets.write_status(status(3, sequence=2**32)),
        lambda: packets.write_status(status(3, joints=(1e300,) * 9)),
        lambda: packets.write_command(CommandPacket(3, -1, JOINTS)),
    ],
    ids=["capability", "version", "sequence", "joint", "command"],
)
def test_a_value_that_the_wire_cannot_carry_is_refused(write: Callable[[], bytes]) -> None:
    with pytest.raises(FanucError):
        write()


@pytest.mark.parametrize(
    "read",
    [
        packets.read_capability,
        packets.read_command,
        packets.read_status,
        lambda data: packets.read_short(data, PacketKind.START),
    ],
    ids=["capability", "command", "status", "short"],
)
@pytest.mark.parametrize("size", [0, 8, 28, 344, 388, 416])
def test_a_packet_of_another_kind_is_refused(read: Callable[[bytes], object], size: int) -> None:
    with pytest.raises(FanucError):
        read(b"\xff" * size)


def test_an_error_without_a_number_answers_nothing() -> None:
    assert FanucError("nothing").counter is None
    assert ControllerError("nothing").counter is None
