"""A daemon and its emulators, each on real links, given what no one should ever send them.

Whatever comes, it is counted where an operator can see it, each telegram is
still answered, and the robot does not move. The emulator's controller says what was answered, its
judge what was applied; the daemon's own word is only believed for its counters.
"""

import os
import socket
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import pytest
from attacked_station import ON_ITS_WAY, Station, serving
from msgspec import structs

from linemate.protocol.rsi.codec import SensorTelegram
from linemate.protocol.sensors import camera_codec
from linemate.protocol.sensors.slcan import CanFrame, format_frame
from linemate.simulators.devices.rsi_controller import RsiController
from linemate.simulators.harness import scenario_file

ROUNDS = 10
JUNK = (
    b"",
    b"\x00",
    b"\xff" * 500,
    bytes(range(256)),
    b"<!DOCTYPE Rob SYSTEM 'file:///etc/passwd'>",
    b"<Rob Type='KUKA'><IPOC>1</IPOC>",
    b"<Rob>" * 300,
    b"{}" * 700,
    os.urandom(700),
    b"A" * 2048,
    b"B" * 2049,
    b"C" * 4000,
)


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Station]:
    with serving(tmp_path_factory.mktemp("station")) as daemon, Station(daemon) as running:
        yield running


@pytest.fixture
def stranger() -> Iterator[socket.socket]:
    """Somebody else on this host."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as port:
        port.bind(("127.0.0.1", 0))
        port.setblocking(False)
        yield port


def throw(
    station: Station, port: socket.socket, target: Sequence[Any], junk: Sequence[bytes]
) -> int:
    """Send all of it so many times, never faster than the daemon can take it; how many."""
    for _ in range(ROUNDS):
        for data in junk:
            port.sendto(data, tuple(target))
        station.daemon.status()
    return ROUNDS * len(junk)


def heard(port: socket.socket) -> bytes | None:
    try:
        return port.recv(4096)
    except BlockingIOError:
        return None


# What comes to the daemon.


def test_garbage_at_the_robots_port_is_counted_and_every_telegram_answered(
    station: Station, stranger: socket.socket
) -> None:
    target = station.daemon.robot()
    with station.unharmed() as before:
        sent = throw(station, stranger, target, JUNK)
        for junk in JUNK[:9]:  # and from the controller's own address, which is no stranger's
            station.do(station.emulator.link.send_raw, junk)
            station.cycles(1)
        assert heard(stranger) is None
    links = station.shown("links", "robot", "counters")
    old = before.status["links"]["robot"]["counters"]
    fresh = {name: count - old.get(name, 0) for name, count in links.items()}
    # The controller has the port for itself: strangers end in the kernel.
    assert fresh["received"] + fresh["kernel_drops"] >= sent + 9
    assert fresh["kernel_drops"] > sent // 2
    # On a stalled machine some wait until the next telegram is there: they are dropped as late.
    late = fresh.get("stale", 0) + fresh.get("crowded", 0)
    assert late < 9
    assert fresh["unanswered"] >= 9 - late
    assert fresh["received"] == sum(
        fresh.get(name, 0) for name in ("answered", "unanswered", "stale", "oversize", "crowded")
    )
    counts = station.shown("telegrams")
    assert counts["unreadable"] - before.status["telegrams"]["unreadable"] >= 9 - late
    assert counts["new_session"] == before.status["telegrams"]["new_session"]
    assert station.shown("last_refusal")


def test_telegrams_with_a_wrong_counter_are_counted_and_not_answered(station: Station) -> None:
    controller = station.emulator.link.controller
    codec = controller.codec

    def again(ipoc: int) -> None:
        """The open cycle's telegram once more, with another counter."""
        reading = controller._describe(ipoc, controller._read())
        station.emulator.link.send_raw(codec.format_robot(reading))

    def wrong(offset: int) -> None:
        again(controller._session.ipoc + offset)

    with station.unharmed() as before:
        for offset, kind in (
            (0, "duplicate"),
            (-12, "backward"),
            (-1200, "backward"),
            (5, "refused"),
            (1_000_003, "refused"),
            (10**15, "refused"),
        ):
            # Of several that wait at once only the newest is judged: on a busy machine, try again.
            station.until_counted(partial(wrong, offset), "telegrams", kind)
        for counter in (b"-1", b"1e6", b"0x10", b"", b"9" * 400, b"nan"):
            telegram = codec.format_robot(controller._describe(7, controller._read()))
            assert b">7</IPOC>" in telegram
            unreadable = telegram.replace(b">7</", b">" + counter + b"</")
            station.until_counted(
                partial(station.emulator.link.send_raw, unreadable), "telegrams", "unreadable"
            )
        assert controller.counts.wrong_counter == before.counts.wrong_counter
    assert station.shown("telegrams", "new_session") == before.status["telegrams"]["new_session"]


