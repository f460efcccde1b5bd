"""Imports while telegrams are answered are named, and a recorded assembly needs none in a step."""

import importlib
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from linemate.daemon.service.host.late_imports import MOST_NAMED, LateImports

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests" / "system" / "golden" / "wheel.mcap"
OFFLINE = ROOT / "daemon" / "core" / "control" / "servo_fit.py"
"""The fit of ``linemate identify``, which no cycle calls."""

REPLAY = """
import sys
from pathlib import Path
from linemate.daemon.core import step
from linemate.daemon.operator.replay_command import compare

class StepImports:
    depth, names = 0, []
    def find_spec(self, name, path, target=None):
        if self.depth:
            self.names.append(name)

imports = StepImports()

def watched(function):
    def call(*args):
        imports.depth += 1
        try:
            return function(*args)
        finally:
            imports.depth -= 1
    return call

step.step = watched(step.step)
sys.meta_path.insert(0, imports)
account, _ = compare(Path(sys.argv[1]))
print(account.steps, *imports.names)
"""


@pytest.fixture
def imports() -> Iterator[LateImports]:
    watch = LateImports()
    watch.watch()
    yield watch
    watch.close()


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    names = [f"late_module_{n}" for n in range(2 * MOST_NAMED)]
    for name in names:
        (tmp_path / f"{name}.py").write_text("")
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(tmp_path)  # it imports modules itself
    return names


def test_a_late_import_is_named_once(
    modules: list[str], imports: LateImports, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(2):
        importlib.import_module(modules[0])
    assert imports.names == modules[:1]
    assert [modules[0] in line for line in caplog.messages] == [True]


def test_the_names_are_bounded(
    modules: list[str], imports: LateImports, caplog: pytest.LogCaptureFixture
) -> None:
    for name in modules:
        importlib.import_module(name)
    assert imports.names == modules[:MOST_NAMED]
    assert len(caplog.messages) == MOST_NAMED


def test_imports_of_other_threads_are_theirs(modules: list[str], imports: LateImports) -> None:
    thread = threading.Thread(target=importlib.import_module, args=(modules[0],))
    thread.start()
    thread.join()
    imports.close()
    importlib.import_module(modules[1])
    assert imports.names == []


def test_a_recorded_assembly_imports_nothing_in_a_step() -> None:
    done = subprocess.run(
        [sys.executable, "-c", REPLAY, str(GOLDEN)], capture_output=True, text=True, check=True
    )
    steps, *names = done.stdout.split()
    assert int(steps) > 900
    assert names == []


def test_no_cycle_calls_the_median_of_numpy_which_imports_its_masked_arrays() -> None:
    files = [
        path
        for folder in ("daemon/core", "daemon/cycle", "protocol", "drivers")
        for path in (ROOT / folder).rglob("*.py")
        if path != OFFLINE
    ]
    assert len(files) > 100
    assert [path for path in files if "np.median(" in path.read_text()] == []
