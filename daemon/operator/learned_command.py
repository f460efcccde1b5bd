"""``linemate learned``: show what the daemon has learned over assemblies, or take it back."""

import argparse
from collections.abc import Mapping
from typing import Any, Final

from linemate.daemon.command_line import OK
from linemate.daemon.operator import console
from linemate.daemon.operator.render import scalar, table, versioned

LEARNED: Final = (
    "tracking.camera.felt",
    "tracking.distance.late",
    "tracking.distance.scale",
    "tracking.payload.part_mass",
    "control.servos.",
)
"""Beginnings of the names of what is learned: camera, distance, part's mass, and servo models."""


def add_parser(commands: Any, common: argparse.ArgumentParser) -> None:
    """Add the command with its verbs."""
    verbs = commands.add_parser("learned", help="what assemblies have taught").add_subparsers(
        required=True, metavar="VERB"
    )
    showing = verbs.add_parser("show", parents=[common], help="values against the file's")
    showing.set_defaults(run=show)
    resetting = verbs.add_parser("reset", parents=[common], help="take the file's values again")
    resetting.set_defaults(run=reset)


def show(args: argparse.Namespace) -> int:
    """Print what differs from the file."""
    learned = _learned(args)
    if args.json:
        print(versioned({"params": learned}))
    elif learned:
        rows = [
            (
                str(item["name"]),
                scalar(item["value"]),
                scalar(item["file"]),
                str(item.get("unit") or ""),
                "unsaved" if item.get("unsaved") else "",
            )
            for item in learned
        ]
        print(table(("name", "value", "file", "unit", ""), rows))
    else:
        print("nothing is learned")
    return OK


def reset(args: argparse.Namespace) -> int:
    """Take the file's values again; the daemon refuses it while the robot moves."""
    values = {str(item["name"]): item["file"] for item in _learned(args)}
    if not values and not args.json:
        print("nothing is learned")
        return OK
    answer = console.ask(args, "set", {"values": values}, console.COMPILE_S)
    console.print_answer(args, answer)
    return OK


def _learned(args: argparse.Namespace) -> list[Mapping[str, Any]]:
    """Return the parameters that are learned and not as in the file."""
    learned: list[Mapping[str, Any]] = []
    for prefix in LEARNED:
        listed = console.ask(args, "params", {"prefix": prefix})["params"]
        learned += [item for item in listed if item.get("file", item["value"]) != item["value"]]
    return learned
