"""Floods from the loopback: ``python tests/floods.py [--rate 20000] [--seconds 5]``.

Bounded in rate and time, to ports of the daemon that it started itself. A robot
asks in between and judges; what it misses while no one floods is the baseline of the same run. A
camera sends good poses all the time; those that did not become samples are counted.
"""

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from daemon_process import DaemonProcess
from plain_robot import CYCLE_S, PlainRobot

from linemate.simulators.devices.sensing.camera_sender import CameraSender

MOST_RATE, MOST_SECONDS = 60_000, 10.0
BATCH_S = 0.002
POSE_S = 0.025
JUNK = (
    os.urandom(54),
    b"LM\x01\x01" + os.urandom(50),
    b"LM\x01\x03" + os.urandom(200),
    b"<Rob Type='KUKA'><IPOC>1</IPOC>",
    b"<!DOCTYPE Rob>" + b"A" * 500,
    b"\x86" + os.urandom(300),
    b"",
    os.urandom(1400),
)


@dataclass(frozen=True)
class Flood:
    """How hard and how long."""

    rate_hz: float = 20_000.0
    seconds: float = 5.0


SHORT = Flood(5_000.0, 1.5)


@dataclass(frozen=True)
class FloodOutcome:
    """What a robot missed.

    Attributes:
        sent: datagrams of the flood.
        cycles: of the robot, with and without.
        baseline, missed: replies that did not come in their cycle.
        answered_s: how long a genuine status took in between, None if none came.
        poses, samples: good poses sent during the flood, and what the daemon took of them.
    """

    sent: int
    cycles: int
    baseline: int
    missed: int
    answered_s: float | None
    poses: int
    samples: int


class Poses:
    """A camera at 40 Hz, in a thread of its own."""

    def __init__(self, target: tuple[str, int]) -> None:
        self.sent = 0
        self._target = target
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._send)

    def __enter__(self) -> "Poses":
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._over.set()
        self._thread.join()

    def _send(self) -> None:
        sender = CameraSender()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            while not self._over.wait(POSE_S):
                now_ns = time.monotonic_ns()
                link.sendto(
                    sender.datagram(
                        (0.0, 0.0, 1.0),
                        (1.0, 0.0, 0.0, 0.0),
                        None,
                        exposure_ns=now_ns - 50_000_000,
                        sent_ns=now_ns,
                    ),
                    self._target,
                )
                self.sent += 1


def _samples(daemon: DaemonProcess) -> int:
    return int(daemon.status()["links"]["camera"]["counters"].get("samples", 0))


def run(daemon: DaemonProcess, port: str, flood: Flood, *, tries: int = 1) -> FloodOutcome:
    """Flood one port of a daemon; ``port`` is robot, camera or command.

    Args:
        tries: made until a fifth of the cycles or less is missed. One camera sends in all of them:
            for 5 s the daemon takes poses of no other sender.
    """
    listening = daemon.listening
    host, number = listening["command"]["udp"] if port == "command" else listening[port]
    camera = listening["camera"]
    with Poses((camera[0], camera[1])) as poses:
        while True:
            outcome = _flooded(daemon, f"{host}:{number}", flood, poses)
            tries -= 1
            if tries <= 0 or outcome.missed <= outcome.baseline + 0.2 * outcome.cycles:
                return outcome


def _flooded(daemon: DaemonProcess, target: str, flood: Flood, poses: Poses) -> FloodOutcome:
    robot = PlainRobot(daemon.robot())
    cycles = round(flood.seconds / CYCLE_S)
    robot.cycles(80)
    baseline = robot.cycles(cycles).count(None)
    asked: list[float | None] = []
    asking = threading.Thread(target=_ask, args=(daemon, asked))
    # A process of its own: the robot's clock must not wait for the flood's interpreter.
    command = [sys.executable, __file__, "--pour", target]
    command += ["--rate", str(flood.rate_hz), "--seconds", str(flood.seconds)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as pouring:
        assert pouring.stdout is not None
        pouring.stdout.readline()
        sent_before, taken_before = poses.sent, _samples(daemon)
        asking.start()
        missed = robot.cycles(cycles).count(None)
        asking.join()
        sent = int(pouring.stdout.readline())
        good, taken = poses.sent - sent_before, _samples(daemon) - taken_before
    robot.close()
    return FloodOutcome(sent, cycles, baseline, missed, asked[0], good, taken)


def _pour(target: tuple[str, int], flood: Flood) -> int:
    """Send junk; how much was sent."""
    sent = 0
    begun = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.setblocking(False)
        while (passed := time.monotonic() - begun) < flood.seconds:
            owed = round(passed * flood.rate_hz) - sent
            for n in range(min(owed, round(flood.rate_hz * 0.05))):
                try:
                    link.sendto(JUNK[n % len(JUNK)], target)
                except OSError:
                    break
            sent += owed
            time.sleep(BATCH_S)
    return sent


def _ask(daemon: DaemonProcess, took: list[float | None]) -> None:
    begun = time.monotonic()
    try:
        daemon.status()
    except Exception:  # noqa: BLE001 - that there is no answer is the finding
        took.append(None)
    else:
        took.append(time.monotonic() - begun)


def main() -> int:
    """Flood every port in turn; 1 if more was missed than is borne."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=20_000.0, help="datagrams a second")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--pour", metavar="HOST:PORT", help="only send, to a loopback address")
    args = parser.parse_args()
    flood = Flood(min(args.rate, MOST_RATE), min(args.seconds, MOST_SECONDS))
    if args.pour:
        host, _, port = args.pour.rpartition(":")
        if not host.startswith("127."):
            parser.error("floods stay on the loopback")
        print("begun", flush=True)
        print(_pour((host, int(port)), flood))
        return 0
    failed, rows = False, []
    from linemate.protocol.command.frame_codec import Role
    from linemate.protocol.command.preshared_keys import key_line, make_key

    for port in ("command", "camera", "robot"):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            keys = folder / "keys"
            key = make_key("operator", Role.OPERATE, os.urandom(32))
            keys.write_text(key_line(key) + "\n", encoding="utf-8")
            keys.chmod(0o400)
            text = (
                "task: wheel.yaml\nrsi: {port: 0}\ncamera: {port: 0}\n"
                f"distance: {{can: {{interface: slcan, channel: {folder}/can}}}}\n"
                f"force_torque: {{url: {folder}/ft}}\n"
                "command: {socket: c.sock, udp: {port: 0, keys: keys}}\n"
            )
            with DaemonProcess(folder, text) as daemon:
                outcome = run(daemon, port, flood)
        bad = outcome.missed > outcome.baseline + 0.003 * outcome.cycles
        bad = bad or outcome.samples < 0.99 * outcome.poses
        failed = failed or bad
        rows.append({"port": port, **asdict(outcome)})
        text = f"{port}: {outcome} {'TOO MANY' if bad else 'good'}"
        print(text, flush=True, file=sys.stderr if args.json else sys.stdout)
    if args.json:
        print(json.dumps({"rows": rows}))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
