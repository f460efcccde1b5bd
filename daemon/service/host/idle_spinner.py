"""Idle spinner: a process of the idle class on each core, so that the core never sleeps.

A sleeping core of a virtual machine is a sleeping thread of its host, which wakes it late. A C
timer of the highest priority woke more than 4 ms late 104 times of 90 000 on idle cores, and 32
times with the spinner (docs/performance.md).

Invariants:
- Every other program on the core runs before the spinner.
- The spinner ends with the process that started it.
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

MODULE: Final = "linemate.daemon.service.host.idle_spinner"
PR_SET_PDEATHSIG: Final = 1
CLOSE_TIMEOUT_S: Final = 1.0


class IdleSpinner:
    """Spinning processes, until ``close``."""

    def __init__(self, cores: Iterable[int]) -> None:
        """Start a process on each core.

        Raises:
            OSError: a process cannot be started; none is left then.
        """
        self._processes: list[subprocess.Popen[bytes]] = []
        # The process imports linemate from where the daemon has it.
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        }
        try:
            for core in sorted(set(cores)):
                command = [sys.executable, "-m", MODULE, str(core), str(os.getpid())]
                self._processes.append(
                    subprocess.Popen(command, stdin=subprocess.DEVNULL, env=environment)  # noqa: S603 - ourselves
                )
        except OSError:
            self.close()
            raise

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the spinners."""
        return tuple(process.pid for process in self._processes)

    def close(self) -> None:
        """Let the cores sleep again."""
        for process in self._processes:
            # On a busy core a process of the idle class gets no time, not even to end.
            with contextlib.suppress(OSError):
                os.sched_setscheduler(process.pid, os.SCHED_OTHER, os.sched_param(0))
            process.kill()
        for process in self._processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(CLOSE_TIMEOUT_S)
        self._processes.clear()


def main(argv: Sequence[str] | None = None) -> int:
    """Spin on a core for as long as another process lives.

    Args:
        argv: number of the core, and process id of the starter.
    """
    core, parent = map(int, sys.argv[1:] if argv is None else argv)
    # The starter ends this process; ^C goes to the whole group.
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
