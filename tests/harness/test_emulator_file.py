"""An emulator's file is read strictly, and its paths are relative to it."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from linemate.daemon.config.documents import FileError
from linemate.daemon.config.files import PROTOCOL_DATA
from linemate.simulators.harness import emulator_command as emulator


def test_names_seeds_and_paths_are_taken_from_the_file(tmp_path: Path) -> None:
    path = tmp_path / "emulator.yaml"
    path.write_text(
        "scenario: wheel\nseed: 7\ncycle_ms: 4\npriority: 60\ncan_link: can\n"
        "robot_target: [127.0.0.1, 50000]\ntruth: /elsewhere/truth.npz\n"
    )
    config, wishes = emulator.load(path)
    assert config.scenario.seed == 7
    assert config.scenario.cycle_s == 0.004
    assert config.can_link == tmp_path / "can"
    assert config.truth == Path("/elsewhere/truth.npz")
    assert config.robot_target == ("127.0.0.1", 50000)
    assert wishes == emulator.Wishes(60, ())


def test_a_row_of_the_world_is_taken_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "emulator.yaml"
    path.write_text("scenario: world/sway-1.0hz\n")
    config, _ = emulator.load(path)
    assert config.scenario.body.carrier[0].frequency_hz == 1.0


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("bogus: 1", "1:1: bogus: unknown key"),
        ("seed: x\ncycle_ms: soon", "2:11: cycle_ms"),
        ("scenario: nowhere.yaml", "nowhere.yaml"),
        ("robot_target: [127.0.0.1]", "robot_target"),
    ],
)
def test_what_is_wrong_is_reported_with_its_place(
    text: str, complaint: str, tmp_path: Path
) -> None:
    path = tmp_path / "emulator.yaml"
    path.write_text(text + "\n")
    with pytest.raises(FileError, match=complaint):
        emulator.load(path)


def test_a_bare_name_is_the_file_next_to_it_or_else_a_shipped_one(tmp_path: Path) -> None:
    path = tmp_path / "emulator.yaml"
    path.write_text("rsi_xml: rsi_joints.xml\ndbc: distance.dbc\n")
    config, _ = emulator.load(path)
    assert config.rsi_xml == PROTOCOL_DATA / "rsi_joints.xml"
    (tmp_path / "rsi_joints.xml").write_text("own")
    config, _ = emulator.load(path)
    assert config.rsi_xml == tmp_path / "rsi_joints.xml"
    assert config.dbc == PROTOCOL_DATA / "distance.dbc"


def test_a_file_that_is_nowhere_is_named_with_its_place_and_the_shipped_ones(
    tmp_path: Path,
) -> None:
    path = tmp_path / "emulator.yaml"
    path.write_text("seed: 1\nrsi_xml: gone.xml\n")
    with pytest.raises(FileError, match=r"emulator\.yaml:2:10: rsi_xml: no such.*rsi_joints\.xml"):
        emulator.load(path)


def test_the_schema_knows_every_key_with_its_meaning() -> None:
    properties = emulator.schema()["properties"]
    assert {"scenario", "seed", "rsi_xml", "egm", "controller", "cpus"} <= properties.keys()
    assert all(value.get("description") for value in properties.values())


def test_an_exchange_that_broke_off_ends_with_1_and_its_reason(tmp_path: Path) -> None:
    path = tmp_path / "emulator.yaml"
    scenario = tmp_path / "short.yaml"
    scenario.write_text("cycle_s: 0.004\nlead_in_s: 0.1\nduration_s: 0.2\n")
    path.write_text("scenario: short.yaml\ncontroller: {timeout: 20}\n")
    command = [sys.executable, "-m", "linemate.simulators.harness.main", "emulator"]
    done = subprocess.run(
        [*command, "--config", str(path)], check=False, capture_output=True, text=True, timeout=60.0
    )
    assert json.loads(done.stdout.splitlines()[-1])["broken"].startswith("KSS29002")
    assert done.returncode == 1
    assert "broke the exchange off: KSS29002" in done.stderr


def test_a_missing_file_is_an_error_with_its_name(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"gone\.yaml:1:1"):
        emulator.load(tmp_path / "gone.yaml")


def test_the_process_tells_where_everything_is_and_ends_on_order(tmp_path: Path) -> None:
    path = tmp_path / "emulator.yaml"
    path.write_text("can_link: can\nserial_link: ft\ntruth: truth.npz\nwait_answered: 10\n")
    command = [sys.executable, "-m", "linemate.simulators.harness.main", "emulator"]
    with subprocess.Popen(
        [*command, "--config", str(path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert ready["event"] == "ready"
        assert os.path.realpath(ready["can"]["channel"]).startswith("/dev/pts/")
        process.send_signal(signal.SIGTERM)
        states = [json.loads(line) for line in process.stdout]
        assert process.wait(20.0) == 0
    assert states[-1]["event"] == "end"
    assert (tmp_path / "truth.npz").exists()
