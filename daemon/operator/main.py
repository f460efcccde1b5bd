"""``linemate``, the operator's tool: its command line, and the commands that are one request.

Invariants:
    * A command's module is imported when the command is asked for: a status starts at once.
    * Exit codes: 0 done or healthy, 1 the answer is no, 2 usage, 3 no answer from the daemon.
"""

import argparse
import gc
import os
import sys
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from linemate.daemon import command_line
from linemate.daemon.command_line import NO, NO_ANSWER, OK, USAGE, CommandLine, Version
from linemate.daemon.operator import console
from linemate.daemon.transport.client import (
    DEFAULT_TIMEOUT_S,
    KeyFileError,
    NoAnswerError,
    RefusedError,
)
from linemate.protocol.command.frame_codec import CommandError, Role

ORDERS: Final = {
    "arm": "let a start be accepted",
    "start": "follow the part and assemble",
    "stop": "come to rest; in contact: retreat",
    "retreat": "leave the part along the tool's axis",
    "ack": "acknowledge a fault",
    "home": "go back to the task's first pose",
}

AFTER_REST: Final = frozenset({"arm", "home"})  # refused until the estimates have settled
SETTLING_MARGIN_S: Final = 0.1


def main(argv: Sequence[str] | None = None) -> int:
    """Run the tool and return its exit code."""
    code = command_line.run("linemate", lambda: _main(sys.argv[1:] if argv is None else argv))
    if argv is None:
        # The process ends. The collection of all modules at its end is 5 ms of a status's 60.
        gc.freeze()
    return code


def _main(words: Sequence[str]) -> int:
    args = parser(words[0] if words else None).parse_args(words)
    run: Callable[[argparse.Namespace], int] = args.run
    try:
        return run(args)
    except NoAnswerError as error:
        console.complain(f"no answer from {error}. Start the daemon, or name its socket: --socket")
        return NO_ANSWER
    except KeyFileError as error:
        console.complain(error)
        return USAGE
    except RefusedError as error:
        console.complain(f"refused: {error}")
    except CommandError as error:
        console.complain(f"refused: {error.detail or error.kind}")
    return NO


def parser(only: str | None = None) -> argparse.ArgumentParser:
    """Return the command line.

    Args:
        only: A command whose parser is enough; of an unknown one all are made.
    """
    common = console.common_options()
    whole = CommandLine(prog="linemate", description="Watch and operate a linemate daemon.")
    whole.add_argument("--version", action=Version)
    commands = whole.add_subparsers(required=True, metavar="COMMAND", prog=whole.prog)
    known = COMMANDS.get(only or "")
    for source in (known,) if known is not None else dict.fromkeys(COMMANDS.values()):
        if isinstance(source, str):
            import_module(f"linemate.daemon.operator.{source}").add_parser(commands, common)
        else:
            source(commands, common)
    return whole


def _add_orders(commands: Any, common: argparse.ArgumentParser) -> None:
    for op, about in ORDERS.items():
        commands.add_parser(op, parents=[common], help=about).set_defaults(run=_order, op=op)


def _add_record(commands: Any, common: argparse.ArgumentParser) -> None:
    record = commands.add_parser("record", parents=[common], help="recordings")
    record.add_argument("action", choices=("start", "stop"))
    record.set_defaults(run=_order, op="record")


def _order(args: argparse.Namespace) -> int:
    params = {"action": args.action} if args.op == "record" else {}
    try:
        answer = console.ask(args, args.op, params, DEFAULT_TIMEOUT_S)
    except RefusedError:
        if args.op not in AFTER_REST:
            raise
        # The refused order has ended the daemon's rest.
        wait_s = console.ask(args, "status", {}, DEFAULT_TIMEOUT_S).get("settles_s", 0.0)
        if not wait_s:
            raise
        console.complain(f"the daemon rested: waiting {wait_s:.1f} s for its estimates")
        time.sleep(wait_s + SETTLING_MARGIN_S)
        answer = console.ask(args, args.op, params, DEFAULT_TIMEOUT_S)
    console.print_answer(args, answer)
    return OK


def _add_keygen(commands: Any, _: argparse.ArgumentParser) -> None:
    keygen = commands.add_parser("keygen", help="make a key and print its line")
    keygen.add_argument("name")
    keygen.add_argument("role", choices=[str(role) for role in Role])
    keygen.add_argument("--out", type=Path, metavar="FILE", help="append it to a key file")
    keygen.set_defaults(run=_keygen)


def _keygen(args: argparse.Namespace) -> int:
    from linemate.protocol.command.preshared_keys import KEY_BYTES, key_line, make_key

    line = key_line(make_key(args.name, Role(args.role), os.urandom(KEY_BYTES)))
    if args.out is None:
        print(line)
        return OK
    try:
        _append_key(args.out, line)
    except CommandError as error:
        raise KeyFileError(error.detail) from error
    except (OSError, UnicodeDecodeError) as error:
        raise KeyFileError(f"{args.out}: {error}") from error
    return OK


def _append_key(path: Path, line: str) -> None:
    from linemate.protocol.command.preshared_keys import parse_keys, unsafe_file

    # The file is created with its owner's access alone: no moment in which others can read it.
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o600)
    with open(handle, "a+", encoding="utf-8") as file:  # noqa: PTH123 - a descriptor
        state = os.fstat(handle)
        unsafe = unsafe_file(state.st_mode, state.st_uid, os.geteuid())
        if unsafe is not None:
            raise KeyFileError(f"{path}: {unsafe}")
        file.seek(0)
        before = file.read()
        line_break = "" if not before or before.endswith("\n") else "\n"
        parse_keys(before + line_break + line, str(path))
        file.write(f"{line_break}{line}\n")


AddParser = Callable[[Any, argparse.ArgumentParser], None]

# A command: the module with its ``add_parser``, or the function itself.
COMMANDS: Final[dict[str, str | AddParser]] = {
    "status": "status_command",
    "param": "param_command",
    "learned": "learned_command",
    **dict.fromkeys(ORDERS, _add_orders),
    "record": _add_record,
    **dict.fromkeys(("announce", "skip", "next", "hold", "queue"), "production.orders"),
    "report": "production.report_command",
    **dict.fromkeys(("plc", "plc-user"), "plc.plc_command"),
    "identify": "identify_command",
    "identify-arm": "robot.arm_command",
    "commission": "commissioning.commission_command",
    "replay": "replay_command",
    "export": "export_command",
    "recover": "export_command",
    "view": "view_command",
    "metrics": "metrics_command",
    "bridge": "bridge_command",
    "ros2": "ros2.ros2_command",
    "fleet": "fleet.fleet_command",
    "doctor": "doctor",
    "keygen": _add_keygen,
    "rsi": "robot.rsi_command",
}


if __name__ == "__main__":
    sys.exit(main())
