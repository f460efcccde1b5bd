"""The daemon against a controller that somebody else wrote: the package rsipi's EchoServer.

A wrong, malformed or foreign reply is never tolerated. A late one is only if the machine kept the
daemon waiting for a processor just then, by the kernel's own account, or kept an echo as well.
"""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import pytest
from daemon_process import DaemonProcess

from linemate.daemon.config.files import PROTOCOL_DATA

pytest.importorskip("RSIPI", reason="the test-only package rsipi is not installed")

PEER = Path(__file__).with_name("rsipi_peer.py")
REST = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
ROUNDS = 3
"""What a virtual machine's host does to it is in no account of the kernel: play it again."""

LOOK_S = 0.01
KEPT_S = 0.002
"""Waiting for a processor that makes a reply late."""


class Waiting:
    """How long the kernel kept a process waiting for a processor, watched while it runs."""

    def __init__(self, pid: int) -> None:
        self._account = Path(f"/proc/{pid}/schedstat")
        self._seen: list[tuple[float, float]] = []
        self._stop = threading.Event()
        self._watcher = threading.Thread(target=self._watch)

    def __enter__(self) -> Self:
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._watcher.join()

    def within(self, from_s: float, to_s: float) -> float:
        """Time spent waiting between two instants [s], or between the looks around them."""
        before = [waited for at_s, waited in self._seen if at_s <= from_s]
        after = [waited for at_s, waited in self._seen if at_s >= to_s]
        return after[0] - before[-1] if before and after else 0.0

    def _watch(self) -> None:
        while not self._stop.wait(LOOK_S):
            try:
                waited_ns = int(self._account.read_text(encoding="ascii").split()[1])
            except FileNotFoundError:  # a kernel without accounts: then nothing is explained
                return
            self._seen.append((time.monotonic(), waited_ns * 1e-9))


@contextmanager
def plain_echo() -> Iterator[int]:
    """A peer that does nothing but answer; its port."""
    with subprocess.Popen([sys.executable, str(PEER), "echo"], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        try:
            yield int(process.stdout.readline())
        finally:
            process.kill()


@contextmanager
def controller(folder: Path, layout: str, port: int, cycle_ms: int, cycles: int) -> Iterator[Path]:
    """rsipi's controller at work; the file that will hold what it counted."""
    folder.mkdir(exist_ok=True)
    shipped = (PROTOCOL_DATA / layout).read_text(encoding="utf-8")
    assert "<PORT>49152</PORT>" in shipped
    config = folder / "RSI_EthernetConfig.xml"
    config.write_text(shipped.replace("49152", str(port)), encoding="utf-8")
    result = folder / "result.json"
    result.unlink(missing_ok=True)
    command = [sys.executable, str(PEER), "controller", "--config", str(config)]
    command += ["--cycle-ms", str(cycle_ms), "--cycles", str(cycles), "--result", str(result)]
    command += ["--joints", *map(str, REST)]
    with (
        (folder / "log").open("wb") as log,
        subprocess.Popen(command, cwd=folder, stdout=log, stderr=subprocess.STDOUT) as process,
    ):
        try:
            yield result
            assert process.wait(120.0) == 0, (folder / "log").read_text()
        finally:
            process.kill()


def played(
    folder: Path, layout: str, daemon_port: int, cycle_ms: int, cycles: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """One round: what a controller counted of the daemon, and one of the echo at the same time."""
    with ExitStack() as stack:
        echo_port = stack.enter_context(plain_echo())
        results = [
            stack.enter_context(controller(folder / name, layout, port, cycle_ms, cycles))
            for name, port in (("echo", echo_port), ("daemon", daemon_port))
        ]
    echoed, served = (json.loads(path.read_text(encoding="utf-8")) for path in results)
    return served, echoed


@contextmanager
def listening(folder: Path, layout: str, cycle_ms: int) -> Iterator[DaemonProcess]:
    """The daemon's process with a layout of telegrams."""
    text = f"""
task: wheel.yaml
rsi: {{config: {layout}, port: 0, cycle_ms: {cycle_ms}}}
command: {{socket: c.sock}}
"""
    with DaemonProcess(folder, text) as daemon:
        yield daemon


def serve(folder: Path, cycle_ms: int, cycles: int, layout: str) -> tuple[Any, Any]:
    """Return what a controller counted of the daemon, and one of the echo, in one round."""
    with listening(folder, layout, cycle_ms) as daemon:
        return played(folder, layout, daemon.robot()[1], cycle_ms, cycles)


@pytest.mark.parametrize(
    ("cycle_ms", "cycles", "layout", "corrected"),
    [
        (4, 1000, "rsi_joints_setpoints.xml", ["AKorr", "EKorr"]),
        (12, 250, "rsi_joints.xml", []),  # it knows AK by the name AKorr alone
    ],
)
def test_a_foreign_controller_counts_no_faulty_reply(
    tmp_path: Path, cycle_ms: int, cycles: int, layout: str, corrected: list[str]
) -> None:
    with listening(tmp_path, layout, cycle_ms) as daemon:
        for _ in range(ROUNDS):
            with Waiting(daemon.process.pid) as waiting:
                served, echoed = played(tmp_path, layout, daemon.robot()[1], cycle_ms, cycles)
            unanswered = served["unanswered"]
            assert served["wrong"] == []
            assert served["sent"] == cycles
            assert served["accepted"] == cycles - len(unanswered)
            assert served["faulty"] == served["late"] <= len(unanswered)
            assert served["joints"] == list(REST)
            assert served["linear_axis"] == 0.0
            assert served["corrected"] == corrected
            unexplained = [span for span in unanswered if waiting.within(*span) < KEPT_S]
            if len(unexplained) <= len(echoed["unanswered"]):
                break
        else:
            pytest.fail(f"late in each of {ROUNDS} rounds, and not the machine's doing")
        status = daemon.status()
        assert status["telegrams"]["unreadable"] == 0
        assert status["telegrams"]["refused"] == 0
        assert status["faults"] == 0
        assert status["state"] in {"idle", "init"}
