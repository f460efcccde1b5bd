"""C programs that only echo and only wake, compiled on the spot: the floor of the daemon.

Invariants:
    No code of linemate.
    Without a compiler the echo is a blocking Python program; the result says so.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Final

from linemate.simulators.harness.processes import Child, Children, wait_until

COMPILERS: Final = ("cc", "gcc", "clang")
TIMEOUT_S: Final = 10.0

PYTHON_ECHO: Final = """
import socket
port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
port.bind(("127.0.0.1", 0))
print("port", port.getsockname()[1], flush=True)
while True:
    data, peer = port.recvfrom(2048)
    port.sendto(data, peer)
"""

HOG: Final = """
import os, mmap
block = bytearray(4 << 20)
while True:
    block[: 2 << 20] = block[2 << 20 :]
    for _ in range(200):
        os.getppid()
    with mmap.mmap(-1, 1 << 20) as page:
        for at in range(0, 1 << 20, 4096):
            page[at] = 1
    sum(range(5000))
"""
"""An ordinary program: memory, system calls, page faults and arithmetic."""


@dataclass(frozen=True, slots=True)
class Spike:
    """A wake that came late: the machine stood still from ``due_ns`` to ``woke_ns``."""

    due_ns: int
    woke_ns: int


@dataclass(frozen=True, slots=True)
class WakeLateness:
    """Of a timer's wakes [ns]."""

    count: int
    p50_ns: int
    p99_ns: int
    max_ns: int


@dataclass(frozen=True, slots=True)
class Place:
    """Where a process runs.

    Attributes:
        cpu: its core, None for any.
        priority: of SCHED_FIFO, None for the ordinary class.
    """

    cpu: int | None = None
    priority: int | None = None

    def assign(self, pid: int) -> None:
        """Bring a process to this core and priority.

        Raises:
            OSError: refused.
        """
        if self.cpu is not None:
            os.sched_setaffinity(pid, {self.cpu})
        if self.priority is not None:
            os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(self.priority))


def compiled(folder: Path) -> Path | None:
    """Compile the C programs.

    Returns:
        The executable; None without a compiler that makes one.
    """
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        return None
    out = folder / "bench_floor"
    source = files("linemate.simulators.lab.bench").joinpath("data", "bench_floor.c")
    with as_file(source) as path:
        compilation = subprocess.run(  # noqa: S603 -- a compiler from PATH, our own source
            [compiler, "-O2", "-o", str(out), str(path)], capture_output=True, check=False
        )
    return out if compilation.returncode == 0 and out.exists() else None


class Words:
    """The lines that a child prints."""

    def __init__(self, child: Child) -> None:
        self.child = child
        self._read = 0
        self._rest = ""

    def new(self) -> list[list[str]]:
        """The words of every whole line since the last call."""
        with self.child.log.open("rb") as log:
            log.seek(self._read)
            data = log.read()
        self._read += len(data)
        *lines, self._rest = (self._rest + data.decode("ascii", "replace")).split("\n")
        return [line.split() for line in lines]

    def await_line(self, head: str, children: Children) -> list[str]:
        """Wait for a line that begins with a word, and return its words; others are lost."""
        lines: list[list[str]] = []

        def there() -> bool:
            lines.extend(words for words in self.new() if words[:1] == [head])
            return bool(lines)

        wait_until(there, children, TIMEOUT_S, f"{self.child.name}: {head}", poll_s=0.005)
        return lines[-1]


def start_echo(children: Children, program: Path | None, folder: Path, place: Place) -> int:
    """Start the echo.

    Returns:
        Its port.
    """
    command = [sys.executable, "-c", PYTHON_ECHO] if program is None else [str(program), "echo"]
    child = children.start("echo", command, folder / "echo.log")
    port = int(Words(child).await_line("port", children)[1])
    place.assign(child.pid)
    return port


class TimerProgram:
    """A program that only wakes, in C or the daemon's clock: both speak alike."""

    def __init__(self, children: Children, command: Sequence[str], log: Path, place: Place) -> None:
        self._children = children
        self._child = children.start(log.stem, command, log)
        self._words = Words(self._child)
        self._words.await_line("ready", children)
        place.assign(self._child.pid)
        self.spikes: list[Spike] = []

    def lateness(self) -> WakeLateness:
        """Of the wakes since the last call."""
        lines: list[list[str]] = []
        self._child.process.send_signal(signal.SIGUSR1)

        def has_answered() -> bool:
            for words in self._words.new():
                if words[0] == "spike":
                    self.spikes.append(Spike(int(words[1]), int(words[2])))
                elif words[0] == "late":
                    lines.append(words)
            return bool(lines)

        wait_until(has_answered, self._children, TIMEOUT_S, self._child.name, poll_s=0.005)
        count, *times = map(int, lines[-1][1:])
        return WakeLateness(count, *(times or (0, 0, 0)))


def c_timer(program: Path, period_ns: int, spike_ns: int) -> list[str]:
    """The command of the C program that only wakes.

    Args:
        spike_ns: a wake later than this is printed [ns].
    """
    return [str(program), "timer", str(period_ns), str(spike_ns)]


class Hogs:
    """Ordinary programs that take whatever the cores have left; stopped until let loose."""

    def __init__(self, children: Children, folder: Path, cpus: Sequence[int]) -> None:
        self._hogs = []
        for number, cpu in enumerate(cpus):
            command = [sys.executable, "-c", HOG]
            hog = children.start(f"hog{number}", command, folder / f"hog{number}.log")
            Place(cpu=cpu).assign(hog.pid)
            hog.process.send_signal(signal.SIGSTOP)
            self._hogs.append(hog)

    def loose(self) -> None:
        """Let them run."""
        self._signal(signal.SIGCONT)

    def stop(self) -> None:
        """Stop them where they are."""
        self._signal(signal.SIGSTOP)

    def _signal(self, number: int) -> None:
        for hog in self._hogs:
            hog.process.send_signal(number)


def cpu_ns(pid: int) -> int:
    """How long all threads of a process have run [ns]."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):  # the thread has ended
            total += int((task / "schedstat").read_text(encoding="ascii").split()[0])
    return total
