"""The doctor tells what a host lacks, from the kernel's files of a host made for it."""

import ctypes
import json
import os
import resource
from pathlib import Path

import pytest

from linemate.daemon.operator import doctor
from linemate.daemon.operator.doctor import Finding, Grade, Host
from linemate.daemon.operator.main import main


def host(root: Path, **files: str) -> Host:
    """A host whose kernel tells these files; __ in a name is a slash."""
    for name, text in files.items():
        path = root / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
    return Host(root)


def by_name(findings: tuple[Finding, ...]) -> dict[str, Finding]:
    return {finding.name: finding for finding in findings}


CLOCK = "sys__devices__system__clocksource__clocksource0__"


def test_this_host_is_examined_whole_and_stays_as_it_was() -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    findings = doctor.examine(Host())
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before
    assert len(by_name(findings)) == len(findings) >= 12
    for finding in findings:
        assert bool(finding.cost) == (finding.grade in {Grade.ADVICE, Grade.LACK}), finding


def test_a_refused_priority_is_a_lack_and_names_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    finding = doctor.fifo(Host())
    assert finding.grade is Grade.LACK
    assert "RLIMIT_RTPRIO" in finding.what
    assert "LimitRTPRIO" in finding.cost


@pytest.mark.parametrize(
    ("capabilities", "grade"), [("0000000000004000", Grade.GOOD), ("0000000000000000", Grade.LACK)]
)
def test_limited_memory_is_a_lack_unless_a_capability_lifts_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capabilities: str, grade: Grade
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (8 << 20, 8 << 20))
    here = host(tmp_path, proc__self__status=f"Name:\tx\nCapEff:\t{capabilities}")
    assert doctor.locked_memory(here).grade is grade


def test_a_slow_clock_is_a_lack_and_names_the_others(tmp_path: Path) -> None:
    here = host(
        tmp_path,
        **{CLOCK + "current_clocksource": "hpet", CLOCK + "available_clocksource": "tsc hpet"},
    )
    finding = doctor.clock_source(here)
    assert finding.grade is Grade.LACK
    assert "tsc" in finding.cost
    good = host(tmp_path, **{CLOCK + "current_clocksource": "tsc"})
    assert doctor.clock_source(good).grade is Grade.GOOD


def test_a_kernel_for_real_time_is_good_and_a_stock_one_could_be_better(tmp_path: Path) -> None:
    stock = host(tmp_path, proc__version="Linux version 6.1 #1 SMP PREEMPT_DYNAMIC")
    finding = doctor.preemption(stock)
    assert (finding.grade, finding.what) == (Grade.ADVICE, "PREEMPT_DYNAMIC")
    assert doctor.preemption(host(tmp_path, sys__kernel__realtime="1")).grade is Grade.GOOD


def test_one_core_that_saves_power_is_enough_for_advice(tmp_path: Path) -> None:
    where = "sys__devices__system__cpu__cpu{}__cpufreq__scaling_governor"
    assert doctor.governor(Host(tmp_path)).grade is Grade.ABSENT
    fast = host(tmp_path, **{where.format(0): "performance", where.format(1): "performance"})
    assert doctor.governor(fast).grade is Grade.GOOD
    mixed = doctor.governor(host(tmp_path, **{where.format(1): "powersave"}))
    assert mixed.grade is Grade.ADVICE
    assert "powersave" in mixed.what


def test_deep_sleep_costs_only_where_it_cannot_be_forbidden(tmp_path: Path) -> None:
    where = "sys__devices__system__cpu__cpu0__cpuidle__state{}__latency"
    shallow = host(tmp_path, **{where.format(0): "0", where.format(1): "2"})
    assert doctor.deep_sleep(shallow).grade is Grade.GOOD
    deep = host(tmp_path, **{where.format(2): "200"})
    assert doctor.deep_sleep(deep).grade is Grade.ADVICE
    assert doctor.deep_sleep(host(tmp_path, dev__cpu_dma_latency="")).grade is Grade.GOOD


def test_a_virtual_machine_is_advised_to_prevent_idle_cores(tmp_path: Path) -> None:
    assert doctor.virtual(host(tmp_path)).grade is Grade.GOOD
    bare = host(tmp_path, proc__cpuinfo="processor : 0\nflags : fpu hypervisors sse2\n")
    assert doctor.virtual(bare).grade is Grade.GOOD
    finding = doctor.virtual(host(tmp_path, proc__cpuinfo="flags : fpu hypervisor sse2\n"))
    assert finding.grade is Grade.ADVICE
    assert "realtime.keep_awake" in finding.cost


def test_throttling_below_nine_tenths_is_a_lack(tmp_path: Path) -> None:
    runtime = "proc__sys__kernel__sched_rt_runtime_us"
    period = {"proc__sys__kernel__sched_rt_period_us": "1000000"}
    for text, grade in (("-1", Grade.GOOD), ("950000", Grade.GOOD), ("400000", Grade.LACK)):
        assert doctor.throttling(host(tmp_path, **{runtime: text}, **period)).grade is grade


def test_a_missing_library_is_named_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(ctypes, "CDLL", missing)
    finding = doctor.openmp(Host())
    assert finding.grade is Grade.LACK
    assert "apt install libgomp1" in finding.cost


def test_can_interfaces_that_are_down_are_a_lack_and_others_are_not_looked_at(
    tmp_path: Path,
) -> None:
    here = host(
        tmp_path,
        sys__class__net__eth0__type="1",
        sys__class__net__can0__type="280", sys__class__net__can0__operstate="down",
        sys__class__net__can0__flags="0x40080",
        sys__class__net__can1__type="280", sys__class__net__can1__operstate="up",
        sys__class__net__can1__flags="0x40081",
    )  # fmt: skip
    found = by_name(doctor.examine(here))
    assert found["CAN can0"].grade is Grade.LACK
    assert "ip link set can0 up" in found["CAN can0"].cost
    assert found["CAN can1"].grade is Grade.GOOD
    assert not any("eth0" in name for name in found)


def test_an_adapter_that_holds_bytes_back_is_a_lack(tmp_path: Path) -> None:
    here = host(
        tmp_path,
        sys__class__tty__ttyUSB0__device__latency_timer="16",
        sys__class__tty__ttyUSB1__device__latency_timer="1",
    )
    found = by_name(doctor.examine(here))
    assert found["serial ttyUSB0"].grade is Grade.LACK
    assert "16 ms" in found["serial ttyUSB0"].what
    assert found["serial ttyUSB1"].grade is Grade.GOOD


def test_the_command_prints_every_check_and_its_exit_code_follows_the_lacks(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = main(["doctor", "--json"])
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert code == int(any(finding["grade"] == "lacking" for finding in findings))
    assert main(["doctor"]) == code
    text = capsys.readouterr().out
    assert all(finding["name"] in text for finding in findings)
    assert all(finding["cost"] in text for finding in findings)
