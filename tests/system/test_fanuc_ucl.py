"""Our emulated FANUC controller driven by a client that somebody else wrote: fanuc-ucl.

A refused command is never tolerated. A cycle without one is only if the host kept a process
waiting, so a few are allowed. ``ucl_peer.py`` drives more cycles.
"""

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from tests.system.emulator_peer import driven

PEER = Path(__file__).with_name("ucl_peer.py")
LOST_SHARE = 0.02  # of all cycles: what a shared host loses


def drive_client(folder: Path, version: int, idle: int, motion: int) -> tuple[Any, Any]:
    """Return what the client saw, and the emulator's facts at the end."""
    address = f"127.60.15.{version}"  # the client has the port built in
    path = folder / "emulator.yaml"
    (folder / "long.yaml").write_text("name: long\nduration_s: 60.0\n")
    path.write_text(
        "scenario: long.yaml\ncycle_ms: 8\n"
        f"fanuc: {{version: {version}, has_rail: false, patient: true}}\n"
        f"robot_bind: [{address}, 60015]\n"
    )
    words = [address, "--idle", str(idle), "--motion", str(motion)]
    return driven(path, PEER, words, 150.0)


@pytest.mark.skipif(
    importlib.util.find_spec("fanuc_ucl") is None,
    reason="the test-only package fanuc-ucl is not installed",
)
@pytest.mark.parametrize("version", [1, 2])
def test_a_public_client_holds_and_moves_the_emulated_robot(tmp_path: Path, version: int) -> None:
    idle, motion = 100, 250
    seen, facts = drive_client(tmp_path, version, idle, motion)
    assert seen["done"]
    assert seen["farthest_deg"] == pytest.approx(1.5, rel=0.02)
    assert seen["stats"]["tx_errors"] == 0
    assert facts["refusals"] == {}
    assert facts["broken"] is None
    answered = facts["telegrams"]["answered"]
    assert (idle + motion) * (1.0 - LOST_SHARE) <= answered <= idle + motion
    assert facts["limits"]["violations"] == 0
    # The tables of limits are the emulated controller's.
    assert seen["limits"]["vmax"] == 2000
