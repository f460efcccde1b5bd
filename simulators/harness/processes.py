"""Child processes of a demonstration.

Invariants:
    Each child leads a process group and dies with its parent.
    The end of the ``with`` block ends all children, SIGTERM first.
    Only processes started here are signalled, by id.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from select import select
from types import FrameType
from typing import Any, Final, NoReturn, Self

PR_SET_PDEATHSIG: Final = 1
START_S: Final = 60.0
POLITE_S: Final = 4.0
FIRM_S: Final = 2.0
LOG_TAIL: Final = 12
LEAST_URGENT: Final = 19
"""The greatest niceness."""

DAEMON: Final = "linemate.daemon.service.main"
"""Module of the daemon."""

_libc = ctypes.CDLL(None, use_errno=True)


class ChildError(Exception):
    """A child ended, or did not get ready, and its last words.

    Attributes:
        tail: the last lines it wrote.
    """

    def __init__(self, name: str, what: str, tail: Sequence[str]) -> None:
        super().__init__("\n".join((f"{name} {what}", *(f"  | {line}" for line in tail))))
        self.name = name
        self.tail = tuple(tail)


class Child:
    """One started process; its output goes to a file, so that no full pipe can stop it."""

    def __init__(self, name: str, process: subprocess.Popen[bytes], log: Path) -> None:
        self.name = name
        self.process = process
        self.log = log

    @property
    def pid(self) -> int:
        """Its process id, which is its group's as well."""
        return self.process.pid

    def ended(self) -> int | None:
        """Return the exit code, or None while it runs (negative: ended by that signal)."""
        return self.process.poll()

    def tail(self) -> list[str]:
        """Return the last lines of its output."""
        with suppress(OSError):
            return self.log.read_text(encoding="utf-8", errors="replace").splitlines()[-LOG_TAIL:]
        return []

    def check(self) -> None:
        """Raise ChildError when the process has ended."""
        code = self.ended()
        if code is not None:
            raise ChildError(self.name, f"ended early, exit {code}", self.tail())

    def wait(self, timeout_s: float) -> int | None:
        """Wait for the end; None when it still runs after timeout_s."""
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None

    def end(self) -> int | None:
        """End it, politely first, and with it whatever is left of its group.

        Returns:
            Its exit code.
        """
        for number, timeout_s in ((signal.SIGTERM, POLITE_S), (signal.SIGKILL, FIRM_S)):
            if self.ended() is None:
                self.signal_group(number)
                # A stopped process ends by SIGTERM only once it continues.
                self.signal_group(signal.SIGCONT)
                self.wait(timeout_s)
        # The leader may be gone and have left others of its group.
        self.signal_group(signal.SIGKILL)
        return self.ended()

    def give_way(self) -> None:
        """Let its group, and what it starts from now on, run after everything else."""
        with suppress(OSError):
            os.setpriority(os.PRIO_PGRP, self.pid, LEAST_URGENT)
        # The kernel shares time out by session first (autogroup), where no niceness has an effect.
        with suppress(OSError), Path(f"/proc/{self.pid}/autogroup").open("wb", buffering=0) as file:
            file.write(b"%d" % LEAST_URGENT)

    def signal_group(self, number: int) -> None:
        """Signal the whole group, if anything of it is left."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, number)


class Children:
    """All children of a run: `with Children() as children: children.start(...)`."""

    def __init__(self) -> None:
        self._children: list[Child] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def __iter__(self) -> Iterator[Child]:
        return iter(self._children)

    def start(
        self, name: str, command: Sequence[str], log: Path, keep: Sequence[int] = ()
    ) -> Child:
        """Start a process in a group of its own.

        Args:
            log: file that takes its standard output and error.
            keep: file descriptors that it inherits.
        """
        parent = os.getpid()
        # Else an interrupt could end the call between the child's birth and its entry in the list,
        # and the child would never be ended.
        with log.open("ab") as output, _interrupts_later():
            process = subprocess.Popen(  # noqa: S603 -- our own programs, no shell
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                pass_fds=keep,
                start_new_session=True,
                preexec_fn=lambda: die_with(parent),  # noqa: PLW1509 -- one C call, no lock
            )
            child = Child(name, process, log)
            self._children.append(child)
        return child

    def check(self) -> None:
        """Raise ChildError when any child has ended."""
        for child in self._children:
            child.check()

    def end(self) -> None:
        """End all children at the same time; returns when none is left."""
        for child in reversed(self._children):
            if child.ended() is None:
                child.signal_group(signal.SIGTERM)
        for child in reversed(self._children):
            child.end()


def wait_until(
    ready: Callable[[], bool], children: Children, timeout_s: float, what: str, poll_s: float = 0.02
) -> None:
    """Wait until something holds while all children live.

    Raises:
        ChildError: a child ended while waiting.
        TimeoutError: it did not come to hold in time; the message names `what`.
    """
    end = time.monotonic() + timeout_s
    while not ready():
        children.check()
        if time.monotonic() > end:
            raise TimeoutError(f"{what}: not within {timeout_s:g} s")
        time.sleep(poll_s)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the stack as Ctrl-C does, so that `with` blocks end."""

    def stop(number: int, _frame: FrameType | None) -> NoReturn:
        raise KeyboardInterrupt(signal.Signals(number).name)

    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, stop) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Hold back what would unwind the stack until the block is done.

    Handlers are exchanged, not signals masked: a mask is one thread's, and its children's.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # no handler is ever called here
        return
    signals: list[int] = []
    before = {
        number: handler
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if callable(handler := signal.getsignal(number))
    }
    try:
        for number in before:
            signal.signal(number, lambda number, _frame: signals.append(number))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if signals:
            signal.raise_signal(signals[0])


def die_with(parent: int) -> None:
    """Let this process be killed as soon as its parent is gone, however that ended."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def start_daemon(
    children: Children, config: Path, log: Path, module: str = DAEMON
) -> tuple[Child, dict[str, Any]]:
    """Start a daemon, and return it with the addresses on which it listens.

    Raises:
        ChildError: it ended without a message.
        TimeoutError: no message in time.
    """
    reading, writing = os.pipe()
    with os.fdopen(reading, encoding="utf-8") as pipe:
        try:
            command = [
                sys.executable, "-m", module,
                "--config", str(config), "--ready-fd", str(writing),
            ]  # fmt: skip
            daemon = children.start("daemon", command, log, keep=[writing])
        finally:
            os.close(writing)
        # Readable after a message, and at its end.
        wait_until(lambda: bool(select([pipe], [], [], 0)[0]), children, START_S, "the daemon")
        line = pipe.readline()
    if not line:
        daemon.wait(START_S)
        raise ChildError("daemon", "did not start", daemon.tail())
    listening: dict[str, Any] = json.loads(line)
    return daemon, listening
