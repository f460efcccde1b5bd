"""The check of a configuration with everything that it names."""

import shutil
from pathlib import Path

import pytest

from linemate.daemon.commissioning import whole_check
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
