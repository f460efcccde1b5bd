"""A copy of a shipped cell that is commissioned by the operator's command."""

import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import yaml

from linemate.daemon.commissioning import walk
from linemate.daemon.commissioning.walk import StepName, StepRecordOfSite
from linemate.simulators.harness.cell import cell_files

TOOL_MASS: Final = {"wheel": 40.0, "kr10": 6.0}  # hung on the sensor in the step force [kg]


def copied(name: str, folder: Path) -> Path:
    """Copy the folder of a shipped cell; return the copy."""
    return Path(shutil.copytree(cell_files.DATA / name, folder / name))


def commission(site: Path, step: StepName, *words: object) -> StepRecordOfSite:
    """Run a step of ``linemate commission``; return what is kept of it."""
    command = [sys.executable, "-m", "linemate.daemon.operator.main", "commission", str(site)]
    command += ["--step", step.value, *map(str, words)]
    subprocess.run(command, check=False, stdout=sys.stderr)  # noqa: S603 - words are our own
    return walk.from_text((site / "commission" / "progress.json").read_text()).of(step)


def overlay(site: Path, step: StepName) -> Mapping[str, Any]:
    """Return the plain values of the overlay that a step has written."""
    text = (site / "commission" / f"{step.value}.yaml").read_text(encoding="utf-8")
    values: dict[str, Any] = yaml.safe_load(text)
    return values
