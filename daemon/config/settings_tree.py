"""Settings by dotted names: ``control.servos.3.damping`` is one value of a tree of dataclasses.

Invariants:
- A change is read as strictly as a file. It gives a new frozen set, or is refused as a whole.
- An error is reported as ``name: what``.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from typing import Any

from linemate.daemon.config import documents
from linemate.daemon.config.documents import FileError, YamlDocument
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.near_names import near_names


class SettingError(ValueError):
    """A change that cannot be made; the message says which and why."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings that can change without opening a link again."""

    tracking: TrackingSettings
    control: ControlSettings
    watch: WatchSettings


SECTIONS: dict[str, type[Any]] = {
    "tracking": TrackingSettings,
    "control": ControlSettings,
    "watch": WatchSettings,
}


def plain(value: Any) -> Any:
    """Return settings as plain values: dict, list, number, text, bool, None."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, (tuple, list)):
        return [plain(item) for item in value]
    return value


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value with its dotted name; a list of plain values is one value."""
    if is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from leaves(getattr(value, field.name), _joined(name, field.name))
    elif isinstance(value, tuple) and value and is_dataclass(value[0]):
        for index, item in enumerate(value):
            yield from leaves(item, _joined(name, str(index)))
    else:
        yield name, plain(value)


def laid_over(settings: Settings, path: Sequence[Any], value: Any) -> Settings:
    """Return settings with one value of an overlay.

    Args:
        path: keys from the section on; a list is one value.
    """
    section, *keys = path
    for key in reversed(keys):
        value = {key: value}
    whole = merge(plain(getattr(settings, section)), value)
    return replace(settings, **{section: read_section(section, whole)})


def change(settings: Settings, values: Mapping[str, Any]) -> Settings:
    """Return settings with some values changed, by dotted name.

    Raises:
        SettingError: every unknown name, or every value that does not fit.
    """
    trees = {
        section: plain(getattr(settings, section))
        for section in {name.partition(".")[0] for name in values}
        if section in SECTIONS
    }
    wrong = [name for name, value in values.items() if not _replace(trees, name.split("."), value)]
    if wrong:
        known = [name for name, _ in leaves(settings)]
        raise SettingError(
            "; ".join(f"no parameter {name}{near_names(name, known)}" for name in wrong)
        )
    sections, errors = {}, []
    for section, tree in trees.items():
        try:
            sections[section] = read_section(section, tree)
        except SettingError as error:
            errors.append(str(error))
    if errors:
        raise SettingError("; ".join(errors))
    return Settings(
        tracking=sections.get("tracking", settings.tracking),
        control=sections.get("control", settings.control),
        watch=sections.get("watch", settings.watch),
    )


def read_section(section: str, tree: Any) -> Any:
    """Return a section's settings from plain values.

    Raises:
        SettingError: everything that does not fit.
    """
    try:
        return documents.fill(YamlDocument(section, tree), SECTIONS[section])
    except FileError as error:
        messages = (line.removeprefix(f"{section}:1:1: ") for line in error.lines)
        raise SettingError("; ".join(f"{section}.{_dotted(line)}" for line in messages)) from error


def merge(tree: Any, overlay: Any) -> Any:
    """Return plain values with an overlay: mappings are merged, all else is replaced."""
    if isinstance(tree, dict) and isinstance(overlay, dict):
        both = {**tree, **{key: value for key, value in overlay.items() if key not in tree}}
        for key in tree.keys() & overlay.keys():
            both[key] = merge(tree[key], overlay[key])
        return both
    return overlay


def difference(tree: Any, base: Any) -> Any:
    """Return the overlay that turns ``base`` into ``tree``, an empty dict if they are equal."""
    if isinstance(tree, dict) and isinstance(base, dict):
        parts = {key: difference(tree[key], base.get(key)) for key in tree}
        return {key: part for key, part in parts.items() if part != {}}
    return {} if tree == base and type(tree) is type(base) else tree


def _replace(tree: Any, path: list[str], value: Any) -> bool:
    """Replace a value; return False if the path has none, or a branch."""
    branch = tree
    for part in path[:-1]:
        branch = _below(branch, part)
    old = _below(branch, path[-1])
    if old is _NOTHING or _is_branch(old):
        return False
    new = list(value) if isinstance(value, tuple) else value
    if isinstance(branch, list):
        branch[int(path[-1])] = new
    else:
        branch[path[-1]] = new
    return True


_NOTHING = object()


def _below(branch: Any, part: str) -> Any:
    if isinstance(branch, dict):
        return branch.get(part, _NOTHING)
    if isinstance(branch, list) and _is_branch(branch) and part.isdecimal():
        return branch[int(part)] if int(part) < len(branch) else _NOTHING
    return _NOTHING


def _is_branch(value: Any) -> bool:
    """Return whether a value has parts with names; a list of plain values has none."""
    if isinstance(value, list):
        return bool(value) and isinstance(value[0], dict)
    return isinstance(value, dict)


def _dotted(line: str) -> str:
    """Return ``servos[3].damping: what`` as ``servos.3.damping: what``."""
    path, colon, what = line.partition(": ")
    return path.replace("[", ".").replace("]", "") + colon + what


def _joined(name: str, part: str) -> str:
    return f"{name}.{part}" if name else part


def read_file(data: bytes, name: str) -> dict[str, Any]:
    """Return a YAML file's plain values, without checking keys and ranges.

    Raises:
        SettingError: everything that is wrong with it.
    """
    try:
        document = documents.read(data, name)
    except FileError as error:
        raise SettingError(str(error)) from error
    if document.complaints:
        raise SettingError("\n".join(document.lines(document.complaints)))
    value: dict[str, Any] = document.value
    return value
