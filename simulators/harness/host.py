"""What this machine is, and what it grants: said beside every figure that depends on it.

Law of the file: asks the kernel, changes nothing unasked, and never fails:
what cannot be found out is None or a reason.
"""

from __future__ import annotations

import os
import platform
import resource
from pathlib import Path
from typing import Any

PRIORITY = 50


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


def missing_rights() -> str | None:
    """Say why a process started here gets no real-time priority; None when it does.

    The scheduler is asked, and put back at once: a limit alone does not tell what a container
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


def take_priority(priority: int) -> str | None:
    """Ask for SCHED_FIFO for this process; return why it was refused, None if granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, ValueError) as error:
        return f"SCHED_FIFO {priority} refused ({error})"
    return None


def _processor() -> str | None:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, None) or platform.machine() or None
