"""``linemate commission``: walk through a site's commissioning; left and resumed at any step."""

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from linemate.daemon.command_line import (
    DISTRIBUTION,
    NO,
    OK,
    BadFileError,
    NegativeError,
    UsageError,
    one_thread,
)
from linemate.daemon.operator import console, render
from linemate.protocol.stamped_samples import Vector3

if TYPE_CHECKING:
    from linemate.daemon.commissioning.walk import SiteState, WalkStep
    from linemate.daemon.identification.outcome import ReportLine
    from linemate.daemon.identification.pipeline import Recorded
    from linemate.daemon.operator.commissioning.site_files import Site

DEFAULT_CONFIG = "linemated.yaml"
WRITER_WAITS, WRITER_WAIT_S = 20, 0.25  # for the end of a recording's file
STEPS = (
    "links", "signs", "limits", "force", "camera",
    "conveyor", "servos", "object", "dry-run", "page",
)  # fmt: skip


def add_parser(commands: Any, common: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "commission", parents=[common], help="measure a cell step by step, and write overlays"
    )
    parser.add_argument("site", type=Path, metavar="SITE", help="directory of the configuration")
    parser.add_argument("--step", choices=STEPS, help="this step alone; the next one that is due")
    parser.add_argument("--list", action="store_true", help="show how far the site has come")
    parser.add_argument(
        "--from", nargs="+", type=Path, dest="files", metavar="FILE", default=[],
        help="recordings to use instead of a new one",
    )  # fmt: skip
    parser.add_argument("--record", type=console.seconds, metavar="S", help="length of a recording")
    parser.add_argument("--skip", metavar="REASON", help="leave the step out; the page says why")
    parser.add_argument(
        "--config", default=DEFAULT_CONFIG, metavar="NAME", help=f"in SITE; {DEFAULT_CONFIG}"
    )
    parser.add_argument(
        "--sensor-at", metavar="WHERE", type=_place,
        help="where the force-torque sensor is: tcp, flange or X,Y,Z in the tcp [m]",
    )  # fmt: skip
    parser.set_defaults(run=main)


def _place(text: str) -> str | Vector3:
    if text in {"tcp", "flange"}:
        return text
    with suppress(ValueError):
        x, y, z = (float(part) for part in text.split(","))
        if math.isfinite(x + y + z):
            return (x, y, z)
    raise argparse.ArgumentTypeError(f"{text!r} is not tcp, flange or X,Y,Z")


@dataclass(frozen=True, slots=True)
class StepResult:
    """What a step gave.

    Attributes:
        overlay: sections of a configuration.
        refused: why there is no result, None if there is one.
        notes: lines for the engineer.
    """

    lines: "tuple[ReportLine, ...]" = ()
    overlay: dict[str, Any] | None = None
    recordings: tuple[str, ...] = ()
    refused: str | None = None
    notes: tuple[str, ...] = ()


def main(args: argparse.Namespace) -> int:
    """Do a step, or all that are due; the exit code says whether the last one has a result."""
    one_thread()
    from linemate.daemon.commissioning.walk import BY_NAME, StepName
    from linemate.daemon.operator.commissioning import site_files

    if args.files and args.step is None:
        raise UsageError("--from needs --step")
    if args.skip is not None and args.step is None:
        raise UsageError("--skip needs --step: it would leave out all steps")
    if args.skip is not None and not args.skip.strip():
        raise UsageError("--skip needs a reason: the page says it")
    site = site_files.open_site(args.site, args.config, writes=not args.list)
    state = site_files.read_state(site)
    if args.list:
        print(listing(state))
        return OK
    if args.step is not None:
        state, done = _perform(site, state, BY_NAME[StepName(args.step)], args)
        return OK if done else NO
    while (step := state.next_due()) is not None:
        state, done = _perform(site, state, step, args)
        if not done:
            return NO
    print("every step has a result")
    return OK


def listing(state: "SiteState") -> str:
    """Return the steps with their results."""
    from linemate.daemon.commissioning import walk
    from linemate.daemon.commissioning.page import duration_text

    rows = []
    for step in walk.STEPS:
        record = state.of(step.name)
        what = record.overlay or record.reason or ""
        duration = duration_text(record)
        rows.append(
            (step.name.value, record.outcome.value, record.when, duration, what, step.about)
        )
    return render.table(("step", "result", "when", "took", "overlay or reason", "measures"), rows)


