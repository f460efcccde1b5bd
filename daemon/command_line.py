"""Command lines of the three programs: exit codes, errors in one line, output places, version.

Invariants:
    * Exit code 1 has one meaning: the answer is no. What prevents an answer has another code.
    * An error of the command line is one line on standard error, without a traceback.
    * An output place is checked before the work whose result goes there.
"""

import argparse
import errno
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, NoReturn, TypeVar

from linemate.daemon.near_names import near_names

OK: Final = 0
NO: Final = 1  # not healthy, refused, different, not a recording, not assembled
USAGE: Final = 2  # the command line, or an output place (full as well) or an address it names
NO_ANSWER: Final = 3  # no daemon, or not in time
INTERNAL: Final = 70  # EX_SOFTWARE: a defect of the program, with a traceback
BAD_FILE: Final = 78  # EX_CONFIG: errors of a configuration, task or scenario
INTERRUPTED: Final = 130  # ^C
CLOSED_PIPE: Final = 141  # 128 + SIGPIPE: the reader of the output has ended

DISTRIBUTION: Final = "linemate"
POSITIVE: Final = math.ulp(0.0)
"""The least number greater than zero."""

Number = TypeVar("Number", int, float)


class UsageError(Exception):
    """An option, an output place or an address cannot be used; the text says why."""


class NegativeError(Exception):
    """The answer is no; the text says why."""


class BadFileError(Exception):
    """A configuration, task or scenario has errors; a line each: ``file:line:col: key: what``."""


# Of the operating system, which no program can prevent: what to do about each.
_REFUSALS: Final = {
    errno.ENOSPC: "Free some space",
    errno.EDQUOT: "Free some space",
    errno.EACCES: "Change its owner or mode, or run as another user",
    errno.EROFS: "Name another place",
}

_CODES: Final[dict[type[Exception], int]] = {
    UsageError: USAGE,
    NegativeError: NO,
    BadFileError: BAD_FILE,
}


