"""Strict YAML reader: frozen dataclasses, or every error at once with its line and column.

Invariants:
- Any bytes give values or complaints.
- A plain value that YAML 1.1 and 1.2 read differently is refused: ``no``, ``010``, ``12:30``,
  ``1_000``, a date. ``1e-3`` is a number.
- Duplicate keys, unknown keys and numbers that are not finite are errors.
"""

import math
import pathlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import yaml

from linemate.daemon.config import files
from linemate.daemon.config.files import UnreadableError
from linemate.daemon.config.reading import accepted
from linemate.daemon.config.reading.complaints import Complaint, Path, Place

T = TypeVar("T")

MAX_BYTES = 262_144
MAX_NODES = 20_000
MAX_DEPTH = 20

_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_BOOL = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,30})|0x[0-9a-fA-F]{1,16}")
_FLOAT = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.?(inf|nan|infinity)", re.IGNORECASE)
_AMBIGUOUS = (
    (re.compile(r"y|n|yes|no|on|off", re.IGNORECASE), "true, false or a quoted text"),
    (re.compile(r"[-+]?0[0-9]+|0[ob][0-9]+"), "a number without leading zeros or a quoted text"),
    (re.compile(r"[-+]?[0-9]+(:[0-5]?[0-9])+(\.[0-9]*)?"), "a quoted text"),
    (re.compile(r"[-+]?[0-9][0-9.]*_[0-9_.]*"), "a number without separators or a quoted text"),
    (re.compile(r"[0-9]{4}-[0-9]{1,2}-[0-9]{1,2}([Tt ].*)?"), "a quoted text"),
)


