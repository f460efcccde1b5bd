"""The notebook runs cell by cell, and shows what its text says."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "docs/examples/own_predictor.ipynb"


def test_the_notebook_runs_and_its_predictor_is_worse_in_a_stop(
    capsys: pytest.CaptureFixture[str],
) -> None:
    names: dict[str, Any] = {}
    for cell in json.loads(EXAMPLE.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    out = capsys.readouterr().out
    default, own = (float(text) for text in re.findall(r"in the stop ([\d.]+) mm", out))
    assert own > default
    assert "identical: True" in out
    assert float(re.findall(r"part by ([\d.]+) mm", out)[0]) > 0.1
