"""The process itself is stopped, and flooded, while a robot asks it: in real time, on the loopback.

Judged by the robot alone, against what the same run missed while nothing was done to it.
"""

import math
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import floods
import pytest
from daemon_process import DaemonProcess
from plain_robot import CYCLE_S, PlainRobot

TEXT = """
task: wheel.yaml
rsi: {port: 0}
distance: {can: {interface: slcan, channel: FOLDER/can}}
camera: {port: 0}
force_torque: {url: FOLDER/ft}
command: {socket: c.sock, udp: {port: 0, keys: keys}}
"""


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[DaemonProcess]:
    from linemate.protocol.command.frame_codec import Role
    from linemate.protocol.command.preshared_keys import key_line, make_key

    keys = tmp_path / "keys"
    key = make_key("operator", Role.OPERATE, os.urandom(32))
    keys.write_text(key_line(key) + "\n", encoding="utf-8")
    keys.chmod(0o400)
    with DaemonProcess(tmp_path, TEXT.replace("FOLDER", str(tmp_path))) as process:
        yield process


def missed(took: list[float | None]) -> int:
    return took.count(None)


@pytest.mark.parametrize("stopped_s", [0.05, 0.2])
def test_a_stopped_process_misses_what_passed_and_answers_the_newest_at_once(
    daemon: DaemonProcess, stopped_s: float
) -> None:
    robot = PlainRobot(daemon.robot())
    robot.cycles(100)
    baseline = missed(robot.cycles(200))
    pid = daemon.process.pid
    resumed: list[float] = []

    def resume() -> None:
        os.kill(pid, signal.SIGCONT)
        resumed.append(time.monotonic())

    begun: list[float] = []
    first: list[int] = []

    def at(k: int) -> None:
        if k == 20:
            begun.append(time.monotonic())
            os.kill(pid, signal.SIGSTOP)
            threading.Timer(stopped_s, resume).start()
        if resumed and not first:
            first.append(k)

    took = robot.cycles(100, at)
    robot.close()
    # What this machine misses anyway is granted.
    assert missed(took) <= math.ceil((resumed[0] - begun[0]) / CYCLE_S) + 2 + baseline
    back = next(k for k in range(21, 100) if took[k] is not None and resumed and k >= first[0])
    assert back - first[0] <= 2 + baseline
    assert daemon.process.poll() is None


def test_a_killed_process_leaves_no_port_taken(daemon: DaemonProcess) -> None:
    robot = PlainRobot(daemon.robot())
    assert missed(robot.cycles(50)) < 50
    daemon.process.kill()
    daemon.process.wait(10.0)
    assert missed(robot.cycles(5)) == 5
    robot.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(daemon.robot())


@pytest.mark.parametrize("port", ["command", "camera", "robot"])
def test_a_flood_on_a_port_costs_hardly_a_telegram(daemon: DaemonProcess, port: str) -> None:
    # Two cores for the flood, the robot, the daemon and everybody else: `make floods` has the bar.
    # A busy machine gets a second try; a daemon that a flood locks out fails both.
    outcome = floods.run(daemon, port, floods.SHORT, tries=2)
    assert outcome.missed <= outcome.baseline + 0.2 * outcome.cycles
    assert outcome.sent > 1000
    assert outcome.samples >= 0.9 * outcome.poses
    assert outcome.answered_s is not None
    assert daemon.process.poll() is None
