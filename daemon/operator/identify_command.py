"""``linemate identify FILE...``: print what recordings identify, and write an overlay.

Exit codes: 0 something was identified, 1 nothing was, with the reason, 2 usage.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from linemate.daemon.operator import render

if TYPE_CHECKING:
    from linemate.daemon.identification.identify import Identified
    from linemate.daemon.identification.outcome import Finding

OK, NOT_OK, USAGE = 0, 1, 2
DEFAULT_OUT = Path("identified.yaml")


def add_parser(commands: Any) -> None:
    """Add the command to the tool's."""
    parser = commands.add_parser(
        "identify", help="servos, tool, swing, delays and noise from recordings"
    )
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument(
        "--out", type=Path, default=DEFAULT_OUT, metavar="FILE", help=f"overlay; {DEFAULT_OUT}"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Identify what the files tell.

    Returns:
        0 something was identified, 1 nothing was.
    """
    # BLAS threads make a sum depend on the machine, and small problems slower.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from linemate.daemon.identification.identify import IdentifyError
    from linemate.daemon.recording.format import UnreadableRecordingError

    try:
        found = from_files(args.files)
    except (UnreadableRecordingError, IdentifyError) as error:
        print(f"linemate: {error}", file=sys.stderr)
        return NOT_OK
    print(render.as_json(as_plain(found)) if args.json else table(found.findings))
    if not found.overlay:
        print("linemate: nothing could be identified; no overlay is written", file=sys.stderr)
        return NOT_OK
    try:
        write(args.out, overlay_text(found, [path.name for path in args.files]))
    except OSError as error:
        print(f"linemate: {args.out}: {error.strerror}", file=sys.stderr)
        return NOT_OK
    if not args.json:
        print(f"\noverlay: {args.out}")
    return OK


def from_files(files: Iterable[Path]) -> "Identified":
    """Return what recordings tell.

    Raises:
        UnreadableRecordingError: a file is no recording.
        IdentifyError: the recordings cannot be used together.
    """
    from linemate.daemon.recording.format import UnreadableRecordingError
    from linemate.daemon.recording.reader import read

    recordings = []
    for path in files:
        recording = read(path)
        if recording.damage is not None and not recording.steps:
            raise UnreadableRecordingError(f"{path}: {recording.damage}")
        if recording.damage is not None:
            print(f"linemate: {path}: {recording.damage}", file=sys.stderr)
        recordings.append((path.name, recording.texts, recording.steps))
    # Imported late: a file that cannot be used is refused before scipy is there.
    from linemate.daemon.identification.identify import Recorded, identify

    return identify([Recorded(*recording) for recording in recordings])


def table(findings: "Sequence[Finding]") -> str:
    """Return a report as text: a line a finding; * marks what goes into the overlay."""
    from linemate.daemon.identification.outcome import Estimate

    rows = []
    for finding in findings:
        outcome = finding.outcome
        if isinstance(outcome, Estimate):
            value, doubt = shown(outcome.value * finding.scale, outcome.deviation * finding.scale)
            mark = "*" if finding.told else ""
            rows.append((finding.name, value, doubt, finding.unit, mark, outcome.basis))
        else:
            rows.append((finding.name, "-", "", finding.unit, "", f"refused: {outcome.reason}"))
    return render.table(("what", "value", "+-", "unit", "", "rests on"), rows)


def shown(value: float, deviation: float) -> tuple[str, str]:
    """Return a value with as many digits as its deviation leaves it."""
    if not 0.0 < deviation < float("inf"):
        return f"{value:.6g}", "0"
    first = f"{deviation:.1e}"
    digits = min(max(1 - int(first.split("e")[1]), 0), 7)
    return f"{value:.{digits}f}", f"{deviation:.{digits}f}" if digits < 7 else "< 1e-6"


def as_plain(found: "Identified") -> dict[str, Any]:
    """Return findings and overlay as plain values, in SI units."""
    from linemate.daemon.identification.outcome import Estimate

    return {
        "version": 1,
        "findings": [
            {"name": f.name, "told": f.told, "value": f.outcome.value,
             "deviation": f.outcome.deviation, "basis": f.outcome.basis}
            if isinstance(f.outcome, Estimate)
            else {"name": f.name, "told": False, "refused": f.outcome.reason}
            for f in found.findings
        ],
        "overlay": found.overlay,
        "kept": list(found.kept),
    }  # fmt: skip


def overlay_text(found: "Identified", names: Sequence[str]) -> str:
    """Return an overlay as YAML, with what it rests on as its head."""
    import yaml

    head = ["# Identified parameters; sections as in a configuration, laid over it."]
    head += [f"# from {name}" for name in names]
    head += [f"# kept as configured: {path}" for path in found.kept]
    body = yaml.safe_dump(found.overlay, sort_keys=False, default_flow_style=None, width=100)
    return "\n".join([*head, str(body)])


def write(path: Path, text: str) -> None:
    """Write a file so that there is never half of it.

    Raises:
        OSError: it cannot be written.
    """
    directory = path.parent
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=directory)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
