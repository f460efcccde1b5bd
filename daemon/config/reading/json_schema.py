"""JSON schema of dataclasses, with the meanings from their docstrings.

The only module of the daemon that imports pydantic, which takes a tenth of a start.
"""

import re
from typing import Any

from pydantic import ConfigDict, create_model
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import DataclassSchema

# One entry of ``Attributes:``, with its continuation lines.
_ENTRY = re.compile(r"^ {8}([a-z_][a-z_0-9, ]*): (.+(?:\n {12}.+)*)", re.MULTILINE)


def documented(target: type[Any], title: str) -> dict[str, Any]:
    """Return the JSON schema of a dataclass, with the meaning of each key."""
    fields: dict[str, Any] = {"root": (target, ...)}
    # The dataclass as the only field of a model, from which it inherits that no other key is known.
    model = create_model("File", __config__=ConfigDict(extra="forbid"), **fields)
    whole = model.model_json_schema(schema_generator=_DocumentedSchema)
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
