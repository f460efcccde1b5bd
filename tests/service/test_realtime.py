"""What is asked of the host: granted or refused, never fatal. In a process of its own."""

import gc
import json
import os
import subprocess
import sys
from typing import Any

import pytest

from linemate.daemon.config.settings import RealtimeSettings
from linemate.daemon.service.host.realtime import (
    Collector,
    HelperThreads,
    heaps,
    request_all,
    use_huge_pages,
    without_reserves,
)

ASK = """
import ctypes, json, os, sys, threading
from linemate.daemon.service.host.realtime import request_all
from linemate.daemon.config.settings import RealtimeSettings
if sys.argv[2] == "drop":
    os.setgid(65534)
    os.setuid(65534)
host = request_all(RealtimeSettings(**json.loads(sys.argv[1])))
inherited = []
thread = threading.Thread(target=lambda: inherited.append(os.sched_getscheduler(0)))
thread.start(); thread.join()
print(json.dumps({
    "outcomes": [[o.what, o.granted, o.message] for o in host.outcomes],
    "policy": os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK,
    "cpus": sorted(os.sched_getaffinity(0)),
    "slack": ctypes.CDLL(None).prctl(30, 0, 0, 0, 0),
    "thread": inherited[0],
}))
"""


def asked(drop: bool = False, **settings: Any) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", ASK, json.dumps(settings), "drop" if drop else ""],
        capture_output=True,
        text=True,
        check=True,
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def test_nothing_is_asked_by_default() -> None:
    assert request_all(RealtimeSettings()).outcomes == []


def test_every_request_is_granted_or_refused_with_its_cost() -> None:
    answer = asked(
        priority=10, cpus=[0], lock_memory=True, timer_slack_ns=1000, cpu_dma_latency_us=100
    )
    by_name = {what: (granted, message) for what, granted, message in answer["outcomes"]}
    assert list(by_name) == ["cpus", "priority", "lock_memory", "timer_slack", "cpu_dma_latency"]
    for what, (granted, message) in by_name.items():
        assert granted == (not message)
        assert granted or message.startswith(f"realtime.{what} was refused (")
    assert answer["cpus"] == [0]
    if by_name["priority"][0]:
        assert answer["policy"] == os.SCHED_FIFO
        assert answer["thread"] == os.SCHED_OTHER


LOCKED = """
import ctypes, json, mmap
from linemate.daemon.service.host.realtime import request_all
from linemate.daemon.config.settings import RealtimeSettings
PAGE, MIB, libc = mmap.PAGESIZE, 1 << 20, ctypes.CDLL(None)
def mapped():
    return mmap.mmap(-1, 128 * MIB, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
def address(space, mib):
    return ctypes.c_void_p(ctypes.addressof(ctypes.c_char.from_buffer(space)) + mib * MIB)
def share(space, begin, end):
    size = (end - begin) * MIB - PAGE
    pages = (ctypes.c_ubyte * (size // PAGE))()
    assert not libc.mincore(address(space, begin), ctypes.c_size_t(size), pages)
    return sum(page & 1 for page in pages) / len(pages)
space = mapped()
# The last page before each of these may not be touched: they are mappings of their own.
for mib in (1, 71, 75, 107):
    assert not libc.mprotect(
        ctypes.c_void_p(address(space, mib).value - PAGE), ctypes.c_size_t(PAGE), 0
    )
space[75 * MIB : 107 * MIB - PAGE] = bytes(32 * MIB - PAGE)
granted = request_all(RealtimeSettings(lock_memory=True)).outcomes[0].granted
shares = [share(space, *each) for each in ((1, 71), (71, 75), (75, 107))]
print(json.dumps([granted, shares, share(mapped(), 0, 4)]))
"""


def test_memory_is_locked_and_faulted_in_but_for_large_reserves() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOCKED], capture_output=True, text=True, check=True
    )
    granted, (reserve, small, used), later = json.loads(done.stdout)
    if not granted:
        pytest.skip("this host grants no locked memory")
    assert (reserve, small, used, later) == (0.0, 1.0, 1.0, 1.0)


MAPPED_LATER = """
import json, threading
from pathlib import Path
import numpy as np
from linemate.daemon.core import lapack
from linemate.daemon.service.host.realtime import request_all
from linemate.daemon.config.settings import RealtimeSettings
def locked_mib():
    words = Path("/proc/self/status").read_text().split()
    return int(words[words.index("VmRSS:") + 1]) / 1024
granted = request_all(RealtimeSettings(lock_memory=True)).outcomes[0].granted
before = locked_mib()
a = np.eye(200)
a @ a, np.linalg.solve(a, a), np.linalg.inv(a), lapack.dgesv(a, a), lapack.dposv(a, a)
algebra, go_on = locked_mib() - before, threading.Event()
threads = [threading.Thread(target=go_on.wait) for _ in range(4)]
for thread in threads:
    thread.start()
print(json.dumps([granted, algebra, locked_mib() - before - algebra]))
go_on.set()
"""


def test_neither_algebra_nor_threads_lock_much_memory_later() -> None:
    done = subprocess.run(
        [sys.executable, "-c", MAPPED_LATER], capture_output=True, text=True, check=True
    )
    granted, algebra, threads = json.loads(done.stdout)
    if not granted:
        pytest.skip("this host grants no locked memory")
    # A buffer of BLAS has 32 MiB, the stack of a thread 8 MiB unless it is made smaller.
    assert algebra < 8.0
    assert threads < 10.0


