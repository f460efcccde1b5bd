"""``linemate announce|skip|next|hold|queue``: parts one after the other."""

import argparse
from typing import Any, Final

from linemate.daemon.command_line import OK
from linemate.daemon.operator import console
from linemate.daemon.transport.client import DEFAULT_TIMEOUT_S

ABOUT: Final = {
    "announce": "add a part to the queue",
    "skip": "let a part go, the next one if none is named",
    "next": "end the hold of production: the next part is begun",
    "hold": "begin no further part",
    "queue": "show the parts that wait and how production goes",
}


def add_parser(commands: Any, common: argparse.ArgumentParser) -> None:
    """Add the commands."""
    for op, about in ABOUT.items():
        parser = commands.add_parser(op, parents=[common], help=about)
        if op == "announce":
            parser.add_argument("part", metavar="PART")
            parser.add_argument("variant", metavar="VARIANT")
            parser.add_argument(
                "--distance", type=float, metavar="M",
                help="reading of the distance sensor as the part was announced; the newest one",
            )  # fmt: skip
        if op == "skip":
            parser.add_argument("part", nargs="?", metavar="PART")
        parser.set_defaults(run=_run, op=op)


def _run(args: argparse.Namespace) -> int:
    names = ("part", "variant", "distance")
    params = {name: getattr(args, name, None) for name in names}
    given = {name: value for name, value in params.items() if value is not None}
    console.print_answer(args, console.ask(args, args.op, given, DEFAULT_TIMEOUT_S))
    return OK