def test_a_second_controllers_flawless_telegrams_are_refused_while_the_first_one_lives(
    station: Station, stranger: socket.socket
) -> None:
    controller = station.emulator.link.controller
    with station.unharmed() as before:
        for ipoc in range(12_000, 12_000 + 20 * 12, 12):
            telegram = codec_telegram(controller, ipoc)
            stranger.sendto(telegram, station.daemon.robot())
            station.cycles(1)
        assert heard(stranger) is None
    counts = station.shown("telegrams")
    links, old = station.shown("links", "robot", "counters"), before.status["links"]["robot"]
    dropped = links["kernel_drops"] - old["counters"].get("kernel_drops", 0)
    assert dropped >= 15
    assert counts["refused"] - before.status["telegrams"]["refused"] + dropped >= 20
    assert counts["new_session"] == before.status["telegrams"]["new_session"]


def codec_telegram(controller: RsiController, ipoc: int) -> bytes:
    """A telegram of a robot that stands elsewhere."""
    reading = controller._describe(ipoc, controller._read())
    return controller.codec.format_robot(structs.replace(reading, joints=(0.1,) * 6))


def test_garbage_at_the_cameras_port_is_counted_and_poses_still_come(
    station: Station, stranger: socket.socket
) -> None:
    good = camera_codec.CameraMessage(
        v=1,
        src="camera",
        seq=10**6,
        t_exp=0,
        t_tx=0,
        frame="camera",
        obj="hub",
        p=(0.0, 0.0, 1.0),
        q=(1.0, 0.0, 0.0, 0.0),
    )
    nan = float("nan")
    broken = [
        msgspec.structs.replace(good, p=(nan, 0.0, 0.0)),
        msgspec.structs.replace(good, p=(0.0, float("inf"), 0.0)),
        msgspec.structs.replace(good, q=(1.0, 1.0, 0.0, 0.0)),
        msgspec.structs.replace(good, q=(nan,) * 4),
        msgspec.structs.replace(good, cov=(-1.0,) * 21),
        msgspec.structs.replace(good, frame="elsewhere"),
        msgspec.structs.replace(good, obj="window"),
    ]
    target = station.daemon.listening["camera"]
    with station.unharmed() as before:
        junk = (*JUNK, *map(camera_codec.encode, broken), camera_codec.encode(good)[:40])
        sent = throw(station, stranger, target, junk)
        for data in junk:  # and from the camera's own address, which is no stranger's
            station.do(station.emulator.camera.send_raw, data)
            station.cycles(1)
        old = before.status["links"]["camera"]["counters"]
        station.status_once(
            lambda s: s["links"]["camera"]["counters"]["samples"] > old["samples"] + 5
        )
    counters = station.shown("links", "camera", "counters")
    fresh = {name: count - old.get(name, 0) for name, count in counters.items()}
    assert fresh["refused"] + fresh["oversize"] + fresh["kernel_drops"] >= sent + len(junk)
    assert fresh["kernel_drops"] > sent // 2
    assert fresh["refused"] > fresh["oversize"] > 0


