"""LAPACK is scipy's own, and nothing else of scipy is imported for it."""

import subprocess
import sys

import numpy as np
import pytest

from linemate.daemon.core import lapack

CHECK = """
import sys
from linemate.daemon.core import lapack
before = sorted(name for name in sys.modules if name.startswith("scipy."))
from scipy.linalg import lapack as whole
same = (getattr(whole, name) is getattr(lapack, name) for name in ("dgesv", "dgtsv", "dposv"))
print(before, *same)
"""


def test_only_the_compiled_module_is_imported_and_scipy_goes_on_with_it() -> None:
    done = subprocess.run([sys.executable, "-c", CHECK], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[0] == f"['{lapack.NAME}'] True True True"


def test_another_layout_of_scipy_is_imported_the_ordinary_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delitem(sys.modules, lapack.NAME)
    monkeypatch.setattr(lapack.PathFinder, "find_spec", lambda name, path: None)
    assert lapack.load().dgesv is not None


def test_both_solvers_solve() -> None:
    A = np.array(((4.0, 1.0), (1.0, 3.0)))
    x = np.array((0.5, -2.0))
    assert lapack.dgesv(A, A @ x)[2] == pytest.approx(x)
    assert lapack.dposv(A, A @ x)[1] == pytest.approx(x)
