"""``linemate identify-arm``: the arm's geometry from measured poses, written as an overlay."""

import argparse
from pathlib import Path
from typing import Any, Final

from linemate.daemon.command_line import BadFileError, NegativeError, check_output_file, one_thread
from linemate.daemon.operator import console, identify_command

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
    identify_command.add_outputs(parser, DEFAULT_OUT)
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Identify, and write the overlay."""
    check_output_file(args.out)
    one_thread()
    from linemate.daemon.config import config, files
    from linemate.daemon.config.documents import FileError
    from linemate.daemon.config.files import UnreadableError
    from linemate.daemon.identification.geometry import arm_geometry, measured_poses
    from linemate.daemon.identification.pipeline import Identified

    try:
        station = config.load(args.config)
        text = files.read(args.file, measured_poses.MOST_BYTES).decode("utf-8-sig")
    except FileError as error:
        raise BadFileError(str(error)) from error
    except UnreadableError as error:
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
    return identify_command.present(identified, args, [args.file.name])
