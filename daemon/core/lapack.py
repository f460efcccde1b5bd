"""LAPACK's solvers ``dgesv``, ``dgtsv`` and ``dposv``, without ``scipy.linalg``.

They are those of scipy's build.

``scipy.linalg`` imports 150 modules, numpy's Fortran parser among them: 0.15 s of every start, and
20 MiB that stay locked. Its compiled module needs none of them.
"""

import sys
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from typing import Any

NAME = "scipy.linalg._flapack"


def load() -> Any:
    """Return scipy's compiled LAPACK module, the same that ``scipy.linalg`` uses.

    Raises:
        ImportError: scipy is not installed.
    """
    loaded = sys.modules.get(NAME)
    if loaded is not None:
        return loaded
    package = find_spec("scipy")
    folders = None if package is None else package.submodule_search_locations
    linear = [str(Path(folder) / "linalg") for folder in folders or ()]
    spec = PathFinder.find_spec(NAME, linear)
    if spec is None or spec.loader is None:  # another layout of scipy's files
        from scipy.linalg import lapack

        return lapack
    module = module_from_spec(spec)
    sys.modules[NAME] = module  # a later import of scipy.linalg takes this one
    spec.loader.exec_module(module)
    return module


_flapack = load()
dgesv = _flapack.dgesv
dgtsv = _flapack.dgtsv
dposv = _flapack.dposv
