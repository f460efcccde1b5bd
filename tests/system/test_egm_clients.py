"""Our emulated ABB controller driven by two EGM clients that somebody else wrote.

A refused correction is never tolerated. A cycle without one is only if the host kept a process
waiting, so a few are allowed. The run is in real time: 3000 cycles of 4 ms take 12 s.
"""

import importlib.util
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

PEER = Path(__file__).with_name("egm_peer.py")
IDLE, MOTION = 1000, 2000
LOST_SHARE = 0.02  # of all cycles: what a shared host loses
CLIENTS = {"abbrobotegm": "ABBRobotEGM", "abb-robot-client": "abb_robot_client"}


def emulator(folder: Path, port: int) -> "subprocess.Popen[str]":
    """Start an emulated station whose controller speaks EGM to a port of this host."""
    path = folder / "emulator.yaml"
    path.write_text(
        f"scenario: quiet\ncycle_ms: 4\negm: {{patient: true}}\nrobot_target: [127.0.0.1, {port}]\n"
    )
    command = [sys.executable, "-m", "linemate.simulators.harness.main", "emulator"]
    return subprocess.Popen([*command, "--config", str(path)], stdout=subprocess.PIPE, text=True)


def drive_client(folder: Path, name: str) -> tuple[Any, Any]:
    """Return what one client saw, and the emulator's facts at the end."""
    command = [sys.executable, str(PEER), name, "--idle", str(IDLE), "--motion", str(MOTION)]
    peer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert peer.stdout is not None
    running = [peer]
    try:
        station = emulator(folder, int(peer.stdout.readline()))
        running.append(station)
        answer, _ = peer.communicate(timeout=150.0)
        station.send_signal(signal.SIGTERM)
        lines, _ = station.communicate(timeout=30.0)
    finally:
        for process in running:
            process.kill()
            process.wait()
    return json.loads(answer), json.loads(lines.splitlines()[-1])


@pytest.mark.parametrize("name", CLIENTS)
def test_a_public_client_holds_and_moves_the_emulated_robot(tmp_path: Path, name: str) -> None:
    if importlib.util.find_spec(CLIENTS[name]) is None:
        pytest.skip(f"the test-only package {name} is not installed")
    seen, facts = drive_client(tmp_path, name)
    assert seen["messages"] == seen["sent"] == seen["ready"] == IDLE + MOTION
    assert seen["farthest_deg"] == pytest.approx(1.5, rel=0.02)
    assert seen["farthest_mm"] == pytest.approx(60.0, rel=0.02)
    telegrams = facts["telegrams"]
    assert facts["refusals"] == {}
    assert telegrams["refused"] == telegrams["unreadable"] == telegrams["duplicate"] == 0
    assert facts["broken"] is None
    # The client ends a moment before the emulator does.
    answered = telegrams["answered"]
    assert answered >= (IDLE + MOTION) * (1.0 - LOST_SHARE)
