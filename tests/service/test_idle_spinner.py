"""Idle spinner: its processes yield to all others and end with their starter."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from linemate.daemon.config.settings import RealtimeSettings
from linemate.daemon.service.host.idle_spinner import MODULE, IdleSpinner
from linemate.daemon.service.host.realtime import request_all

TIMEOUT_S = 20.0

STARTER = """
import os, sys, time
from linemate.daemon.service.host.idle_spinner import IdleSpinner
spinner = IdleSpinner(os.sched_getaffinity(0))
print(*spinner.pids, flush=True)
time.sleep(60)
"""


def eventually(what: Callable[[], bool]) -> bool:
    end = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end:
        if what():
            return True
        time.sleep(0.01)
    return False


def is_idle_class(pid: int) -> bool:
    return os.sched_getscheduler(pid) == os.SCHED_IDLE


def state(pid: int) -> str:
    """As the kernel calls it: R running, Z ended; empty if it is gone."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    return ""


@pytest.fixture
def spinner() -> Iterator[IdleSpinner]:
    made = IdleSpinner(os.sched_getaffinity(0))
    yield made
    made.close()


def test_each_core_has_a_process_of_the_idle_class_that_runs_there(spinner: IdleSpinner) -> None:
    cores = sorted(os.sched_getaffinity(0))
    assert len(spinner.pids) == len(cores)
    for pid, core in zip(spinner.pids, cores, strict=True):
        assert eventually(lambda pid=pid: is_idle_class(pid))  # type: ignore[misc]
        assert eventually(lambda pid=pid, core=core: os.sched_getaffinity(pid) == {core})  # type: ignore[misc]
        assert eventually(lambda pid=pid: state(pid) == "R")  # type: ignore[misc]


def test_closing_ends_them_and_may_be_done_twice(spinner: IdleSpinner) -> None:
    pids = spinner.pids
    spinner.close()
    assert spinner.pids == ()
    assert all(state(pid) == "" for pid in pids)
    spinner.close()


def test_they_end_with_a_starter_that_is_killed_and_ctrl_c_is_not_theirs() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", STARTER], stdout=subprocess.PIPE, text=True
    ) as starter:
        assert starter.stdout is not None
        pids = [int(pid) for pid in starter.stdout.readline().split()]
        assert all(eventually(lambda pid=pid: is_idle_class(pid)) for pid in pids)  # type: ignore[misc]
        for pid in pids:
            os.kill(pid, signal.SIGINT)
        time.sleep(0.05)
        assert all(state(pid) == "R" for pid in pids)
        starter.kill()
        starter.wait()
    assert all(eventually(lambda pid=pid: state(pid) in {"", "Z"}) for pid in pids)  # type: ignore[misc]


def test_one_whose_starter_is_gone_before_it_began_ends_at_once() -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    core = str(min(os.sched_getaffinity(0)))
    command = [sys.executable, "-m", MODULE, core, str(gone.pid)]
    subprocess.run(command, check=True, timeout=TIMEOUT_S)


def test_the_daemon_asks_for_it_only_on_request_and_gives_it_back() -> None:
    assert request_all(RealtimeSettings()).spinner is None
    host = request_all(RealtimeSettings(keep_awake=True))
    assert host.granted("keep_awake")
    assert host.spinner is not None
    pids = host.spinner.pids
    assert len(pids) == len(os.sched_getaffinity(0))
    host.close()
    assert host.spinner is None
    assert all(state(pid) == "" for pid in pids)
