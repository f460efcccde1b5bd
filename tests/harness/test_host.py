"""What is said about the machine is what the kernel says."""

import os
from pathlib import Path

from linemate.simulators.harness import host


def test_the_machine_is_named_with_what_figures_depend_on() -> None:
    told = host.machine()
    assert told["cores"] == len(os.sched_getaffinity(0))
    assert told["kernel"] == os.uname().release
    assert told["real_time"] == (host.missing_rights() is None)


def test_time_that_a_hypervisor_withheld_is_told_if_the_kernel_counts_it(tmp_path: Path) -> None:
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
