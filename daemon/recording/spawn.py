"""Starting a process without holding the interpreter's lock.

``subprocess`` and ``os.posix_spawn`` hold the lock until the new process has begun its program. On
a busy host that took 6 ms, although a thread asked for it. A call through ``ctypes`` lets it go.
"""

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

POLL_S: Final = 0.002
ACTIONS_BYTES: Final = 512  # at least a posix_spawn_file_actions_t; 80 in glibc
INPUT: Final = b"/dev/null"  # standard input of the new process

_C: Final = ctypes.CDLL(None)


class Spawned:
    """A child process.

    Attributes:
        returncode: exit code, negative for a signal; None while it runs.
    """

    def __init__(
        self, command: Sequence[str], environment: Mapping[str, str], descriptor: int
    ) -> None:
        """Start the process.

        Args:
            command: path of a program, and its arguments.
            descriptor: a file that it gets, under the same number; its standard input is empty.

        Raises:
            OSError: it cannot be started.
        """
        self.returncode: int | None = None
        actions = ctypes.create_string_buffer(ACTIONS_BYTES)
        _checked(_C.posix_spawn_file_actions_init(actions))
        try:
            _checked(_C.posix_spawn_file_actions_addopen(actions, 0, INPUT, os.O_RDONLY, 0))
            # Onto itself: the copy in the new process stays open when the program begins.
            _checked(_C.posix_spawn_file_actions_adddup2(actions, descriptor, descriptor))
            pid = ctypes.c_int()
            _checked(
                _C.posix_spawn(
                    ctypes.byref(pid),
                    os.fsencode(command[0]),
                    actions,
                    None,
                    _vector(map(os.fsencode, command)),
                    _vector(os.fsencode(f"{name}={value}") for name, value in environment.items()),
                )
            )
        finally:
            _C.posix_spawn_file_actions_destroy(actions)
        self.pid = pid.value

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""
        if self.returncode is None:
            try:
                pid, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:  # somebody else has waited for it
                self.returncode = 0
            else:
                if pid:
                    self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout_s: float | None = None) -> int:
        """Wait for its end.

        Args:
            timeout_s: how long at most, None for ever [s].

        Raises:
            subprocess.TimeoutExpired: it runs still.
        """
        end = None if timeout_s is None else time.monotonic() + timeout_s
        while (code := self.poll()) is None:
            if end is not None and time.monotonic() >= end:
                raise subprocess.TimeoutExpired(str(self.pid), timeout_s or 0.0)
            time.sleep(POLL_S)
        return code

    def kill(self) -> None:
        """End it at once."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)


def _vector(items: Iterable[bytes]) -> "ctypes.Array[ctypes.c_char_p]":
    texts = list(items)
    return (ctypes.c_char_p * (len(texts) + 1))(*texts, None)


def _checked(error: int) -> None:
    if error:
        raise OSError(error, os.strerror(error))
