"""``linemate replay FILE``: recorded inputs through ``step``, and a table of what differs.

The steps are made in ``daemon.recording.replay``, imported when asked for. Exit codes: 0 identical,
1 different, damaged or not to be replayed, 2 usage.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from linemate.daemon.operator import render

if TYPE_CHECKING:
    from linemate.daemon.recording.format import DamageReport
    from linemate.daemon.recording.step_replay import Overrides, ReplayedStep, Summary

OK, NOT_OK, USAGE = 0, 1, 2
VERSION = 1
NOTES = 8
HELP = "run a recording's inputs through this program and compare, bit for bit"


def add_parser(commands: Any) -> None:
    """Add the command to the tool's."""
    parser = commands.add_parser("replay", help=HELP, description=HELP)
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="lay a configuration's parameters over it"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", dest="values",
        help="another parameter, as in `linemate param list`",
    )  # fmt: skip
    parser.add_argument(
        "--tolerance", type=float, default=0.0, metavar="X",
        help="numbers no further apart count as the same (SI units); 0: every bit",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=main)


@dataclass(slots=True)
class Account:
    """What a replay came to, as it goes."""

    steps: int = 0
    different: int = 0
    unmade: int = 0
    first_ns: int | None = None
    broken: "DamageReport | None" = None
    notes: list[tuple["ReplayedStep", str]] = field(default_factory=list)

    def take(self, verdicts: "Iterator[ReplayedStep]") -> "Iterator[ReplayedStep]":
        """Count verdicts as they pass."""
        for verdict in verdicts:
            if self.first_ns is None:
                self.first_ns = verdict.stamp_ns
            self.steps += 1
            self.different += bool(verdict.changes)
            self.unmade += verdict.unmade is not None
            why = verdict.unmade or verdict.begun
            if why is not None and len(self.notes) < NOTES:
                self.notes.append((verdict, why))
            yield verdict

    @property
    def is_complete(self) -> bool:
        """Every step of the file was read and made again."""
        return self.broken is None and not self.unmade and self.steps > 0

    def at_s(self, verdict: "ReplayedStep") -> float:
        """When a step was, since the first one [s]."""
        return (verdict.stamp_ns - (self.first_ns or 0)) * 1e-9


def main(args: argparse.Namespace) -> int:
    """Replay a file.

    Args:
        args: file, config, values, tolerance, json.

    Returns:
        0 identical, 1 different.
    """
    # BLAS threads would add in another order than the daemon's one.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    from linemate.daemon.recording.format import UnreadableRecordingError
    from linemate.daemon.recording.step_replay import ReplayError

    try:
        overrides = overrides_of(args.config, args.values)
    except ValueError as error:
        print(f"linemate: {error}", file=sys.stderr)
        return USAGE
    try:
        account, summaries = compare(args.file, overrides, args.tolerance)
    except (UnreadableRecordingError, ReplayError) as error:
        print(f"linemate: {error}", file=sys.stderr)
        return NOT_OK
    if args.json:
        print(render.as_json(as_plain(account, summaries)))
    else:
        print("\n".join(report(account, summaries)))
    return OK if account.is_complete and not summaries else NOT_OK


def compare(
    path: Path, overrides: "Overrides | None" = None, tolerance: float = 0.0
) -> "tuple[Account, dict[str, Summary]]":
    """Return what a recording's replay came to, and what differs by field.

    Raises:
        UnreadableRecordingError: it is no recording.
        ReplayError: it cannot be replayed.
    """
    from linemate.daemon.recording.format import DamageReport
    from linemate.daemon.recording.reader import pieces
    from linemate.daemon.recording.step_replay import Piece, replay, summarise, with_cycle

    account = Account()

    def heard() -> "Iterator[Piece]":
        for piece in with_cycle(pieces(path)):
            if isinstance(piece, DamageReport):
                account.broken = piece
            yield piece

    summaries = summarise(account.take(replay(heard(), overrides)), tolerance)
    return account, summaries


