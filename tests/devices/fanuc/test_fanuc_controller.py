"""The strict FANUC controller: who gets packets, what raises an alarm, what silence does."""

import math
import struct
from dataclasses import replace
from typing import Any, Literal

import pytest

from linemate.protocol.exchange_controller import Judgement
from linemate.protocol.fanuc import classic_packets as classic
from linemate.protocol.fanuc import packets
from linemate.protocol.fanuc.classic_packets import ClassicKind
from linemate.protocol.fanuc.packets import CapabilityPacket, CommandPacket, PacketKind
from linemate.simulators.devices.fanuc.fanuc_controller import FanucConfig, FanucController
from linemate.simulators.devices.rsi_controller import RobotReading, Seven

START: Seven = (0.1, -1.4, 1.6, 0.0, 1.3, 0.2, 0.5)
CONFIG = FanucConfig()


class Robot:
    """A client of a controller whose robot is where it was sent."""

    def __init__(self, config: FanucConfig = CONFIG) -> None:
        self.controller = FanucController(self._read, START, config)
        self.version = config.version

    def _read(self) -> RobotReading:
        return RobotReading(self.controller.setpoints, (0.0,) * 6, digital_in=3)

    def start(self) -> "Robot":
        self.controller.on_reply(packets.write_short(PacketKind.START, self.version))
        return self

    def status(self) -> packets.StatusPacket:
        data = self.controller.telegram()
        assert data is not None
        return packets.read_status(data)

    def cycle(self, offset_deg: float = 0.0, **changes: Any) -> Judgement:
        """Command where it is, J1 off by something; the cycle stays open."""
        status = self.status()
        return self.reply(status, offset_deg, **changes)

    def reply(self, status: packets.StatusPacket, offset_deg: float, **changes: Any) -> Judgement:
        joints = (status.joints[0] + offset_deg, *status.joints[1:])
        command = CommandPacket(self.version, status.sequence, joints)
        data = packets.write_command(replace_struct(command, changes))
        return self.controller.on_reply(patched(data, changes))

    def end(self) -> Seven:
        return self.controller.end_of_cycle().setpoints


def replace_struct(command: CommandPacket, changes: dict[str, Any]) -> CommandPacket:
    known = {name: value for name, value in changes.items() if name != "patch"}
    return CommandPacket(
        **{name: known.get(name, getattr(command, name)) for name in command.__struct_fields__}
    )


def patched(data: bytes, changes: dict[str, Any]) -> bytes:
    """Overwrite bytes that the codec would refuse to write."""
    for place, piece in changes.get("patch", {}).items():
        data = data[:place] + piece + data[place + len(piece) :]
    return data


def test_only_a_client_that_asks_gets_packets() -> None:
    robot = Robot()
    assert robot.controller.telegram() is None
    robot.controller.on_reply(packets.write_capability(CapabilityPacket(3)))
    (answer,) = robot.controller.take_answers()
    assert packets.read_capability(answer) == CapabilityPacket(3, 8, 1, 3)
    robot.start()
    status = robot.status()
    assert (status.sequence, status.motion_bits, status.fault_bits) == (1, 1, 0)
    assert status.joints[:7] == pytest.approx([*map(math.degrees, START[:6]), 500.0])
    assert status.io[0] == 3
    robot.controller.on_reply(packets.write_short(PacketKind.STOP, 3))
    assert robot.controller.telegram() is None


def test_a_good_command_moves_the_setpoint() -> None:
    robot = Robot().start()
    assert robot.cycle(0.01) is Judgement.ACCEPTED
    assert robot.end()[0] == pytest.approx(START[0] + math.radians(0.01), abs=3e-7)
    assert robot.controller.counts.answered == 1


def test_a_coupled_elbow_counts_from_the_horizontal() -> None:
    robot = Robot(replace(CONFIG, is_coupled=True)).start()
    assert robot.status().joints[2] == pytest.approx(math.degrees(START[2] - START[1]))
    assert robot.cycle() is Judgement.ACCEPTED
    assert robot.end() == pytest.approx(START, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"patch": {14: b"\0\0"}}, "style"),
        ({"moves": False}, "no_motion"),
        ({"version": 4}, "version"),
        ({"sequence": 900}, "sequence"),
        ({"patch": {16: b"\x7f\xf8\0\0\0\0\0\0"}}, "not_finite"),
        ({"patch": {16 + 8 * 7: b"\x3f\xf0\0\0\0\0\0\0"}}, "axis"),
        ({"offset_deg": 1.0}, "limit"),
    ],
)
def test_a_wrong_command_raises_an_alarm_and_stops(changes: dict[str, Any], reason: str) -> None:
    robot = Robot().start()
    assert robot.cycle(**changes) is Judgement.REFUSED
    assert robot.end() == pytest.approx(START)
    assert robot.controller.refusals[reason] == 1
    assert robot.controller.broken is not None
    assert f"alarm {reason}" in robot.controller.broken
    status = robot.status()
    assert (status.motion_bits, status.fault_bits) == (0, 1)
    assert robot.reply(status, 0.0) is Judgement.REFUSED
    robot.controller.reset()
    assert robot.status().motion_bits == 1


def test_a_second_command_in_a_cycle_raises_an_alarm() -> None:
    robot = Robot().start()
    status = robot.status()
    assert robot.reply(status, 0.0) is Judgement.ACCEPTED
    assert robot.reply(status, 0.0) is Judgement.REFUSED
    assert robot.controller.refusals["double"] == 1


