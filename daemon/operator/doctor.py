"""``linemate doctor``: what this host lacks for real time and for the links, and what that costs.

Invariants:
    * A check changes nothing that stays. It is one function with one finding.
    * What does not exist here (no CAN, no serial port) is not a lack.
"""

import argparse
import ctypes
import fcntl
import os
import resource
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from linemate.daemon.command_line import NO, OK
from linemate.daemon.operator import render

FIFO_PRIORITY: Final = 70
CAP_IPC_LOCK: Final = 14
CAN_TYPE: Final = "280"  # ARPHRD_CAN

GOOD_CLOCKS: Final = frozenset(
    {"tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page"}
)
DEEP_SLEEP_US: Final = 50  # a core that wakes more slowly should not sleep deeply

TIOCGSERIAL: Final = 0x541E
SERIAL_STRUCT: Final = 72
FLAGS_AT: Final = 16
ASYNC_LOW_LATENCY: Final = 1 << 13


class Grade(StrEnum):
    """Result of a check."""

    GOOD = "good"
    ADVICE = "could be better"
    LACK = "lacking"
    ABSENT = "not here"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check.

    Attributes:
        what: The value or state that was read.
        cost: What it costs and how to change it; empty if it is good.
    """

    name: str
    grade: Grade
    what: str
    cost: str = ""


@dataclass(frozen=True, slots=True)
class Host:
    """The files in which the kernel describes the host.

    Attributes:
        root: Root of the file system; another one in tests.
    """

    root: Path = Path("/")

    def read(self, path: str) -> str | None:
        """Return the text of a file, None if there is none."""
        try:
            return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return None

    def each(self, pattern: str) -> list[Path]:
        """Return the files of a pattern in order."""
        return sorted(self.root.glob(pattern))


def add_parser(commands: Any, _: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser = commands.add_parser("doctor", help="what this host lacks for real time and links")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Print the findings; the exit code says whether anything is lacking."""
    findings = examine(Host())
    if args.json:
        print(render.versioned({"findings": [asdict(finding) for finding in findings]}))
    else:
        print(render.table((), [(f.name, str(f.grade), f.what) for f in findings]))
        costs = [f"{f.name}: {f.cost}" for f in findings if f.cost]
        print("\n".join(["", *costs] if costs else ["", "nothing is lacking"]))
    return NO if any(finding.grade is Grade.LACK for finding in findings) else OK


def examine(host: Host) -> tuple[Finding, ...]:
    """Run every check."""
    return (*(check(host) for check in CHECKS), *_can(host), *_serial(host))


# --- the scheduler and memory -------------------------------------------------------------


def fifo(_: Host) -> Finding:
    """Check whether a process may have a real-time priority."""
    name = "SCHED_FIFO"
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except OSError as error:
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        return Finding(
            name, Grade.LACK, f"refused: {error.strerror}; RLIMIT_RTPRIO is {limit}",
            "on a busy machine replies come 20 to 40 ms late; LimitRTPRIO=98 in the unit, or "
            "ulimit -r 98, or CAP_SYS_NICE",
        )  # fmt: skip
    os.sched_setscheduler(0, policy, parameters)
    return Finding(name, Grade.GOOD, f"granted at {FIFO_PRIORITY}")


