"""Strict YAML reader: frozen dataclasses, or every error at once with its line and column.

Invariants:
- Any bytes give values or complaints.
- A plain value that YAML 1.1 and 1.2 read differently is refused: ``no``, ``010``, ``12:30``,
  ``1_000``, a date. ``1e-3`` is a number.
- Duplicate keys, unknown keys and numbers that are not finite are errors.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, create_model
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import DataclassSchema

from linemate.daemon.near_names import near_names

T = TypeVar("T")

Path = tuple[str | int, ...]  # keys and indices from the file's root
Place = tuple[int, int]  # line and column, from 1

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


# One entry of ``Attributes:``, with its continuation lines.
_ENTRY = re.compile(r"^ {8}([a-z_][a-z_0-9, ]*): (.+(?:\n {12}.+)*)", re.MULTILINE)


class FileError(Exception):
    """Everything that is wrong with one file or several.

    Attributes:
        lines: one ``file:line:col: key: what`` an error.
    """

    def __init__(self, lines: Sequence[str]) -> None:
        """Keep the lines and print them."""
        super().__init__("\n".join(lines))
        self.lines = tuple(lines)


@dataclass(frozen=True, slots=True)
class Complaint:
    """One thing that is wrong.

    Attributes:
        path: where in the values.
        what: message for the author of the file.
        at_key: the key is wrong, not its value.
        place: where, if the path does not say it.
    """

    path: Path
    what: str
    at_key: bool = False
    place: Place | None = None


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
    filled: T | None = None
    try:
        wrapped = _model(target).model_validate_json(json.dumps({"root": document.value}))
        filled = getattr(wrapped, "root")  # noqa: B009 -- create_model adds the field
    except ValidationError as error:
        unread = {complaint.path for complaint in complaints if complaint.place is None}
        invalid = filter(None, map(_complaint, error.errors(include_url=False)))
        hinted = (_with_near_keys(complaint, target) for complaint in invalid)
        complaints.extend(complaint for complaint in hinted if complaint.path not in unread)
    # A duplicate key, which has a place, does not hide errors of its value.
    wrong = {complaint.path for complaint in complaints if complaint.place is None}
    complaints.extend(c for c in check(document.value) if c.path not in wrong)
    if complaints or filled is None:
        raise FileError(document.lines(complaints))
    return filled


def schema(target: type[Any], title: str) -> dict[str, Any]:
    """Return the JSON schema of a dataclass, with the meaning of each key."""
    whole = _model(target).model_json_schema(schema_generator=_DocumentedSchema)
    definitions: dict[str, Any] = whole.pop("$defs")
    root = definitions.pop(target.__name__)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **root,
        "title": title,
        "$defs": definitions,
    }


class _DocumentedSchema(GenerateJsonSchema):
    """Schema whose descriptions come from the docstrings of the dataclasses."""

    def dataclass_schema(self, schema: DataclassSchema) -> JsonSchemaValue:
        """Return the schema of one dataclass."""
        documented = super().dataclass_schema(schema)
        docstring = schema["cls"].__doc__ or ""
        documented["description"] = docstring.partition("\n")[0]
        for names, text in _ENTRY.findall(docstring):
            for name in names.split(","):
                if name.strip() in documented["properties"]:
                    documented["properties"][name.strip()]["description"] = " ".join(text.split())
        return documented


def _model(target: type[Any]) -> type[BaseModel]:
    """Return a model with the dataclass as its only field, which inherits the strict settings."""
    if target not in _MODELS:
        strict = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
        fields: dict[str, Any] = {"root": (target, ...)}
        _MODELS[target] = create_model(f"{target.__name__}File", __config__=strict, **fields)
    return _MODELS[target]


UNKNOWN_KEY = "unknown key"
_MODELS: dict[type[Any], type[BaseModel]] = {}


def _complaint(error: Mapping[str, Any]) -> Complaint | None:
    kind, message, path = error["type"], str(error["msg"]), tuple(error["loc"][1:])
    if kind in {"too_short", "too_long"} and isinstance(error["input"], list):
        return _wrong_length(path, error["ctx"], len(error["input"]))
    if kind in {"unexpected_keyword_argument", "extra_forbidden"}:
        return Complaint(path, UNKNOWN_KEY, at_key=True)
    if kind in {"missing", "missing_argument"}:
        return Complaint(path, "missing")
    what = message.removeprefix("Input ").replace("an object", "a mapping")
    return Complaint(path, what + _shown(error.get("input")))


def _with_near_keys(complaint: Complaint, target: type[Any]) -> Complaint:
    """Return a complaint of an unknown key with the known keys near it."""
    if complaint.what != UNKNOWN_KEY:
        return complaint
    *path, key = complaint.path
    near = near_names(str(key), _known_keys(target, path))
    return replace(complaint, what=UNKNOWN_KEY + near)


def _known_keys(target: type[Any], path: Iterable[str | int]) -> list[str]:
    """Return the keys that a mapping at a path of the file may have."""
    whole = _model(target).model_json_schema()
    nodes = _options([whole["properties"]["root"]], whole["$defs"])
    for part in path:
        children = [child for node in nodes for child in _children(node, part)]
        nodes = _options(children, whole["$defs"])
    return [name for node in nodes for name in node.get("properties", {})]


def _options(nodes: Iterable[Any], definitions: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Resolve references and alternatives of a JSON schema."""
    options = []
    for node in nodes:
        if "$ref" in node:
            options += _options([definitions[node["$ref"].rpartition("/")[2]]], definitions)
        elif "anyOf" in node:
            options += _options(node["anyOf"], definitions)
        else:
            options.append(node)
    return options


def _children(node: Mapping[str, Any], part: str | int) -> list[Any]:
    if isinstance(part, int):
        return [node["items"]] if "items" in node else []
    child = node.get("properties", {}).get(part)
    return [child] if child is not None else []


def _wrong_length(path: Path, limits: Mapping[str, Any], given: int) -> Complaint | None:
    """Return a complaint about the file's own count: pydantic does not count bad items."""
    least, most = limits.get("min_length", 0), limits.get("max_length") or given
    if least <= given <= most:
        return None
    bound = f"at least {least}" if given < least else f"at most {most}"
    return Complaint(path, f"should have {bound} items, not {given}")


def _shown(value: object) -> str:
    if isinstance(value, (dict, list)):
        return ""
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return f", not {text if len(text) <= 60 else text[:57] + '...'}"


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
            if key in first:
                what = f"given twice, first in line {first[key][0]}"
                self._complain(here, what, _place(key_node))
                continue
            first[key] = self.document.keys[here] = _place(key_node)
            yield key, self.value(value_node, here)

    def _scalar(self, text: str, path: Path, *, plain: bool) -> Any:
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
