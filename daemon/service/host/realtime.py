"""Real-time requests to the host: scheduler, cores, memory, sleep states, garbage collector.

Invariants:
- A refusal is a text with its cost and how to allow the request. It never ends the daemon.
"""

import contextlib
import ctypes
import gc
import os
import resource
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from linemate.daemon.config.settings import RealtimeSettings
from linemate.daemon.core import lapack
from linemate.daemon.service.host.idle_spinner import IdleSpinner

MCL_CURRENT: Final = 1
MCL_FUTURE: Final = 2
MCL_ONFAULT: Final = 4
LEAST_RESERVE: Final = 16 << 20  # of a mapping that may stay empty [bytes]
MOST_USED: Final = 8  # such a mapping is a reserve while less than an eighth of it is in use
BLAS_SIDE: Final = 128  # of matrices that are too large for the kernels without a buffer
THREAD_STACK: Final = 1 << 20  # instead of 8 MiB, all of which would be locked [bytes]
PR_SET_TIMERSLACK: Final = 29
MADV_COLLAPSE: Final = 25  # since Linux 6.1
HUGE_PAGE: Final = 2 << 20  # [bytes]
CAP_IPC_LOCK: Final = 14
DMA_LATENCY: Final = Path("/dev/cpu_dma_latency")
SWITCH_S: Final = 0.0005  # longest wait of the loop for a thread that computes [s]


@dataclass(frozen=True, slots=True)
class RequestOutcome:
    """Outcome of one request.

    Attributes:
        message: refusal for an operator, empty if granted.
    """

    what: str
    granted: bool
    message: str = ""


@dataclass(slots=True)
class RealtimeHost:
    """What the host granted, and what must stay open for it.

    Attributes:
        outcomes: in the order of the requests.
        latency_fd: while it is open, the cores stay in light sleep states. None if not requested.
        spinner: keeps the cores from sleeping, None if not requested.
    """

    outcomes: list[RequestOutcome] = field(default_factory=list)
    latency_fd: int | None = None
    spinner: IdleSpinner | None = None

    def granted(self, what: str) -> bool:
        """Return whether a request was made and granted."""
        return any(outcome.granted for outcome in self.outcomes if outcome.what == what)

    def refusals(self) -> tuple[str, ...]:
        """Return the refusals, for the log and the status."""
        return tuple(o.message for o in self.outcomes if not o.granted)

    def close(self) -> None:
        """Let the cores sleep again."""
        if self.latency_fd is not None:
            os.close(self.latency_fd)
            self.latency_fd = None
        if self.spinner is not None:
            self.spinner.close()
            self.spinner = None


def request_all(settings: RealtimeSettings) -> RealtimeHost:
    """Make all configured requests.

    Call it before threads are started, so that they inherit the cores but not the priority.
    """
    sys.setswitchinterval(SWITCH_S)
    host = RealtimeHost()
    for what, request in _requests(settings, host):
        try:
            request()
        except OSError as error:
            reason = error.strerror or str(error)
            host.outcomes.append(
                RequestOutcome(what, granted=False, message=_sentence(what, reason))
            )
        else:
            host.outcomes.append(RequestOutcome(what, granted=True))
    return host


def _requests(
    settings: RealtimeSettings, host: RealtimeHost
) -> Iterator[tuple[str, Callable[[], None]]]:
    if settings.cpus:
        yield "cpus", lambda: os.sched_setaffinity(0, settings.cpus)
    if settings.priority is not None:
        priority = settings.priority
        yield "priority", lambda: _fifo(priority)
    if settings.lock_memory:
        yield "lock_memory", _lock_memory
    if settings.timer_slack_ns is not None:
        slack_ns = settings.timer_slack_ns
        yield "timer_slack", lambda: _libc("prctl", PR_SET_TIMERSLACK, slack_ns, 0, 0, 0)
    if settings.cpu_dma_latency_us is not None:
        latency_us = settings.cpu_dma_latency_us
        yield "cpu_dma_latency", lambda: _hold_latency(host, latency_us)
    if settings.keep_awake:
        yield "keep_awake", lambda: _start_spinner(host)