def locked_memory(host: Host) -> Finding:
    """Check whether a process may lock its memory."""
    name = "mlockall"
    hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
    if hard == resource.RLIM_INFINITY:
        return Finding(name, Grade.GOOD, "no limit")
    status = host.read("proc/self/status") or ""
    effective = [line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")]
    if effective and int(effective[0], 16) >> CAP_IPC_LOCK & 1:
        return Finding(name, Grade.GOOD, "CAP_IPC_LOCK")
    return Finding(
        name, Grade.LACK, f"at most {hard >> 10} KiB",
        "a page fault in a reply costs milliseconds; LimitMEMLOCK=infinity in the unit",
    )  # fmt: skip


def timer_slack(host: Host) -> Finding:
    """Check how late the kernel may make timers of the ordinary class."""
    slack = host.read("proc/self/timerslack_ns")
    if slack is None:
        return Finding("timer slack", Grade.ABSENT, "the kernel does not report it")
    grade = Grade.GOOD if int(slack) <= 50_000 else Grade.ADVICE
    cost = "" if grade is Grade.GOOD else "every sleep may be late by as much"
    return Finding("timer slack", grade, f"{int(slack) / 1000:g} us", cost)


def throttling(host: Host) -> Finding:
    """Check whether the kernel throttles a real-time process."""
    name, runtime = "real-time throttling", host.read("proc/sys/kernel/sched_rt_runtime_us")
    period = host.read("proc/sys/kernel/sched_rt_period_us")
    if runtime is None or period is None:
        return Finding(name, Grade.ABSENT, "the kernel does not report it")
    if int(runtime) < 0:
        return Finding(name, Grade.GOOD, "off")
    share = int(runtime) / max(1, int(period))
    grade = Grade.GOOD if share >= 0.9 else Grade.LACK
    cost = "" if grade is Grade.GOOD else "the daemon is stopped for the rest of each second"
    return Finding(name, grade, f"at {share:.0%} of a core", cost)


# --- the kernel and the processor ---------------------------------------------------------


def cores(_: Host) -> Finding:
    """Check for a core that the cycle does not need."""
    count = len(os.sched_getaffinity(0))
    if count > 1:
        return Finding("cores", Grade.GOOD, str(count))
    cost = "recording and operators take turns with the cycle; realtime.cpus cannot help"
    return Finding("cores", Grade.ADVICE, "1", cost)


def preemption(host: Host) -> Finding:
    """Check whether a real-time process can preempt the kernel."""
    name = "kernel preemption"
    if host.read("sys/kernel/realtime") == "1":
        return Finding(name, Grade.GOOD, "PREEMPT_RT")
    version = host.read("proc/version") or ""
    models = ("PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT")
    model = next((model for model in models if model in version), None)
    if model == "PREEMPT_RT":
        return Finding(name, Grade.GOOD, model)
    return Finding(
        name, Grade.ADVICE, model or "none",
        "now and then the kernel keeps the processor for some ms; good for 12 and 4 ms, "
        "for 1 ms take a PREEMPT_RT kernel",
    )  # fmt: skip


def clock_source(host: Host) -> Finding:
    """Check that reading the clock is no system call."""
    where = "sys/devices/system/clocksource/clocksource0/"
    name, current = "clock source", host.read(where + "current_clocksource")
    if current is None:
        return Finding(name, Grade.ABSENT, "the kernel does not report it")
    if current in GOOD_CLOCKS:
        return Finding(name, Grade.GOOD, current)
    others = host.read(where + "available_clocksource") or ""
    return Finding(
        name, Grade.LACK, current,
        f"each reading is a system call of a microsecond, dozens a cycle; there is: {others}",
    )  # fmt: skip


def governor(host: Host) -> Finding:
    """Check that the processor keeps its frequency between two cycles."""
    files = host.each("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    governors = sorted({path.read_text(encoding="ascii").strip() for path in files})
    if not governors:
        return Finding("governor", Grade.ABSENT, "no frequency scaling")
    if governors == ["performance"]:
        return Finding("governor", Grade.GOOD, "performance")
    return Finding(
        "governor", Grade.ADVICE, ", ".join(governors),
        "a step takes up to three times as long; cpupower frequency-set -g performance",
    )  # fmt: skip


def deep_sleep(host: Host) -> Finding:
    """Check how long a core takes to wake, and whether deep sleep can be prevented."""
    name = "cpu_dma_latency"
    latencies = [
        int(text)
        for path in host.each("sys/devices/system/cpu/cpu0/cpuidle/state*/latency")
        if (text := path.read_text(encoding="ascii").strip()).isdigit()
    ]
    deepest = max(latencies, default=0)
    if deepest <= DEEP_SLEEP_US:
        return Finding(name, Grade.GOOD, f"cores wake within {deepest} us")
    device = host.root / "dev/cpu_dma_latency"
    if os.access(device, os.W_OK):
        return Finding(
            name, Grade.GOOD, f"cores take {deepest} us to wake; realtime.cpu_dma_latency_us helps"
        )
    return Finding(
        name, Grade.ADVICE, f"cores take {deepest} us to wake",
        f"a reply comes {deepest} us late after a pause; DeviceAllow=/dev/cpu_dma_latency rw",
    )  # fmt: skip


def is_virtual(host: Host) -> bool:
    """Return whether the processor reports a hypervisor."""
    lines = (host.read("proc/cpuinfo") or "").splitlines()
    return any(line.startswith("flags") and "hypervisor" in line.split() for line in lines)


def virtual(host: Host) -> Finding:
    """Does a host of its own give its cores back when they are to wake?"""
    name = "virtual machine"
    if not is_virtual(host):
        return Finding(name, Grade.GOOD, "none that the processor reports")
    return Finding(
        name, Grade.ADVICE, "yes",
        "a core that sleeps is woken when its host comes to it, now and then 4 ms late and more; "
        "realtime.keep_awake lets none sleep; what the host withholds is in /proc/stat as steal",
    )  # fmt: skip


def openmp(_: Host) -> Finding:
    """Check for the library that pinocchio's wheel does not contain."""
    try:
        ctypes.CDLL("libgomp.so.1")
    except OSError:
        return Finding(
            "libgomp1", Grade.LACK, "not found", "the daemon does not start; apt install libgomp1"
        )
    return Finding("libgomp1", Grade.GOOD, "found")


CHECKS: Final[tuple[Callable[[Host], Finding], ...]] = (
    fifo, locked_memory, throttling, timer_slack, deep_sleep, virtual, cores, preemption,
    clock_source, governor, openmp,
)  # fmt: skip


# --- the links ----------------------------------------------------------------------------


def _can(host: Host) -> Iterator[Finding]:
    """Check that the kernel's CAN interfaces are up."""
    has_interface = False
    for path in host.each("sys/class/net/*/type"):
        if path.read_text(encoding="ascii").strip() != CAN_TYPE:
            continue
        has_interface = True
        interface = path.parent.name
        state = host.read(f"sys/class/net/{interface}/operstate") or "unknown"
        if state in {"up", "unknown"} and _is_up(host, interface):
            yield Finding(f"CAN {interface}", Grade.GOOD, "up")
        else:
            yield Finding(
                f"CAN {interface}", Grade.LACK, state,
                f"no distance from it; ip link set {interface} up type can bitrate 500000 "
                "restart-ms 100",
            )  # fmt: skip
    if not has_interface:
        yield Finding("CAN", Grade.ABSENT, "no interface of the kernel's; slcan needs none")


def _is_up(host: Host, interface: str) -> bool:
    flags = host.read(f"sys/class/net/{interface}/flags") or "0x0"
    return bool(int(flags, 16) & 1)


def _serial(host: Host) -> Iterator[Finding]:
    """Check that serial adapters forward bytes at once."""
    ports = host.each("sys/class/tty/ttyUSB*") + host.each("sys/class/tty/ttyACM*")
    if not ports:
        yield Finding("serial", Grade.ABSENT, "no adapter")
    for port in ports:
        name = f"serial {port.name}"
        timer = host.read(f"sys/class/tty/{port.name}/device/latency_timer")
        if timer is not None and timer.isdigit() and int(timer) > 1:
            yield Finding(
                name, Grade.LACK, f"holds bytes back for {timer} ms",
                f"the force is up to {timer} ms old; echo 1 > /sys/class/tty/{port.name}/device/"
                "latency_timer, or setserial low_latency",
            )  # fmt: skip
        elif timer is None and _is_slow(host.root / "dev" / port.name):
            yield Finding(
                name, Grade.ADVICE, "not low_latency",
                f"bytes may be held back for some ms; setserial /dev/{port.name} low_latency",
            )  # fmt: skip
        else:
            yield Finding(name, Grade.GOOD, "hands on at once")


def _is_slow(device: Path) -> bool:
    """Return whether a serial driver may hold bytes back; False if it does not report it."""
    with suppress(OSError, struct.error):
        fd = os.open(device, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        try:
            settings = fcntl.ioctl(fd, TIOCGSERIAL, bytes(SERIAL_STRUCT))
            (flags,) = struct.unpack_from("@i", settings, FLAGS_AT)
            return not flags & ASYNC_LOW_LATENCY
        finally:
            os.close(fd)
    return False