def overrides_of(config: Path | None, assignments: list[str]) -> "Overrides":
    """Return the parameters that a command line names.

    Raises:
        ValueError: the file or an assignment cannot be read.
    """
    from linemate.daemon.config.settings_tree import SECTIONS
    from linemate.daemon.recording.step_replay import Overrides

    sections: dict[str, Any] = {}
    if config is not None:
        value = _yaml(config)
        sections = {name: value[name] for name in SECTIONS if isinstance(value.get(name), dict)}
        if not sections:
            raise ValueError(f"{config}: no section {', '.join(SECTIONS)}")
    values: dict[str, Any] = {}
    for text in assignments:
        name, equals, told = text.partition("=")
        if not equals or not name:
            raise ValueError(f"--set {text}: should be NAME=VALUE")
        try:
            values[name] = json.loads(told)
        except json.JSONDecodeError:
            values[name] = told
    return Overrides(sections, values)


def report(account: Account, summaries: "Mapping[str, Summary]") -> list[str]:
    """Return a replay as lines of text."""
    lines = [f"{account.steps} steps, {account.different} of them different"]
    if account.unmade:
        lines.append(f"{account.unmade} steps could not be made again")
    if account.broken is not None:
        lines.append(str(account.broken))
    for verdict, why in account.notes:
        lines.append(f"step {verdict.k} ({account.at_s(verdict):.3f} s): {why}")
    if not summaries:
        if account.steps and not account.unmade:
            same = "identical" if not account.different else "the same within the tolerance"
            lines.append(same if account.is_complete else f"{same} as far as it was read")
        return lines
    rows = []
    for name, one in summaries.items():
        was, made = one.first.changes[name]
        apart = "" if one.largest is None else f"{one.largest:.3g}"
        where = "" if one.largest is None else f"{account.at_s(one.at):.3f}"
        first = f"{account.at_s(one.first):.3f}"
        rows.append((name, str(one.steps), str(one.first.k), first, apart, where, _both(was, made)))
    head = ("output", "steps", "first k", "at s", "largest", "at s", "first change")
    return [*lines, "", render.table(head, rows)]


def as_plain(account: Account, summaries: "Mapping[str, Summary]") -> dict[str, Any]:
    """Return a replay as plain values."""
    return {
        "version": VERSION,
        "identical": account.is_complete and not summaries,
        "steps": account.steps,
        "different": account.different,
        "unmade": account.unmade,
        "broken": None if account.broken is None else account.broken.reason,
        "total": account.steps if account.broken is None else account.broken.total,
        "notes": [
            {"k": verdict.k, "at_s": account.at_s(verdict), "what": why}
            for verdict, why in account.notes
        ],
        "fields": {
            name: {
                "steps": one.steps,
                "first": _place(account, one.first, name),
                "largest": one.largest,
                "at": _place(account, one.at, name),
            }
            for name, one in summaries.items()
        },
    }


def _place(account: Account, verdict: "ReplayedStep", name: str) -> dict[str, Any]:
    was, made = verdict.changes[name]
    return {"k": verdict.k, "at_s": account.at_s(verdict), "recorded": was, "made": made}


def _both(was: Any, made: Any) -> str:
    """Return a change in a few words: of a tuple, the first item that changed."""
    if isinstance(was, (tuple, list)) and isinstance(made, (tuple, list)) and len(was) == len(made):
        for index, (a, b) in enumerate(zip(was, made, strict=True)):
            if a != b or str(a) != str(b):
                return f"[{index}] {_both(a, b)}"
    return f"{_short(was)} -> {_short(made)}"


def _short(value: Any) -> str:
    text = value.hex() if isinstance(value, bytes) else render.scalar(value)
    return text if len(text) <= 28 else text[:25] + "..."


def _yaml(path: Path) -> dict[str, Any]:
    from linemate.daemon.config.settings_tree import SettingError, read_file

    try:
        return read_file(path.read_bytes(), str(path))
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from error
    except SettingError as error:
        raise ValueError(str(error)) from error
