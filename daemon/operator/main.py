"""`linemate`, the operator's tool.

Law of this file: words of a command line in, one question to the daemon, text and an exit
code out. Light imports only, for a status must not cost a second: no numpy. Exit codes:
0 done or healthy, 1 refused or not healthy, 2 usage, 3 no answer.
"""

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NoReturn

from linemate.daemon.operator import render
from linemate.daemon.transport.client import (
    DEFAULT_PORT,
    DEFAULT_TIMEOUT_S,
    Client,
    KeyFileError,
    NoAnswerError,
    RefusedError,
    default_key_path,
    read_key,
)
from linemate.daemon.version import Version
from linemate.protocol.command.frame_codec import CommandError, Role

OK: Final = 0
NOT_OK: Final = 1
USAGE: Final = 2
NO_ANSWER: Final = 3

COMPILE_S: Final = 4.5
"""What a daemon may take for parameters that it has to compile, or for its disk [s]."""

HEALTHY: Final = "healthy"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the tool and return its exit code."""
    words = sys.argv[1:] if argv is None else argv
    args = parser(words[0] if words else None).parse_args(words)
    run: Callable[[argparse.Namespace], int] = args.run
    try:
        return run(args)
    except (NoAnswerError, RefusedError, CommandError, KeyFileError) as error:
        return _failed(error)
    except BrokenPipeError:
        # `linemate param list | head`: nobody is left to read; keep the interpreter quiet.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return NOT_OK
    except KeyboardInterrupt:
        return 130


def _failed(error: Exception) -> int:
    if isinstance(error, NoAnswerError):
        _complain(f"no answer from {error}")
        return NO_ANSWER
    if isinstance(error, KeyFileError):
        _complain(str(error))
        return USAGE
    reason = error.detail or error.kind if isinstance(error, CommandError) else str(error)
    _complain(f"refused: {reason}")
    return NOT_OK


def _complain(text: str) -> None:
    print(f"linemate: {text}", file=sys.stderr)


def _client(args: argparse.Namespace) -> Client:
    if not getattr(args, "udp", None):
        return Client.local(getattr(args, "socket", None))
    host, port = args.udp
    path = getattr(args, "key", None) or default_key_path()
    return Client.udp(host, port, read_key(path, getattr(args, "key_name", None)))


def _ask(
    args: argparse.Namespace,
    op: str,
    params: Mapping[str, Any] | None = None,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> dict[str, Any]:
    with _client(args) as client:
        return client.call(op, params, getattr(args, "timeout", timeout_s))


# --- status -------------------------------------------------------------------------------


def _status(args: argparse.Namespace) -> int:
    if args.watch:
        return _watch(args)
    answer = _ask(args, "status")
    if args.json:
        print(render.versioned(answer))
    else:
        print(render.table((), render.rows(answer)))
    return _health(answer)


def _health(answer: Mapping[str, Any]) -> int:
    return OK if answer.get("health") == HEALTHY else NOT_OK


def _watch(args: argparse.Namespace) -> int:
    code = NO_ANSWER
    clear = "\x1b[H\x1b[J" if sys.stdout.isatty() else ""
    end = time.monotonic() + args.seconds if args.seconds is not None else None
    with _client(args) as client:
        while end is None or time.monotonic() < end:
            try:
                answer = client.call("status", None, getattr(args, "timeout", DEFAULT_TIMEOUT_S))
            except NoAnswerError as error:
                code = NO_ANSWER
                print(f"{clear}no answer: {error}", flush=True)
            else:
                code = _health(answer)
                print(clear + render.table((), render.rows(answer)), flush=True)
            time.sleep(args.interval)
    return code


# --- parameters ---------------------------------------------------------------------------


def _described(args: argparse.Namespace, prefix: str = "") -> list[dict[str, Any]]:
    params = {"prefix": prefix} if prefix else {}
    listed: list[dict[str, Any]] = _ask(args, "params", params)["params"]
    return listed


def _param_list(args: argparse.Namespace) -> int:
    return _print_parameters(args, _described(args, args.prefix))


def _param_diff(args: argparse.Namespace) -> int:
    listed = _described(args)
    rows = render.difference_rows(listed)
    if args.json:
        names = {row[0] for row in rows}
        print(render.versioned({"params": [item for item in listed if item["name"] in names]}))
    elif rows:
        print(render.table(("name", "value", "file", "default", "unit", ""), rows))
    return OK


def _print_parameters(args: argparse.Namespace, listed: list[dict[str, Any]]) -> int:
    if args.json:
        print(render.versioned({"params": listed}))
    else:
        head = ("name", "value", "unit", "default", "changes")
        print(render.table(head, render.parameter_rows(listed)))
    return OK


def _param_describe(args: argparse.Namespace) -> int:
    listed = [item for item in _described(args, args.name) if item["name"] == args.name]
    if not listed:
        _complain(f"refused: no parameter {args.name}")
        return NOT_OK
    print(render.versioned(listed[0]) if args.json else render.description(listed[0]))
    return OK


def _param_get(args: argparse.Namespace) -> int:
    values: dict[str, Any] = _ask(args, "get", {"names": args.names})["values"]
    if args.json:
        print(render.versioned({"values": values}))
    elif len(values) == 1:
        print(render.scalar(next(iter(values.values()))))
    else:
        print(render.table((), [(name, render.scalar(value)) for name, value in values.items()]))
    return OK


def _param_set(args: argparse.Namespace) -> int:
    answer = _ask(args, "set", {"values": dict(args.assignments)}, COMPILE_S)
    if args.json:
        print(render.versioned(answer))
        return OK
    if not answer.get("changed"):
        print("nothing to change")
    for name, change in answer.get("changed", {}).items():
        print(f"{name}: {render.scalar(change['old'])} -> {render.scalar(change['new'])}")
    return OK


def _assignment(text: str) -> tuple[str, object]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    import json

    try:
        return name, json.loads(value)
    except json.JSONDecodeError:
        return name, value


# --- operating ----------------------------------------------------------------------------


def _operate(args: argparse.Namespace) -> int:
    params = {"action": args.action} if args.op == "record" else {}
    answer = _ask(args, args.op, params, COMPILE_S if args.op == "save" else DEFAULT_TIMEOUT_S)
    if args.json:
        print(render.versioned(answer))
    elif answer:
        print(render.table((), render.rows(answer)))
    return OK


def _keygen(args: argparse.Namespace) -> int:
    from linemate.protocol.command.preshared_keys import (
        KEY_BYTES,
        key_line,
        make_key,
        parse_keys,
        unsafe_file,
    )

    key = make_key(args.name, Role(args.role), os.urandom(KEY_BYTES))
    if args.out is None:
        print(key_line(key))
        return OK
    path: Path = args.out
    try:
        # Created for the owner alone from its first moment.
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o600)
        with open(handle, "a+", encoding="utf-8") as file:  # noqa: PTH123 - a descriptor
            found = os.fstat(handle)
            wrong = unsafe_file(found.st_mode, found.st_uid, os.geteuid())
            if wrong is not None:
                raise KeyFileError(f"{path}: {wrong}")
            file.seek(0)
            before = file.read()
            ended = before if not before or before.endswith("\n") else before + "\n"
            parse_keys(ended + key_line(key), str(path))
            file.write(ended[len(before) :] + key_line(key) + "\n")
    except CommandError as error:
        raise KeyFileError(error.detail) from error
    except (OSError, UnicodeDecodeError) as error:
        raise KeyFileError(f"{path}: {error}") from error
    return OK


def _doctor(args: argparse.Namespace) -> int:
    import dataclasses

    from linemate.daemon.operator import doctor

    findings = doctor.examine(doctor.Host())
    if args.json:
        plain = [dataclasses.asdict(finding) for finding in findings]
        print(render.versioned({"findings": plain}))
    else:
        print(render.table((), [(f.name, str(f.grade), f.what) for f in findings]))
        costs = [f"{f.name}: {f.cost}" for f in findings if f.cost]
        print("\n".join(["", *costs] if costs else ["", "nothing is lacking"]))
    return NOT_OK if doctor.is_lacking(findings) else OK


# --- the command line ---------------------------------------------------------------------


def _udp(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not colon:
        return text, DEFAULT_PORT
    with contextlib.suppress(ValueError):
        if host and 0 < int(port) < 65536:
            return host.strip("[]"), int(port)
    raise argparse.ArgumentTypeError(f"{text!r} is not HOST or HOST:PORT")


def _positive(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0.0 < float(text) <= 3600.0:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds")


class CommandLine(argparse.ArgumentParser):
    """A command line whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """End with 2."""
        self.exit(USAGE, f"{self.prog}: {message}; see {self.prog} --help\n")


