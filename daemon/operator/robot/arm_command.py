"""``linemate identify-arm``: the arm's geometry from measured poses, written as an overlay."""

import argparse
import os
from pathlib import Path
from typing import Any, Final

from linemate.daemon.command_line import OK, NegativeError, UsageError, check_output_file
from linemate.daemon.operator import console, identify_command, render

DEFAULT_OUT: Final = Path("arm-geometry.yaml")


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "identify-arm", help="the arm's zeros, lengths and twists from measured poses of the tcp"
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="table of poses, CSV")
    parser.add_argument(
        "--config", type=Path, required=True, metavar="FILE", help="of the daemon: arm, tool, bend"
    )
    parser.add_argument(
        "--out", type=Path, default=DEFAULT_OUT, metavar="FILE", help=f"overlay; {DEFAULT_OUT}"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Identify, and write the overlay."""
    check_output_file(args.out)
    # BLAS threads make a sum depend on the machine, and small problems slower.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from linemate.daemon.config import config, files
    from linemate.daemon.config.documents import FileError
    from linemate.daemon.config.files import UnreadableError
    from linemate.daemon.identification.geometry import arm_geometry, measured_poses
    from linemate.daemon.identification.pipeline import Identified

    try:
        station = config.load(args.config)
        text = files.read(args.file, measured_poses.MOST_BYTES).decode("utf-8-sig")
    except (FileError, UnreadableError) as error:
        raise NegativeError(str(error)) from error
    except UnicodeDecodeError as error:
        raise NegativeError(f"{args.file}: not a text: {error.reason}") from error
    task, control = station.task, station.config.control
    try:
        poses = measured_poses.read(text, linear_axis=task.file.arm.linear_axis)
        arm = arm_geometry.MeasuredArm(task.file, task.urdf, control)
        geometry = arm_geometry.identify_geometry(arm, poses)
    except ValueError as error:
        lines = "\n".join(f"{args.file}: {line}" for line in str(error).splitlines())
        raise NegativeError(lines) from error
    if not any(control.bend.compliance):
        console.complain("control.bend is not set: the geometry takes the bend under weight")
    identified = Identified(geometry.findings, geometry.overlay, ())
    if args.json:
        print(render.as_json(identify_command.as_plain(identified)))
    else:
        print(identify_command.table(identified.findings))
    try:
        overlay = identify_command.overlay_text(identified, [args.file.name])
        identify_command.write(args.out, overlay)
    except OSError as error:
        raise UsageError(f"--out {args.out}: {error.strerror}") from error
    if not args.json:
        print(f"\noverlay: {args.out}")
    return OK
