"""The demonstration, shortened and watched: the real daemon's telemetry reaches a page."""

import json
import os
import subprocess
import sys
import urllib.error
import urllib.request
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml

from linemate.simulators.harness import scenario_file

DEMO = [sys.executable, "-m", "linemate.simulators.harness.main", "demo", "--view"]
SHORT_S = 8.0
FEWEST = 60
MOST = 500  # twenty seconds: by then it has begun to track


def has_foresight(frame: dict[str, Any]) -> bool:
    return len(frame.get("foreseen", ())) > 2


def heard(address: str) -> dict[str, list[Any]]:
    """What a page hears until it has seen enough, by the name of the event."""
    found: dict[str, list[Any]] = {}
    name = ""
    with urllib.request.urlopen(f"{address}stream", timeout=60.0) as stream:
        for line in stream:
            word, _, data = line.decode().rstrip("\n").partition(": ")
            if word == "event":
                name = data
            elif word == "data":
                found.setdefault(name, []).append(json.loads(data))
                frames = found.get("frame", [])
                if len(frames) >= MOST or (len(frames) >= FEWEST and has_foresight(frames[-1])):
                    return found
    raise AssertionError(f"it ended early: { {name: len(all_) for name, all_ in found.items()} }")


def test_the_real_daemon_is_shown_and_the_view_ends_with_the_run(tmp_path: Path) -> None:
    scenario = tmp_path / "short.yaml"
    plain = scenario_file.to_plain(replace(scenario_file.load("wheel"), duration_s=SHORT_S))
    scenario.write_text(yaml.safe_dump({**plain, "name": "short"}))
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    with subprocess.Popen(
        [*DEMO, "--scenario", str(scenario), "--out", str(tmp_path / "out")],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as demo:
        assert demo.stderr is not None
        lines = []
        for line in demo.stderr:
            lines.append(line)
            if "http://" in line:
                break
        address = lines[-1].split()[-1]
        assert address.startswith("http://127.0.0.1:"), lines
        found = heard(address)
        demo.terminate()
        demo.stderr.read()
        assert demo.wait(60.0) == 130
    assert found["scene"][-1]["trouble"] == ""
    frames = found["frame"]
    assert all(frame["arm"] and frame["guessed"] is False for frame in frames[-10:])
    assert all(b["t"] >= a["t"] for a, b in pairwise(frames))
    assert {"robot", "distance", "camera", "force_torque"} == set(found["status"][-1]["links"])
    assert any(" -> " in one["text"] for one in found["happened"])
    # It tracks at least for a moment, however loaded the machine is, and foresees then.
    assert any(has_foresight(frame) for frame in frames)
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(address, timeout=5.0)
