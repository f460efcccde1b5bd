"""``linemate replay``: run recorded inputs through ``step`` and print what differs."""

import argparse
import json
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from linemate.daemon.command_line import NO, OK, NegativeError, UsageError, bounded
from linemate.daemon.operator import render

if TYPE_CHECKING:
    from linemate.daemon.recording.format import DamageReport
    from linemate.daemon.recording.step_replay import Overrides, ReplayedStep, Summary

VERSION = 1
MAX_NOTES = 8
MAX_VALUE_WIDTH = 28  # of a value in the table
HELP = "run a recording's inputs through this program and compare, bit for bit"


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the command."""
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
        "--tolerance", default=0.0, metavar="X",
        type=bounded(float, 0.0, sys.float_info.max, "is not a finite number of at least 0"),
        help="numbers no further apart count as the same (SI units); 0: every bit",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=main)


@dataclass(slots=True)
class ReplayCount:
    """Counts of a replay while its steps pass.

    Attributes:
        unmade: Steps that could not be computed again.
        first_ns: Stamp of the first step [ns].
        broken: Why the recording could not be read to its end.
        notes: The first remarks on steps.
    """

    steps: int = 0
    different: int = 0
    unmade: int = 0
    first_ns: int | None = None
    broken: "DamageReport | None" = None
    notes: list[tuple["ReplayedStep", str]] = field(default_factory=list)

    def count(self, comparisons: "Iterator[ReplayedStep]") -> "Iterator[ReplayedStep]":
        """Count the comparisons of steps and hand them on."""
        for comparison in comparisons:
            if self.first_ns is None:
                self.first_ns = comparison.stamp_ns
            self.steps += 1
            self.different += bool(comparison.changes)
            self.unmade += comparison.failure is not None
            why = comparison.failure or comparison.restart
            if why is not None and len(self.notes) < MAX_NOTES:
                self.notes.append((comparison, why))
            yield comparison

    @property
    def is_complete(self) -> bool:
        """Whether every step of the file was read and computed again."""
        return self.broken is None and not self.unmade and self.steps > 0

    def at_s(self, comparison: "ReplayedStep") -> float:
        """Return the time of a step since the first one [s]."""
        return (comparison.stamp_ns - (self.first_ns or 0)) * 1e-9


def main(args: argparse.Namespace) -> int:
    """Replay a file; the exit code says whether all of it is identical."""
    # More BLAS threads than the daemon's one would add numbers in another order.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    from linemate.daemon.recording.format import UnreadableRecordingError
    from linemate.daemon.recording.step_replay import ReplayError

    try:
        overrides = overrides_of(args.config, args.values)
    except ValueError as error:
        raise UsageError(str(error)) from error
    try:
        count, summaries = compare(args.file, overrides, args.tolerance)
    except (UnreadableRecordingError, ReplayError) as error:
        raise NegativeError(str(error)) from error
    if args.json:
        print(render.as_json(as_plain(count, summaries)))
    else:
        print("\n".join(report(count, summaries)))
    return OK if count.is_complete and not summaries else NO


def compare(
    path: Path, overrides: "Overrides | None" = None, tolerance: float = 0.0
) -> "tuple[ReplayCount, dict[str, Summary]]":
    """Return the counts of a recording's replay, and what differs by field.

    Raises:
        UnreadableRecordingError: The file is not a recording.
        ReplayError: The recording cannot be replayed.
    """
    from linemate.daemon.recording.format import DamageReport
    from linemate.daemon.recording.reader import pieces
    from linemate.daemon.recording.step_replay import Piece, replay, summarise, with_cycle

    count = ReplayCount()

    def recorded() -> "Iterator[Piece]":
        for piece in with_cycle(pieces(path)):
            if isinstance(piece, DamageReport):
                count.broken = piece
            yield piece

    summaries = summarise(count.count(replay(recorded(), overrides)), tolerance)
    return count, summaries


def overrides_of(config: Path | None, assignments: list[str]) -> "Overrides":
    """Return the parameters that a command line names.

    Raises:
        ValueError: The file or an assignment cannot be read.
    """
    from linemate.daemon.config.settings_tree import SECTIONS
    from linemate.daemon.recording.step_replay import Overrides

    sections: dict[str, Any] = {}
    if config is not None:
        whole = _read_yaml(config)
        sections = {name: whole[name] for name in SECTIONS if isinstance(whole.get(name), dict)}
        if not sections:
            raise ValueError(f"{config}: no section {', '.join(SECTIONS)}")
    values: dict[str, Any] = {}
    for text in assignments:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise ValueError(f"--set {text}: should be NAME=VALUE")
        if name in values:
            raise ValueError(f"--set {name} is given twice")
        try:
            values[name] = json.loads(value)
        except (ValueError, RecursionError):
            values[name] = value
    return Overrides(sections, values)


def report(count: ReplayCount, summaries: "Mapping[str, Summary]") -> list[str]:
    """Return a replay as lines of text."""
    lines = [f"{count.steps} steps, {count.different} of them different"]
    if count.unmade:
        lines.append(f"{count.unmade} steps could not be computed again")
    if count.broken is not None:
        lines.append(str(count.broken))
    for comparison, why in count.notes:
        lines.append(f"step {comparison.k} ({count.at_s(comparison):.3f} s): {why}")
    if summaries:
        head = ("output", "steps", "first k", "at s", "largest", "at s", "first change")
        rows = [_row(count, name, summary) for name, summary in summaries.items()]
        return [*lines, "", render.table(head, rows)]
    if count.steps and not count.unmade:
        same = "identical" if not count.different else "the same within the tolerance"
        lines.append(same if count.is_complete else f"{same} as far as it was read")
    return lines


def _row(count: ReplayCount, name: str, summary: "Summary") -> tuple[str, ...]:
    recorded, replayed = summary.first.changes[name]
    return (
        name,
        str(summary.steps),
        str(summary.first.k),
        f"{count.at_s(summary.first):.3f}",
        "" if summary.largest is None else f"{summary.largest:.3g}",
        "" if summary.largest is None else f"{count.at_s(summary.at):.3f}",
        _change(recorded, replayed),
    )


def as_plain(count: ReplayCount, summaries: "Mapping[str, Summary]") -> dict[str, Any]:
    """Return a replay as plain values."""
    return {
        "version": VERSION,
        "identical": count.is_complete and not summaries,
        "steps": count.steps,
        "different": count.different,
        "unmade": count.unmade,
        "broken": None if count.broken is None else count.broken.reason,
        "total": count.steps if count.broken is None else count.broken.total,
        "notes": [
            {"k": comparison.k, "at_s": count.at_s(comparison), "what": why}
            for comparison, why in count.notes
        ],
        "fields": {
            name: {
                "steps": summary.steps,
                "first": _place(count, summary.first, name),
                "largest": summary.largest,
                "at": _place(count, summary.at, name),
            }
            for name, summary in summaries.items()
        },
    }


def _place(count: ReplayCount, comparison: "ReplayedStep", name: str) -> dict[str, Any]:
    recorded, replayed = comparison.changes[name]
    return {
        "k": comparison.k,
        "at_s": count.at_s(comparison),
        "recorded": recorded,
        "made": replayed,
    }


def _change(recorded: Any, replayed: Any) -> str:
    """Return a change as text: of a tuple, its first different item."""
    if (
        isinstance(recorded, (tuple, list))
        and isinstance(replayed, (tuple, list))
        and len(recorded) == len(replayed)
    ):
        for index, (a, b) in enumerate(zip(recorded, replayed, strict=True)):
            # NaN differs from itself, and 0.0 equals -0.0: their texts decide.
            if a != b or str(a) != str(b):
                return f"[{index}] {_change(a, b)}"
    return f"{_short(recorded)} -> {_short(replayed)}"


def _short(value: Any) -> str:
    text = value.hex() if isinstance(value, bytes) else render.scalar(value)
    return text if len(text) <= MAX_VALUE_WIDTH else text[: MAX_VALUE_WIDTH - 3] + "..."


def _read_yaml(path: Path) -> dict[str, Any]:
    from linemate.daemon.config.settings_tree import SettingError, read_file

    try:
        return read_file(path.read_bytes(), str(path))
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from error
    except SettingError as error:
        raise ValueError(str(error)) from error
