"""Processor time of the daemon by part, in a live assembly.

The daemon and the emulators run as in a demonstration, so that the robot follows the commands and
the inverse kinematics does what it does in an assembly.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from linemate.daemon.transport.client import NoAnswerError, RefusedError
from linemate.simulators.harness import demo, host, setup
from linemate.simulators.harness.processes import ChildError
from linemate.simulators.judge.table import DASH, number
from linemate.simulators.lab.bench import cpu_daemon

DAEMON: Final = "linemate.simulators.lab.bench.cpu_daemon"
HEAD: Final = ("part", "us a cycle")


def measure(cycles_ms: Iterable[int], seed: int = 0) -> dict[str, Any]:
    """Assemble once at each cycle, and return the figures of each, or why there are none.

    Args:
        cycles_ms: [ms]; at 1 ms the shipped task is not assembled.
    """
    return {f"{cycle_ms}ms": _tried(cycle_ms, seed) for cycle_ms in cycles_ms if cycle_ms > 1}


def _measure(cycle_ms: int, seed: int) -> dict[str, Any]:
    scenario = replace(setup.make("wheel", cycle_ms=float(cycle_ms)).scenario, seed=seed)
    with tempfile.TemporaryDirectory(prefix="linemate-") as folder:
        cores = host.shared_out() if host.missing_rights() is None else ((), ())
        station = demo.DemoStation(Path(folder), scenario, cores, daemon=DAEMON)
        status = demo.run_station(station)
        text = (station.folder / cpu_daemon.FILE).read_text(encoding="utf-8")
    figures: dict[str, Any] = json.loads(text)
    return figures | {"state": status.get("state")}


def _tried(cycle_ms: int, seed: int) -> dict[str, Any]:
    try:
        return _measure(cycle_ms, seed)
    except (ChildError, demo.DemoError, NoAnswerError, RefusedError, TimeoutError) as error:
        return {"failed": str(error).partition("\n")[0]}


def rows(measured: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the rows of the table ``HEAD``, the largest part of each cycle first."""
    for cycle, figures in measured.items():
        if "failed" in figures:
            yield f"{cycle}: {figures['failed']}", DASH
            continue
        yield f"{cycle}: all of {figures['cycles']} cycles", number(figures["all_us"], 0)
        parts = sorted(figures["parts_us"].items(), key=lambda item: -item[1])
        for part, us in parts:
            yield f"  {part}", number(us, 0)
        yield "  of it for the measurement", number(figures["measurement_us"], 0)
        memory = figures["memory_mib"]
        yield f"{cycle}: resident memory [MiB]", number(sum(memory.values()), 0)
        for part, mib in sorted(memory.items(), key=lambda item: -item[1]):
            yield f"  {part}", number(mib, 0)