def test_garbage_at_the_command_ports_is_counted_and_operators_still_answered(
    station: Station, stranger: socket.socket
) -> None:
    target = station.daemon.listening["command"]["udp"]
    forged = [b"LM" + bytes((1, kind)) + os.urandom(60) for kind in range(12)]
    with station.unharmed() as before:
        throw(station, stranger, target, (*JUNK, *forged, b"LM", b"LM" + bytes(1300)))
        with closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) as local:
            local.connect(station.daemon.listening["command"]["socket"])
            for junk in (b"x", b"LM", *forged, os.urandom(1500)):
                local.send(junk)
            station.cycles(5)
    counters, old = station.shown("commands", "counters"), before.status["commands"]["counters"]
    assert counters["kernel_drops"] >= old.get("kernel_drops", 0) + 10 * (len(JUNK) + 1)
    dropped = sum(count for name, count in counters.items() if name.startswith("dropped_"))
    assert dropped >= 10 * len(forged) + len(forged)
    assert counters.get("orders", 0) >= old.get("orders", 0)
    assert station.shown("state") == "idle"


def test_garbage_on_the_can_adapters_line_is_counted_and_frames_still_come(
    station: Station,
) -> None:
    can = station.emulator.can

    def write(data: bytes) -> None:
        can.port.write(data)

    with station.unharmed() as before:
        for junk, kind in (
            *((junk[:64], "garbage") for junk in (b"\xff" * 64, bytes(range(128, 192)))),
            (b"t1838FFFF", "refused"),  # says 8 bytes, has 2
            (b"tXYZ4000000", "garbage"),
            (b"t183", "garbage"),
            (format_frame(CanFrame(0x183, b"\x01\x02")), "refused"),  # too short for the message
            (format_frame(CanFrame(0x7FF, bytes(8))), "other"),
            (format_frame(CanFrame(0x183, remote=True, length=4)), "remote_frames"),
        ):
            station.until_counted(
                partial(write, junk + b"\r"), "links", "distance", "counters", kind
            )
        for junk in (*JUNK, b"\r\r\a\a\r", b"\0" * 3000):
            station.do(write, junk)
            station.cycles(1)
        old = before.status["links"]["distance"]["counters"]
        station.status_once(
            lambda s: s["links"]["distance"]["counters"]["samples"] > old["samples"] + 40
        )
    assert station.shown("links", "distance", "counters", "lost") == old.get("lost", 0)


def test_garbage_on_the_force_torque_line_is_counted_and_wrenches_still_come(
    station: Station,
) -> None:
    with station.unharmed() as before:
        for junk in (*JUNK[:9], b"\xaa" * 200, os.urandom(1000)):
            station.do(station.emulator.force_torque.port.write, junk)
            station.cycles(1)
        old = before.status["links"]["force_torque"]["counters"]
        station.status_once(
            lambda s: s["links"]["force_torque"]["counters"]["samples"] > old["samples"] + 100
        )
    counters = station.shown("links", "force_torque", "counters")
    assert counters["garbage_bytes"] > old.get("garbage_bytes", 0) + 500
    assert counters["resyncs"] > old.get("resyncs", 0)


@pytest.mark.parametrize("name", ["distance", "force_torque"])
def test_a_port_that_is_unplugged_is_reported_and_reopened_when_it_is_back(
    station: Station, name: str
) -> None:
    device = station.emulator.can if name == "distance" else station.emulator.force_torque
    with station.unharmed() as before:
        old = before.status["links"][name]["counters"]
        station.do(device.close)
        down = station.status_once(lambda s: not s["links"][name]["up"])
        assert down["health"] == "degraded"
        assert any(f"link {name} is down" in complaint for complaint in down["complaints"])
        code, shown = station.daemon.status_by_tool()
        assert code == 1
        assert shown["links"][name]["reason"]
        station.do(device.open)
        station.status_once(
            lambda s: (
                s["links"][name]["up"]
                and s["links"][name]["counters"]["samples"] > old["samples"] + 20
            )
        )
    counters = station.shown("links", name, "counters")
    assert counters["lost"] == old.get("lost", 0) + 1
    assert counters["opened"] == old["opened"] + 1
    station.status_once(lambda s: not any(name in complaint for complaint in s["complaints"]))


