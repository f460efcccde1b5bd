"""What pydantic says of plain values: every error at once, and the JSON schema of a dataclass."""

import inspect
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, create_model
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import DataclassSchema

from linemate.daemon.config.reading.complaints import Complaint, Path
from linemate.daemon.near_names import near_names

T = TypeVar("T")

# One entry of ``Attributes:``, with its continuation lines.
_ENTRY = re.compile(r"^ {4}([a-z_][a-z_0-9, ]*): (.+(?:\n {8}.+)*)", re.MULTILINE)


class _DocumentedSchema(GenerateJsonSchema):
    """Schema whose descriptions come from the docstrings of the dataclasses."""

    def dataclass_schema(self, schema: DataclassSchema) -> JsonSchemaValue:
        """Return the schema of one dataclass."""
        documented = super().dataclass_schema(schema)
        # From Python 3.13 on a docstring comes without the source's indent.
        docstring = inspect.cleandoc(schema["cls"].__doc__ or "")
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


def filled(target: type[T], value: Any) -> tuple[T | None, list[Complaint]]:
    """Return a dataclass with these plain values, or None and everything that is wrong."""
    try:
        wrapped = _model(target).model_validate_json(json.dumps({"root": value}))
    except ValidationError as error:
        invalid = filter(None, map(_complaint, error.errors(include_url=False)))
        return None, [_with_near_keys(complaint, target) for complaint in invalid]
    return getattr(wrapped, "root"), []  # noqa: B009 -- create_model adds the field


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


def _complaint(error: Mapping[str, Any]) -> Complaint | None:
    kind, message, path = error["type"], str(error["msg"]), tuple(error["loc"][1:])
    if kind in {"too_short", "too_long"} and isinstance(error["input"], (list, dict)):
        return _wrong_length(path, error["ctx"], len(error["input"]))
    if kind in {"unexpected_keyword_argument", "extra_forbidden"}:
        return Complaint(path, UNKNOWN_KEY, at_key=True)
    if kind in {"missing", "missing_argument"}:
        return Complaint(path, "missing")
    if kind == "string_too_short" and not error["input"]:
        return Complaint(path, "should not be empty")
    what = message.removeprefix("Input ").removeprefix("String ").replace("an object", "a mapping")
    what = what.replace("a valid array", "a list")
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
