"""The check of a configuration with everything that it names."""

import shutil
from pathlib import Path

import pytest

from linemate.daemon.commissioning import whole_check
from linemate.daemon.config import overlays
from linemate.daemon.config.documents import FileError
from linemate.simulators.harness.cell.cell_files import DATA


def test_what_is_wrong_with_the_arm_is_reported_in_the_task_file(tmp_path: Path) -> None:
    site = shutil.copytree(DATA / "kr10", tmp_path / "site")
    task = site / "task.yaml"
    text = task.read_text(encoding="utf-8")
    task.write_text(text.replace("flange: flange", "flange: tool0"), encoding="utf-8")
    with pytest.raises(FileError) as refused:
        whole_check.check(site / "linemated.yaml")
    (line,) = refused.value.lines
    assert line.startswith(f"{task}:9:3: arm: the URDF has no frame 'tool0'")


@pytest.mark.parametrize(
    ("saved", "guilty"),
    [
        (
            "tracking:\n  bank: {penalty: 6.0}\n  distance:\n    deviation: 0.01\n"
            "watch: {missed_s: 0.04}\n",
            ["4:16: tracking.distance.deviation"],
        ),
        # Each alone is good, both together are not.
        (
            "tracking:\n  distance:\n    deviation: 0.001\n  bank:\n    perceived: 20.0\n",
            ["3:16: tracking.distance.deviation", "5:16: tracking.bank.perceived"],
        ),
    ],
)
def test_a_start_names_the_saved_parameters_that_keep_it_from_running(
    tmp_path: Path, saved: str, guilty: list[str]
) -> None:
    path, state = tmp_path / "linemated.yaml", tmp_path / overlays.NAME
    path.write_text("task: wheel.yaml\nstate: .\n")
    whole_check.check(path)
    state.write_text(saved)
    with pytest.raises(FileError) as refused:
        whole_check.check(path)
    first, *named = refused.value.lines
    assert "guard.tolerance" in first
    assert [line.partition(": saved by")[0] for line in named] == [f"{state}:{g}" for g in guilty]
    assert named[0].endswith(
        "without it the configuration is good. Delete it here, or the file to drop everything "
        "that was saved."
    )


@pytest.mark.parametrize("saved", ["tracking: {bank: {penalty: 6.0}}\n", "# nothing\n"])
def test_saved_parameters_are_not_blamed_for_what_the_files_lack(
    tmp_path: Path, saved: str
) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\nstate: .\ntracking: {distance: {deviation: 0.01}}\n")
    (tmp_path / overlays.NAME).write_text(saved)
    with pytest.raises(FileError) as refused:
        whole_check.check(path)
    (line,) = refused.value.lines
    assert "guard.tolerance" in line
