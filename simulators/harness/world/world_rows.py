"""Rows of the realistic world: a scenario each, and the daemon's settings for it.

Invariants:
    Truth and settings stand apart: ``truth`` is for the plant, ``daemon`` for the daemon.
    ``daemon`` holds only what somebody who commissions the cell measures or reads.
    Rows are in the order of the file.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from linemate.daemon.config import documents
from linemate.daemon.config.documents import FileError, YamlDocument

DATA = Path(__file__).parents[1] / "data"
ROWS = DATA / "world" / "rows.yaml"
PARAMETERS = DATA / "parameters"
PREFIX = "world/"

TRUTH, DAEMON = "truth", "daemon"
COMMISSIONED = "commissioned"
_KEYS = {"what", "base", COMMISSIONED, TRUTH, DAEMON}


@dataclass(frozen=True, slots=True)
class WorldRow:
    """One row.

    Attributes:
        what: what the plant does, in one line.
        truth: plain values of the scenario file.
        commissioned: name of the overlay that the cell was commissioned with.
        daemon: overlay of the daemon's settings over it.
    """

    name: str
    what: str
    truth: Mapping[str, Any]
    commissioned: str
    daemon: Mapping[str, Any]


@cache
def rows() -> dict[str, WorldRow]:
    """Return the rows by name.

    Raises:
        FileError: the file cannot be read.
    """
    document = documents.read(ROWS.read_bytes(), str(ROWS))
    lines = document.lines(document.complaints)
    base, listed = document.value["base"], document.value["rows"]
    by_name: dict[str, WorldRow] = {}
    for name, row in listed.items():
        lines += [f"{ROWS}:1:1: rows.{name}.{key}: unknown key" for key in row if key not in _KEYS]
        below = _read(row["base"]) if "base" in row else base
        truth = laid_over(below, row.get(TRUTH) or {})
        commissioned = row.get(COMMISSIONED, document.value[COMMISSIONED])
        by_name[name] = WorldRow(name, row["what"], truth, commissioned, row.get(DAEMON) or {})
    if lines:
        raise FileError(lines)
    return by_name


def names() -> tuple[str, ...]:
    """Names of the rows as scenarios: ``world/NAME``."""
    return tuple(PREFIX + name for name in rows())


def document(scenario: str) -> YamlDocument:
    """Return the scenario file of ``world/NAME``."""
    row = rows()[scenario.removeprefix(PREFIX)]
    return YamlDocument(f"{ROWS}: {row.name}", {**row.truth, "name": scenario})


def daemon_settings(scenario: str) -> Mapping[str, Any]:
    """Return the overlay of the daemon's settings that belongs to a scenario, or an empty one.

    For a row it stands in the row, for a scenario file in ``data/parameters`` under its name.
    """
    if scenario.startswith(PREFIX):
        row = rows().get(scenario.removeprefix(PREFIX))
        return {} if row is None else laid_over(_overlay(row.commissioned), row.daemon)
    path = PARAMETERS / f"{scenario}.yaml"
    # A path of somebody's own file names no settings of ours.
    return _overlay(scenario) if path.parent == PARAMETERS and path.exists() else {}


def _overlay(name: str) -> dict[str, Any]:
    """Return an overlay of ``data/parameters``."""
    return _read(name, PARAMETERS / f"{name}.yaml")


def laid_over(below: Any, above: Any) -> Any:
    """Return plain values with others over them; mappings are merged, the rest is replaced.

    A mapping over a list changes the items that it names by their index.
    """
    if isinstance(below, list) and isinstance(above, Mapping):
        return [laid_over(item, above.get(str(i), {})) for i, item in enumerate(below)]
    if not isinstance(below, Mapping) or not isinstance(above, Mapping):
        return above if above != {} else below
    return {**below, **{key: laid_over(below.get(key, {}), above[key]) for key in above}}


def _read(name: str, path: Path | None = None) -> dict[str, Any]:
    source = path or DATA / f"{name}.yaml"
    document = documents.read(source.read_bytes(), str(source))
    if document.complaints:
        raise FileError(document.lines(document.complaints))
    plain: dict[str, Any] = json.loads(json.dumps(document.value))
    return plain
