"""Overlay of identified parameters over the daemon's settings of a run.

Invariants:
    Sections: ``tracking``, ``control`` and ``task.arm.camera_in_tcp``.
    An overlay that changes the scenario is refused.
    A list replaces the whole old list.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from linemate.daemon.config import documents
from linemate.daemon.config.documents import FileError
from linemate.simulators.devices.worlds import MUJOCO, OWN
from linemate.simulators.harness.cell.families import EGM

_DATA = Path(__file__).with_name("data")
_FOLDER = _DATA / "parameters"
SHIPPED = {OWN: _DATA / "cells/wheel/identified.yaml", MUJOCO: _FOLDER / "mujoco.yaml"}
"""What was identified of the default cell of each world, by `identify_run`, from recordings."""

BEHIND = {EGM: _FOLDER / "egm.yaml"}
"""What was identified of the servos behind a family's controller, not the default."""

SECTIONS = ("tracking", "control", "task")


def load(path: Path = SHIPPED[OWN]) -> dict[str, Any]:
    """Return an overlay's plain values.

    Raises:
        FileError: no file, no YAML, or a section that is none of a daemon's.
    """
    document = documents.read(documents.content(path), str(path))
    lines = document.lines(document.complaints)
    value = document.value if isinstance(document.value, dict) else {}
    lines += [f"{path}:1:1: {key}: unknown section" for key in value if key not in SECTIONS]
    if lines:
        raise FileError(lines)
    return value


def leaves(overlay: Mapping[str, Any], path: str = "") -> list[tuple[str, Any]]:
    """Return an overlay's values by path; a list is one value."""
    values: list[tuple[str, Any]] = []
    for key, value in overlay.items():
        here = f"{path}.{key}" if path else str(key)
        values += leaves(value, here) if isinstance(value, Mapping) else [(here, value)]
    return values
