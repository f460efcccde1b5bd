"""Scenario files: YAML to the plants' Scenario, and the schemas of scenario and task files.

Law of this file: the file's keys are the fields of ``plants.scenario.Scenario`` and nothing else;
what a file leaves out keeps its default. Every error comes at once, with its place in the file.
The plants carry no ranges of their own, so the ranges stand here, by a field's name.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from linemate.daemon.tracking.task import TaskFile
from linemate.simulators.harness import located
from linemate.simulators.harness.located import Document, FileError
from linemate.simulators.plants.scenario import Scenario

__all__ = ["DATA", "DEFAULT", "FileError", "check", "load", "parse", "schema", "shipped"]

DATA = Path(__file__).parent / "data"
DEFAULT = "wheel"

CYCLES_S = (0.001, 0.002, 0.004, 0.008, 0.012)
"""Cycles that the plant's substep divides."""

RANGES: dict[str, tuple[float | None, float | None]] = {
    "acceleration": (1e-4, 10.0),
    "nominal_speed": (1e-3, 2.0),
    "frequency_hz": (1e-3, 500.0),
    "damping": (0.0, 3.0),
    "correlation_s": (1e-3, None),
    "phase": (None, None),
    "period_s": (1e-3, 10.0),
    "cycle_s": (min(CYCLES_S), max(CYCLES_S)),
    "lead_in_s": (0.0, 600.0),
    "duration_s": (0.0, 1e6),
    "close_s": (1e-3, 10.0),
    "step_s": (1e-3, 10.0),
    "covariance_honesty": (1e-3, 1e3),
    "stiffness": (1.0, 1e9),
    "acceleration_limit": (1e-3, 1e4),
    "count": (0, None),
    "seed": (0, 2**63 - 1),
}
"""Lowest and highest value of the fields of that name; tuples item by item."""

NOT_NEGATIVE = ("rate", "sigma", "delay_s", "jitter_s", "dead_time_s", "quantisation", "range")
SHARES = ("rate", "outlier_rate", "dropout_rate")


class _ScenarioFile(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    scenario: Scenario


class _TaskFile(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    task: TaskFile


def shipped() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    return tuple(sorted(path.stem for path in DATA.glob("*.yaml")))


def load(name: str) -> Scenario:
    """Load a scenario by name, or by the path of its file.

    Raises:
        FileError: there is no such file, or what is wrong in it.
    """
    path = DATA / f"{name}.yaml" if name in shipped() else Path(name)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        known = ", ".join(shipped())
        raise FileError([f"{name}:1:1: (whole file): {error}; shipped are {known}"]) from error
    return parse(text, path.name if name in shipped() else name)


def parse(text: str, file: str) -> Scenario:
    """Read a scenario from YAML.

    Args:
        text: of the file.
        file: its name, for messages.

    Raises:
        FileError: every error at once, as ``file:line:col: key: what``.
    """
    return from_document(located.read(text, file))


def from_document(document: Document) -> Scenario:
    """Fill a scenario from plain values; the file's stem names it unless it does so itself."""
    model = located.validate(document, _ScenarioFile, "scenario", _out_of_range)
    scenario = model.scenario
    if "name" in document.value:
        return scenario
    return replace(scenario, name=Path(document.file).stem)


def check(plain: dict[str, Any], source: str) -> None:
    """Refuse plain values that are out of range, where they do not come from a file.

    Raises:
        FileError: every error at once; ``source`` stands for the file.
    """
    document = Document(source, plain, {})
    complaints = [document.line(path, what) for path, what in _out_of_range(plain)]
    if complaints:
        raise FileError(complaints)


def to_plain(scenario: Scenario) -> dict[str, Any]:
    """Plain values that a file of this scenario would hold."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(scenario)))
    return plain


def schema(kind: str) -> dict[str, Any]:
    """JSON schema of a file.

    Args:
        kind: "scenario" or "task".

    Raises:
        KeyError: another kind.
    """
    models: dict[str, type[BaseModel]] = {"scenario": _ScenarioFile, "task": _TaskFile}
    whole = models[kind].model_json_schema()
    definitions = whole["$defs"]
    root = definitions.pop("Scenario" if kind == "scenario" else "TaskFile")
    if kind == "scenario":
        for definition in (root, *definitions.values()):
            _add_ranges(definition)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **root,
        "$defs": definitions,
    }


def _range(name: str) -> tuple[float | None, float | None]:
    """Lowest and highest value of a field, by its name."""
    if name in RANGES:
        return RANGES[name]
    if name in SHARES:
        return 0.0, 1.0
    negative = not any(name.endswith(end) or name.startswith(end) for end in NOT_NEGATIVE)
    return (None if negative else 0.0), None


def _out_of_range(value: Any, path: located.Path = ()) -> Iterator[tuple[located.Path, str]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _out_of_range(item, (*path, key))
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from _out_of_range(item, (*path, i))
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        name = next((part for part in reversed(path) if isinstance(part, str)), "")
        low, high = _range(name)
        if low is not None and value < low:
            yield path, f"should be at least {low}, not {value}"
        elif high is not None and value > high:
            yield path, f"should be at most {high}, not {value}"
        elif name == "cycle_s" and value not in CYCLES_S:
            yield path, f"should be one of {', '.join(map(str, CYCLES_S))}, not {value}"


def _add_ranges(definition: dict[str, Any]) -> None:
    for name, prop in definition.get("properties", {}).items():
        low, high = _range(name)
        for part in (prop, *prop.get("anyOf", ()), *prop.get("prefixItems", ())):
            if part.get("type") not in {"number", "integer"}:
                continue
            part.update({"minimum": low} if low is not None else {})
            part.update({"maximum": high} if high is not None else {})
