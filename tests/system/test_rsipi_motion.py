"""rsipi in motion: its controller leads our daemon's task, its client our emulated robot."""

import re
import socket
from pathlib import Path
from typing import Any

import pytest

from tests.system import rsipi_motion
from tests.system.emulator_peer import driven

pytest.importorskip("RSIPI", reason="the test-only package rsipi is not installed")

CLIENT = Path(__file__).with_name("rsipi_client.py")
LOST_SHARE = 0.2  # of all cycles: what a shared host loses of a client of several processes


def drive_client(folder: Path, idle: int, motion: int) -> tuple[Any, Any]:
    """Return what the client saw, and the emulator's facts at the end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    text = rsipi_motion.FILE.read_text(encoding="utf-8")
    text = re.sub(r"<IP_NUMBER>.*?<", "<IP_NUMBER>127.0.0.1<", text)
    config = folder / "rsi.xml"
    config.write_text(re.sub(r"<PORT>.*?<", f"<PORT>{port}<", text), encoding="utf-8")
    (folder / "long.yaml").write_text("name: long\nduration_s: 60.0\n")
    emulator = folder / "emulator.yaml"
    emulator.write_text(
        "scenario: long.yaml\ncycle_ms: 12\nrsi_xml: rsi.xml\n"
        "controller: {patient: true, timeout: 10000}\n"
    )
    words = [str(config), str(idle), str(motion), "12"]
    return driven(emulator, CLIENT, words, 120.0)


def test_rsipis_controller_takes_every_reply_in_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    seen = rsipi_motion.play(900)
    assert (seen["cycles"], seen["accepted"]) == (900, 900)
    assert (seen["unanswered"], seen["refused"]) == (0, 0)
    assert seen["farthest_deg"] > 20.0


def test_rsipis_client_holds_and_moves_the_emulated_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    idle, motion = 100, 400
    seen, facts = drive_client(tmp_path, idle, motion)
    assert seen["moved_deg"] == pytest.approx(seen["sent_deg"], rel=0.05)
    assert seen["sent_deg"] == pytest.approx(1.5, rel=0.02)
    assert set(facts["refusals"]) <= {"late"}
    assert facts["telegrams"]["answered"] >= (idle + motion) * (1.0 - LOST_SHARE)
    assert facts["broken"] is None
