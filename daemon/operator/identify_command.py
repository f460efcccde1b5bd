"""``linemate identify``: identify parameters from recordings and write them as an overlay."""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from linemate.daemon.command_line import (
    NO,
    OK,
    NegativeError,
    UsageError,
    check_output_file,
    one_thread,
)
from linemate.daemon.config import files as config_files
from linemate.daemon.operator import console, render

if TYPE_CHECKING:
    from linemate.daemon.identification.outcome import ReportLine
    from linemate.daemon.identification.pipeline import Identified

DEFAULT_OUT = Path("identified.yaml")

write = config_files.write


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "identify", help="servos, windup, tool, swing, delays and noise from recordings"
    )
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    add_outputs(parser, DEFAULT_OUT)
    parser.set_defaults(run=main)


def add_outputs(parser: argparse.ArgumentParser, out: Path) -> None:
    """Add ``--out`` and ``--json``, as ``present`` reads them."""
    parser.add_argument("--out", type=Path, default=out, metavar="FILE", help=f"overlay; {out}")
    parser.add_argument("--json", action="store_true", help="print JSON")


def main(args: argparse.Namespace) -> int:
    """Identify; the exit code says whether anything was identified."""
    check_output_file(args.out)
    one_thread()
    from linemate.daemon.identification.pipeline import IdentifyError
    from linemate.daemon.recording.format import UnreadableRecordingError

    try:
        identified = from_files(args.files)
    except (UnreadableRecordingError, IdentifyError) as error:
        raise NegativeError(str(error)) from error
    return present(identified, args, [path.name for path in args.files])


def present(identified: "Identified", args: argparse.Namespace, names: Sequence[str]) -> int:
    """Print what was identified, and write its overlay; return the exit code.

    Args:
        args: the parsed outputs: ``out`` and ``json``.
        names: of the files that it was identified from.

    Raises:
        UsageError: the overlay cannot be written.
    """
    print(render.as_json(as_plain(identified)) if args.json else table(identified.findings))
    if not identified.overlay:
        console.complain("nothing could be identified; no overlay is written")
        return NO
    try:
        write(args.out, overlay_text(identified, names))
    except OSError as error:
        raise UsageError(f"--out {args.out}: {error.strerror}") from error
    if not args.json:
        print(f"\noverlay: {args.out}")
    return OK


def from_files(files: Iterable[Path]) -> "Identified":
    """Identify parameters from recordings.

    Raises:
        UnreadableRecordingError: A file is not a recording.
        IdentifyError: The recordings cannot be used together.
    """
    from linemate.daemon.recording.format import UnreadableRecordingError
    from linemate.daemon.recording.reader import read

    recordings = []
    for path in files:
        recording = read(path)
        if recording.damage is not None and not recording.steps:
            raise UnreadableRecordingError(f"{path}: {recording.damage}")
        if recording.damage is not None:
            console.complain(f"{path}: {recording.damage}")
        recordings.append((path.name, recording.texts, recording.steps))
    # Imported late: scipy takes longer than to refuse a file.
    from linemate.daemon.identification.pipeline import Recorded, identify

    return identify([Recorded(*recording) for recording in recordings])


def table(findings: "Sequence[ReportLine]") -> str:
    """Return findings as text, one a line; * marks those of the overlay."""
    from linemate.daemon.identification.outcome import Estimate

    rows = []
    for finding in findings:
        outcome = finding.outcome
        if isinstance(outcome, Estimate):
            value, deviation = shown(
                outcome.value * finding.scale, outcome.deviation * finding.scale
            )
            mark = "*" if finding.in_overlay else ""
            rows.append((finding.name, value, deviation, finding.unit, mark, outcome.basis))
        else:
            rows.append((finding.name, "-", "", finding.unit, "", f"refused: {outcome.reason}"))
    return render.table(("what", "value", "+-", "unit", "", "rests on"), rows)


def shown(value: float, deviation: float) -> tuple[str, str]:
    """Return a value and its standard deviation, with two digits of the deviation."""
    if not 0.0 < deviation < float("inf"):
        return f"{value:.6g}", "0"
    first = f"{deviation:.1e}"
    digits = min(max(1 - int(first.split("e")[1]), 0), 7)
    return f"{value:.{digits}f}", f"{deviation:.{digits}f}" if digits < 7 else "< 1e-6"


def as_plain(identified: "Identified") -> dict[str, Any]:
    """Return findings and overlay as plain values, in SI units."""
    from linemate.daemon.identification.outcome import Estimate

    return {
        "version": 1,
        "findings": [
            {"name": f.name, "told": f.in_overlay, "value": f.outcome.value,
             "deviation": f.outcome.deviation, "basis": f.outcome.basis}
            if isinstance(f.outcome, Estimate)
            else {"name": f.name, "told": False, "refused": f.outcome.reason}
            for f in identified.findings
        ],
        "overlay": identified.overlay,
        "kept": list(identified.kept),
    }  # fmt: skip


def overlay_text(identified: "Identified", names: Sequence[str]) -> str:
    """Return an overlay as YAML, with the names of its recordings in comments."""
    import yaml

    head = ["# Identified parameters; sections as in a configuration, laid over it."]
    head += [f"# from {name}" for name in names]
    head += [f"# kept as configured: {path}" for path in identified.kept]
    body = yaml.safe_dump(identified.overlay, sort_keys=False, default_flow_style=None, width=100)
    return "\n".join([*head, str(body)])
