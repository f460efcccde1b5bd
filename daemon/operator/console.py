"""What the commands of ``linemate`` share: options, argument types, and the daemon's client."""

import argparse
import contextlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from linemate.daemon.command_line import POSITIVE, CommandLine, bounded
from linemate.daemon.operator import render
from linemate.daemon.transport.client import (
    DEFAULT_PORT,
    DEFAULT_TIMEOUT_S,
    Client,
    default_key_path,
    read_key,
)

COMPILE_S: Final = 4.5  # time for a daemon that compiles parameters or writes a file [s]
seconds: Final = bounded(float, POSITIVE, 3600.0, "is not a number of seconds")
"""Type of a duration [s], at most an hour."""


def complain(text: object) -> None:
    """Print one line on standard error."""
    print(f"linemate: {text}", file=sys.stderr)


def connect(args: argparse.Namespace) -> Client:
    """Return a client of the daemon that the common options name."""
    if not getattr(args, "udp", None):
        return Client.local(getattr(args, "socket", None))
    host, port = args.udp
    path = getattr(args, "key", None) or default_key_path()
    return Client.udp(host, port, read_key(path, getattr(args, "key_name", None)))


def ask(
    args: argparse.Namespace,
    op: str,
    params: Mapping[str, Any] | None = None,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> dict[str, Any]:
    """Ask that daemon for one operation and return its answer."""
    with connect(args) as client:
        return client.call(op, params, getattr(args, "timeout", timeout_s))


def print_answer(args: argparse.Namespace, answer: Mapping[str, Any]) -> None:
    """Print an answer as JSON or as rows; an empty one as nothing."""
    if args.json:
        print(render.versioned(answer))
    elif answer:
        print(render.table((), render.rows(answer)))


def common_options() -> argparse.ArgumentParser:
    """Return the parent parser of commands that ask a daemon."""
    common = CommandLine(add_help=False, argument_default=argparse.SUPPRESS)
    where = common.add_argument_group("where the daemon is")
    where.add_argument("--socket", type=Path, metavar="PATH", help="its local socket")
    where.add_argument(
        "--udp", type=udp_address, metavar="HOST[:PORT]", help=f"its UDP port ({DEFAULT_PORT})"
    )
    where.add_argument("--key", type=Path, metavar="FILE", help="key file for --udp")
    where.add_argument("--key-name", metavar="NAME", help="which key of the file; the first")
    where.add_argument("--timeout", type=seconds, metavar="S", help="wait so long; 0.5")
    common.add_argument("--json", action="store_true", default=False, help="print JSON")
    return common


def numeric_address(text: str) -> str:
    """Return the address of an option."""
    import ipaddress

    with contextlib.suppress(ValueError):
        return str(ipaddress.ip_address(text))
    raise argparse.ArgumentTypeError(f"{text!r} is not a numeric address")


def udp_address(text: str) -> tuple[str, int]:
    """Return HOST or HOST:PORT as a pair."""
    host, colon, port = text.rpartition(":")
    if not colon:
        return text, DEFAULT_PORT
    with contextlib.suppress(ValueError):
        if host and 0 < int(port) < 65536:
            return host.strip("[]"), int(port)
    raise argparse.ArgumentTypeError(f"{text!r} is not HOST or HOST:PORT")


def station(text: str) -> tuple[str, Path]:
    """Return NAME=SOCKET as a pair."""
    name, equals, path = text.partition("=")
    if not (name and equals and path):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=SOCKET")
    return name, Path(path)


class _AppendOnce(argparse.Action):
    """Append a pair to a list; a name that is there already would hide the other station."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,  # noqa: ARG002 - argparse's signature
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,  # noqa: ARG002
    ) -> None:
        given = getattr(namespace, self.dest)
        if values[0] in dict(given):
            raise argparse.ArgumentError(self, f"the name {values[0]!r} is given twice")
        setattr(namespace, self.dest, [*given, values])


def add_stations(
    parser: argparse.ArgumentParser, kind: Callable[[str], tuple[str, Path]] = station
) -> None:
    """Add the options that name the daemons of several stations, and who may reach them."""
    parser.add_argument(
        "--station", action=_AppendOnce, type=kind, default=[], metavar="NAME=SOCKET",
        help="a daemon's local socket and the name it goes by; the system's daemon",
    )  # fmt: skip
    parser.add_argument(
        "--allow-remote", action="store_true", help="consent to an address that others can reach"
    )
