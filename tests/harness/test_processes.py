"""What a demonstration starts, it ends: politely, firmly, and even when it is killed itself."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from linemate.simulators.harness import processes
from linemate.simulators.harness.processes import ChildError, Children, interruptible, wait_until

READY = "import time; print('ready', flush=True); time.sleep(60)"
DEAF = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); " + READY


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def wait_gone(pid: int, timeout_s: float = 10.0) -> bool:
    end = time.monotonic() + timeout_s
    while alive(pid) and time.monotonic() < end:
        time.sleep(0.02)
    return not alive(pid)


def test_leaving_the_block_ends_every_child(tmp_path: Path) -> None:
    with Children() as children:
        pids = [children.start(f"c{i}", python(READY), tmp_path / f"{i}.log").pid for i in range(2)]
        logs = [tmp_path / f"{i}.log" for i in range(2)]
        wait_until(lambda: all("ready" in p.read_text() for p in logs), children, 20.0, "ready")
        assert all(alive(pid) for pid in pids)
    assert not any(alive(pid) for pid in pids)


def test_a_child_that_hears_no_request_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "POLITE_S", 0.2)
    log = tmp_path / "log"
    with Children() as children:
        child = children.start("deaf", python(DEAF), log)
        wait_until(lambda: "ready" in log.read_text(), children, 20.0, "ready")
    assert child.ended() == -signal.SIGKILL


def test_grandchildren_go_with_their_group(tmp_path: Path) -> None:
    log = tmp_path / "log"
    code = (
        "import subprocess, sys; "
        "p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']); "
        "print('ready', p.pid, flush=True); p.wait()"
    )
    with Children() as children:
        children.start("leader", python(code), log)
        wait_until(lambda: "ready" in log.read_text(), children, 20.0, "ready")
        grandchild = int(log.read_text().split()[1])
        assert alive(grandchild)
    assert wait_gone(grandchild)


def test_a_child_that_fails_is_reported_with_its_last_words(tmp_path: Path) -> None:
    with Children() as children:
        children.start("doomed", python("import sys; sys.exit('no such port')"), tmp_path / "log")
        with pytest.raises(ChildError, match=r"(?s)doomed ended early, exit 1.*no such port"):
            wait_until(lambda: False, children, 20.0, "never")


def test_what_gives_way_has_the_greatest_niceness_and_what_it_starts_then_too(
    tmp_path: Path,
) -> None:
    log = tmp_path / "log"
    code = (
        "import os, subprocess, sys, time\n"
        "print(os.nice(0), flush=True)\n"
        "while os.nice(0) < 19: time.sleep(0.01)\n"
        "time.sleep(0.2)\n"
        "group = '/proc/self/autogroup'\n"
        "print(open(group).read().split()[-1] if os.path.exists(group) else 19, flush=True)\n"
        "subprocess.run([sys.executable, '-c', 'import os; print(os.nice(0), flush=True)'])"
    )
    with Children() as children:
        child = children.start("view", python(code), log)
        wait_until(lambda: bool(child.tail()), children, 20.0, "its first word")
        child.give_way()
        assert child.wait(20.0) == 0
    before, autogroup, inherited = log.read_text().split()
    assert int(before) == os.nice(0)
    assert autogroup == inherited == "19"


def test_waiting_ends_and_names_what_did_not_come(tmp_path: Path) -> None:
    with Children() as children:
        children.start("slow", python(READY), tmp_path / "log")
        with pytest.raises(TimeoutError, match="the moon"):
            wait_until(lambda: False, children, 0.05, "the moon")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_children_do_not_outlive_their_parent(tmp_path: Path, number: signal.Signals) -> None:
    code = f"""
import sys, time
from pathlib import Path
from linemate.simulators.harness.processes import Children, interruptible
try:
    with interruptible(), Children() as children:
        log = Path({str(tmp_path / "log")!r})
        child = children.start("c", [sys.executable, "-c", {READY!r}], log)
        print(child.pid, flush=True)
        time.sleep(60)
except KeyboardInterrupt:
    sys.exit(130)
"""
    with subprocess.Popen(python(code), stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert alive(child)
        os.kill(parent.pid, number)
        code_at_end = parent.wait(20.0)
    assert code_at_end == (-signal.SIGKILL if number == signal.SIGKILL else 130)
    assert wait_gone(child)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_a_child_is_born_leaves_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    born: list[int] = []

    class Interrupted(subprocess.Popen[bytes]):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            born.append(self.pid)
            signal.raise_signal(number)

    monkeypatch.setattr(processes.subprocess, "Popen", Interrupted)
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), interruptible(), Children() as children:
        children.start("c", python(READY), tmp_path / "log")
    assert len(born) == 1
    assert not alive(born[0])
    assert signal.getsignal(number) == before
