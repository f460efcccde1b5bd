"""Links that cannot be opened, and gates that wait for a signal."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from linemate.daemon.config import task_file
from linemate.daemon.config.documents import spelled
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.section_checks import PlainValues, complaints, waiting_gates

WHEEL = task_file.load(DAEMON_DATA / "wheel.yaml").file


def test_the_shipped_task_waits_for_both_signals() -> None:
    assert list(waiting_gates(WHEEL)) == [
        ("waypoints[5] waits for screws_fixed", "tool.fixed_after"),
        ("waypoints[7] waits for wheel_released", "tool.released_after"),
    ]


def test_a_time_stands_for_a_signal() -> None:
    tool = replace(WHEEL.tool, fixed_after=1.0, released_after=0.5)
    assert list(waiting_gates(replace(WHEEL, tool=tool))) == []


def refused(can: dict[str, Any], **sections: Any) -> list[str]:
    values = PlainValues({"distance": {"can": can}, **sections})
    return [f"{spelled(c.path)}: {c.what}" for c in complaints(values, Path(), ("rsi", None))]


def test_a_bus_has_an_interface_of_python_can_and_the_channel_that_it_needs() -> None:
    assert refused({"interface": "slcan", "channel": "/dev/ttyACM0"}) == []
    assert refused({"interface": "kvaser"}) == []
    (line,) = refused({"interface": "slcna", "channel": "/dev/ttyACM0"})
    assert line == "distance.can: python-can has no interface 'slcna'; near are slcan, iscan"
    for channel in ({}, {"channel": ""}):
        (line,) = refused({"interface": "socketcan", **channel})
        assert line == "distance.can: socketcan needs a channel, such as can0"


@pytest.mark.parametrize("name", ["tty", "link", "tty@115200"])
def test_two_sensors_do_not_share_a_serial_device(name: str, tmp_path: Path) -> None:
    (tmp_path / "tty").touch()
    (tmp_path / "link").symlink_to("tty")
    can = {"interface": "slcan", "channel": str(tmp_path / name)}
    (line,) = refused(can, force_torque={"url": str(tmp_path / "tty")})
    assert line.startswith(f"force_torque.url: {tmp_path / 'tty'} is distance.can.channel's")
    assert refused(can, force_torque={"url": "/dev/ttyUSB0"}) == []


@pytest.mark.parametrize("bitrate", [500, "500k", 2_000_000])
def test_a_bitrate_of_can_is_in_bit_s(bitrate: Any) -> None:
    (line,) = refused({"interface": "kvaser", "bitrate": bitrate})
    assert line == f"distance.can: bitrate should be 10000 to 1000000 bit/s, not {bitrate!r}"
    assert refused({"interface": "kvaser", "bitrate": 500_000}) == []


def test_a_force_torque_sensor_is_a_device_or_a_serial_server() -> None:
    bus = {"interface": "kvaser"}
    for url in ("ttyUSB0", "COM3", "socket://host", "socket://host:99999", "tcp://host:5000"):
        (line,) = refused(bus, force_torque={"url": url})
        assert line.startswith(f"force_torque.url: {url!r} is not the path of a device")
    for url in ("/dev/ttyUSB0", "virtual", "socket://host:5000", "socket://[::1]:5000"):
        assert refused(bus, force_torque={"url": url}) == []


@pytest.mark.parametrize("section", ["rsi", "egm", "fanuc", "camera"])
def test_a_peer_can_send_to_the_address_that_is_listened_on(section: str) -> None:
    def lines(peer: str, **bind: str) -> list[str]:
        values = PlainValues({section: {"peer": peer, **bind}})
        return [f"{spelled(c.path)}: {c.what}" for c in complaints(values, Path(), ("x", None))]

    (line,) = lines("10.0.0.1")  # the address by default is the loopback
    assert line.startswith(f"{section}.bind: 10.0.0.1 cannot send to 127.0.0.1")
    assert lines("fe80::1", bind="10.0.0.2")
    assert lines("10.0.0.1", bind="10.0.0.2") == lines("10.0.0.1", bind="0.0.0.0") == []
    assert lines("127.0.0.1") == []
    for none in ("224.0.0.1", "0.0.0.0", "255.255.255.255", "ff02::1"):
        bind = "::" if ":" in none else "0.0.0.0"
        (line,) = lines(none, bind=bind)
        assert line.startswith(f"{section}.peer: {none} is the address of no single host")


def test_a_command_socket_takes_the_place_of_no_other_file(tmp_path: Path) -> None:
    (tmp_path / "task.yaml").touch()
    for name in ("task.yaml", "."):
        values = PlainValues({"command": {"socket": name}})
        (complaint,) = complaints(values, tmp_path, ("x", None))
        assert complaint.what.startswith("exists and is not a socket")
