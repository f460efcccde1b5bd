"""The tutorial of commissioning: its quick commands run in a copy of its folder, as shown."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from linemate.simulators.harness.cell import cell_files

PAGE = Path(__file__).resolve().parents[2] / "docs" / "commissioning.md"
TUTORIAL = PAGE.read_text(encoding="utf-8").partition("## With the robot")[0]
LINES = [
    line
    for block in re.findall(r"^```sh host\n(.*?)^```", TUTORIAL, re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
]
MODULES = {"linemated": "daemon.service.main", "linemate": "daemon.operator.main"}


def ran(line: str, folder: Path) -> str:
    """Return what a line of the page prints, run in a folder with ``site``."""
    words = shlex.split(line)
    name = Path(words[0]).name
    if name in MODULES:
        words = [sys.executable, "-m", f"linemate.{MODULES[name]}", *words[1:]]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    copies = [shlex.split(line) for line in LINES if line.startswith("cp ")]
    assert {PAGE.parents[1] / source for _, _, source, _ in copies} == {
        cell_files.DATA / name for name in cell_files.shipped()
    }
    _, _, source, target = copies[0]
    shutil.copytree(PAGE.parents[1] / source, tmp_path / target)
    return tmp_path


def test_the_files_of_the_table_are_those_of_the_folder() -> None:
    listed = set(re.findall(r"^\| `([\w.]+)` \|", TUTORIAL, re.MULTILINE))
    assert listed == {file.name for file in (cell_files.DATA / "kr10").iterdir()}


def test_both_checks_say_what_the_page_says(folder: Path) -> None:
    check, lint = (
        line for line in LINES[:4] if "linemated --check" in line or " rsi lint " in line
    )
    assert ran(check, folder).startswith("site/linemated.yaml: good\n")
    assert ran(lint, folder) == "site/rsi.xml: good\n"


def test_what_does_not_fit_is_refused_as_shown(folder: Path) -> None:
    quicker, check, slower = LINES[5:8]
    before = (folder / "site" / "task.yaml").read_text()
    ran(quicker, folder)
    refused = ran(check, folder)
    shown = re.findall(r"^`(the arm does not reach [^`]*)`", TUTORIAL, re.MULTILINE)
    assert len(shown) == 1
    assert shown[0] in refused
    assert refused.startswith("site/task.yaml:")
    ran(slower, folder)
    assert (folder / "site" / "task.yaml").read_text() == before
