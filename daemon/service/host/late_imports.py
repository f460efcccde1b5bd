"""Late imports: modules that the loop's thread imports while telegrams are answered.

An import reads files and runs for 1 to 200 ms, in which no telegram is answered. Whatever a cycle
needs is imported before the daemon is ready. What is missed there is named once in the journal.
"""

import importlib
import logging
import sys
import threading
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from types import ModuleType
from typing import Final

MOST_NAMED: Final = 20
"""Modules that the journal names."""

ON_DEMAND: Final = ("difflib",)
"""Modules that the operator's commands import when they need them; the daemon has them before."""

log = logging.getLogger(__name__)


class LateImports(MetaPathFinder):
    """Names the modules that the watched thread imports from now on; finds none itself.

    Attributes:
        names: of them, in order, at most ``MOST_NAMED``.
    """

    def __init__(self) -> None:
        self.names: list[str] = []
        self._thread = threading.get_ident()

    def watch(self) -> None:
        """Watch the calling thread, until ``close``."""
        for name in ON_DEMAND:
            importlib.import_module(name)
        self._thread = threading.get_ident()
        sys.meta_path.insert(0, self)

    def close(self) -> None:
        """Watch no longer."""
        if self in sys.meta_path:
            sys.meta_path.remove(self)

    def find_spec(
        self, fullname: str, _path: Sequence[str] | None, _target: ModuleType | None = None
    ) -> None:
        """Name a module that is about to be imported, and leave it to the other finders."""
        if threading.get_ident() == self._thread and len(self.names) < MOST_NAMED:
            self.names.append(fullname)
            log.warning("%s is imported while telegrams are answered: some may be late", fullname)
