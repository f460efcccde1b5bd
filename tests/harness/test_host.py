"""What is said about the machine is what the kernel says."""

import os

from linemate.simulators.harness import host


def test_the_machine_is_named_with_what_figures_depend_on() -> None:
    told = host.machine()
    assert told["cores"] == len(os.sched_getaffinity(0))
    assert told["kernel"] == os.uname().release
    assert told["real_time"] == (host.missing_rights() is None)


def test_asking_for_rights_leaves_the_scheduler_as_it_was() -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    host.missing_rights()
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before
