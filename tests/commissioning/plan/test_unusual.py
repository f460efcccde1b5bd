"""Settings that `--check` passes with a caution: each cost force in a cell that has less."""

from pathlib import Path

import pytest
import yaml

from linemate.daemon.commissioning.plan.unusual import cautions
from linemate.daemon.config.config import load
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.service import main as service

SERVO = {"frequency_hz": 4.0, "damping": 0.75, "dead_time": 0.036}


def write(
    folder: Path,
    sections: dict[str, object],
    tool: dict[str, float],
    guard: dict[str, float] | None = None,
) -> Path:
    task = yaml.safe_load((DAEMON_DATA / "wheel.yaml").read_text(encoding="utf-8"))
    task["tool"] |= tool
    task["guard"] = guard or {}
    (folder / "task.yaml").write_text(yaml.safe_dump(task), encoding="utf-8")
    path = folder / "linemated.yaml"
    path.write_text(yaml.safe_dump({"task": "task.yaml", **sections}), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("sections", "tool", "line"),
    [
        (
            {"control": {"servos": [SERVO] * 6 + [SERVO | {"dead_time": 0.3}]}},
            {},
            "control.servos[6].dead_time: 0.3 s of E1 is longer than 0.15 s; `linemate identify`",
        ),
        (
            {"control": {"servos": [SERVO | {"damping": 2.9}] + [SERVO] * 6}},
            {},
            "control.servos[0].damping: 2.9 of A1 is more than 1.5, which few drives have",
        ),
        (
            {"camera": {"frame": None}},
            {},
            "camera.frame: null takes a pose of any frame for one in the camera's own frame",
        ),
        (
            {"tracking": {"payload": {"mass": 100.0}}},
            {},
            "tracking.payload.mass: 100 kg is more than twice the 26 kg that tactile.stiffness",
        ),
        (
            {"tracking": {"distance": {"delay": 0.1}}},
            {},
            "tracking.distance.delay: 0.1 s is longer than 0.02 s, and leads the tool ahead",
        ),
        (
            {"tracking": {"swing": [{"gain": 2.0}]}},
            {},
            "tracking.swing[0].gain: 2 is more than a body that hangs has, 1.5",
        ),
        (
            {"tracking": {"sway": {"gain": 2.0}}},
            {},
            "tracking.sway.gain: 2 is more than a body that hangs has, 1.5",
        ),
        (
            {
                "learning": {},
                "production": {
                    "variants": {"sedan": "task.yaml"},
                    "announced_at": -3.0,
                    "records": ".",
                },
            },
            {},
            "learning: production compiles each variant at start, so no servo model is learned",
        ),
        ({}, {"released_after": 0.001}, "tool.released_after: 0.001 s is less than a clamp needs"),
    ],
)
def test_an_unusual_setting_is_named_in_one_sentence(
    tmp_path: Path, sections: dict[str, object], tool: dict[str, float], line: str
) -> None:
    found = list(cautions(load(write(tmp_path, sections, tool))))
    assert len(found) == 1
    assert found[0].startswith(line)


def test_the_shipped_cell_has_none(tmp_path: Path) -> None:
    assert not list(cautions(load(write(tmp_path, {}, {}))))


def test_a_tolerance_that_no_tool_has_is_named(tmp_path: Path) -> None:
    wide = {"tolerance": 0.3, "angle_tolerance": 0.86}
    lines = list(cautions(load(write(tmp_path, {}, {}, wide))))
    assert [line[:32] for line in lines] == [
        "guard.tolerance: 0.3 m is more t",
        "guard.angle_tolerance: 0.86 rad ",
    ]


def test_the_check_prints_it_and_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, {"tracking": {"distance": {"delay": 0.1}}}, {})
    assert service.main(["--config", str(path), "--check"]) == service.OK
    printed = capsys.readouterr()
    assert printed.err.startswith(f"{path}: unusual: tracking.distance.delay: 0.1 s is longer")
    assert printed.out.startswith(f"{path}: good\n")
