"""The demonstration, shortened: real processes, real links, real time, and nothing left behind.

The machine may be loaded: what is compared here is who says what, never how many microseconds.
"""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from linemate.simulators.harness import demo, scenario_file
from linemate.simulators.harness.main import main
from linemate.simulators.harness.processes import ChildError
from linemate.simulators.judge import joined
from linemate.simulators.judge.judge import shortfalls
from linemate.simulators.plants.scenario import Scenario

SHORT_S = 3.0
DEMO = [sys.executable, "-m", "linemate.simulators.harness.main", "demo"]


@dataclass(frozen=True)
class Ended:
    code: int
    out: Path
    output: str
    errors: str

    @property
    def result(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.out / "result.json").read_text())
        return found


def children_of(folder: Path) -> dict[int, str]:
    """Processes that were started with a configuration below a folder, and with which."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = os.fsdecode((entry / "cmdline").read_bytes()).split("\0")
            except OSError:
                continue
            if "--config" in words[:-1]:
                config = Path(words[words.index("--config") + 1])
                if config.is_relative_to(folder):
                    found[int(entry.name)] = config.name
    return found


def environment(folder: Path) -> dict[str, str]:
    """Temporary directories are made below a folder, so that what is left there can be seen."""
    return {**os.environ, "TMPDIR": str(folder)}


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    base = tmp_path_factory.mktemp("demo")
    (base / "tmp").mkdir()
    scenario = base / "short.yaml"
    plain = scenario_file.to_plain(replace(scenario_file.load("wheel"), duration_s=SHORT_S))
    scenario.write_text(yaml.safe_dump({**plain, "name": "short"}))
    done = subprocess.run(
        [*DEMO, "--scenario", str(scenario), "--seed", "5", "--out", str(base / "out"), "--json"],
        env=environment(base / "tmp"),
        capture_output=True,
        text=True,
        timeout=150.0,
        check=False,
    )
    assert list((base / "tmp").iterdir()) == []
    assert children_of(base / "tmp") == {}
    return Ended(done.returncode, base / "out", done.stdout, done.stderr)


def test_a_run_that_ends_before_the_wheel_is_on_is_not_called_assembled(ended: Ended) -> None:
    assert ended.code == 1, ended.errors
    assert ended.result["assembled"] is False
    assert ended.result["outcome"] in {"held", "retreated", "fault"}
    assert json.loads(ended.output) == ended.result


def test_the_reason_of_a_run_that_did_not_assemble_is_the_daemons_last_change(ended: Ended) -> None:
    recording = next(ended.out.glob("*.mcap"))
    changes = [str(change) for change in joined.read_changes(recording)]
    assert any("started: start ordered by" in change for change in changes)
    assert any(change in ended.result["reason"] for change in changes)


@pytest.mark.parametrize(
    ("late", "strict", "code"), [(0, True, 0), (7, False, 0), (7, True, 1), (101, False, 1)]
)
def test_late_replies_end_with_1_beyond_what_the_controller_tolerates_or_strictly_at_all(
    late: int,
    strict: bool,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def perform(*_: Any, strict: bool, **__: Any) -> dict[str, Any]:
        counts = {"late": late, "lost": 0, "refused": 0, "tolerated": 0 if strict else 100}
        result: dict[str, Any] = {
            "assembled": True,
            "outcome": "assembled",
            "control_error": {"approach": {"max_mm": 0.1, "max_mrad": 0.1}},
            "telegrams": counts,
            "limits": {"violations": 0},
        }
        short = shortfalls(result)
        return {**result, "shortfalls": short, "within_limits": not short}

    monkeypatch.setattr(demo, "perform", perform)
    words = ["demo", "--out", str(tmp_path), *(["--strict"] if strict else [])]
    assert main(words) == code
    assert f"replies: {late} late ({0 if strict else 100} tolerated)" in capsys.readouterr().out


def test_results_report_figures_and_recording_are_left(ended: Ended) -> None:
    names = {path.name for path in ended.out.iterdir()}
    assert names == {"result.json", "report.html", "fig4.png", "fig5.png", "short-seed5-12ms.mcap"}


def test_the_controller_counted_every_telegram(ended: Ended) -> None:
    counts = ended.result["telegrams"]
    sent = counts["sent"]
    lead_in_s = scenario_file.load("wheel").lead_in_s
    assert sent == pytest.approx((lead_in_s + SHORT_S) / 0.012, abs=3)
    assert counts["answered"] + counts["late"] + counts["lost"] + counts["refused"] == sent
    assert counts["refused"] == 0
    assert counts["answered"] > 0.5 * sent
    turnaround = ended.result["turnaround_us"]
    assert 0.0 < turnaround["p50"] <= turnaround["p99"] <= turnaround["max"]


def test_both_sides_tell_of_the_same_run(ended: Ended) -> None:
    steps = list(joined.read_steps(ended.out / "short-seed5-12ms.mcap"))
    answered = {step.counter for step in steps if step.counter is not None}
    counts = ended.result["telegrams"]
    # The daemon answered before the counting began, and may have been late as well.
    assert len(answered) >= counts["answered"]
    tracked = [step for step in steps if step.state == "track"]
    assert tracked
    assert any(step.inputs.camera for step in tracked)
    assert any(step.inputs.distance for step in tracked)
    assert any(step.inputs.wrench for step in tracked)
    if counts["late"] == counts["lost"] == 0:
        moved = [
            abs(tracked[-1].outputs["command"][axis] - tracked[0].outputs["command"][axis])
            for axis in range(6)
        ]
        assert max(moved) > 0.01


def test_progress_goes_to_standard_error_as_plain_lines(ended: Ended) -> None:
    assert "track" in ended.errors
    assert "\x1b[" not in ended.errors
    assert len(ended.errors.splitlines()) < 100


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_everything_that_was_started(
    tmp_path: Path, number: signal.Signals
) -> None:
    with subprocess.Popen(
        [*DEMO, "--out", str(tmp_path / "out")],
        env=environment(tmp_path),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as demo:
        # By name, for numbers deceive: until its exec, what the daemon starts is a second daemon.
        started: set[str] = set()
        end = time.monotonic() + 60.0
        while started != {"daemon.yaml", "emulator.yaml"} and time.monotonic() < end:
            time.sleep(0.05)
            started = set(children_of(tmp_path).values())
        assert started == {"daemon.yaml", "emulator.yaml"}
        demo.send_signal(number)
        _, errors = demo.communicate(timeout=60.0)
    assert demo.returncode == 130, errors
    assert children_of(tmp_path) == {}
    assert list(tmp_path.iterdir()) == []


def test_a_daemon_that_does_not_start_is_reported_with_its_own_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    sound = demo.DemoStation.daemon_file
    monkeypatch.setattr(
        demo.DemoStation, "daemon_file", lambda station: {**sound(station), "bogus": 1}
    )
    with pytest.raises(ChildError, match=r"(?s)daemon did not start.*bogus: unknown key"):
        demo.run_station(demo.DemoStation(tmp_path, Scenario()))
    assert children_of(tmp_path) == {}


def test_a_world_that_never_begins_is_blamed_on_what_kept_it_waiting() -> None:
    operator: Any = SimpleNamespace(refusal="")

    def reason(**state: Any) -> str:
        emulated: Any = SimpleNamespace(state=state)
        return demo._stalled(emulated, {"state": "init"}, operator)

    missed = {"late": 30, "lost": 12, "refused": 0, "answered": 900}
    assert "42 telegrams got no answer in time" in reason(waiting=True, telegrams=missed)
    assert reason(waiting=True, telegrams={"answered": 900}) == "the daemon is init"
    operator.refusal = "arm refused: no distance has been measured yet"
    assert reason(waiting=False, telegrams=missed) == operator.refusal


def test_a_broken_scenario_is_refused_before_anything_starts(tmp_path: Path) -> None:
    scenario = tmp_path / "broken.yaml"
    scenario.write_text("duration_s: soon\nbogus: 1\n")
    done = subprocess.run(
        [*DEMO, "--scenario", str(scenario), "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    assert done.returncode == 78
    assert "broken.yaml:1:13: duration_s" in done.stderr
    assert "broken.yaml:2:1: bogus" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_robot_on_hold_has_its_reason_on_the_screen() -> None:
    cause = "track -> idle: the task is over"
    glimpse = demo._glimpse(0.012, {"waiting": False}, {"held": "hold", "cause": cause})
    assert glimpse.held == cause
    limited = demo._glimpse(0.012, {"waiting": False}, {"held": "limited: tcp", "cause": cause})
    assert limited.held == "limited: tcp"