def _perform(
    site: "Site", state: "SiteState", step: "WalkStep", args: argparse.Namespace
) -> "tuple[SiteState, bool]":
    """Do a step, keep its result, and return whether it has one."""
    from linemate.daemon.commissioning.walk import StepOutcome, StepRecordOfSite
    from linemate.daemon.operator.commissioning import site_files

    print(f"\n{step.name.value}: {step.about}")
    for need in state.missing(step.name):
        console.complain(
            f"{step.name.value} builds on {need.value}, which has no result yet. It goes on without"
        )
    when = datetime.now().astimezone().isoformat(timespec="seconds")
    begin_s = time.monotonic()
    if args.skip is not None:
        record = StepRecordOfSite(StepOutcome.SKIPPED, when, reason=args.skip)
    else:
        result = _result(site, state, step, args)
        record = _kept(site, state, step, result, when)
        record = replace(record, took_s=time.monotonic() - begin_s)
    state = state.with_result(step.name, record)
    site_files.write_state(site, state)
    if record.outcome is StepOutcome.REFUSED:
        console.complain(f"{step.name.value} refused: {record.reason}")
    _remind(site, state)
    return state, record.outcome is not StepOutcome.REFUSED


def _result(
    site: "Site", state: "SiteState", step: "WalkStep", args: argparse.Namespace
) -> StepResult:
    from linemate.daemon.commissioning.walk import StepName

    special: dict[StepName, Callable[[], StepResult]] = {
        StepName.LIMITS: lambda: _limits(site, state),
        StepName.PAGE: lambda: _page(site, state),
    }
    if step.name in special:
        return special[step.name]()
    if step.name in {StepName.SIGNS, StepName.SERVOS} and not args.files:
        _write_motion(site, state, step)
    return _measured(site, step, args)


def _write_motion(site: "Site", state: "SiteState", step: "WalkStep") -> None:
    """Write the task of a step's motion and a configuration that runs it.

    Raises:
        BadFileError: the configuration, or the motion in it, is refused.
    """
    from linemate.daemon.config.documents import FileError
    from linemate.daemon.operator.commissioning import motion_files

    try:
        path = motion_files.write_motion(site, state, step.name)
    except FileError as error:
        raise BadFileError(str(error)) from error
    print(f"  motion: linemated --config {path}, then home, arm and start. Stop it afterwards")


def _kept(site: "Site", state: "SiteState", step: "WalkStep", result: StepResult, when: str) -> Any:
    """Print a result, write its overlay, and return what is kept of it."""
    from linemate.daemon.commissioning.walk import StepOutcome, StepRecordOfSite, plain_figures
    from linemate.daemon.config.documents import FileError
    from linemate.daemon.operator import identify_command
    from linemate.daemon.operator.commissioning import site_files

    if result.lines:
        print(identify_command.table(result.lines))
    for note in result.notes:
        print(note)
    record = StepRecordOfSite(
        StepOutcome.MEASURED, when, plain_figures(result.lines), None, result.recordings
    )
    if result.refused is not None:
        return replace(record, outcome=StepOutcome.REFUSED, reason=result.refused)
    if not result.overlay:
        return record
    try:
        file = site_files.write_overlay(site, state, step.name, result.overlay)
    except FileError as error:
        reason = f"the configuration is refused with the result: {'; '.join(error.lines)}"
        return replace(record, outcome=StepOutcome.REFUSED, reason=reason)
    except OSError as error:
        raise UsageError(f"{site.folder}: {error.strerror}") from error
    print(f"overlay: {site.overlay(file)}")
    return replace(record, overlay=file)


def _limits(site: "Site", state: "SiteState") -> StepResult:
    """Run the task through the kinematics."""
    from linemate.daemon.commissioning.limit_margins import margin_lines
    from linemate.daemon.config.documents import FileError
    from linemate.daemon.operator.commissioning import site_files

    try:
        report = site_files.checked(site, state)
    except FileError as error:
        return StepResult(refused="; ".join(error.lines))
    return StepResult(
        tuple(margin_lines(report)),
        notes=("The controller's own limits are not on the wire: compare them on the pendant.",),
    )