_COSTS = {
    "cpus": "the daemon may be moved between cores (a reply now and then 0.1 ms later); "
    "check realtime.cpus against this machine",
    "priority": "other programs may delay replies by tens of milliseconds; allow it with "
    "LimitRTPRIO= or AmbientCapabilities=CAP_SYS_NICE in the unit",
    "lock_memory": "a page fault may delay a reply by milliseconds; allow it with "
    "LimitMEMLOCK=infinity in the unit",
    "timer_slack": "timers may be 50 us late",
    "cpu_dma_latency": "a sleeping core may answer 0.1 ms late; allow it with "
    "DeviceAllow=/dev/cpu_dma_latency rw in the unit",
    "keep_awake": "in a virtual machine a sleeping core may answer milliseconds late",
}


def _sentence(what: str, reason: str) -> str:
    return f"realtime.{what} was refused ({reason}): {_COSTS[what]}"


def _fifo(priority: int) -> None:
    # Children and threads fall back to the ordinary class; threads get the least priority later.
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    os.sched_setscheduler(0, policy, os.sched_param(priority))


def is_fifo() -> bool:
    """Return whether this thread is in the real-time class."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO


def _use_blas() -> None:
    """Let the two libraries of BLAS map their buffers of 32 MiB now.

    A buffer that is mapped after the lock is faulted in as a whole: 32 MiB, and 10 ms in motion.
    """
    square = np.eye(BLAS_SIDE)
    square @ square
    np.linalg.solve(square, square)
    lapack.dgesv(square, square)
    lapack.dposv(square, square)


def _lock_memory() -> None:
    threading.stack_size(THREAD_STACK)
    _use_blas()
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if hard != soft:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    # Under a finite limit MCL_FUTURE would make a later allocation fail, which kills the daemon.
    unlimited = hard == resource.RLIM_INFINITY or _may_lock_all()
    if not unlimited:
        _libc("mlockall", MCL_CURRENT)
        return
    # Two libraries of BLAS reserve 64 MiB each for products of large matrices. None is computed.
    # All of it is locked as it is touched; what is no reserve is faulted in now.
    touched = without_reserves(Path("/proc/self/smaps").read_text(encoding="utf-8"))
    _libc("mlockall", MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT)
    for begin, end in touched:
        # A mapping that is gone by now needs no lock.
        with contextlib.suppress(OSError):
            _libc("mlock", begin, end - begin)
    _libc("mlockall", MCL_FUTURE)


def without_reserves(smaps: str) -> list[tuple[int, int]]:
    """Return begin and end of each mapping of an ``smaps``, but for large reserves.

    A reserve is a nameless mapping of 16 MiB or more, of which less than an eighth is in use.
    """
    reserves: list[tuple[int, int]] = []
    is_anonymous = False
    for line in smaps.splitlines():
        words = line.split()
        if not words[0].endswith(":"):
            begin, end = (int(address, 16) for address in words[0].split("-"))
            is_anonymous = len(words) == 5
            # The kernel's own pages and guard pages cannot be locked.
            if "r" in words[1] and not words[-1].startswith("[v"):
                reserves.append((begin, end))
        elif words[0] == "Rss:" and is_anonymous and reserves and reserves[-1] == (begin, end):
            size = end - begin
            if size >= LEAST_RESERVE and int(words[1]) * 1024 * MOST_USED < size:
                reserves.pop()
    return reserves


def use_huge_pages(maps: str | None = None) -> int:
    """Move the objects of a start to huge pages, and return how many mappings have some now.

    A step touches objects all over them: on small pages each cycle costs 5 to 10 % more. What is
    allocated later stays on small pages, so that no fault has to clear 2 MiB.

    Args:
        maps: as in ``/proc/self/maps``; by default this process'.
    """
    if maps is None:
        maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    moved = 0
    for begin, end in heaps(maps):
        # An old kernel, or a range that is empty: the pages stay as they are.
        with contextlib.suppress(OSError):
            _libc("madvise", begin, end - begin, MADV_COLLAPSE)
            moved += 1
    return moved


def heaps(maps: str) -> list[tuple[int, int]]:
    """Return begin and end of the whole huge pages in each mapping of objects in a ``maps``."""
    ranges = []
    for line in maps.splitlines():
        words = line.split()
        if not words[1].startswith("rw") or (len(words) > 5 and words[5] != "[heap]"):
            continue
        begin, end = (int(address, 16) for address in words[0].split("-"))
        begin, end = -(-begin // HUGE_PAGE) * HUGE_PAGE, end // HUGE_PAGE * HUGE_PAGE
        if begin < end:
            ranges.append((begin, end))
    return ranges


def _may_lock_all() -> bool:
    """Return whether RLIMIT_MEMLOCK does not bind this process."""
    for line in Path("/proc/self/status").read_bytes().splitlines():
        if line.startswith(b"CapEff:"):
            return bool(int(line.split()[1], 16) >> CAP_IPC_LOCK & 1)
    return False


def _hold_latency(host: RealtimeHost, latency_us: int) -> None:
    fd = os.open(DMA_LATENCY, os.O_WRONLY | os.O_CLOEXEC)
    try:
        os.write(fd, struct.pack("@i", latency_us))
    except OSError:
        os.close(fd)
        raise
    host.latency_fd = fd


def _start_spinner(host: RealtimeHost) -> None:
    host.spinner = IdleSpinner(os.sched_getaffinity(0))


def _libc(name: str, *arguments: int) -> None:
    function = getattr(ctypes.CDLL(None, use_errno=True), name)
    if function(*(ctypes.c_ulong(argument) for argument in arguments)) != 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))


HELPER_PRIORITY: Final = 1  # SCHED_FIFO, above every ordinary program
TASKS: Final = Path("/proc/self/task")


@dataclass(slots=True)
class HelperThreads:
    """Priority of the other threads, which hold the interpreter now and then.

    The loop waits for such a thread. In the ordinary class a busy machine would delay both: the
    p99 of a wake was 3 ms instead of 0.6 ms.

    Attributes:
        wanted: the loop has a real-time priority.
        granted, refused: number of threads that asked for their priority.
    """

    wanted: bool
    granted: int = 0
    refused: int = 0
    _known: frozenset[int] = frozenset()

    def raise_priority(self) -> None:
        """Give new threads the lowest real-time priority."""
        if not self.wanted:
            return
        threads = frozenset(int(task.name) for task in TASKS.iterdir()) - {os.getpid()}
        for thread in threads - self._known:
            try:
                least = os.sched_param(HELPER_PRIORITY)
                os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, least)
            except OSError:  # the thread has ended, or the limit has changed
                self.refused += 1
            else:
                self.granted += 1
        self._known = threads


@dataclass(slots=True)
class Collector:
    """Garbage collector that runs only when the loop calls it, after a reply.

    Attributes:
        every: cycles between two quick collections.
    """

    every: int = 250
    quick: int = 0
    full: int = 0
    _cycles: int = 0
    _has_frozen: bool = False

    def freeze(self) -> None:
        """Keep all present objects out of later collections, and disable the collector.

        Nothing is collected before: of a start's objects 23 are garbage, and to find them is 60 ms.
        """
        gc.freeze()
        gc.disable()
        self._has_frozen = True

    def thaw(self) -> None:
        """Enable the collector again."""
        if self._has_frozen:
            self._has_frozen = False
            gc.enable()
            gc.unfreeze()

    def collect_if_due(self, *, is_moving: bool) -> None:
        """Collect the young generations every ``every`` cycles; all only while the robot stands.

        Args:
            moving: the robot is being led.
        """
        self._cycles += 1
        if self._cycles % self.every:
            return
        if is_moving or self._cycles % (40 * self.every):
            gc.collect(1)
            self.quick += 1
        else:
            gc.collect()
            self.full += 1
