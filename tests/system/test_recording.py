"""A real daemon's recording: it replays to the bit, and a sudden death costs its last second."""

import contextlib
import os
import resource
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from daemon_process import DaemonProcess
from plain_robot import PlainRobot

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA, PROTOCOL_DATA
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.operator import main as tool
from linemate.daemon.recording.reader import read
from linemate.daemon.recording.recorder import Recorder
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, parse_config
from linemate.simulators.harness import lockstep, setup

CYCLE_S = 0.012
TEXT = """
task: wheel.yaml
rsi: {port: 0}
camera: {port: 0}
command: {socket: c.sock}
recording: {directory: ., at_start: true}
"""


def exchange(daemon: DaemonProcess, seconds: float) -> int:
    """Send telegrams of a robot that stands; how many were answered."""
    codec = RsiCodec(parse_config((PROTOCOL_DATA / "rsi_joints.xml").read_bytes()))
    rest = task_file.load(DAEMON_DATA / "wheel.yaml").file.arm.rest_joints
    answered = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        robot.connect(daemon.robot())
        robot.setblocking(False)
        # The daemon has to hear that no program runs before one starts.
        time.sleep(0.1)
        begin = time.monotonic()
        for k in range(round(seconds / CYCLE_S)):
            telegram = RobotTelegram(
                4_000_000 + 12 * k,
                joints=rest,
                external=(0.0,) * 6,
                tcp=(0.0,) * 6,
                delay=0,
                channels={"DiL": 0},
            )
            robot.send(codec.format_robot(telegram))
            time.sleep(max(0.0, begin + (k + 1) * CYCLE_S - time.monotonic()))
            with contextlib.suppress(BlockingIOError):
                while robot.recv(2048):
                    answered += 1
    return answered


def test_what_a_daemon_recorded_replays_to_the_bit(tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, TEXT) as daemon:
        answered = exchange(daemon, 1.5)
        assert daemon.end()[0] == 0
    (path,) = tmp_path.glob("linemate-*.mcap")
    recording = read(path)
    assert recording.whole
    assert sum(step.counter is not None for step in recording.steps) >= 0.9 * answered > 0
    assert tool.main(["replay", str(path)]) == 0


def writer_of(daemon: DaemonProcess) -> int:
    """The process that writes the daemon's recordings, its only child."""
    pid = daemon.process.pid
    tasks = Path(f"/proc/{pid}/task").glob("*/children")  # a thread may have started it
    (child,) = " ".join(task.read_text() for task in tasks).split()
    return int(child)


def test_a_daemon_that_is_killed_loses_nothing_that_its_writer_has(tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, TEXT) as daemon:
        exchange(daemon, 2.0)
        writer = os.pidfd_open(writer_of(daemon))
        daemon.process.send_signal(signal.SIGKILL)
        killed_ns = time.monotonic_ns()
        daemon.process.wait(10.0)
    assert select.select([writer], [], [], 10.0)[0], "the writer ends when no one is left"
    os.close(writer)
    (path,) = tmp_path.glob("linemate-*.mcap")
    recording = read(path)
    assert recording.whole
    assert killed_ns - recording.steps[-1].inputs.stamp_ns < 1_000_000_000
    assert tool.main(["replay", str(path)]) == 0


def test_a_daemon_killed_with_its_writer_loses_its_last_second_at_most(tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, TEXT) as daemon:
        answered = exchange(daemon, 3.0)
        os.kill(writer_of(daemon), signal.SIGKILL)
        daemon.process.send_signal(signal.SIGKILL)
        killed_ns = time.monotonic_ns()
        daemon.process.wait(10.0)
    (path,) = tmp_path.glob("linemate-*.mcap")
    recording = read(path)
    assert not recording.whole
    steps = recording.steps
    assert answered > 100
    assert killed_ns - steps[-1].inputs.stamp_ns < 1_000_000_000
    assert [step.inputs.k for step in steps] == list(range(len(steps)))
    assert tool.main(["recover", str(path)]) == 0
    assert tool.main(["replay", str(path.with_name(f"{path.stem}-recovered.mcap"))]) == 0


