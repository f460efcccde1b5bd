"""Ctrl-C ends each command soon, in real time."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

LINEMATE = (sys.executable, "-m", "linemate.daemon.operator.main")
HARNESS = (sys.executable, "-m", "linemate.simulators.harness.main")
LONG = {
    "status --watch": (*LINEMATE, "status", "--watch", "--socket", "/nowhere"),
    "replay": (*LINEMATE, "replay", "{golden}"),
    "identify": (*LINEMATE, "identify", "{golden}", "--out", "{out}"),
    "view FILE": (*LINEMATE, "view", "--no-browser", "{golden}"),
    "view": (*LINEMATE, "view", "--no-browser", "--socket", "/nowhere"),
    "metrics": (*LINEMATE, "metrics", "--listen", "127.0.0.1:0"),
    "run": (*HARNESS, "run", "--seed", "0..9"),
    "campaign": (*HARNESS, "campaign", "--seeds", "9"),
    "detection": (*HARNESS, "campaign", "--detection", "9"),
    "bench": (*HARNESS, "bench"),
    "demo": (*HARNESS, "demo"),
}


@pytest.mark.row
@pytest.mark.parametrize("name", LONG)
def test_ctrl_c_ends_a_command_within_a_second(name: str, tmp_path: Path) -> None:
    from rerun import GOLDEN

    words = [word.format(golden=GOLDEN, out=tmp_path / "o.yaml") for word in LONG[name]]
    for after_s in (1.0, 4.0):
        # The best of three: a loaded host delays any process.
        assert any(interrupted(words, after_s) < 1.0 for _ in range(3)), after_s


def interrupted(words: list[str], after_s: float) -> float:
    """How long a command needs to end after Ctrl-C [s]; 0 if it had ended before."""
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        time.sleep(after_s)
        if process.poll() is not None:
            return 0.0
        process.send_signal(signal.SIGINT)
        began = time.monotonic()
        errors = process.communicate(timeout=60.0)[1]
        took_s = time.monotonic() - began
    assert "Traceback" not in errors, errors[-2000:]
    assert process.returncode in {0, 130, -signal.SIGINT}
    return took_s
