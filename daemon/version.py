"""``--version`` of the three programs.

Law of this file: what is installed is looked up when somebody asks; nobody who does not ask waits
for it.
"""

import argparse
from collections.abc import Sequence
from typing import Any

DISTRIBUTION = "linemate"


class Version(argparse.Action):
    """Prints the program's name and the installed version, and ends."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: Any) -> None:
        super().__init__(
            option_strings, argparse.SUPPRESS, nargs=0, help="print the version and end"
        )
        del dest

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,  # noqa: ARG002 - argparse's signature
        values: str | Sequence[Any] | None,  # noqa: ARG002
        option_string: str | None = None,  # noqa: ARG002
    ) -> None:
        """Do so."""
        from importlib.metadata import version

        print(parser.prog, version(DISTRIBUTION))
        parser.exit()