def _common() -> argparse.ArgumentParser:
    common = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    where = common.add_argument_group("where the daemon is")
    where.add_argument("--socket", type=Path, metavar="PATH", help="its local socket")
    where.add_argument(
        "--udp", type=_udp, metavar="HOST[:PORT]", help=f"its UDP port ({DEFAULT_PORT})"
    )
    where.add_argument("--key", type=Path, metavar="FILE", help="key file for --udp")
    where.add_argument("--key-name", metavar="NAME", help="which key of the file; the first")
    where.add_argument("--timeout", type=_positive, metavar="S", help="wait so long; 0.5")
    common.add_argument("--json", action="store_true", default=False, help="print JSON")
    return common


def parser(only: str | None = None) -> argparse.ArgumentParser:
    """The command line.

    Args:
        only: the command that is wanted: the others are left out, which saves their time.
    """
    common = _common()
    made = CommandLine(prog="linemate", description="Watch and operate a linemate daemon.")
    made.add_argument("--version", action=Version)
    commands = made.add_subparsers(required=True, metavar="COMMAND", prog=made.prog)
    wanted = ADDED.get(only or "")
    for add in (wanted,) if wanted is not None else dict.fromkeys(ADDED.values()):
        add(commands, common)
    return made


def _add_status(commands: Any, common: argparse.ArgumentParser) -> None:
    status = commands.add_parser("status", parents=[common], help="state, links, rates, ages")
    status.add_argument("--watch", action="store_true", help="again and again until Ctrl-C")
    status.add_argument(
        "--interval", type=_positive, default=0.5, metavar="S", help="between two looks; 0.5"
    )
    status.add_argument("--for", dest="seconds", type=_positive, metavar="S", help="watch so long")
    status.set_defaults(run=_status)


