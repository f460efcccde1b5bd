"""``--version`` of the three programs."""

import importlib.metadata
from collections.abc import Callable
from typing import Any

import pytest

from linemate.daemon.operator import main as operator
from linemate.daemon.service import main as service
from linemate.simulators.harness import main as harness


@pytest.mark.parametrize("program", [operator.main, service.main, harness.main])
def test_a_program_tells_its_name_and_what_is_installed(
    program: Callable[[list[str]], Any], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        program(["--version"])
    assert ended.value.code == 0
    name, version = capsys.readouterr().out.split()
    assert name in {"linemate", "linemated", "linemate-sim"}
    assert version == importlib.metadata.version("linemate")
