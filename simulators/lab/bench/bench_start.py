"""Start of the daemon, its return after ``kill -9``, and its processor time while nothing moves.

Processor time is that of all threads, from the kernel's account, so that other work on the machine
counts little. A controller at rest asks in each cycle over loopback. A reply is correct if it has
the counter of the newest telegram.
"""

from __future__ import annotations

import compileall
import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import Any, Final

import yaml

from linemate.daemon.transport.client import Client
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, parse_config
from linemate.simulators.harness import host
from linemate.simulators.harness.cell.cell_truth import shipped_task
from linemate.simulators.harness.processes import (
    DAEMON,
    START_S,
    Child,
    ChildError,
    Children,
    start_daemon,
)
from linemate.simulators.judge.table import number
from linemate.simulators.lab.bench.bench_floor import cpu_ns

HEAD: Final = ("start and rest", "here")
CYCLE_S: Final = 0.004
PRIORITY: Final = 80
CONTROLLER_PRIORITY: Final = 60
TRIES: Final = 3
AT_REST_S: Final = 6.0  # the daemon makes no more steps 5 s after the last telegram
MEASURED_S: Final = 5.0
SETTLED_S: Final = 2.0  # of a controller that asks, before the daemon's share is measured
STEPPED_S: Final = 2.0  # the daemon makes steps for 5 s of IDLE
PACKAGES: Final = ("protocol", "drivers", "daemon")  # that the daemon and its tool import
OPERATOR: Final = "linemate.daemon.operator.main"


class AskingController:
    """A controller whose robot stands, and which asks in each cycle.

    Attributes:
        asked, answered: telegrams, and those answered in their cycle.
    """

    def __init__(self, target: tuple[str, int]) -> None:
        xml = files("linemate.protocol") / "data/rsi_joints.xml"
        self._codec = RsiCodec(parse_config(xml.read_bytes()))
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._link.connect(target)
        self._joints = shipped_task().file.arm.rest_joints
        self._counter = 1_000_000
        self._due_s = time.monotonic()
        self.asked = self.answered = 0

    def cycle(self) -> bool:
        """Ask, wait for the end of the cycle, and return whether a correct reply came."""
        self._counter += round(1e3 * CYCLE_S)
        a1, a2, a3, a4, a5, a6 = self._joints[:6]
        telegram = RobotTelegram(
            self._counter,
            joints=(a1, a2, a3, a4, a5, a6),
            external=(0.0,) * 6,
            tcp=(0.0,) * 6,
            delay=self.asked - self.answered,
            channels={"DiL": 0},
        )
        self._due_s = max(self._due_s + CYCLE_S, time.monotonic())
        try:
            self._link.send(self._codec.format_robot(telegram))
            is_answered = self._reply()
        except OSError:  # nothing listens
            is_answered = False
        self.asked += 1
        self.answered += is_answered
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        return is_answered

    def _reply(self) -> bool:
        wanted = b"<IPOC>%d</IPOC>" % self._counter
        while (left_s := self._due_s - time.monotonic()) > 0.0:
            self._link.settimeout(left_s)
            if wanted in self._link.recv(2048):
                return True
        return False

    def run(self, duration_s: float) -> None:
        """Ask for some time [s]."""
        until_s = time.monotonic() + duration_s
        while time.monotonic() < until_s:
            self.cycle()

    def close(self) -> None:
        """Close the socket."""
        self._link.close()


def measure() -> dict[str, Any]:
    """Return medians of starts and returns, and shares of a core while nothing moves."""
    # As after an installation. A clone's sources that changed would be compiled at each start.
    for package in PACKAGES:
        compileall.compile_dir(str(files("linemate") / package), quiet=2)
    with tempfile.TemporaryDirectory(prefix="linemate-") as name:
        folder = Path(name)
        config = _written(folder)
        tried = [_tried(folder, config) for _ in range(TRIES)]
        figures: dict[str, Any] = {key: round(median(t[key] for t in tried), 3) for key in tried[0]}
        return figures | _at_rest(folder, config)