class FileError(Exception):
    """Everything that is wrong with one file or several.

    Attributes:
        lines: one ``file:line:col: key: what`` an error.
    """

    def __init__(self, lines: Sequence[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = tuple(lines)


@dataclass(slots=True)
class YamlDocument:
    """What a file says.

    Attributes:
        name: of the file, for messages.
        value: plain values: dict, list, str, int, float, bool, None.
        values, keys: where each value and each key stands.
        complaints: what could not be read.
    """

    name: str
    value: Any = None
    values: dict[Path, Place] = field(default_factory=dict)
    keys: dict[Path, Place] = field(default_factory=dict)
    complaints: list[Complaint] = field(default_factory=list)

    def place(self, complaint: Complaint) -> Place:
        """Return the nearest known place of a complaint."""
        path = complaint.path
        if complaint.place is not None:
            return complaint.place
        if complaint.at_key and path in self.keys:
            return self.keys[path]
        while path and path not in self.values:
            path = path[:-1]
        return self.values.get(path, (1, 1))

    def line(self, complaint: Complaint) -> str:
        """Return a complaint as ``file:line:col: key: what``."""
        line, column = self.place(complaint)
        return f"{self.name}:{line}:{column}: {spelled(complaint.path)}: {complaint.what}"

    def lines(self, complaints: Iterable[Complaint]) -> list[str]:
        """Return complaints in the order of their places, without duplicates."""
        ordered = sorted(complaints, key=lambda c: (self.place(c), spelled(c.path)))
        return list(dict.fromkeys(map(self.line, ordered)))


def spelled(path: Path) -> str:
    """Return a path as an operator writes it: ``waypoints[2].time``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text or "(file)"


def content(path: pathlib.Path) -> bytes:
    """Return a document's bytes.

    Raises:
        FileError: it cannot be read.
    """
    try:
        return files.read(path, MAX_BYTES)
    except UnreadableError as error:
        raise FileError([f"{path}:1:1: (file): {error}"]) from error


def read(data: bytes, name: str) -> YamlDocument:
    """Read YAML and the places of its values.

    Args:
        name: of the file, for messages.

    Returns:
        A document; what could not be read stands in its complaints.

    Raises:
        FileError: not UTF-8, not YAML, or beyond reason.
    """
    if len(data) > MAX_BYTES:
        raise FileError([f"{name}:1:1: (file): longer than {MAX_BYTES} bytes"])
    text = _decoded(data, name)
    try:
        node = yaml.compose(text, Loader=yaml.BaseLoader)
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        # ValueError: PyYAML lets chr() speak of an escape beyond Unicode.
        raise FileError([_not_yaml(error, text, name)]) from error
    except RecursionError as error:
        raise FileError([f"{name}:1:1: (file): nested too deep"]) from error
    document = YamlDocument(name, {})
    if node is not None:
        _Walk(document).whole(node)
    return document


def fill(
    document: YamlDocument,
    target: type[T],
    check: Callable[[Any], Iterable[Complaint]] = lambda _: (),
) -> T:
    """Return a dataclass with a document's values: no unknown key, no text for a number.

    Args:
        target: a dataclass of dataclasses with annotated ranges.
        check: yields further complaints about the plain values, which may be of any kind.

    Raises:
        FileError: every error at once.
    """
    complaints = list(document.complaints)
    filled = accepted.filled(target, document.value)
    if filled is None:
        from linemate.daemon.config.reading import judged  # pydantic is a third of a start

        filled, invalid = judged.filled(target, document.value)
        unread = {complaint.path for complaint in complaints if complaint.place is None}
        complaints.extend(complaint for complaint in invalid if complaint.path not in unread)
    # A duplicate key, which has a place, does not hide errors of its value.
    wrong = {complaint.path for complaint in complaints if complaint.place is None}
    complaints.extend(c for c in check(document.value) if c.path not in wrong)
    if complaints or filled is None:
        raise FileError(document.lines(complaints))
    return filled


def schema(target: type[Any], title: str) -> dict[str, Any]:
    """Return the JSON schema of a dataclass, with the meaning of each key."""
    from linemate.daemon.config.reading import judged

    return judged.schema(target, title)


def _decoded(data: bytes, name: str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start]
        line = before.count(b"\n") + 1
        column = error.start - (before.rfind(b"\n") + 1) + 1
        what = f"not UTF-8: byte 0x{data[error.start]:02x}"
        raise FileError([f"{name}:{line}:{column}: (file): {what}"]) from error


def _not_yaml(error: Exception, text: str, name: str) -> str:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    if mark is not None:
        line, column = mark.line + 1, mark.column + 1
    else:
        before = text[: getattr(error, "position", 0)]
        line, column = before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1
    return f"{name}:{line}:{column}: (file): not YAML: {' '.join(str(problem).split())}"


@dataclass(slots=True)
class _Walk:
    """Walk through a node tree: builds values and keeps their places."""

    document: YamlDocument
    nodes: int = 0

    def whole(self, node: yaml.Node) -> None:
        """Read the file's root, which is a mapping or nothing."""
        value = self.value(node, ())
        if value is None:
            return
        if isinstance(value, dict):
            self.document.value = value
        else:
            self._complain((), "should be a mapping of keys to values")

    def value(self, node: yaml.Node, path: Path) -> Any:
        """Return the node's plain value."""
        self.nodes += 1
        # An alias of aliases grows a small file into a large one, or into an endless one.
        if self.nodes > MAX_NODES or len(path) > MAX_DEPTH:
            what = f"more than {MAX_NODES} values or {MAX_DEPTH} levels"
            raise FileError([f"{self.document.name}:1:1: (file): {what}"])
        self.document.values[path] = _place(node)
        if not node.tag.startswith("tag:yaml.org,2002:") or node.tag[18:] not in _TAGS:
            self._complain(path, f"tags are not understood: {node.tag}")
            return None
        if isinstance(node, yaml.MappingNode):
            return dict(self._items(node, path))
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node.value, path, plain=node.style is None)
        return [self.value(item, (*path, i)) for i, item in enumerate(node.value)]

    def _items(self, node: yaml.MappingNode, path: Path) -> Iterator[tuple[str, Any]]:
        first: dict[str, Place] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self._complain(path, "a key should be a text")
                continue
            key = key_node.value
            here = (*path, key)
            if not _is_unicode(key):
                self._complain(path, NOT_UNICODE, _place(key_node))
                continue
            if key in first:
                what = f"given twice, first in line {first[key][0]}"
                self._complain(here, what, _place(key_node))
                continue
            first[key] = self.document.keys[here] = _place(key_node)
            yield key, self.value(value_node, here)

    def _scalar(self, text: str, path: Path, *, plain: bool) -> Any:
        if not _is_unicode(text):
            self._complain(path, NOT_UNICODE)
            return None
        if not plain:
            return text
        try:
            return _plain(text)
        except ValueError as error:
            self._complain(path, str(error))
            return None

    def _complain(self, path: Path, what: str, place: Place | None = None) -> None:
        self.document.complaints.append(Complaint(path, what, place=place))


_TAGS = frozenset({"str", "map", "seq"})
NOT_UNICODE = "an escape is half of a surrogate pair; write the character itself"


def _is_unicode(text: str) -> bool:
    """Return whether a text can be written to a file: an escape may be half of a character."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _plain(text: str) -> Any:
    """Return the value of an unquoted scalar.

    Raises:
        ValueError: not finite, or read differently by other readers.
    """
    if text in _NULL:
        return None
    if text in _BOOL:
        return _BOOL[text]
    if _INTEGER.fullmatch(text):
        return int(text, 0)
    if _NOT_FINITE.fullmatch(text):
        raise ValueError(f"should be a finite number, not {text}")
    for pattern, instead in _AMBIGUOUS:
        if pattern.fullmatch(text):
            raise ValueError(f"{text} means different things to different readers; give {instead}")
    if not _FLOAT.fullmatch(text):
        return text
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"should be a finite number, not {text}")
    return number


def _place(node: yaml.Node) -> Place:
    return node.start_mark.line + 1, node.start_mark.column + 1