def one_thread() -> None:
    """Let BLAS have one thread, before numpy is imported.

    More of them make a sum depend on the machine, and small problems slower.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def bounded(
    kind: Callable[[str], Number], low: float, high: float, refusal: str
) -> Callable[[str], Number]:
    """Return the type of an option whose value lies from low to high; others have the refusal."""

    def read(text: str) -> Number:
        with suppress(ValueError):
            value = kind(text)
            if low <= value <= high:
                return value
        raise argparse.ArgumentTypeError(f"{text!r} {refusal}")

    return read


def run(program: str, command: Callable[[], int]) -> int:
    """Run a command and return its exit code, whatever ends it."""
    try:
        code = command()
        if sys.stdout is not None:  # None: the shell has closed it
            sys.stdout.flush()
    except tuple(_CODES) as error:
        # A line of a file begins with the file's name, as an editor reads it.
        print(*() if type(error) is BadFileError else (f"{program}:",), error, file=sys.stderr)
        return _CODES[type(error)]
    except BrokenPipeError:
        _drop_output()
        return CLOSED_PIPE
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:  # noqa: BLE001 - Python's own code for it is 1: "no" here
        return _unexpected(program, error)
    return code


def _unexpected(program: str, error: Exception) -> int:
    if isinstance(error.__cause__, KeyboardInterrupt):
        return INTERRUPTED  # of a class body in an import
    if isinstance(error, OSError) and error.errno in _REFUSALS:
        if error.filename is None:
            _drop_output()
        what = f"{error.filename or 'the output'}: {error.strerror}. {_REFUSALS[error.errno]}"
        print(f"{program}: {what}", file=sys.stderr)
        return USAGE
    import traceback

    traceback.print_exception(error)
    return INTERNAL


def _drop_output() -> None:
    """Send to /dev/null what Python flushes at exit, so that it does not complain there."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def killed_by_ctrl_c() -> Iterator[None]:
    """Let Ctrl-C kill the process, as it may while packages are imported.

    An extension module can swallow the KeyboardInterrupt that is raised while it is loaded.
    """
    handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def make_folder(path: Path) -> None:
    """Make an output directory.

    Raises:
        UsageError: It cannot be made, or not be written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = "is a file" if path.is_file() else error.strerror
        raise UsageError(f"--out {path}: {why}. Name a directory that can be written") from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise UsageError(f"--out {path}: cannot be written. Name another directory")


def check_output_folder(path: Path) -> None:
    """Check that an output directory can be made and written; what it makes it removes again.

    Raises:
        UsageError: It cannot be made, or not be written.
    """
    missing = [part for part in (path, *path.parents) if not part.exists()]
    make_folder(path)
    for part in missing:
        part.rmdir()


def check_output_file(path: Path, option: str = "--out") -> None:
    """Check that a file can be written.

    Raises:
        UsageError: Its directory is missing or read-only, or the path is a directory.
    """
    if path.is_dir():
        raise UsageError(f"{option} {path}: is a directory. Name a file")
    if not path.parent.is_dir():
        raise UsageError(f"{option} {path}: no such directory: {path.parent}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise UsageError(f"{option} {path}: cannot be written. Name another file")


class CommandLine(argparse.ArgumentParser):
    """A parser whose errors are one line, with the known names near a wrong one."""

    _given: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and keep the arguments for ``error``."""
        self._given = sys.argv[1:] if args is None else [*args]
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """End with USAGE."""
        unknown = message.partition("unrecognized arguments: ")[2].partition(" ")[0]
        known = list(_options(self))
        if " required" in message:
            # argparse does not come to an option that it does not know, as of ``--confg file``.
            options = (given.partition("=")[0] for given in self._given if given[:2] == "--")
            wrong = (name for name in options if not any(o.startswith(name) for o in known))
            unknown = next(wrong, "")
        if unknown.startswith("-"):
            message += near_names(unknown.partition("=")[0], known)
        self.exit(USAGE, f"{self.prog}: {message}; see {self.prog} --help\n")

    def _get_formatter(self) -> argparse.HelpFormatter:
        # argparse asks for one with each argument. Without a width it imports shutil and with it
        # three compressors: 6 ms of each command.
        return argparse.HelpFormatter(self.prog, width=_columns() - 2)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        choices = [str(choice) for choice in action.choices or ()]
        if choices and value not in (action.choices or ()):
            # Many choices are listed by --help; the near ones help more here.
            near = near_names(str(value), choices)
            listed = "" if near and len(choices) > 6 else f"; there are {', '.join(choices)}"
            raise argparse.ArgumentError(action, f"no {value!r}{near or listed}")


def _columns() -> int:
    """Return the width of the terminal as ``shutil.get_terminal_size`` does."""
    with suppress(KeyError, ValueError):
        columns = int(os.environ["COLUMNS"])
        if columns > 0:
            return columns
    try:
        return os.get_terminal_size(sys.__stdout__.fileno()).columns or 80  # type: ignore[union-attr]
    except (AttributeError, ValueError, OSError):
        return 80


def _options(parser: argparse.ArgumentParser) -> Iterator[str]:
    for action in parser._actions:  # noqa: SLF001 - argparse has no public list of them
        yield from action.option_strings
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for command in action.choices.values():
                yield from _options(command)


class Version(argparse.Action):
    """Print the program's name and the installed version, and end."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: Any) -> None:
        super().__init__(
            option_strings, argparse.SUPPRESS, nargs=0, help="print the version and end"
        )
        del dest

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,  # noqa: ARG002 - argparse's signature
        values: str | Sequence[Any] | None,  # noqa: ARG002
        option_string: str | None = None,  # noqa: ARG002
    ) -> None:
        """Print and end."""
        from importlib.metadata import version  # slow: looked up only when it is asked for

        print(parser.prog, version(DISTRIBUTION))
        parser.exit()
