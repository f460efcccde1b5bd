"""Our emulated FANUC controller driven by airo-fanuc's compiled client.

The client numbers its commands by a counter of its own and keeps a clock of its own. A cycle
without a command is possible, a refused command is not.
"""

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from tests.system.emulator_peer import driven

PEER = Path(__file__).with_name("airo_client.py")
ADDRESS = "127.60.15.9"
LOST_SHARE = 0.05  # of all cycles: two clocks drift, and a shared host loses some


def drive_client(folder: Path, idle: int, motion: int) -> tuple[Any, Any]:
    """Return what the client saw, and the emulator's facts at the end."""
    path = folder / "emulator.yaml"
    (folder / "long.yaml").write_text("name: long\nduration_s: 60.0\n")
    path.write_text(
        "scenario: long.yaml\ncycle_ms: 8\n"
        "fanuc: {is_echoed: false, has_rail: false, signals_byte: null, patient: true}\n"
        f"robot_bind: [{ADDRESS}, 60015]\n"
    )
    words = [ADDRESS, "60015", "--idle", str(idle), "--motion", str(motion)]
    return driven(path, PEER, words, 60.0)


@pytest.mark.skipif(
    importlib.util.find_spec("airo_fanuc") is None,
    reason="the test-only package airo-fanuc is not installed",
)
def test_a_compiled_client_holds_and_moves_the_emulated_robot(tmp_path: Path) -> None:
    idle, motion = 60, 250
    seen, facts = drive_client(tmp_path, idle, motion)
    assert seen["fault"] == "FaultReason.NONE"
    assert seen["motion"] == "MotionStatus.DONE"
    assert seen["farthest_deg"] == pytest.approx(1.5, rel=0.05)
    assert facts["refusals"] == {}
    assert facts["broken"] is None
    assert facts["telegrams"]["answered"] >= (idle + motion) * (1.0 - LOST_SHARE)