def test_a_disk_that_fills_up_costs_the_recording_and_no_cycle(tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, TEXT) as daemon:
        exchange(daemon, 1.0)
        (path,) = tmp_path.glob("linemate-*.mcap")
        limit_bytes = path.stat().st_size + 4096
        resource.prlimit(writer_of(daemon), resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))
        steps = daemon.status()["steps"]
        answered = exchange(daemon, 2.0)
        status = daemon.status_once(lambda status: bool(status["recording"]["failure"]))
        assert "File too large" in status["recording"]["failure"]
        assert not status["recording"]["recording"]
        assert any("recording ended" in complaint for complaint in status["complaints"])
        assert status["steps"] - steps >= answered > 0.9 * 2.0 / CYCLE_S
        assert status["faults"] == 0
        assert daemon.end()[0] == 0
    recording = read(path)
    assert len(recording.steps) > 30
    assert path.stat().st_size <= limit_bytes


def test_a_killed_recorder_comes_back_twice_and_costs_no_cycle(tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, TEXT) as daemon:
        exchange(daemon, 1.0)
        for restarts in (1, 2):
            os.kill(writer_of(daemon), signal.SIGKILL)
            before = daemon.status()["steps"]
            answered = exchange(daemon, 4.0)
            assert answered > 0.9 * 4.0 / CYCLE_S
            assert daemon.status()["steps"] - before >= answered
            status = daemon.status()["recording"]
            assert status["recording"]
            assert status["restarts"] == restarts
            assert status["dropped"] > 0
        assert daemon.status()["faults"] == 0
        assert daemon.end()[0] == 0
        log = daemon.log_text()
    *cut, last = sorted(tmp_path.glob("linemate-*.mcap"))
    assert len(cut) == 2
    for path in cut:
        assert "signal 9" in log
        assert f"{path} was cut short" in log
        assert not read(path).whole
    assert tool.main(["replay", str(last)]) == 0


SWITCHES = 6
OPERATOR = f"""
import sys, time
from linemate.daemon.transport.client import Client
with Client.local(sys.argv[1]) as client:
    print("ready", flush=True)
    for _ in sys.stdin:
        for _ in range({SWITCHES}):
            print(client.call("record", {{"action": "stop"}}, 4.0)["file"], flush=True)
            time.sleep(0.05)
            client.call("record", {{"action": "start"}}, 4.0)
            time.sleep(0.15)
"""
ATTEMPTS = 4


def test_recordings_that_are_switched_cost_no_telegram(tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, TEXT) as daemon:
        # An operator in a process of its own does not delay the robot's thread.
        operator = subprocess.Popen(
            [sys.executable, "-c", OPERATOR, daemon.listening["command"]["socket"]],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert operator.stdin is not None
        assert operator.stdout is not None
        assert operator.stdout.readline() == "ready\n"
        robot = PlainRobot(daemon.robot())
        robot.cycles(100)
        files: list[str] = []
        for _ in range(ATTEMPTS):
            baseline = robot.cycles(150).count(None)
            print("switch", file=operator.stdin, flush=True)
            missed = robot.cycles(150).count(None)
            files += [operator.stdout.readline().strip() for _ in range(SWITCHES)]
            # What this machine misses anyway is granted.
            if missed <= baseline:
                break
        operator.communicate(timeout=10.0)
        robot.close()
        assert missed <= baseline
        assert daemon.status()["faults"] == 0
        assert daemon.end()[0] == 0
    assert len(set(files)) == len(files)
    for path in files:
        recording = read(Path(path))
        assert recording.whole
        assert len(recording.steps) > 0


def test_recordings_that_are_switched_in_motion_change_no_setpoint(tmp_path: Path) -> None:
    made = setup.make("wheel", ("scenario.lead_in_s=1.5", "scenario.duration_s=7.0"))
    task = setup.shipped_task()
    recorder = Recorder(tmp_path, {"config": "task: wheel.yaml\n", "task": task.text})
    commands: dict[bool, list[tuple[float, ...]]] = {True: [], False: []}
    states: set[str] = set()
    files: list[str] = []

    def keep(entry: LogEntry) -> None:
        commands[True].append(entry.outputs.command)
        states.add(entry.state)
        if len(commands[True]) % 60 == 0:
            assert recorder.stop() is None
            files.append(recorder.status.file)
            assert recorder.start() is None
        recorder.record((entry,))

    assert recorder.start() is None
    lockstep.run(made, 0, on_step=keep)
    recorder.close()
    lockstep.run(made, 0, on_step=lambda entry: commands[False].append(entry.outputs.command))
    assert commands[True] == commands[False]
    assert states >= {"track", "contact"}
    assert len(set(files)) == len(commands[True]) // 60 > 10
    numbers = [step.inputs.k for path in files for step in read(Path(path)).steps]
    assert numbers == list(range(len(numbers)))
    assert all(read(Path(path)).whole for path in files)
