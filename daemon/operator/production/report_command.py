"""``linemate report``: an HTML page of a day's quality records."""

import argparse
import contextlib
import json
import re
from datetime import date
from pathlib import Path
from typing import Any, Final

from linemate.daemon.command_line import NO, OK, USAGE
from linemate.daemon.operator import console

MOST_BYTES: Final = 256 * 1024 * 1024
_DAY: Final = re.compile(r"\d{4}-\d{2}-\d{2}")
_NEEDED: Final = ("at", "station", "part", "variant", "ok", "reason")


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser = commands.add_parser("report", help="page of a day's quality records")
    parser.add_argument("day", metavar="DAY", type=_day, help="YYYY-MM-DD, in UTC")
    parser.add_argument(
        "--records", type=Path, default=Path("records"), metavar="DIR",
        help="directory of the records (production.records); records",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="FILE", help="the page; report-DAY.html")
    parser.set_defaults(run=_run)


def _day(text: str) -> str:
    try:
        if _DAY.fullmatch(text) is not None:
            return str(date.fromisoformat(text))
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} should be a day, YYYY-MM-DD")


def _run(args: argparse.Namespace) -> int:
    from linemate.daemon.production import day_report

    path = args.records / f"parts-{args.day}.jsonl"
    try:
        if path.stat().st_size > MOST_BYTES:
            console.complain(f"{path}: longer than {MOST_BYTES} bytes")
            return NO
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        console.complain(f"{path}: {error.strerror}. Check --records and production.records")
        return NO
    except UnicodeDecodeError as error:
        console.complain(f"{path}: not a text: {error.reason}")
        return NO
    records, damaged = read(lines)
    out = args.out or Path(f"report-{args.day}.html")
    try:
        out.write_text(day_report.page(records, args.day), encoding="utf-8")
    except OSError as error:
        console.complain(f"{out}: {error.strerror}")
        return USAGE
    note = f", {damaged} damaged lines left out" if damaged else ""
    print(f"{out}: {len(records)} parts{note}")
    return OK


def read(lines: list[str]) -> tuple[list[dict[str, Any]], int]:
    """Return the records of some lines of JSON, and the number of lines that are none."""
    records = []
    for line in lines:
        with contextlib.suppress(ValueError, RecursionError):
            record = json.loads(line)
            if isinstance(record, dict) and all(name in record for name in _NEEDED):
                records.append(record)
    return records, len(lines) - len(records)
