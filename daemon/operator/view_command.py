"""``linemate view``: the live view of a daemon, or of recordings, in a browser.

Law of this file: words of a command line in, a process that serves a page until it is ended. What
that takes is imported when it is asked for. It gives way to everything else on the machine.
"""

import argparse
import contextlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from linemate.daemon.transport.client import Client
    from linemate.daemon.view.view_process import Where

OK, NOT_OK, USAGE = 0, 1, 2
NICE: Final = 10
HELP: Final = "show a daemon, or recordings, in the browser"
ABOUT: Final = (
    "Show a running daemon, or recordings, in the browser. Serves one page on the loopback until "
    "Ctrl-C; nothing in it comes from elsewhere, and it can order nothing."
)


def add_parser(
    commands: Any,
    common: argparse.ArgumentParser,
    client: "Callable[[argparse.Namespace], Client]",
) -> None:
    """Add the command to the tool's.

    Args:
        common: where the daemon is.
        client: makes one of the arguments.
    """
    parser = commands.add_parser("view", parents=[common], help=HELP, description=ABOUT)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="recordings to play")
    parser.add_argument("--port", type=_port, default=0, help="of the page; any free one")
    parser.add_argument(
        "--bind", type=_address, default="127.0.0.1", metavar="ADDRESS",
        help="listen there; beyond the loopback everybody who reaches it can look on",
    )  # fmt: skip
    parser.add_argument(
        "--no-browser", action="store_true", help="print the address and open nothing"
    )
    parser.set_defaults(run=lambda args: main(args, client))


def main(args: argparse.Namespace, client: "Callable[[argparse.Namespace], Client]") -> int:
    """Serve until told to end.

    Args:
        args: files, port, bind, no_browser, and where the daemon is.
        client: makes one of them.
    """
    import asyncio

    from linemate.daemon.recording.format import UnreadableRecordingError
    from linemate.daemon.view import view_process

    with contextlib.suppress(OSError):
        os.nice(NICE)  # whatever else runs here goes first
    try:
        if args.files:
            asyncio.run(view_process.play(args.files, _at(args)))
        else:
            asyncio.run(view_process.watch(lambda: client(args), _name(args), _at(args)))
    except UnreadableRecordingError as error:
        print(f"linemate view: {error}", file=sys.stderr)
        return NOT_OK
    except OSError as error:
        where = f"{args.bind}:{args.port}"
        print(f"linemate view: {where}: {error.strerror or error}", file=sys.stderr)
        return NOT_OK
    return OK


def _at(args: argparse.Namespace) -> "Where":
    from linemate.daemon.view.view_process import Where

    return Where(args.bind, args.port, is_opened=not args.no_browser and has_display())


def has_display() -> bool:
    """Whether there is a screen to open a browser on."""
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform == "darwin" or any(os.environ.get(name) for name in names)


def _name(args: argparse.Namespace) -> str:
    udp = getattr(args, "udp", None)
    if udp:
        return f"{udp[0]}:{udp[1]}"
    told = getattr(args, "socket", None)
    return str(told) if told else "this host"


def _port(text: str) -> int:
    with contextlib.suppress(ValueError):
        if 0 <= int(text) < 65536:
            return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a port")


def _address(text: str) -> str:
    import ipaddress

    with contextlib.suppress(ValueError):
        return str(ipaddress.ip_address(text))
    raise argparse.ArgumentTypeError(f"{text!r} is not a numeric address")
