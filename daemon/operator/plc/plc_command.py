"""``linemate plc`` and ``linemate plc-user``: the OPC UA server, and its users."""

import argparse
import asyncio
import getpass
import ipaddress
import os
import signal
import sys
from pathlib import Path
from typing import Any, Final

from linemate.daemon.command_line import OK, UsageError
from linemate.daemon.operator import console
from linemate.daemon.operator.plc import plc_users
from linemate.protocol.command.frame_codec import Role

PORT: Final = 4840


def add_parser(commands: Any, common: argparse.ArgumentParser) -> None:
    """Add the commands."""
    about = "serve state, results and methods over OPC UA (extra 'plc')"
    plc = commands.add_parser("plc", parents=[common], help=about, description=about)
    plc.add_argument("--users", type=Path, required=True, metavar="FILE", help="who may do what")
    plc.add_argument(
        "--bind",
        type=console.numeric_address,
        default="127.0.0.1",
        metavar="ADDRESS",
        help="127.0.0.1",
    )
    plc.add_argument("--port", type=_port, default=PORT, metavar="N", help=f"{PORT}")
    plc.add_argument("--certificate", type=Path, metavar="FILE", help="of the server, DER or PEM")
    plc.add_argument("--private-key", type=Path, metavar="FILE", help="of the certificate")
    plc.add_argument(
        "--allow-remote", action="store_true",
        help="consent to an address that others can reach; needs --certificate",
    )  # fmt: skip
    plc.set_defaults(run=_serve)
    user = commands.add_parser("plc-user", help="print the line of a user of the OPC UA server")
    user.add_argument("name", metavar="NAME")
    user.add_argument("role", choices=[str(role) for role in Role])
    user.set_defaults(run=_user)


def _port(text: str) -> int:
    if text.isdigit() and 0 < int(text) < 65536:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a port")


def _serve(args: argparse.Namespace) -> int:
    certificate = None
    if (args.certificate is None) != (args.private_key is None):
        raise UsageError("--certificate and --private-key belong together")
    if args.certificate is not None:
        certificate = (args.certificate, args.private_key)
    is_local = ipaddress.ip_address(args.bind).is_loopback
    if not is_local and not (args.allow_remote and certificate):
        raise UsageError(
            f"{args.bind} can be reached by others; add --allow-remote and give --certificate"
        )
    users = plc_users.read_users(args.users)
    try:
        from linemate.daemon.operator.plc.plc_server import PlcServer
    except ImportError as error:
        raise UsageError("asyncua is not installed; pip install linemate[plc]") from error
    endpoint = f"opc.tcp://{args.bind}:{args.port}/linemate"
    server = PlcServer(endpoint, users, lambda: console.connect(args))

    async def body() -> None:
        end = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, end.set)
        await server.run(end, lambda: print(endpoint, flush=True), certificate)

    try:
        asyncio.run(body())
    except OSError as error:
        raise UsageError(f"{endpoint}: {error.strerror or error}") from error
    return OK


def _user(args: argparse.Namespace) -> int:
    """Read a password from the terminal, or a line of standard input, and print the user's line."""
    if sys.stdin.isatty():
        password = getpass.getpass("password: ")
    else:
        password = sys.stdin.readline().rstrip("\n")
    try:
        salt = os.urandom(plc_users.SALT_BYTES)
        print(plc_users.user_line(args.name, Role(args.role), password, salt))
    except ValueError as error:
        raise UsageError(str(error)) from error
    return OK