def rows(measured: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the rows of the table ``HEAD``."""
    yield "processor time to READY", f"{number(measured['ready_cpu_s'])} s"
    yield "READY after", f"{number(measured['ready_s'])} s"
    yield "processor time from kill -9 to a correct reply", f"{number(measured['back_cpu_s'])} s"
    yield "a correct reply after", f"{number(measured['back_s'])} s"
    yield "processor time of `linemate status`", f"{number(1e3 * measured['status_cpu_s'], 0)} ms"
    for key, name in (
        ("init_share", "of a core in INIT, without a robot"),
        ("stepped_share", "of a core in IDLE, a robot asks every 4 ms, at first"),
        ("idle_share", "of a core in IDLE after 5 s without a client"),
        ("gone_share", "of a core after that robot has gone"),
    ):
        yield name, f"{number(100.0 * measured[key], 1)} %"


def _written(folder: Path) -> Path:
    """Write the daemon's configuration, for a free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    realtime = {"lock_memory": True, "priority": PRIORITY}
    config = {
        "task": "wheel.yaml",
        # A port of its own: a daemon that is started again has to take the same.
        "rsi": {"cycle_ms": round(1e3 * CYCLE_S), "port": port},
        "command": {"socket": str(folder / "command.sock")},
        "recording": {"directory": str(folder), "at_start": True},
        "state": str(folder),
        **({"realtime": realtime} if host.missing_rights() is None else {}),
    }
    path = folder / "linemated.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return path


def _started(children: Children, folder: Path, config: Path) -> tuple[Child, dict[str, Any]]:
    return start_daemon(children, config, folder / "daemon.log")


def _tried(folder: Path, config: Path) -> dict[str, float]:
    """Start, kill, start again with a controller that asks on, and ask for the status."""
    with Children() as children:
        began_s = time.monotonic()
        daemon, listening = _started(children, folder, config)
        ready_s, ready_cpu_s = time.monotonic() - began_s, 1e-9 * cpu_ns(daemon.pid)
        host_name, port = listening["robot"]
        controller = AskingController((host_name, port))
        controller.run(0.5)
        killed_s = time.monotonic()
        daemon.signal_group(signal.SIGKILL)
        daemon.wait(START_S)
        # Without waiting until it is ready, as systemd starts it.
        command = [sys.executable, "-m", DAEMON, "--config", str(config)]
        again = children.start("daemon", command, folder / "restart.log")
        while not controller.cycle():
            if time.monotonic() - killed_s > START_S:
                raise TimeoutError("the daemon did not answer again after kill -9")
        back_s, back_cpu_s = time.monotonic() - killed_s, 1e-9 * cpu_ns(again.pid)
        status_cpu_s = _status_cpu_s(folder)
        again.end()
        controller.close()
    return {
        "ready_s": ready_s,
        "ready_cpu_s": ready_cpu_s,
        "back_s": back_s,
        "back_cpu_s": back_cpu_s,
        "status_cpu_s": status_cpu_s,
    }


def _status_cpu_s(folder: Path) -> float:
    """Return the processor time of one ``linemate status`` [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", OPERATOR, "status", "--socket", str(folder / "command.sock")]
    # It ends with 1 while the robot is not ready.
    shown = subprocess.run(  # noqa: S603 - a program of this package
        command, check=False, stdout=subprocess.PIPE, timeout=START_S
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if not shown.stdout:
        raise ChildError("status", f"showed nothing, exit {shown.returncode}", ())
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def _at_rest(folder: Path, config: Path) -> dict[str, Any]:
    """Return the daemon's shares of a core without a robot, with one that stands, and after it."""
    with Children() as children:
        daemon, listening = _started(children, folder, config)
        time.sleep(AT_REST_S)
        init = _share(daemon.pid, lambda: time.sleep(MEASURED_S))
        host_name, port = listening["robot"]
        controller = AskingController((host_name, port))
        with _punctual():
            first_is_correct = controller.cycle()
            controller.run(SETTLED_S)
            stepped = _share(daemon.pid, lambda: controller.run(STEPPED_S))
            controller.run(AT_REST_S - STEPPED_S)
            idle = _share(daemon.pid, lambda: controller.run(MEASURED_S))
        with Client.local(folder / "command.sock") as client:
            status = client.call("status")
        controller.close()
        time.sleep(AT_REST_S)
        gone = _share(daemon.pid, lambda: time.sleep(MEASURED_S))
    return {
        "init_share": init,
        "stepped_share": stepped,
        "idle_share": idle,
        "gone_share": gone,
        "state": status["state"],
        "rested": status["rested"],
        "first_reply_after_rest_correct": first_is_correct,
        "answered": [controller.answered, controller.asked],
    }


@contextmanager
def _punctual() -> Iterator[None]:
    """Send telegrams in time, as a controller does, where the host grants a priority.

    A controller that is late itself counts replies as lost, and a lost reply ends a rest.
    """
    if host.missing_rights() is not None:
        yield
        return
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    urgent = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    os.sched_setscheduler(0, urgent, os.sched_param(CONTROLLER_PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


def _share(pid: int, wait: Callable[[], object]) -> float:
    """Return which share of a core a process takes while something is waited for."""
    began_ns, began_s = cpu_ns(pid), time.monotonic()
    wait()
    return round(1e-9 * (cpu_ns(pid) - began_ns) / (time.monotonic() - began_s), 4)