def _add_orders(commands: Any, common: argparse.ArgumentParser) -> None:
    for op, text in (
        ("arm", "let a start be accepted"),
        ("start", "follow the part and assemble"),
        ("stop", "come to rest; in contact: retreat"),
        ("retreat", "leave the part along the tool's axis"),
        ("ack", "acknowledge a fault"),
    ):
        operate = commands.add_parser(op, parents=[common], help=text)
        operate.set_defaults(run=_operate, op=op)


def _add_record(commands: Any, common: argparse.ArgumentParser) -> None:
    record = commands.add_parser("record", parents=[common], help="recordings")
    record.add_argument("action", choices=("start", "stop"))
    record.set_defaults(run=_operate, op="record")


def _add_files(commands: Any, _: argparse.ArgumentParser) -> None:
    from linemate.daemon.operator import export_command, identify_command, replay_command

    identify_command.add_parser(commands)
    replay_command.add_parser(commands)
    export_command.add_parsers(commands)


def _add_view(commands: Any, common: argparse.ArgumentParser) -> None:
    from linemate.daemon.operator import view_command

    view_command.add_parser(commands, common, _client)


def _add_metrics(commands: Any, _: argparse.ArgumentParser) -> None:
    from linemate.daemon.operator import metrics_command

    metrics_command.add_parser(commands)


def _add_bridge(commands: Any, _: argparse.ArgumentParser) -> None:
    from linemate.daemon.operator import bridge_command

    bridge_command.add_parser(commands)


def _add_doctor(commands: Any, _: argparse.ArgumentParser) -> None:
    doctor = commands.add_parser("doctor", help="what this host lacks for real time and links")
    doctor.add_argument("--json", action="store_true", help="print JSON")
    doctor.set_defaults(run=_doctor)


def _add_keygen(commands: Any, _: argparse.ArgumentParser) -> None:
    keygen = commands.add_parser("keygen", help="make a key and print its line")
    keygen.add_argument("name")
    keygen.add_argument("role", choices=[str(role) for role in Role])
    keygen.add_argument("--out", type=Path, metavar="FILE", help="append it to a key file")
    keygen.set_defaults(run=_keygen)


def _add_param(commands: Any, common: argparse.ArgumentParser) -> None:
    verbs = commands.add_parser("param", help="parameters").add_subparsers(
        required=True, metavar="VERB"
    )
    listing = verbs.add_parser("list", parents=[common], help="all, or those that begin so")
    listing.add_argument("prefix", nargs="?", default="")
    listing.set_defaults(run=_param_list)
    getting = verbs.add_parser("get", parents=[common], help="values")
    getting.add_argument("names", nargs="+", metavar="NAME")
    getting.set_defaults(run=_param_get)
    setting = verbs.add_parser("set", parents=[common], help="all of them or none")
    setting.add_argument("assignments", nargs="+", type=_assignment, metavar="NAME=VALUE")
    setting.set_defaults(run=_param_set)
    saving = verbs.add_parser("save", parents=[common], help="keep the present values")
    saving.set_defaults(run=_operate, op="save")
    describing = verbs.add_parser("describe", parents=[common], help="what one means")
    describing.add_argument("name", metavar="NAME")
    describing.set_defaults(run=_param_describe)
    diffing = verbs.add_parser(
        "diff", parents=[common], help="those that are not the default, or not as in the file"
    )
    diffing.set_defaults(run=_param_diff)


ADDED: Final[dict[str, Callable[[Any, argparse.ArgumentParser], None]]] = {
    "status": _add_status,
    "param": _add_param,
    "arm": _add_orders,
    "start": _add_orders,
    "stop": _add_orders,
    "retreat": _add_orders,
    "ack": _add_orders,
    "record": _add_record,
    "identify": _add_files,
    "replay": _add_files,
    "export": _add_files,
    "recover": _add_files,
    "view": _add_view,
    "metrics": _add_metrics,
    "bridge": _add_bridge,
    "doctor": _add_doctor,
    "keygen": _add_keygen,
}
"""What puts each command on the command line."""


if __name__ == "__main__":
    sys.exit(main())
