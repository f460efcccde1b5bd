"""An emulator of its own process, driven by a client that somebody else wrote."""

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def driven(config: Path, client: Path, words: Sequence[str], timeout_s: float) -> tuple[Any, Any]:
    """Return what the client saw, and the emulator's facts at the end."""
    command = [sys.executable, "-m", "linemate.simulators.harness.main", "emulator"]
    station = subprocess.Popen(
        [*command, "--config", str(config)], stdout=subprocess.PIPE, text=True
    )
    assert station.stdout is not None
    try:
        assert '"ready"' in station.stdout.readline()
        peer = subprocess.run(
            [sys.executable, str(client), *words],
            stdout=subprocess.PIPE,
            text=True,
            timeout=timeout_s,
            check=True,
        )
        station.send_signal(signal.SIGTERM)
        lines, _ = station.communicate(timeout=30.0)
    finally:
        station.kill()
        station.wait()
    return json.loads(peer.stdout.splitlines()[-1]), json.loads(lines.splitlines()[-1])