SMAPS = """\
1000-2000 r-xp 00000000 08:01 7 /lib/libopenblas.so
Rss:                   4 kB
10000000-12000000 rw-p 00000000 00:00 0
Rss:                   8 kB
20000000-22000000 rw-p 00000000 00:00 0
Rss:               20000 kB
30000000-32000000 rw-p 00000000 00:00 0                          [heap]
Rss:                   8 kB
40000000-40001000 ---p 00000000 00:00 0
Rss:                   0 kB
50000000-50001000 r--p 00000000 00:00 0                          [vvar]
Rss:                   0 kB
"""


def test_a_reserve_is_a_large_nameless_mapping_of_which_little_is_in_use() -> None:
    assert without_reserves(SMAPS) == [
        (0x1000, 0x2000),
        (0x20000000, 0x22000000),
        (0x30000000, 0x32000000),
    ]


MAPS = """\
7f0000000000-7f0000400000 rw-p 00000000 00:00 0
7f0000500000-7f0000a00000 rw-p 00000000 00:00 0 [heap]
7f0000a00000-7f0000b00000 rw-p 00000000 00:00 0
7f0010000000-7f0010400000 r-xp 00000000 fe:00 12 /usr/lib/libpython3.11.so
7f0020000000-7f0020400000 rw-p 00000000 fe:00 12 /usr/lib/libpython3.11.so
7f0030000000-7f0030400000 ---p 00000000 00:00 0
7fff00000000-7fff00400000 rw-p 00000000 00:00 0 [stack]
"""


def test_only_whole_huge_pages_of_objects_are_moved() -> None:
    assert heaps(MAPS) == [(0x7F0000000000, 0x7F0000400000), (0x7F0000600000, 0x7F0000A00000)]


def test_a_kernel_that_moves_nothing_is_no_error() -> None:
    # The mapping is not there.
    assert use_huge_pages("10000000-10400000 rw-p 00000000 00:00 0\n") == 0


def test_moved_objects_stay_as_they_are() -> None:
    code = (
        "from linemate.daemon.service.host import realtime; "
        "kept = [bytes((n % 251,)) * 1000 for n in range(20000)]; "
        "realtime.use_huge_pages(); "
        "print(all(each == bytes((n % 251,)) * 1000 for n, each in enumerate(kept)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"


def test_the_timer_slack_of_an_ordinary_process_is_as_configured() -> None:
    assert asked(timer_slack_ns=1000)["slack"] == 1000


def test_a_core_that_is_not_there_is_refused_in_words() -> None:
    (outcome,) = asked(cpus=[4000])["outcomes"]
    assert not outcome[1]
    assert "realtime.cpus" in outcome[2]


@pytest.mark.skipif(os.geteuid() != 0, reason="needs rights to give up")
def test_without_rights_every_refusal_tells_how_to_allow_it() -> None:
    answer = asked(drop=True, priority=50, lock_memory=True)
    assert answer["policy"] == os.SCHED_OTHER
    priority, _ = answer["outcomes"]
    assert not priority[1]
    assert "LimitRTPRIO" in priority[2]


def test_the_collector_runs_between_cycles_and_fully_only_at_rest() -> None:
    collector = Collector(every=10)
    collections: list[int] = []

    def note(phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            collections.append(info["generation"])

    gc.callbacks.append(note)
    try:
        collector.freeze()
        assert not collections
        for _ in range(1000):
            collector.collect_if_due(is_moving=True)
        assert set(collections) == {1}
        assert len(collections) == 100
        for _ in range(1000):
            collector.collect_if_due(is_moving=False)
        assert collections.count(2) == 3
        assert (collector.quick, collector.full) == (197, 3)
        assert not gc.isenabled()
    finally:
        gc.callbacks.remove(note)
        collector.thaw()
    assert gc.isenabled()


HELPERS = """
import json, os, threading
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as the daemon does: the algebra brings no thread
from linemate.daemon.service.host.realtime import HelperThreads, request_all
from linemate.daemon.config.settings import RealtimeSettings
host = request_all(RealtimeSettings(priority=10))
helpers = HelperThreads(host.granted("priority"))
end = threading.Event()
threads = [threading.Thread(target=end.wait) for _ in range(2)]
for thread in threads:
    thread.start()
helpers.raise_priority()
helpers.raise_priority()
seen = [(os.sched_getscheduler(t.native_id), os.sched_getparam(t.native_id).sched_priority)
        for t in threads]
own = os.sched_getparam(0).sched_priority
end.set()
print(json.dumps([helpers.wanted, helpers.granted, own, seen]))
"""


def test_other_threads_get_the_least_priority_once_the_loop_has_one() -> None:
    done = subprocess.run(
        [sys.executable, "-c", HELPERS], capture_output=True, text=True, check=True
    )
    wanted, granted, own, seen = json.loads(done.stdout)
    if not wanted:
        pytest.skip("no real-time rights here")
    assert granted == 2
    assert own == 10
    assert seen == [[os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 1]] * 2


def test_without_a_priority_the_other_threads_are_left_alone() -> None:
    helpers = HelperThreads(wanted=False)
    helpers.raise_priority()
    assert (helpers.granted, helpers.refused) == (0, 0)
