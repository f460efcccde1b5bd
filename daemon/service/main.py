"""``linemated``: command line and start-up of the daemon.

Exit codes: 0 ended on request, 1 cannot run, 2 usage, 78 bad configuration, with every error as
``file:line:col: key: what``.
"""

import argparse
import asyncio
import gc
import json
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from linemate.daemon import command_line
from linemate.daemon.command_line import CommandLine, Version
from linemate.daemon.service.host.log_stream import LogStream

if TYPE_CHECKING:
    from linemate.daemon.commissioning.kept_rehearsals import KeptRehearsals
    from linemate.daemon.commissioning.whole_check import CheckedConfig

# Before numpy is imported: a second BLAS thread is slower for small matrices, and wakes a core.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

OK = 0
CANNOT_RUN = 1
BAD_CONFIGURATION = 78

log = logging.getLogger("linemated")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the daemon and return its exit code."""
    arguments = parser().parse_args(argv)
    logging.basicConfig(
        level=arguments.log.upper(),
        handlers=[LogStream()],
        format="%(levelname)s %(name)s: %(message)s",
    )
    # Nothing that a start imports and compiles is garbage: to look for it is 5 % of the start.
    gc.disable()
    try:
        return command_line.run("linemated", lambda: _main(arguments))
    finally:
        gc.enable()


def _main(arguments: argparse.Namespace) -> int:
    # Imported late, so that a wrong command line is answered at once.
    from linemate.daemon.config import config
    from linemate.daemon.config.documents import FileError

    if arguments.schema:
        print(json.dumps(config.schema(), indent=2))
        return OK
    from linemate.daemon.commissioning import whole_check

    try:
        checked = whole_check.check(arguments.config, keeps=not arguments.check)
    except FileError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return BAD_CONFIGURATION
    if arguments.check:
        from linemate.daemon.commissioning.plan.unusual import cautions

        for line in cautions(checked.station):
            print(f"{arguments.config}: unusual: {line}", file=sys.stderr)
        print(f"{arguments.config}: good", *checked.peaks, sep="\n")
        return OK
    _keep_rehearsals(checked.kept)
    return _serve(checked, arguments.ready_fd)


def _keep_rehearsals(kept: "KeptRehearsals") -> None:
    """Keep good rehearsals for the next start, and log what was left out."""
    if kept.left_out:
        log.info("not rehearsed again, the same was good before: %s", ", ".join(kept.left_out))
    if kept.trouble:
        log.warning("kept rehearsals are not used: %s", kept.trouble)
    try:
        kept.keep()
    except OSError as error:
        log.warning("rehearsals are not kept: %s", error)


def _serve(checked: "CheckedConfig", ready_fd: int | None) -> int:
    from linemate.daemon.service.app import App, StartError
    from linemate.daemon.service.host import realtime
    from linemate.daemon.service.host.notify import Notifier

    station = checked.station
    host = realtime.request_all(station.config.realtime)
    for refusal in host.refusals():
        log.warning("%s", refusal)
    notifier = Notifier.from_environment()
    app = App(station, checked.parameters, host, notifier, checked.variants)
    app.counters["unusable_rehearsals"] += checked.kept.unusable
    if not station.config.realtime.freeze_collector:
        # Else it would go through all objects of the start, 60 ms, before it is disabled again.
        gc.enable()
    try:
        asyncio.run(app.run(lambda listening: _report_ready(listening, ready_fd)))
    except StartError as error:
        log.error("%s", error)  # noqa: TRY400 - a line for an operator, not a trace
        return CANNOT_RUN
    return OK


def _report_ready(listening: dict[str, Any], ready_fd: int | None) -> None:
    """Write one line of JSON for the process that started the daemon, and close."""
    if ready_fd is None:
        return
    try:
        with os.fdopen(ready_fd, "w", encoding="utf-8") as pipe:
            pipe.write(json.dumps(listening) + "\n")
    except OSError as error:
        log.warning("the ports are not reported: --ready-fd %d: %s", ready_fd, error.strerror)


def _descriptor(text: str) -> int:
    try:
        os.fstat(int(text))
    except (ValueError, OverflowError, OSError) as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no open file descriptor") from error
    return int(text)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    command_parser = CommandLine(prog="linemated", description="The linemate daemon.")
    command_parser.add_argument("--version", action=Version)
    what = command_parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--config", type=Path, metavar="FILE", help="YAML, see linemated.yaml(5)")
    what.add_argument("--schema", action="store_true", help="print the JSON schema of FILE and end")
    command_parser.add_argument("--check", action="store_true", help="validate every file and end")
    command_parser.add_argument(
        "--ready-fd", type=_descriptor, metavar="N", help="write a line of JSON with the ports here"
    )
    levels = ("debug", "info", "warning", "error")
    command_parser.add_argument(
        "--log", choices=levels, default="info", help="what is logged; info"
    )
    return command_parser


if __name__ == "__main__":
    sys.exit(main())
