"""Search path of the import contracts: ``linemate`` as a namespace of four packages.

The tool that reads the imports takes a package below ``linemate`` as a root only if ``linemate``
is a namespace. Installed, it is a package of its own, with the names of ``import linemate``.
``.typing`` shows it as a namespace, as mypy needs it too. ``lint-imports`` imports this module
for its contract type before it reads any package.
"""

import sys
from pathlib import Path

from importlinter.contracts.layers import LayersContract

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / ".typing"))


class NamespaceLayers(LayersContract):
    """Contract of layers, read below the namespace."""
