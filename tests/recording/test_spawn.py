"""Processes that are started next to a loop that must not wait."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from linemate.daemon.recording.spawn import Spawned


def spawned(code: str, descriptor: int = 2) -> Spawned:
    return Spawned([sys.executable, "-c", code], dict(os.environ), descriptor)


def test_the_exit_code_or_the_signal_is_reported() -> None:
    assert spawned("raise SystemExit(3)").wait(20.0) == 3
    process = spawned("import time; time.sleep(60)")
    assert process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.01)
    process.kill()
    assert process.wait(20.0) == -9


def test_the_given_file_is_open_there_and_standard_input_is_empty() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        number = theirs.fileno()
        code = f"import os, sys; os.write({number}, sys.stdin.read().encode() + b'!')"
        assert spawned(code, number).wait(20.0) == 0
        assert ours.recv(10) == b"!"
        assert not theirs.get_inheritable()


def test_the_environment_is_the_given_one() -> None:
    code = "import os; raise SystemExit(int(os.environ['CODE']))"
    assert Spawned([sys.executable, "-c", code], {"CODE": "7"}, 2).wait(20.0) == 7


def test_a_program_that_is_not_there_is_an_error() -> None:
    with pytest.raises(FileNotFoundError):
        Spawned(["/nowhere/at/all"], {}, 2)


def test_no_child_is_left_behind() -> None:
    process = spawned("pass")
    process.wait(20.0)
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


BEHIND_A_PIPE = """
import os, sys, threading, time
from linemate.daemon.recording import spawn
spawn.INPUT = os.fsencode(sys.argv[1])
command = [sys.executable, "-c", "pass"]
codes = []
thread = threading.Thread(
    target=lambda: codes.append(spawn.Spawned(command, dict(os.environ), 2).wait(20.0))
)
thread.start()
time.sleep(0.2)
assert not codes
with open(sys.argv[1], "wb"):
    thread.join(20.0)
raise SystemExit(codes != [0])
"""


def test_other_threads_run_while_the_new_process_has_not_begun_its_program(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    # Before its program the new process opens a pipe, and that waits for the one who writes. With
    # the interpreter's lock held no thread ever would.
    with subprocess.Popen([sys.executable, "-c", BEHIND_A_PIPE, str(pipe)]) as process:
        try:
            assert process.wait(30.0) == 0
        finally:
            process.kill()
