"""A whole cell under a real systemd: the daemon is killed while it leads the robot.

The template unit, the emulators on the real links next to it, and their own truth
as the judge. What systemd restarts leads no one: the robot stays where it was left until its
programme and an operator begin again. Skipped with a reason where rights or tools are missing.
"""

import json
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pytest
import yaml
from systemd_machine import CHECKOUT, OUT, PROGRAM, Machine, lacking

from linemate.simulators.harness import identified_overlay as overlay
from linemate.simulators.harness.cell.cell_truth import shipped_task

REASON = lacking()
pytestmark = pytest.mark.skipif(REASON is not None, reason=f"no systemd to be booted: {REASON}")

UNIT = "linemated@west.service"
LAB = "lab.service"
SOCKET = "/run/linemate-west/command.sock"
ROBOT = ("127.0.0.1", 49252)
CAMERA = ("127.0.0.1", 49253)
READY_S = 3.0
TIMEOUT_S = 30.0
SILENCE_S = 0.2
"""The daemon hears silence for this long before the robot's program starts [s]."""
LED_S = 1.8
"""On the scenario's clock: the car has come at 0, contact is at about 6 [s]."""

DAEMON = {
    "task": "wheel.yaml",
    "rsi": {"bind": ROBOT[0], "port": ROBOT[1]},
    "distance": {"can": {"interface": "slcan", "channel": "/run/lab/can"}},
    "camera": {"bind": CAMERA[0], "port": CAMERA[1]},
    "force_torque": {"url": "/run/lab/force-torque"},
    "command": {"socket": SOCKET},
    **overlay.load(),
}

EMULATOR = {
    "scenario": "wheel",
    "robot_target": list(ROBOT),
    "camera_target": list(CAMERA),
    "distance_mount": shipped_task().file.conveyor.start_position,
    "can_link": "/run/lab/can",
    "serial_link": "/run/lab/force-torque",
    # Single late replies of a busy machine are no end; a daemon that is gone is one.
    "controller": {"timeout": 50, "timeout_rule": "row", "patient": True},
    "wait_answered": 150,
    "truth": f"{OUT}/truth.npz",
}

LAB_UNIT = f"""\
[Service]
User=linemate
RuntimeDirectory=lab
ExecStart={PROGRAM}/bin/linemate-sim emulator --config /etc/linemate/emulator.yaml
StandardOutput=truncate:{OUT}/lab.jsonl
StandardError=append:{OUT}/lab.log
"""

# Ports that are pseudo-terminals here are devices at a site.
DROP_IN = f"[Service]\nDeviceAllow=char-pts rw\nStandardError=append:{OUT}/linemated.log\n"


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    made = Machine(tmp_path_factory.mktemp("cell"))
    subprocess.run(
        ["make", "-s", "-C", str(CHECKOUT), "install-files", f"DESTDIR={made.tree}"],
        check=True,
        capture_output=True,
    )
    made.file("etc/linemate/west.yaml", yaml.safe_dump(DAEMON))
    made.file("etc/linemate/emulator.yaml", yaml.safe_dump(EMULATOR))
    made.file("etc/systemd/system/lab.service", LAB_UNIT)
    made.file("etc/systemd/system/linemated@west.service.d/site.conf", DROP_IN)
    with made:
        made.run("systemd-sysusers", "/etc/sysusers.d/linemate.conf")
        yield made


def tool(machine: Machine, *words: str) -> subprocess.CompletedProcess[str]:
    return machine.run("linemate", *words, "--socket", SOCKET, "--timeout", "4", check=False)


def until(
    machine: Machine, found: Callable[[Mapping[str, Any]], bool], what: str
) -> dict[str, Any]:
    """The first status that has something; while no one answers there is none."""
    end, status = time.monotonic() + TIMEOUT_S, {}
    while time.monotonic() < end:
        done = tool(machine, "status", "--json")
        if done.stdout:
            status = json.loads(done.stdout)
            if found(status):
                return dict(status)
        time.sleep(0.02)
    log = (machine.out / "linemated.log").read_text()[-2000:]
    raise AssertionError((what, status.get("state"), status.get("unfit"), log))


def until_scene(machine: Machine, time_s: float) -> None:
    """Wait for a time on the scenario's clock, by the emulator's word."""
    end = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end:
        path = machine.out / "lab.jsonl"
        lines = path.read_text().splitlines() if path.exists() else []
        if lines and lines[-1].endswith("}") and json.loads(lines[-1]).get("time_s", -9.0) > time_s:
            return
        time.sleep(0.02)
    raise AssertionError("the emulated car did not come")


def started(machine: Machine) -> None:
    """Arm and start; a machine that stood still disarms the robot in between."""
    end = time.monotonic() + TIMEOUT_S
    while (done := tool(machine, "start")).returncode != 0:
        assert time.monotonic() < end, done.stderr
        tool(machine, "arm")
        time.sleep(0.05)


def truth(machine: Machine) -> dict[str, Any]:
    """The emulator's account of what it applied; written at its end."""
    machine.run("systemctl", "stop", LAB)
    with np.load(machine.out / "truth.npz") as archive:
        account = {
            name: archive[name] for name in ("setpoints", "joints", "answered", "digital_out")
        }
    for name in ("truth.npz", "lab.jsonl"):
        (machine.out / name).unlink()
    return account


def test_a_daemon_killed_while_it_leads_moves_nothing_when_it_is_back(machine: Machine) -> None:
    # The unit is ready once the daemon listens: only a start that it hears proves the correction.
    machine.run("systemctl", "start", UNIT)
    time.sleep(SILENCE_S)
    machine.run("systemctl", "start", LAB)
    started(machine)
    until(machine, lambda status: status["state"] == "track", "the robot is led")
    until_scene(machine, LED_S)
    pid = int(machine.show(UNIT, "MainPID")["MainPID"])
    machine.run("kill", "-KILL", str(pid))
    status = until(machine, lambda status: status["pid"] != pid, "another daemon")
    shown = machine.show(UNIT, "NRestarts", "ActiveEnterTimestampMonotonic",
                        "ActiveExitTimestampMonotonic")  # fmt: skip
    exited, entered = (
        int(shown[f"Active{name}TimestampMonotonic"]) * 1e-6 for name in ("Exit", "Enter")
    )
    assert shown["NRestarts"] == "1"
    assert entered - exited < READY_S
    assert status["state"] == "init"
    time.sleep(1.0)
    first = truth(machine)
    led = np.flatnonzero(np.any(np.diff(first["setpoints"], axis=0) != 0.0, axis=1))
    assert len(led) > 0.5 * LED_S / 0.012, "the robot was led"
    # After the last reply of the killed daemon the setpoints stay.
    after = first["setpoints"][led[-1] + 1 :]
    assert len(after) > 40
    assert np.ptp(after, axis=0).max() == 0.0
    assert not first["answered"][led[-1] + 2 :].any()

    # The robot's programme begins again, at a place of its own, and is reported to stay there.
    machine.run("systemctl", "start", LAB)
    until_scene(machine, -3.0)
    second = truth(machine)
    answered = np.flatnonzero(second["answered"])
    assert len(answered) > 20
    begin = second["joints"][0]
    assert np.abs(second["setpoints"][answered[0]] - begin).max() < 1e-7
    assert np.abs(second["setpoints"] - begin).max() < 1e-7
    assert not second["digital_out"].any()
    machine.run("systemctl", "stop", UNIT)