def test_the_command_of_an_earlier_cycle_is_late_and_not_applied() -> None:
    robot = Robot().start()
    status = robot.status()
    robot.end()
    robot.status()
    assert robot.reply(status, 0.01) is Judgement.LATE
    assert robot.end() == pytest.approx(START)
    assert robot.controller.counts.late == 1


def test_silence_coasts_for_a_while_and_then_stops_with_an_alarm() -> None:
    robot = Robot().start()
    for step in (0.005, 0.01, 0.015):
        robot.cycle(step)
        robot.end()
    before = robot.controller.setpoints[0]
    way = math.radians(0.015)
    for cycle in range(1, 16):
        robot.status()
        assert robot.end()[0] == pytest.approx(before + cycle * way, abs=5e-6)
        assert robot.controller.alarm is None
    robot.status()
    robot.end()
    assert robot.controller.alarm == "alarm silence: no command for 0.12 s"


def test_a_client_that_starts_again_does_not_prolong_the_silence() -> None:
    """The axes went on at their speed for 0.7 s, into the object, as no command followed."""
    robot = Robot().start()
    for _ in range(3):
        robot.cycle(0.001)
        robot.end()
    for k in range(16):
        if k == 9:  # both in one cycle
            robot.controller.on_reply(packets.write_short(PacketKind.STOP, robot.version))
            robot.start()
        robot.controller.telegram()
        robot.end()
    assert robot.controller.alarm == "alarm silence: no command for 0.12 s"
    resting = [robot.end() for _ in range(3)]
    assert resting[2] == resting[1]


def test_silence_before_the_first_command_raises_no_alarm() -> None:
    robot = Robot().start()
    for _ in range(100):
        robot.status()
        assert robot.end() == START
    assert robot.controller.alarm is None


@pytest.mark.parametrize(
    ("change", "bits"),
    [
        ({"is_emergency_stop": True}, (0, 4)),
        ({"is_pendant_enabled": True}, (0, 2)),
        ({"is_program_running": False}, (0, 0)),
    ],
)
def test_a_controller_that_is_not_ready_takes_no_command(
    change: dict[str, bool], bits: tuple[int, int]
) -> None:
    robot = Robot().start()
    for name, value in change.items():
        setattr(robot.controller, name, value)
    status = robot.status()
    assert (status.motion_bits, status.fault_bits) == bits
    assert robot.reply(status, 0.01) is Judgement.REFUSED
    assert robot.end() == START
    assert robot.controller.alarm is None


def test_a_stop_without_a_last_command_is_unclean() -> None:
    robot = Robot().start()
    robot.cycle()
    robot.end()
    robot.controller.on_reply(packets.write_short(PacketKind.STOP, 3))
    assert robot.controller.refusals["unclean_stop"] == 1
    robot = Robot().start()
    robot.cycle(is_last=True)
    robot.controller.on_reply(packets.write_short(PacketKind.STOP, 3))
    assert not robot.controller.refusals
    robot = Robot().start()
    robot.cycle(is_last=True)
    robot.end()
    assert not robot.controller.takes_commands
    robot.controller.on_reply(packets.write_short(PacketKind.STOP, 3))
    assert not robot.controller.refusals


def test_a_start_of_another_version_raises_an_alarm() -> None:
    robot = Robot()
    robot.controller.on_reply(packets.write_short(PacketKind.START, 4))
    assert robot.controller.broken == "alarm version: START of version 4, not 3"
    assert robot.controller.telegram() is None


@pytest.mark.parametrize("data", [b"", b"<Rob/>", b"\0\0\0\xc9", b"\0\0\0\x63" + bytes(8)])
def test_what_is_no_packet_is_refused(data: bytes) -> None:
    robot = Robot().start()
    assert robot.controller.on_reply(data) is Judgement.REFUSED
    assert robot.controller.refusals["malformed"] == 1


@pytest.mark.parametrize("version", [1, 2])
def test_the_older_generation_starts_answers_and_stops(version: Literal[1, 2]) -> None:
    robot = Robot(replace(CONFIG, version=version))
    controller = robot.controller
    for kind in (ClassicKind.START, ClassicKind.VERSION, ClassicKind.POSITION):
        assert controller.on_reply(classic.write_short(kind, 3)) is Judgement.MISSING
    controller.on_reply(struct.pack(">IIII", ClassicKind.LIMITS, 3, 1, 2))
    version_answer, position, limits = controller.take_answers()
    assert classic.read_short(version_answer) == (ClassicKind.VERSION, version)
    assert struct.unpack_from(">f", position, 12 + 36)[0] == pytest.approx(math.degrees(START[0]))
    jerk = math.degrees(CONFIG.limits[0].jerk)
    assert struct.unpack_from(">20f", limits, 24) == pytest.approx((jerk,) * 20)
    data = controller.telegram()
    assert data is not None
    status = classic.read_status(data)
    assert status.motion_bits == 0x05
    command = CommandPacket(version, status.sequence, status.joints, is_last=True)
    assert controller.on_reply(classic.write_command(command)) is Judgement.ACCEPTED
    controller.on_reply(classic.write_short(ClassicKind.STOP, version))
    assert controller.telegram() is None
    assert not controller.refusals
    assert controller.on_reply(struct.pack(">II", 9, version)) is Judgement.REFUSED


def test_a_client_that_counts_by_itself_needs_only_growing_numbers() -> None:
    robot = Robot(replace(CONFIG, is_echoed=False)).start()
    for number, offset in ((500, 0.001), (501, 0.002), (700, 0.003)):
        assert robot.cycle(offset, sequence=number) is Judgement.ACCEPTED
        robot.end()
    assert robot.cycle(0.0, sequence=700) is Judgement.REFUSED
    assert robot.controller.refusals["double"] == 1
