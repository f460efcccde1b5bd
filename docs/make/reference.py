"""Reference tables of configuration, parameters, task and scenarios, from the settings' classes.

Types and ranges come from annotations, units and meanings from docstrings.
"""

import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_type_hints

from linemate.daemon.config import documents, parameter_list, task_file
from linemate.daemon.config.settings import Config
from linemate.daemon.config.settings_tree import SECTIONS
from linemate.daemon.core.tracking.task import Gate, TaskFile, WaypointFrame
from linemate.simulators.devices.faults import KINDS, MEANINGS, REAL
from linemate.simulators.devices.links.emulator_config import EmulatorConfig
from linemate.simulators.harness.setup import shipped_control
from linemate.simulators.plants.scenario import Scenario

SHIPPED_TASK = Path(__file__).resolve().parents[2] / "daemon/data/wheel.yaml"
MADE = "<!-- Made by `make docs-write`; edit the settings' docstrings instead. -->\n"


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the file.

    Attributes:
        optional: it is off when left out.
        role: what it is there, by the section above.
    """

    name: str
    kind: type[Any]
    optional: bool
    is_list: bool
    role: str = ""


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a section, as text."""

    name: str
    kind: str
    default: str
    allowed: str
    meaning: str


def sections(whole: type[Any] = Config) -> Iterator[Section]:
    """Yield every section of a file, the file itself first."""
    yield Section("", whole, optional=False, is_list=False)
    yield from _below("", whole)


def _below(above: str, kind: type[Any]) -> Iterator[Section]:
    about = documents.schema(kind, kind.__name__)["properties"]
    for name, hint in get_type_hints(kind).items():
        inner, optional, is_list = _class(hint)
        if inner is not None:
            path = f"{above}{name}"
            yield Section(path, inner, optional, is_list, about[name].get("description", ""))
            yield from _below(f"{path}[]." if is_list else f"{path}.", inner)


def _class(hint: Any) -> tuple[type[Any] | None, bool, bool]:
    """Return the settings class in a hint, whether it may be None, whether it is a list."""
    if is_dataclass(hint) and isinstance(hint, type):
        return hint, False, False
    parts = get_args(hint)
    for part in parts:
        inner, optional, is_list = _class(part)
        if inner is not None:
            return (
                inner,
                optional or NoneType in parts,
                is_list or Ellipsis in parts or len(parts) > 2,
            )
    return None, False, False


def keys(section: Section) -> Iterator[Key]:
    """Yield the keys of a section that are values, not sections."""
    about = parameter_list.describe_fields(section.kind)
    hints = get_type_hints(section.kind)
    for field in fields(section.kind):
        if _class(hints[field.name])[0] is None:
            entry = about[field.name]
            yield Key(
                field.name,
                entry["type"],
                _default(field),
                _allowed(entry),
                entry.get("describe", ""),
            )


def meaning(section: Section) -> str:
    """Return the first line of a section's class."""
    return (section.kind.__doc__ or "").partition("\n")[0]


def _default(field: Any) -> str:
    if field.default is not MISSING:
        return shown(field.default)
    if field.default_factory is not MISSING:
        return shown(field.default_factory())
    return "must be given"


def shown(value: Any) -> str:
    """Return a value as a file has it."""
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, Path):
        return value.name  # A shipped file: its folder depends on the machine.
    if value is None or isinstance(value, bool):
        return {None: "none", True: "true", False: "false"}[value]
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(shown, value)) + "]"
    return str(value)


def _allowed(entry: dict[str, Any]) -> str:
    if "choices" in entry:
        return ", ".join(map(shown, entry["choices"]))
    low, high = entry.get("min"), entry.get("max")
    if low is None and high is None:
        return ""
    above, below = (
        word if bound in entry.get("excluded", ()) else ""
        for bound, word in (("min", "above "), ("max", "below "))
    )
    lowest = "" if low is None else f"{above}{shown(low)}"
    return f"{lowest} .. {'' if high is None else f'{below}{shown(high)}'}".strip()


def configuration_page() -> str:
    """Return docs/configuration.md below its head."""
    lines = []
    for section in sections():
        listed = list(keys(section))
        if section.name.partition(".")[0] in SECTIONS or not listed:
            continue
        lines += [f"## `{section.name}`" if section.name else "## The file", "", meaning(section)]
        lines += ["Left out, it is not opened."] if section.optional else []
        lines += ["", *_table(listed), ""]
    return "\n".join(lines)


