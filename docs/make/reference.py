"""The configuration's and the parameters' reference, from the settings' own classes.

Law of this file: nothing is said here that the program does not say itself; types and ranges come
from the annotations that check a file, units and meanings from the docstrings beside them.
"""

from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_type_hints

from linemate.daemon.config import parameter_list
from linemate.daemon.config.settings import Config
from linemate.daemon.config.settings_tree import SECTIONS
from linemate.daemon.core.tracking.task import TaskFile
from linemate.simulators.devices.faults import KINDS, MEANINGS, REAL
from linemate.simulators.devices.links.emulator_config import EmulatorConfig
from linemate.simulators.harness.setup import shipped_control
from linemate.simulators.plants.scenario import Scenario

MADE = "<!-- Made by `make docs-write`; edit the settings' docstrings instead. -->\n"


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the file: its dotted name, its class, whether it is off when left out."""

    name: str
    kind: type[Any]
    optional: bool
    is_list: bool


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a section, in words."""

    name: str
    kind: str
    default: str
    allowed: str
    meaning: str


def sections(whole: type[Any] = Config) -> Iterator[Section]:
    """Every section of a file, a configuration's if no other is named; the file itself first."""
    yield Section("", whole, optional=False, is_list=False)
    yield from _below("", whole)


def _below(above: str, kind: type[Any]) -> Iterator[Section]:
    for name, hint in get_type_hints(kind).items():
        inner, optional, is_list = _class(hint)
        if inner is not None:
            path = f"{above}{name}"
            yield Section(path, inner, optional, is_list)
            yield from _below(f"{path}[]." if is_list else f"{path}.", inner)


def _class(hint: Any) -> tuple[type[Any] | None, bool, bool]:
    """The settings class in a hint, whether None may stand for it, whether there are several."""
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
    """The keys of a section that are values, not sections."""
    about = parameter_list.describe_fields(section.kind)
    hints = get_type_hints(section.kind)
    for field in fields(section.kind):
        if _class(hints[field.name])[0] is None:
            told = about[field.name]
            yield Key(
                field.name,
                told["type"],
                _default(field),
                _allowed(told),
                told.get("describe", ""),
            )


def meaning(section: Section) -> str:
    """The first sentence of a section's class."""
    return (section.kind.__doc__ or "").partition("\n")[0]


def _default(field: Any) -> str:
    if field.default is not MISSING:
        return shown(field.default)
    if field.default_factory is not MISSING:
        return shown(field.default_factory())
    return "must be given"


def shown(value: Any) -> str:
    """A value as a file has it."""
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, Path):
        return value.name  # a shipped one: where it lies is this machine's affair
    if value is None or isinstance(value, bool):
        return {None: "none", True: "true", False: "false"}[value]
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(shown, value)) + "]"
    return str(value)


def _allowed(told: dict[str, Any]) -> str:
    if "choices" in told:
        return ", ".join(map(shown, told["choices"]))
    low, high = told.get("min"), told.get("max")
    if low is None and high is None:
        return ""
    return f"{'' if low is None else shown(low)} .. {'' if high is None else shown(high)}".strip()


def configuration_page() -> str:
    """docs/configuration.md, below its hand-written head."""
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
    """docs/scenarios.md, below its hand-written head: a scenario's keys, faults, an emulator's."""
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


def task_page() -> str:
    """The tables of docs/task.md: a task file's keys."""
    lines = []
    for section in sections(TaskFile):
        name = f"{section.name}[]" if section.is_list else section.name
        lines += [f"### `{name}`" if name else "### The file", ""]
        lines += [meaning(section), "", *_table(list(keys(section))), ""]
    return "\n".join(lines)


def parameters_page() -> str:
    """The tables of docs/parameters.md: every parameter with its default and when it may change."""
    lines: list[str] = []
    above = None
    for told in parameter_list.list_parameters(
        Config(task="wheel.yaml", control=shipped_control())
    ):
        name = told["name"]
        if name.partition(".")[0] not in SECTIONS:
            continue
        parent = name.rpartition(".")[0]
        if parent != above:
            above = parent
            lines += ["", f"## `{parent}`", ""]
            lines += ["| name | default | unit | allowed | changes | meaning |"]
            lines += ["|---|---|---|---|---|---|"]
        changes = told["change"] + (", not in contact" if told.get("in_contact") is False else "")
        lines.append(
            f"| `{name.rpartition('.')[2]}` | {_usual(told)} "
            f"| {told.get('unit', '')} | {_cell(_allowed(told))} | {changes} "
            f"| {_text(told.get('describe', ''))} |"
        )
    return "\n".join(lines[1:]) + "\n"


def _usual(told: dict[str, Any]) -> str:
    """A parameter's default in words."""
    if told["name"].startswith("control.limits."):
        return "the URDF's"
    return _cell(shown(told["default"]))


def _cell(text: str) -> str:
    return f"`{text}`" if text else ""


def _text(text: str) -> str:
    return text.replace("``", "`").replace("|", "\\|")
