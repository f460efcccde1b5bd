"""Reference of ``import linemate``: signature and docstring of every public name."""

import inspect
import re
import textwrap
from collections.abc import Iterator
from typing import Any

import linemate
from linemate.simulators.judge.rows import Rows

_QUALIFIED = re.compile(r"\b(?:[a-z_]+\.)+(?=[A-Z])")
_ARRAY = re.compile(r"numpy\.ndarray\[tuple\[Any, \.\.\.\], numpy\.dtype\[[\w.]+(?:\[Any\])?\]\]")
_ENTRY = re.compile(r"^(\w+): ", re.MULTILINE)


def page() -> str:
    """Return docs/python.md below its head."""
    lines = ["## Names", ""]
    for name in linemate.__all__:
        lines += [f"### `linemate.{name}`", "", *_described(name, getattr(linemate, name))]
    lines += ["## Columns of a run", "", *_text(Rows)]
    return "\n".join(lines)


def _described(name: str, value: Any) -> Iterator[str]:
    if not inspect.isclass(value):
        yield from _block(name, value)
        return
    yield from _text(value)
    for member, inner in vars(value).items():
        if member.startswith("_"):
            continue
        if isinstance(inner, property):
            yield from (f"`{member}`: {inner.__doc__}", "")
        elif inspect.isfunction(inner):
            yield from _block(member, inner)


def _block(name: str, function: Any) -> Iterator[str]:
    signature = _QUALIFIED.sub("", f"{name}{inspect.signature(function)}")
    signature = _ARRAY.sub("ndarray", signature)
    yield from ("```python", *_wrapped(signature), "```", "")
    yield from _text(function)


def _wrapped(signature: str) -> list[str]:
    """Return a signature in lines of at most 100 characters."""
    if len(signature) <= 100 or "()" in signature:
        return [signature]
    head, _, rest = signature.partition("(")
    arguments, _, tail = rest.rpartition(")")
    depth, parts = 0, [""]
    for character in arguments:
        depth += (character in "[(") - (character in "])")
        if character == "," and not depth:
            parts.append("")
        else:
            parts[-1] += character
    return [f"{head}(", *(f"    {part.strip()}," for part in parts), f"){tail}"]


def _text(value: Any) -> Iterator[str]:
    """Yield a docstring as Markdown, its sections as lists."""
    text = (inspect.getdoc(value) or "").replace("``", "`")
    summary, *sections = re.split(r"^(Args|Attributes|Returns|Raises):$", text, flags=re.MULTILINE)
    yield from (*summary.strip().splitlines(), "")
    for head, body in zip(sections[::2], sections[1::2], strict=True):
        yield from (f"{head}:", "")
        for item in re.split(r"\n(?=\S)", textwrap.dedent(body).strip()):
            named = _ENTRY.sub(r"`\1`: ", " ".join(item.split()))
            yield from textwrap.wrap(f"- {named}", 118, subsequent_indent="  ")
        yield ""
