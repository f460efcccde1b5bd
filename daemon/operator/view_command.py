"""``linemate view``: serve a page that shows a daemon, or recordings, in a browser."""

import argparse
import contextlib
import os
import sys
from pathlib import Path
from typing import Any, Final

from linemate.daemon.command_line import OK, NegativeError, UsageError, bounded
from linemate.daemon.operator import console

NICE: Final = 10  # the robot's processes of this machine go first
HELP: Final = "show a daemon, or recordings, in the browser"
ABOUT: Final = (
    "Show a running daemon, or recordings, in the browser. Serves one page on the loopback until "
    "Ctrl-C; nothing in it comes from elsewhere, and it can order nothing."
)


def add_parser(commands: Any, common: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser = commands.add_parser("view", parents=[common], help=HELP, description=ABOUT)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="recordings to play")
    parser.add_argument(
        "--port",
        type=bounded(int, 0, 65535, "is not a port"),
        help="of the page, any free one; with --foxglove 8765",
    )
    parser.add_argument(
        "--bind", type=console.numeric_address, default="127.0.0.1", metavar="ADDRESS",
        help="listen there; beyond the loopback all who reach it can watch",
    )  # fmt: skip
    parser.add_argument(
        "--no-browser", action="store_true", help="print the address and open nothing"
    )
    parser.add_argument(
        "--foxglove", action="store_true",
        help="no page, but standard channels of the daemon by WebSocket (extra 'foxglove')",
    )  # fmt: skip
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Serve until a signal ends it."""
    with contextlib.suppress(OSError):
        os.nice(NICE)
    if args.foxglove:
        return _serve_channels(args)
    for file in args.files:
        try:
            file.open("rb").close()
        except OSError as error:
            raise UsageError(f"{file}: {error.strerror}") from error
    import asyncio

    from linemate.daemon.recording.format import UnreadableRecordingError
    from linemate.daemon.view import view_process

    where = view_process.Where(args.bind, args.port or 0, not args.no_browser and has_display())
    try:
        if args.files:
            asyncio.run(view_process.play(args.files, where))
        else:
            asyncio.run(view_process.watch(lambda: console.connect(args), _source(args), where))
    except UnreadableRecordingError as error:
        raise NegativeError(str(error)) from error
    except OSError as error:
        raise UsageError(f"{args.bind}:{args.port or 0}: {error.strerror or error}") from error
    return OK


def _serve_channels(args: argparse.Namespace) -> int:
    """Serve a daemon's standard channels until a signal ends it."""
    if args.files:
        raise UsageError("--foxglove shows a daemon; `linemate export FILE --foxglove` a recording")
    try:
        from linemate.daemon.view.channels import channel_server
    except ImportError as error:
        raise UsageError(
            f"{error.name} is not installed; pip install linemate[foxglove]"
        ) from error
    console.connect(args).close()  # reports an unreadable key at once
    port = channel_server.PORT if args.port is None else args.port
    try:
        channel_server.serve(lambda: console.connect(args), args.bind, port)
    except (OSError, RuntimeError) as error:
        raise UsageError(f"{args.bind}:{port}: {error}") from error
    return OK


def has_display() -> bool:
    """Return whether there is a screen to open a browser on."""
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform == "darwin" or any(os.environ.get(name) for name in names)


def _source(args: argparse.Namespace) -> str:
    udp = getattr(args, "udp", None)
    if udp:
        return f"{udp[0]}:{udp[1]}"
    return str(getattr(args, "socket", None) or "this host")
