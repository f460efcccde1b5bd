"""``linemate status``: the daemon's state once, or as a screen that is drawn again and again."""

import argparse
import contextlib
import os
import select
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final, Self, TextIO

from linemate.daemon.command_line import NO, NO_ANSWER, OK
from linemate.daemon.operator import console, render
from linemate.daemon.transport.client import DEFAULT_TIMEOUT_S, NoAnswerError

HEALTHY: Final = "healthy"
BEGIN: Final = "\x1b[?1049h\x1b[?25l"  # alternate screen, cursor off
END: Final = "\x1b[?25h\x1b[?1049l"
HOME: Final = "\x1b[H"
END_OF_LINE: Final = "\x1b[K"
BELOW: Final = "\x1b[J"  # clear what is below


def add_parser(commands: Any, common: argparse.ArgumentParser) -> None:
    """Add the command."""
    status = commands.add_parser("status", parents=[common], help="state, links, rates, ages")
    status.add_argument(
        "--watch", action="store_true", help="draw a screen of 24 x 80 until Ctrl-C"
    )
    status.add_argument(
        "--all", action="store_true", help="with --watch: print every key, again and again"
    )
    status.add_argument(
        "--interval", type=console.seconds, default=0.5, metavar="S", help="of --watch; 0.5"
    )
    status.add_argument(
        "--for", dest="seconds", type=console.seconds, metavar="S", help="watch so long"
    )
    status.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Print the status; the exit code says whether the daemon is healthy."""
    if args.watch:
        return watch(args)
    answer = console.ask(args, "status")
    print(render.versioned(answer) if args.json else _every_key(answer))
    return _health(answer)


def _health(answer: Mapping[str, Any]) -> int:
    return OK if answer.get("health") == HEALTHY else NO


def _every_key(answer: Mapping[str, Any]) -> str:
    return render.table((), render.rows(answer))


def watch(args: argparse.Namespace) -> int:
    """Show the status until Ctrl-C or the end of ``--for``; return the code of the last look."""
    end = None if args.seconds is None else time.monotonic() + args.seconds
    timeout_s = getattr(args, "timeout", DEFAULT_TIMEOUT_S)
    answer: dict[str, Any] | None = None
    with console.connect(args) as client, Screen(sys.stdout, args.all or args.json) as shown:
        while True:
            try:
                answer = client.call("status", None, timeout_s)
                code, trouble = _health(answer), ""
            except NoAnswerError as error:
                code, trouble = NO_ANSWER, str(error)
            if not args.all and not args.json:
                shown.draw(render.screen(answer, trouble, *shown.size()))
            elif trouble:
                console.complain(f"no answer from {trouble}")
            elif answer is not None:
                line = render.versioned(answer, None) if args.json else _every_key(answer) + "\n"
                print(line, flush=True)
            left_s = args.interval if end is None else min(args.interval, end - time.monotonic())
            if left_s <= 0.0:
                return code
            shown.wait(left_s)


class Screen:
    """Draws lines over the ones before on a terminal, and one after the other elsewhere."""

    def __init__(self, stream: TextIO, is_plain: bool) -> None:
        self._stream = stream
        self._on_terminal = stream.isatty() and not is_plain
        self._last: Sequence[str] = ()

    def __enter__(self) -> Self:
        # A signal that comes just before a wait must end it: each writes a byte to this pipe.
        self._wake, pipe = os.pipe()
        os.set_blocking(self._wake, False)
        os.set_blocking(pipe, False)
        self._pipe = pipe
        signal.set_wakeup_fd(pipe, warn_on_full_buffer=False)
        signal.signal(signal.SIGWINCH, lambda *_: None)
        if self._on_terminal:
            # As Ctrl-C, so that a terminal is always left as it was.
            signal.signal(signal.SIGTERM, signal.default_int_handler)
            self._stream.write(BEGIN)
        return self

    def __exit__(self, *_: object) -> None:
        if self._on_terminal:
            self._stream.write(END + "".join(f"{line}\n" for line in self._last))
            self._stream.flush()
        signal.signal(signal.SIGWINCH, signal.SIG_DFL)
        signal.set_wakeup_fd(-1)
        os.close(self._wake)
        os.close(self._pipe)

    def size(self) -> tuple[int, int]:
        """Return columns and lines."""
        if not self._on_terminal:
            return render.WIDTH, render.HEIGHT
        columns, lines = os.get_terminal_size(self._stream.fileno())
        return columns or render.WIDTH, lines or render.HEIGHT  # 0: a terminal without a size

    def draw(self, lines: Sequence[str]) -> None:
        """Show lines."""
        self._last = lines
        if self._on_terminal:
            # No line break after the last line: it would scroll a full screen.
            self._stream.write(HOME + f"{END_OF_LINE}\n".join(lines) + END_OF_LINE + BELOW)
        else:
            self._stream.write("\n".join(lines) + "\n\n")
        self._stream.flush()

    def wait(self, duration_s: float) -> None:
        """Wait for the time, or until the terminal changes its size."""
        select.select([self._wake], [], [], duration_s)
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake, 4096)
