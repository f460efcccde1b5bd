"""Import contracts of this project, and their search path: ``linemate`` as a namespace.

The tool that reads the imports takes a package below ``linemate`` as a root only if ``linemate``
is a namespace. Installed, it is a package of its own, with the names of ``import linemate``.
``.typing`` shows it as a namespace, as mypy needs it too. ``lint-imports`` imports this module
for its contract types before it reads any package.
"""

import sys
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / ".typing"))


class AcyclicModules(Contract):
    """Contract: no module imports itself by way of others."""

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:  # noqa: ARG002
        """Return whether there is no circle, or the first one."""
        imports: dict[str, set[str]] = {}
        for name in graph.modules:
            others = graph.find_modules_directly_imported_by(name)
            place = self.place_of(name, graph)
            imports.setdefault(place, set()).update(self.place_of(n, graph) for n in others)
        try:
            TopologicalSorter({name: mine - {name} for name, mine in imports.items()}).prepare()
        except CycleError as error:
            return ContractCheck(kept=False, metadata={"circle": error.args[1]})
        return ContractCheck(kept=True)

    def place_of(self, module: str, graph: ImportGraph) -> str:  # noqa: ARG002
        """Return what must not stand in a circle for a module: itself."""
        return module

    def render_broken_contract(self, check: ContractCheck) -> None:
        """Print the circle."""
        output.print_error(" -> ".join(check.metadata["circle"]))


class OneWayPackages(AcyclicModules):
    """Contract: no package imports itself by way of others, its own parts included."""

    whole = fields.SetField(subfield=fields.StringField(), required=False)
    """Packages that count as one with their parts: between these, circles are left."""

    def place_of(self, module: str, graph: ImportGraph) -> str:
        """Return the package of a module."""
        if graph.is_module_squashed(module):
            return module
        package = module if graph.find_children(module) else module.rpartition(".")[0]
        wholes = self.whole or set()
        return next((w for w in wholes if f"{package}.".startswith(f"{w}.")), package)


class SmallPackages(Contract):
    """Contract: at most so many modules in a package, ``__init__`` not counted."""

    most = fields.IntegerField(minimum=1)

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:  # noqa: ARG002
        """Return whether each package is small enough, or those that are not."""
        parents = {name.rpartition(".")[0] for name in graph.modules}
        count = Counter(name.rpartition(".")[0] for name in graph.modules if name not in parents)
        large = {name: number for name, number in count.items() if name and number > self.most}
        return ContractCheck(kept=not large, metadata={"large": large})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """Print the packages that are too large."""
        for name, number in check.metadata["large"].items():
            output.print_error(f"{name}: {number} modules, limit {self.most}")