def _table(listed: list[Key]) -> Iterator[str]:
    yield "| key | type | default | allowed | meaning |"
    yield "|---|---|---|---|---|"
    for key in listed:
        yield (
            f"| `{key.name}` | {key.kind} | {_cell(key.default)} | {_cell(key.allowed)} "
            f"| {_text(key.meaning)} |"
        )


def scenarios_page() -> str:
    """Return docs/scenarios.md below its head: keys of a scenario, faults, keys of an emulator."""
    lines = ["## A scenario", ""]
    for section in sections(Scenario):
        name = f"{section.name}[]" if section.is_list else section.name
        lines += [f"### `{name}`", ""] if name else []
        lines += [meaning(section), "", *_table(list(keys(section))), ""]
    lines += ["## Faults", "", "| link | kind | in real time | what happens |", "|---|---|---|---|"]
    lines += [
        f"| `{link}` | `{kind}` | {'yes' if kind in REAL.get(link, ()) else ''} "
        f"| {_text(MEANINGS[kind])} |"
        for link, kinds in KINDS.items()
        for kind in kinds
    ]
    lines += ["", "## An emulator", ""]
    for section in sections(EmulatorConfig):
        if section.name.partition(".")[0] != "scenario":
            lines += [f"### `{section.name}`", ""] if section.name else []
            lines += [meaning(section), "", *_table(list(keys(section))), ""]
    return "\n".join(lines)


def shipped_waypoints() -> Iterator[str]:
    """Yield the table of the shipped task's waypoints."""
    yield "| task time, s | phase behind it | place | gate |"
    yield "|---|---|---|---|"
    for point in task_file.load(SHIPPED_TASK).file.waypoints:
        depth = 1000.0 * point.pose.position[2]
        place = (
            "rest pose"
            if point.frame is WaypointFrame.BASE
            else f"{depth:g} mm along z of the object"
        )
        gate = "" if point.gate is Gate.NONE else f"`{point.gate}`"
        yield f"| {point.time:g} | `{point.phase}` | {place} | {gate} |"


def task_page() -> str:
    """Return docs/task.md below its head: the shipped task's waypoints, and all keys."""
    lines = ["## The shipped task", "", *shipped_waypoints(), "", "## Keys", ""]
    for section in sections(TaskFile):
        name = f"{section.name}[]" if section.is_list else section.name
        lines += [f"### `{name}`" if name else "### The file", ""]
        lines += [*textwrap.wrap(f"Here: {_text(section.role)}", 120), ""] if section.role else []
        listed = list(keys(section))
        lines += [meaning(section), "", *([*_table(listed), ""] if listed else [])]
    return "\n".join(lines)


def parameters_page() -> str:
    """Return docs/parameters.md below its head: every parameter and when it may change."""
    lines: list[str] = []
    above = None
    for entry in parameter_list.list_parameters(
        Config(task="wheel.yaml", control=shipped_control())
    ):
        name = entry["name"]
        if name.partition(".")[0] not in SECTIONS:
            continue
        parent = name.rpartition(".")[0]
        if parent != above:
            above = parent
            lines += ["", f"## `{parent}`", ""]
            lines += ["| name | default | unit | allowed | changes | meaning |"]
            lines += ["|---|---|---|---|---|---|"]
        changes = entry["change"] + (", not in contact" if entry.get("in_contact") is False else "")
        lines.append(
            f"| `{name.rpartition('.')[2]}` | {_usual(entry)} "
            f"| {entry.get('unit', '')} | {_cell(_allowed(entry))} | {changes} "
            f"| {_text(entry.get('describe', ''))} |"
        )
    return "\n".join(lines[1:]) + "\n"


def _usual(entry: dict[str, Any]) -> str:
    """Return a parameter's default in words."""
    if entry["name"].startswith("control.limits."):
        return "the URDF's"
    return _cell(shown(entry["default"]))


def _cell(text: str) -> str:
    return f"`{text}`" if text else ""


def _text(text: str) -> str:
    return text.replace("``", "`").replace("|", "\\|")
