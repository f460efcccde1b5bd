"""``linemate fleet``: ask the bridges of all stations for their status and print one table."""

import argparse
import time
from typing import Any, Final

from linemate.daemon.command_line import NO, NO_ANSWER, OK, UsageError
from linemate.daemon.operator import console, render
from linemate.daemon.operator.bridge_command import ENDPOINT, open_session
from linemate.daemon.operator.fleet.fleet_table import fleet_rows, fleet_table

ASK_S: Final = 2.0  # for all answers, and for a station to be found


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the command."""
    about = "several stations in one table, over zenoh (extra 'fleet')"
    parser = commands.add_parser("fleet", help=about, description=about)
    parser.add_argument(
        "--connect", action="append", default=[], metavar="ENDPOINT",
        help=f"a bridge or a router; {ENDPOINT}",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Print the table; the exit code says whether every station is healthy."""
    endpoints = args.connect or [ENDPOINT]
    try:
        import zenoh
    except ImportError as error:
        raise UsageError("zenoh is not installed; pip install linemate[fleet]") from error
    try:
        with open_session([], endpoints) as session:
            answers = _ask(session)
    except zenoh.ZError as error:
        raise UsageError(" ".join(str(error).split())) from error
    rows, unreadable = fleet_rows(answers, time.time())
    if unreadable:
        console.complain(f"{unreadable} answers cannot be read")
    if not rows:
        console.complain(f"no station answers at {', '.join(endpoints)}")
        return NO_ANSWER
    named = [{name.replace(" ", "_"): value for name, value in row.items()} for row in rows]
    print(render.versioned({"stations": named}) if args.json else fleet_table(rows))
    return OK if all(row["health"] == "healthy" for row in rows) else NO


def _ask(session: Any) -> list[bytes]:
    """Return the answers of all stations; a session that has just begun may find none yet."""
    end = time.monotonic() + ASK_S
    while True:
        left_s = max(0.1, end - time.monotonic())
        replies = session.get("linemate/*/status", timeout=left_s)
        answers = [reply.ok.payload.to_bytes() for reply in replies if reply.ok]
        if answers or time.monotonic() >= end:
            return answers
        time.sleep(0.1)
