"""Scenario files: YAML to ``Scenario``, and the schemas of scenario and task files.

Invariants:
    Keys are the fields of ``plants.scenario.Scenario``; a missing key keeps its default.
    All errors are reported together, each with its place.
    Ranges are here, by field name, because the plants have none.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

from linemate.daemon.config import documents, task_file
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.near_names import near_names
from linemate.simulators.devices.faults import KINDS
from linemate.simulators.harness.cell import cell_truth
from linemate.simulators.harness.world import world_rows
from linemate.simulators.plants.scenario import Scenario

DATA = Path(__file__).parent / "data"
DEFAULT = "wheel"

CYCLES_S = (0.001, 0.002, 0.004, 0.008, 0.012, 0.024)
"""Cycles whose substeps are the same for every one of them, or shorter."""

RANGES: dict[str, tuple[float | None, float | None]] = {
    "acceleration": (1e-4, 10.0),
    "nominal_speed": (1e-3, 2.0),
    "frequency_hz": (1e-3, 500.0),
    "damping": (0.0, 3.0),
    "correlation_s": (1e-3, None),
    "period_s": (1e-3, 10.0),
    "lead_in_s": (0.0, 600.0),
    "duration_s": (0.0, 1e6),
    "close_s": (1e-3, 10.0),
    "step_s": (1e-3, 10.0),
    "covariance_honesty": (1e-3, 1e3),
    "stiffness": (1.0, 1e9),
    "acceleration_limit": (1e-3, 1e4),
    "travel": (1e-6, 1.0),
    "stribeck_speed": (1e-6, 10.0),
    "presliding": (1e-7, 1.0),
    "dead_time_period_s": (0.1, 1e6),
    "frequency_share": (0.0, 0.3),
    "dead_time_amplitude": (0.0, 0.01),
    "growth_s": (0.0, 0.3),
    "balanced": (0.0, 1.0),
    "mass": (0.0, 1e6),
    "bolts": (0, 20),
    "bolt_circle": (1e-3, 1.0),
    "bolt_length": (0.0, 0.1),
    "chamfer": (0.0, 0.01),
    "clearance": (0.0, 0.01),
    "flange": (1e-3, 1.0),
    "friction": (0.0, 2.0),
    "elasticity": (1e3, 5e6),
    "contact_damping": (0.0, 2.0),
    "seat": (1e-5, 0.01),
    "tear_off": (0.0, 1e6),
    "tool_mass": (0.0, 1e4),
    "wheel_mass": (0.0, 1e4),
    "wheel_mass_spread": (0.0, 0.9),
    "bias_force": (0.0, 1e4),
    "bias_torque": (0.0, 1e4),
    "drift_force": (0.0, 1e4),
    "drift_torque": (0.0, 1e4),
    "drift_time_s": (1e-3, 1e6),
    "frequency_spread": (0.0, 0.9),
    "mass_spread": (0.0, 0.9),
    "count": (0, None),
    "seed": (0, 2**63 - 1),
    "cell_seed": (0, 2**63 - 1),
}
"""Lowest and highest value of the fields of that name; tuples item by item."""

SHARES = ("outlier_rate", "dropout_rate")
NOT_NEGATIVE = (
    "sigma",
    "delay_s",
    "jitter_s",
    "dead_time_s",
    "quantisation",
    "range",
    "depth",
    "lost_motion",
    "coulomb",
    "breakaway",
    "recovery_s",
    "compliance",
    "masses",
    "inertia",
)
"""How the names of fields begin or end that are never negative."""


def shipped() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    return tuple(sorted(path.stem for path in DATA.glob("*.yaml")))


def load(name: str, task: task_file.Task | None = None) -> Scenario:
    """Load a scenario by name, or by the path of its file.

    Args:
        task: of the emulated cell, for what the file leaves out; None: the shipped one.

    Raises:
        FileError: there is no such file, or everything that is wrong in it.
        SetupError: the emulated cell cannot be of this task.
    """
    document = _document(name)
    scenario = documents.fill(document, Scenario, complaints)
    if "name" not in document.value:
        scenario = replace(scenario, name=Path(name).stem)
    return cell_truth.placed(scenario, document.value, task or cell_truth.shipped_task())


def _document(name: str) -> documents.YamlDocument:
    """Read a scenario file, shipped or not, or a row of the world."""
    if name in world_rows.names():
        return world_rows.document(name)
    known = shipped()
    path = DATA / f"{name}.yaml" if name in known else Path(name)
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        others = near_names(name, known) or f"; shipped are {', '.join(known)}"
        raise FileError([f"{name}:1:1: (file): {why}{others}"]) from error
    return documents.read(data, str(path))


def parse(data: bytes, name: str) -> Scenario:
    """Read a scenario from YAML; the file's stem names it unless it does so itself.

    Args:
        name: of the file, for messages.

    Raises:
        FileError: every error at once, as ``file:line:col: key: what``.
    """
    document = documents.read(data, name)
    scenario = documents.fill(document, Scenario, complaints)
    return scenario if "name" in document.value else replace(scenario, name=Path(name).stem)


def to_plain(scenario: Scenario) -> dict[str, Any]:
    """Plain values that a file of this scenario would hold."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(scenario)))
    return plain


def schema(kind: str) -> dict[str, Any]:
    """JSON schema of a file.

    Raises:
        ValueError: another kind.
    """
    if kind == "task":
        return task_file.schema()
    if kind != "scenario":
        raise ValueError(f"no schema {kind!r}; there are scenario and task")
    whole = documents.schema(Scenario, "linemate scenario")
    for definition in (whole, *whole["$defs"].values()):
        _add_ranges(definition)
    return whole


def complaints(value: Any) -> Iterator[Complaint]:
    """Yield errors of the plain values of a scenario, other than their kinds."""
    yield from _out_of_range(value)
    faults = value.get("faults") if isinstance(value, dict) else None
    for i, fault in enumerate(faults if isinstance(faults, list) else ()):
        if not isinstance(fault, dict) or not {"link", "kind"} <= fault.keys():
            continue
        kinds = KINDS.get(str(fault["link"]))
        if kinds is None:
            what = f"should be one of {', '.join(KINDS)}, not {fault['link']!r}"
            yield Complaint(("faults", i, "link"), what)
        elif fault["kind"] not in kinds:
            what = f"should be one of {', '.join(kinds)}, not {fault['kind']!r}"
            yield Complaint(("faults", i, "kind"), what)


def _out_of_range(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[Complaint]:
    """Yield plain values that are out of their field's range; other kinds are ignored."""
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
            yield Complaint(path, f"should be at least {low}, not {value}")
        elif high is not None and value > high:
            yield Complaint(path, f"should be at most {high}, not {value}")
        elif name == "cycle_s" and value not in CYCLES_S:
            yield Complaint(path, f"should be one of {', '.join(map(str, CYCLES_S))}, not {value}")


@cache
def _range(name: str) -> tuple[float | None, float | None]:
    """Lowest and highest value of a field, by its name."""
    if name in RANGES:
        return RANGES[name]
    if name in SHARES:
        return 0.0, 1.0
    is_size = any(name.startswith(part) or name.endswith(part) for part in NOT_NEGATIVE)
    return (0.0 if is_size else None), None


def _add_ranges(definition: dict[str, Any]) -> None:
    for name, prop in definition.get("properties", {}).items():
        low, high = _range(name)
        for part in (prop, *prop.get("anyOf", ()), *prop.get("prefixItems", ())):
            if part.get("type") not in {"number", "integer"}:
                continue
            part.update({"minimum": low} if low is not None else {})
            part.update({"maximum": high} if high is not None else {})