def _page(site: "Site", state: "SiteState") -> StepResult:
    from importlib.metadata import version

    from linemate.daemon.commissioning.page import PageFacts, page
    from linemate.daemon.operator import identify_command
    from linemate.daemon.operator.commissioning import site_files

    path = site.folder / site_files.PAGE
    facts = PageFacts(
        site.directory.resolve().name,
        site.config.name,
        f"linemate {version(DISTRIBUTION)}",
        datetime.now().astimezone().isoformat(timespec="minutes"),
        site_files.digests(site, state),
    )
    identify_command.write(path, page(state, facts))
    return StepResult(notes=(f"page: {path}",))


def _measured(site: "Site", step: "WalkStep", args: argparse.Namespace) -> StepResult:
    """Measure from recordings: those that are given, or a new one."""
    from linemate.daemon.commissioning import measurements
    from linemate.daemon.commissioning.recorded_cell import CellError

    files = list(args.files) or [_record(step, args)]
    recordings = read_recordings(files)
    names = tuple(path.name for path in files)
    try:
        measured = measurements.measure(step.name, recordings, _options(recordings, args, site))
    except CellError as error:
        return StepResult(recordings=names, refused=str(error))
    return StepResult(measured.lines, dict(measured.overlay), names, measured.refused)


def _options(recordings: "Sequence[Recorded]", args: argparse.Namespace, site: "Site") -> Any:
    """Return what the engineer states, and which sensors are configured."""
    from linemate.daemon.commissioning import measurements
    from linemate.daemon.commissioning.recorded_cell import flange_in_tcp
    from linemate.daemon.config import documents

    document = documents.read(site.config.read_bytes(), str(site.config))
    value = document.value if isinstance(document.value, dict) else {}
    known = ("distance", "camera", "force_torque")
    sensors = tuple(name for name in known if value.get(name)) or known
    place: str | Vector3 | None = args.sensor_at
    if place == "flange":
        place = flange_in_tcp(recordings[0].texts, recordings[0].name)
    elif isinstance(place, str):
        place = (0.0, 0.0, 0.0)
    return measurements.StatedFacts(place, sensors)


def read_recordings(files: Sequence[Path]) -> "list[Recorded]":
    """Return recordings from files.

    Raises:
        NegativeError: a file is none.
    """
    from linemate.daemon.identification.pipeline import Recorded
    from linemate.daemon.recording.format import UnreadableRecordingError
    from linemate.daemon.recording.reader import read

    recordings = []
    for path in files:
        try:
            recording = read(path)
        except UnreadableRecordingError as error:
            raise NegativeError(str(error)) from error
        if recording.damage is not None:
            if not recording.steps:
                raise NegativeError(f"{path}: {recording.damage}")
            console.complain(f"{path}: {recording.damage}")
        recordings.append(Recorded(path.name, recording.texts, recording.steps))
    return recordings


def _record(step: "WalkStep", args: argparse.Namespace) -> Path:
    """Let the daemon record while the engineer does what the step asks; return the file."""
    length_s = args.record or step.record_s
    print(f"  {step.do}")
    if sys.stdin.isatty():
        input(f"  Enter records for {length_s:.0f} s, Ctrl-C leaves: ")
    with console.connect(args) as client:
        client.call("record", {"action": "start"}, console.COMPILE_S)
        try:
            time.sleep(length_s)
        finally:
            client.call("record", {"action": "stop"}, console.COMPILE_S)
        recording = _ended(client)
    if not recording.get("file"):
        raise NegativeError("the daemon recorded nothing. Check the section recording")
    return Path(recording["file"])


def _ended(client: Any) -> dict[str, Any]:
    """Return the status of a recording once its writer has ended the file."""
    recording: dict[str, Any] = {}
    for _ in range(WRITER_WAITS):
        status = client.call("status", {}, console.COMPILE_S)
        recording = dict(status.get("recording") or {})
        if not recording.get("recording"):
            break
        time.sleep(WRITER_WAIT_S)
    return recording


def _remind(site: "Site", state: "SiteState") -> None:
    """Say which overlays the configuration does not name yet."""
    from linemate.daemon.operator.commissioning import site_files

    names = site_files.unlisted(site, state)
    if names:
        listed = ", ".join(names)
        print(f"not in force yet; name it in {site.config.name}: overlays: [..., {listed}]")
