"""Cores that do not fall asleep: on each a process of the idle class, which only counts.

Law of this file: whoever has anything to do on a core comes before it, and it ends with whoever
started it. A core of a virtual machine that sleeps is a thread of its host's that sleeps, and the
host wakes it when it comes to it: a C timer of the highest priority woke more than 4 ms late 104
times of 90 000 on idle cores, and 32 times where they were kept awake (docs/performance.md).
"""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence
from itertools import repeat
from typing import Final

MODULE: Final = "linemate.daemon.service.awake"
PR_SET_PDEATHSIG: Final = 1
PATIENCE_S: Final = 1.0


class Awake:
    """Cores that are kept awake, until ``close``."""

    def __init__(self, cores: Iterable[int]) -> None:
        """Start a process on each core.

        Raises:
            OSError: a process cannot be started; none is left then.
        """
        self._processes: list[subprocess.Popen[bytes]] = []
        # Wherever we were found, by whatever means, it is found as well.
        found = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        try:
            for core in sorted(set(cores)):
                command = [sys.executable, "-m", MODULE, str(core), str(os.getpid())]
                self._processes.append(
                    subprocess.Popen(command, stdin=subprocess.DEVNULL, env=found)  # noqa: S603 - ourselves
                )
        except OSError:
            self.close()
            raise

    @property
    def pids(self) -> tuple[int, ...]:
        """The processes."""
        return tuple(process.pid for process in self._processes)

    def close(self) -> None:
        """Let the cores sleep again."""
        for process in self._processes:
            process.kill()
        for process in self._processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE_S)
        self._processes.clear()


def main(argv: Sequence[str] | None = None) -> int:
    """Keep a core awake for as long as another process lives.

    Args:
        argv: the core and the process that asked for it.
    """
    core, parent = map(int, sys.argv[1:] if argv is None else argv)
    # It is its starter's to end; Ctrl-C goes to the whole group.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.sched_setaffinity(0, {core})
    if os.getppid() == parent:
        for _ in repeat(None):
            pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
