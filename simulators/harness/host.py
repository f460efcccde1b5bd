"""Facts of this machine and its rights, printed with figures that depend on them.

Invariants:
    It changes nothing unless asked, and never fails.
    An unknown fact is None or a reason.
"""

from __future__ import annotations

import ctypes
import os
import platform
import resource
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

PRIORITY = 50
URGENT_NICENESS = -15
"""Instead of SCHED_FIFO, where that is refused."""

MCL_CURRENT = 1

_libc = ctypes.CDLL(None, use_errno=True)


def machine() -> dict[str, Any]:
    """Name processor, cores, kernel, Python and load, as far as they are known."""
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "kernel": platform.release(),
        "preempt_rt": Path("/sys/kernel/realtime").exists(),
        "python": platform.python_version(),
        "load_1min": round(os.getloadavg()[0], 2),
        "real_time": missing_rights() is None,
    }


def stolen_s(stat: Path = Path("/proc/stat")) -> float | None:
    """Return the time of all cores that a hypervisor withheld since the start [s], if known."""
    try:
        # cpu user nice system idle iowait irq softirq steal ...
        steal = stat.read_text(encoding="ascii").split("\n", 1)[0].split()[8]
        return int(steal) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return None


def resident_bytes() -> int:
    """Return the memory of this process that is in use [bytes], 0 if it is not known."""
    try:
        return int(Path("/proc/self/statm").read_bytes().split()[1]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        return 0


def missing_rights() -> str | None:
    """Say why a process started here gets no real-time priority; None when it does.

    The scheduler is asked, and put back at once: a limit alone does not show what a container
    allows.
    """
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError as error:
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        return f"SCHED_FIFO {PRIORITY} refused ({error.strerror}; RLIMIT_RTPRIO is {limit})"
    os.sched_setscheduler(0, policy, parameters)
    return None


def grant(priority: int | None, cpus: Sequence[int]) -> Iterator[str]:
    """Ask for a priority and cores for this process; say what was refused, and why.

    With a priority the memory is locked as well: a browser that starts pushes out pages, and one
    that is read from disk again holds up every emulated device.

    Args:
        priority: of SCHED_FIFO, None leaves the scheduler alone.
        cpus: the only ones to use, empty leaves them alone.
    """
    try:
        if cpus:
            os.sched_setaffinity(0, cpus)
    except (OSError, ValueError) as error:
        yield f"cores {list(cpus)} refused ({error})"
    if priority is None:
        return
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, ValueError) as error:
        yield f"SCHED_FIFO {priority} refused ({error}); {_next_best()}"
    try:
        lock_memory()
    except OSError as error:
        yield f"locked memory refused ({error.strerror})"


def _next_best() -> str:
    """Ask for a niceness below everybody else's, and say what came of it."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, URGENT_NICENESS)
    except OSError as error:
        return f"niceness {URGENT_NICENESS} refused as well ({error.strerror})"
    return f"niceness {URGENT_NICENESS} instead"


def lock_memory() -> None:
    """Keep what this process has in memory there.

    Raises:
        OSError: the host refuses.
    """
    if _libc.mlockall(MCL_CURRENT) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def shared_out() -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Share the cores out: one for the daemon, the rest for all others; empty where there is one.

    A real-time process that wakes every few milliseconds is better off on a core of its own: a
    scheduler that moves it now and then is late by more than the cycle allows (measured on two
    cores, next to another one at 4 ms: 1 to 3 wakes of 1500 later than 1 ms, 3 to 23 without).
    """
    cores = sorted(os.sched_getaffinity(0))
    return ((), ()) if len(cores) < 2 else ((cores[-1],), tuple(cores[:-1]))


def _processor() -> str | None:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, None) or platform.machine() or None
