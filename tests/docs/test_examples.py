"""The example in cells runs, and shows what its comments say."""

import re
import runpy
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "docs/examples/own_predictor.py"


def test_the_example_in_cells_runs_and_its_predictor_is_worse_in_a_stop(
    capsys: pytest.CaptureFixture[str],
) -> None:
    runpy.run_path(str(EXAMPLE))
    out = capsys.readouterr().out
    default, own = (float(text) for text in re.findall(r"in the stop ([\d.]+) mm", out))
    assert own > default
    assert "identical: True" in out
    assert float(re.findall(r"part by ([\d.]+) mm", out)[0]) > 0.1
