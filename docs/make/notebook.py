"""Jupyter notebooks of the examples in cells: ``# %%`` begins a cell, its title is text.

Invariants:
- A notebook has its example's code and no outputs: a run makes them.
- The same example gives the same bytes.
"""

import ast
import json
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
MARK = "# %%"


def text(example: Path) -> str:
    """Return the notebook of an example in nbformat 4.5."""
    cells = [_cell(i, *cell) for i, cell in enumerate(_cells(example.read_text(encoding="utf-8")))]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook = {
        "cells": cells,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(notebook, indent=1) + "\n"


def _cells(source: str) -> list[tuple[str, str]]:
    """Return kind and text of each cell: the docstring first, then title and code in turn."""
    head, *parts = source.split(f"\n{MARK} ")
    cells = [("markdown", ast.get_docstring(ast.parse(head)) or "")]
    for part in parts:
        title, _, code = part.partition("\n")
        cells += [("markdown", title.strip()), ("code", code.strip())]
    return cells


def _cell(number: int, kind: str, text: str) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}}
    cell["source"] = text.splitlines(keepends=True)
    return cell if kind == "markdown" else cell | {"execution_count": None, "outputs": []}
