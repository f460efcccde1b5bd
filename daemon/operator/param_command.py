"""``linemate param``: list, get, set, save, describe and compare a daemon's parameters."""

import argparse
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

from linemate.daemon.command_line import NO, OK, UsageError
from linemate.daemon.near_names import near_names
from linemate.daemon.operator import console
from linemate.daemon.operator.render import scalar, table, versioned

Parameter = Mapping[str, Any]  # as the operation ``params`` describes it

LONGEST_VALUE: Final = 512  # that a request carries [characters]
CHANGES: Final = {
    "live": "at once, between two cycles",
    "idle": "while the robot stands idle",
    "restart": "with a restart, in the configuration file",
}


def add_parser(commands: Any, common: argparse.ArgumentParser) -> None:
    """Add the command with its verbs."""
    verbs = commands.add_parser("param", help="parameters").add_subparsers(
        required=True, metavar="VERB"
    )
    listing = verbs.add_parser("list", parents=[common], help="all, or those that begin so")
    listing.add_argument("prefix", nargs="?", default="")
    listing.set_defaults(run=print_list)
    getting = verbs.add_parser("get", parents=[common], help="values")
    getting.add_argument("names", nargs="+", metavar="NAME")
    getting.set_defaults(run=print_values)
    setting = verbs.add_parser("set", parents=[common], help="all of them or none")
    setting.add_argument("assignments", nargs="+", type=_assignment, metavar="NAME=VALUE")
    setting.set_defaults(run=set_values)
    saving = verbs.add_parser("save", parents=[common], help="keep the present values")
    saving.set_defaults(run=save)
    describing = verbs.add_parser("describe", parents=[common], help="what one means")
    describing.add_argument("name", metavar="NAME")
    describing.set_defaults(run=print_description)
    comparing = verbs.add_parser(
        "diff", parents=[common], help="those that are not the default, or not as in the file"
    )
    comparing.set_defaults(run=print_differences)


def print_list(args: argparse.Namespace) -> int:
    """Print the parameters that begin with the prefix."""
    parameters = _parameters(args, args.prefix)
    if args.json:
        print(versioned({"params": parameters}))
    else:
        print(table(("name", "value", "unit", "default", "changes"), map(_list_row, parameters)))
    return OK


def print_values(args: argparse.Namespace) -> int:
    """Print values by name; a single one alone, for scripts."""
    values: dict[str, Any] = console.ask(args, "get", {"names": args.names})["values"]
    if args.json:
        print(versioned({"values": values}))
    elif len(values) == 1:
        print(scalar(next(iter(values.values()))))
    else:
        print(table((), [(name, scalar(value)) for name, value in values.items()]))
    return OK


def set_values(args: argparse.Namespace) -> int:
    """Set all of the values or none, and print what changed."""
    values = dict(args.assignments)
    if len(values) < len(args.assignments):
        raise UsageError("a NAME is given twice")
    answer = console.ask(args, "set", {"values": values}, console.COMPILE_S)
    if args.json:
        print(versioned(answer))
        return OK
    if not answer.get("changed"):
        print("nothing to change")
    for name, change in answer.get("changed", {}).items():
        print(f"{name}: {scalar(change['old'])} -> {scalar(change['new'])}")
    return OK


def save(args: argparse.Namespace) -> int:
    """Have the daemon write the present values to its file."""
    answer = console.ask(args, "save", None, console.COMPILE_S)
    console.print_answer(args, answer)
    return OK


def print_description(args: argparse.Namespace) -> int:
    """Print what one parameter means, or the names near an unknown one."""
    every = _parameters(args)
    named = [item for item in every if item["name"] == args.name]
    if not named:
        near = near_names(args.name, [str(item["name"]) for item in every])
        console.complain(f"refused: no parameter {args.name}{near}")
        return NO
    print(versioned(named[0]) if args.json else description(named[0]))
    return OK


def print_differences(args: argparse.Namespace) -> int:
    """Print the parameters that differ from their default or from the file."""
    different = [item for item in _parameters(args) if _is_different(item)]
    if args.json:
        print(versioned({"params": different}))
    elif different:
        head = ("name", "value", "file", "default", "unit", "")
        print(table(head, map(_difference_row, different)))
    return OK


def _parameters(args: argparse.Namespace, prefix: str = "") -> list[dict[str, Any]]:
    params = {"prefix": prefix} if prefix else {}
    listed: list[dict[str, Any]] = console.ask(args, "params", params)["params"]
    return listed


def _assignment(text: str) -> tuple[str, object]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    if len(value) > LONGEST_VALUE:
        raise argparse.ArgumentTypeError(f"{name}: longer than {LONGEST_VALUE} characters")
    try:
        read = json.loads(value, parse_constant=str)
    except ValueError:
        return name, value
    return name, read if _is_carried(read) else value


def _is_carried(value: object) -> bool:
    """Return whether a request can have a value; as a text it is refused with its name."""
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, list):
        return all(map(_is_carried, value))
    return isinstance(value, str | None) or (isinstance(value, int) and abs(value) < 2**63)


def _list_row(item: Parameter) -> tuple[str, ...]:
    return (
        str(item["name"]),
        scalar(item.get("value")),
        str(item.get("unit") or ""),
        scalar(item.get("default")),
        str(item.get("change") or ""),
    )


def _is_different(item: Parameter) -> bool:
    value = item.get("value")
    return bool(value != item.get("default") or value != item.get("file", value))


def _difference_row(item: Parameter) -> tuple[str, ...]:
    return (
        str(item["name"]),
        scalar(item.get("value")),
        scalar(item.get("file", item.get("value"))),
        scalar(item.get("default")),
        str(item.get("unit") or ""),
        "unsaved" if item.get("unsaved") else "",
    )


def description(item: Parameter) -> str:
    """Return the paragraph of ``param describe``."""
    return "\n".join(_description(item))


def _description(item: Parameter) -> Iterable[str]:
    unit = f" {item['unit']}" if item.get("unit") else ""
    yield f"{item['name']} = {scalar(item.get('value'))}{unit}"
    if item.get("describe"):
        yield f"  {item['describe']}"
    low, high = item.get("min"), item.get("max")
    above, below = (
        word if bound in item.get("excluded", ()) else ""
        for bound, word in (("min", "above "), ("max", "below "))
    )
    if low is not None or high is not None:
        yield f"  range    {above}{scalar(low)} .. {below}{scalar(high)}{unit}"
    yield f"  default  {scalar(item.get('default'))}{unit}"
    if item.get("choices"):
        yield f"  one of   {', '.join(map(scalar, item['choices']))}"
    if "file" in item and item["file"] != item.get("value"):
        yield f"  file     {scalar(item['file'])}{unit}"
    limit = ", not in contact" if item.get("in_contact") is False else ""
    yield f"  changes  {CHANGES.get(str(item.get('change')), '')}{limit}"
    if item.get("by"):
        yield f"  set by   {item['by']}, {'not saved' if item.get('unsaved') else 'saved'}"
