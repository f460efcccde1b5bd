"""``linemate rsi``: lint of a controller's file, and the files for a KUKA controller."""

import argparse
import shutil
from pathlib import Path
from typing import Any, Final

from linemate.daemon.command_line import NO, OK, BadFileError, NegativeError, UsageError
from linemate.daemon.config import documents, files, task_file
from linemate.daemon.config.files import PROTOCOL_DATA, UnreadableError
from linemate.daemon.config.settings import Corrections
from linemate.daemon.core.tracking.task import TaskFile
from linemate.daemon.operator import render
from linemate.daemon.operator.robot import rsi_lint
from linemate.protocol.rsi.ethernet_config import MAX_CONFIG_BYTES

KUKA: Final = PROTOCOL_DATA / "kuka"
VERSIONS: Final = ("kss-8.2", "kss-8.5", "iiqka-os2")
"""Folders of files: KSS 8.2 to 8.4, KSS 8.5 to 8.7, iiQKA.OS2."""


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser = commands.add_parser("rsi", help="files of a KUKA controller: lint, and ready to copy")
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    lint = actions.add_parser("lint", help="what the daemon would refuse in an EthernetConfig")
    lint.add_argument("file", type=Path, metavar="FILE")
    lint.add_argument("--config", type=Path, metavar="FILE", help="for corrections and constants")
    lint.add_argument("--task", type=Path, metavar="FILE", help="whose arm and gates it serves")
    lint.add_argument("--json", action="store_true", help="print JSON")
    lint.set_defaults(run=_lint)
    copy = actions.add_parser("files", help="copy KRL program, RSI context and EthernetConfig")
    copy.add_argument("version", choices=VERSIONS)
    copy.add_argument("folder", type=Path, metavar="DIR")
    copy.set_defaults(run=_files)


def _lint(args: argparse.Namespace) -> int:
    corrections, constants, task = Corrections.ABSOLUTE, dict[str, Any](), None
    try:
        xml = files.read(args.file, MAX_CONFIG_BYTES)
        if args.config is not None:
            corrections, constants, task = _configured(args.config)
        if args.task is not None:
            task = task_file.load(args.task).file
    except UnreadableError as error:
        raise UsageError(str(error)) from error
    except documents.FileError as error:
        raise BadFileError(str(error)) from error
    findings = rsi_lint.lint(xml, corrections, constants, task)
    if args.json:
        print(
            render.as_json([{"line": finding.line, "what": finding.what} for finding in findings])
        )
    else:
        for finding in findings:
            print(
                f"{args.file}:{'' if finding.line is None else f'{finding.line}:'} {finding.what}"
            )
        if not findings:
            print(f"{args.file}: good")
    return NO if findings else OK


def _configured(path: Path) -> tuple[Corrections, dict[str, Any], TaskFile]:
    """Return what a configuration says of RSI, and its task; ``linemated --check`` checks it all.

    Raises:
        FileError, UnreadableError: it cannot be read, or its task is wrong.
        UsageError: a value that the check of the configuration would refuse.
    """
    value = documents.read(files.read(path, documents.MAX_BYTES), str(path)).value
    plain = value if isinstance(value, dict) else {}
    rsi = plain.get("rsi") or {}
    name, constants = plain.get("task"), rsi.get("constants") or {}
    corrections = rsi.get("corrections", Corrections.ABSOLUTE.value)
    if not isinstance(name, str) or corrections not in list(Corrections):
        raise UsageError(f"{path}: task or rsi.corrections is wrong. Run linemated --check.")
    task = task_file.load(files.find(name, path.parent, files.DAEMON_DATA)).file
    return Corrections(corrections), dict(constants), task


def _files(args: argparse.Namespace) -> int:
    sources = sorted((KUKA / args.version).iterdir())
    existing = [file.name for file in sources if (args.folder / file.name).exists()]
    if existing:
        raise NegativeError(
            f"{args.folder} has {', '.join(existing)} already. Nothing is changed: "
            "name another folder."
        )
    try:
        args.folder.mkdir(parents=True, exist_ok=True)
        for file in sources:
            shutil.copyfile(file, args.folder / file.name)
            print(args.folder / file.name)
    except OSError as error:
        raise UsageError(f"{args.folder}: {error.strerror}") from error
    return OK
