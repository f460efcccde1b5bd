"""Facts of the machine are those of the kernel."""

import os
import subprocess
import sys
from pathlib import Path

from linemate.simulators.harness import host


def test_the_machine_is_named_with_what_figures_depend_on() -> None:
    facts = host.machine()
    assert facts["cores"] == len(os.sched_getaffinity(0))
    assert facts["kernel"] == os.uname().release
    assert facts["real_time"] == (host.missing_rights() is None)


def test_time_that_a_hypervisor_withheld_is_reported_if_the_kernel_counts_it(
    tmp_path: Path,
) -> None:
    stat = tmp_path / "stat"
    stat.write_text("cpu  10 20 30 40 50 60 70 250 0 0\ncpu0 1 2 3 4 5 6 7 8 0 0\n")
    assert host.stolen_s(stat) == 250 / os.sysconf("SC_CLK_TCK")
    for unknown in ("", "cpu 1 2\n", "cpu a b c d e f g h i\n"):
        stat.write_text(unknown)
        assert host.stolen_s(stat) is None
    assert host.stolen_s(tmp_path / "nothing") is None


def test_asking_for_rights_leaves_the_scheduler_as_it_was() -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    host.missing_rights()
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before


def granted(priority: int, *, refuse_nice: bool = False) -> list[str]:
    """What a process of its own says of a priority it may not have."""
    code = (
        "import os\n"
        "from linemate.simulators.harness import host\n"
        "def refuse(*_): raise PermissionError(1, 'Operation not permitted')\n"
        "os.sched_setscheduler = refuse\n"
        f"if {refuse_nice}: os.setpriority = refuse\n"
        "else: os.setpriority = lambda *a: print('asked', *a[1:])\n"
        "host.lock_memory = lambda: print('locked')\n"
        f"print(*host.grant({priority}, ()), sep='\\n')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60.0
    )
    return done.stdout.splitlines()


def test_without_sched_fifo_a_niceness_is_asked_for_and_what_came_of_it_is_reported() -> None:
    facts = granted(60)
    assert "asked 0 -15" in facts
    assert "locked" in facts
    assert any(line.endswith("; niceness -15 instead") for line in facts)
    refused = granted(60, refuse_nice=True)
    assert any("niceness -15 refused as well (Operation not permitted)" in line for line in refused)


def test_memory_is_locked_where_the_host_lets_it() -> None:
    code = (
        "from linemate.simulators.harness import host\n"
        "host.lock_memory()\n"
        "print(next(l for l in open('/proc/self/status') if l.startswith('VmLck')))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60.0
    )
    if done.returncode == 0:
        assert int(done.stdout.split()[1]) > 0
    else:
        assert "OSError" in done.stderr
