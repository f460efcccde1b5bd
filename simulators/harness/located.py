"""YAML with places: what a file says, and where it says it.

Law of this file: text in; plain values, a place for each key and every error at once out. Any
text gives a document or a ``FileError`` whose lines read ``file:line:col: key: what``.
Duplicate keys and anything that JSON could not hold (dates, anchors beyond reason) are errors.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

Model = TypeVar("Model", bound=BaseModel)

Path = tuple[str | int, ...]
Place = tuple[int, int]
"""Line and column, from 1."""

Complaint = tuple[Path, str]
"""Where in the values, and what."""

MAX_CHARACTERS = 1_000_000
MAX_NODES = 100_000
MAX_DEPTH = 30


class Loader(yaml.SafeLoader):
    """YAML as people write it: 1e-3 is a number (YAML 1.1 reads it as text)."""


Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"),
)


class FileError(ValueError):
    """Everything that is wrong with a file.

    Attributes:
        lines: one ``file:line:col: key: what`` an error.
    """

    def __init__(self, lines: Sequence[str]) -> None:
        """Keep the lines and print them."""
        super().__init__("\n".join(lines))
        self.lines = tuple(lines)


@dataclass(frozen=True, slots=True)
class Document:
    """What a file says.

    Attributes:
        file: its name, for messages.
        value: plain values; None where one could not be read.
        places: where each key or item stands.
        complaints: what could not be read.
    """

    file: str
    value: Any
    places: dict[Path, Place]
    complaints: tuple[Complaint, ...] = ()

    def place(self, path: Path) -> Place:
        """The nearest place that is known."""
        while path and path not in self.places:
            path = path[:-1]
        return self.places.get(path, (1, 1))

    def line(self, path: Path, what: str) -> str:
        """One error as ``file:line:col: key: what``."""
        line, column = self.place(path)
        key = ".".join(str(part) for part in path) or "(whole file)"
        return f"{self.file}:{line}:{column}: {key}: {what}"


def read(text: str, file: str) -> Document:
    """Parse YAML and keep places.

    Args:
        text: of the file.
        file: its name, for messages.

    Raises:
        FileError: not YAML, or beyond reason.
    """
    if len(text) > MAX_CHARACTERS:
        raise FileError([f"{file}:1:1: (whole file): more than {MAX_CHARACTERS} characters"])
    try:
        node = yaml.compose(text, Loader=Loader)
    except yaml.YAMLError as error:
        raise FileError([_yaml_complaint(error, file)]) from error
    reader = _Reader(file)
    value = {} if node is None else reader.value(node, ())
    if not isinstance(value, dict):
        reader.complaints.append(((), "should be a mapping of keys to values"))
    return Document(file, value, reader.places, tuple(reader.complaints))


def validate(
    document: Document,
    model: type[Model],
    under: str,
    check: Callable[[Any], Iterable[Complaint]] = lambda _: (),
) -> Model:
    """Fill a model strictly: no unknown key, no text for a number, no NaN.

    Args:
        document: what a file says.
        model: with one field, ``under``, that takes the whole document.
        under: that field.
        check: what else is wrong with the plain values.

    Raises:
        FileError: every error at once, in order of place.
    """
    found = dict(document.complaints)
    filled: Model | None = None
    try:
        filled = model.model_validate_json(json.dumps({under: document.value}), strict=True)
    except ValidationError as error:
        found = {e["loc"][1:]: _what(dict(e)) for e in error.errors()} | found
    found = dict(check(document.value)) | found
    if found or filled is None:
        order = sorted(found, key=document.place)
        raise FileError([document.line(path, found[path]) for path in order])
    return filled


def _what(error: dict[str, Any]) -> str:
    """Pydantic's message in the words of a file."""
    kind, message = error["type"], str(error["msg"])
    if kind in {"unexpected_keyword_argument", "extra_forbidden"}:
        return "unknown key"
    if kind in {"missing", "missing_argument"}:
        return "missing"
    given = error.get("input")
    shown = "" if isinstance(given, (dict, list)) or given is None else f", not {given!r}"
    return message[:1].lower() + message[1:] + shown


def _yaml_complaint(error: yaml.YAMLError, file: str) -> str:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
    return f"{file}:{line}:{column}: (whole file): not YAML: {problem}"


class _Reader:
    """Walks a node tree, building values and noting places."""

    def __init__(self, file: str) -> None:
        self.places: dict[Path, Place] = {}
        self.complaints: list[Complaint] = []
        self._file = file
        self._scalars = Loader("")
        self._nodes = 0

    def value(self, node: yaml.Node, path: Path) -> Any:
        """The node's plain value; complaints are collected."""
        self._nodes += 1
        # Aliases of aliases grow a small file into a large one, or into an endless one.
        if self._nodes > MAX_NODES or len(path) > MAX_DEPTH:
            what = f"more than {MAX_NODES} values or {MAX_DEPTH} levels"
            raise FileError([f"{self._file}:1:1: (whole file): {what}"])
        self.places.setdefault(path, _place(node))
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(item, (*path, i)) for i, item in enumerate(node.value)]
        return self._scalar(node, path)

    def _mapping(self, node: yaml.MappingNode, path: Path) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = str(key_node.value) if isinstance(key_node, yaml.ScalarNode) else "?"
            here = (*path, key)
            if key in found:
                self.complaints.append((here, "given twice"))
                continue
            self.places[here] = _place(key_node)
            found[key] = self.value(value_node, here)
        return found

    def _scalar(self, node: yaml.Node, path: Path) -> Any:
        try:
            value = self._scalars.construct_object(node, deep=True)
        except (yaml.YAMLError, ValueError) as error:
            self.complaints.append((path, f"cannot be read: {str(error).splitlines()[0]}"))
            return None
        if isinstance(value, float) and not math.isfinite(value):
            self.complaints.append((path, f"should be a finite number, not {value}"))
            return None
        if value is not None and not isinstance(value, (str, int, float, bool)):
            self.complaints.append((path, f"should be a plain value, not {node.value!r}"))
            return None
        return value


def _place(node: yaml.Node) -> Place:
    return node.start_mark.line + 1, node.start_mark.column + 1