# What comes to the emulators.


def test_wrong_replies_are_counted_by_the_controller_and_move_nothing(
    station: Station, stranger: socket.socket
) -> None:
    link = station.emulator.link
    assert link.address is not None
    sample = station.do(
        lambda: link.controller.codec.format_sensor(
            SensorTelegram(1, joints=(0.5,) * 6, external=(1.0,), channels={"DiO": 3})
        )
    )
    assert b"<IPOC>1<" in sample
    foreign = sample.replace(b"ImFree", b"Somebody")
    with station.unharmed():
        old = station.do(lambda: dict(link.controller.refusals))
        for data in (*JUNK, sample, foreign, sample[:-9]):
            stranger.sendto(data, link.address)
            station.cycles(1)
        station.until(
            lambda: link.controller.refusals["malformed"] >= old.get("malformed", 0) + len(JUNK)
        )
    refusals = link.controller.refusals
    assert refusals["wrong_counter"] == old.get("wrong_counter", 0) + 1
    assert refusals["sentype"] == old.get("sentype", 0) + 1
    # The telegrams' Delay has reported it to the daemon, which goes on.
    assert station.shown("state") == "idle"


def test_a_host_that_writes_nonsense_to_the_devices_is_refused_and_served_on(
    station: Station,
) -> None:
    can, force_torque = station.emulator.can, station.emulator.force_torque
    with station.unharmed() as before:
        refused = can.adapter.refused
        for device, junk in (
            (can, b"Q9\rS9\rtzz\r\xff\xfe\r" + b"t" * 500 + b"\r"),
            (force_torque, bytes(200) + b"c,1,2\rm9\r,,,\r\xff"),
        ):
            port = os.open(device.port.path, os.O_WRONLY | os.O_NOCTTY)
            try:
                os.write(port, junk)
            finally:
                os.close(port)
        station.until(lambda: can.adapter.refused >= refused + 3)
        station.status_once(
            lambda s: all(
                s["links"][name]["counters"]["samples"]
                > before.status["links"][name]["counters"]["samples"] + 100
                for name in ("distance", "force_torque")
            )
        )


# While it moves.


def test_what_comes_while_the_robot_moves_never_makes_it_move_beyond_its_limits(
    tmp_path: Path, stranger: socket.socket
) -> None:
    wheel = replace(scenario_file.load("wheel"), lead_in_s=5.0)
    with serving(tmp_path) as daemon, Station(daemon, wheel) as station:
        counts = station.set_going()
        if station.travelled() < ON_ITS_WAY:
            pytest.skip(f"the machine is too busy for the robot to get on its way: {counts}")
        listening = daemon.listening
        for junk in JUNK:
            for target in (listening["robot"], listening["camera"], listening["command"]["udp"]):
                stranger.sendto(junk, tuple(target))
            station.do(station.emulator.can.port.write, junk)
            station.do(station.emulator.force_torque.port.write, junk)
            station.cycles(2)
        devices = (station.emulator.can, station.emulator.force_torque)
        for device in devices:
            station.do(device.close)
        station.status_once(lambda s: s["state"] not in {"armed", "track", "contact"})
        for device in devices:
            station.do(device.open)
        station.cycles(20)
        status = daemon.status()
        judge = station.emulator.link.controller.judge
        assert status["faults"] == 0
        assert judge.violations == 0, judge.evidence
        assert station.emulator.world.collision is None
        assert station.emulator.link.controller.broken is None
