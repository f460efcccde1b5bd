"""The processor time by part comes from an assembly of its own daemon at each cycle."""

import json
from pathlib import Path
from typing import Any

import pytest

from linemate.simulators.harness import demo
from linemate.simulators.lab.bench import bench_cpu, cpu_daemon

TAKEN: dict[str, Any] = {
    "cycles": 4000,
    "parts_us": {"tracking": 600.0, "control": 170.0},
    "all_us": 770.0,
    "measurement_us": 12.0,
    "memory_mib": {"numpy": 15.5, "heap": 60.0},
}


def test_each_cycle_is_assembled_by_the_daemon_with_an_account(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stations: list[demo.DemoStation] = []

    def run(station: demo.DemoStation) -> dict[str, Any]:
        stations.append(station)
        Path(station.folder, cpu_daemon.FILE).write_text(json.dumps(TAKEN), encoding="utf-8")
        return {"state": "idle"}

    monkeypatch.setattr(demo, "run_station", run)
    measured = bench_cpu.measure((12, 4, 1))
    assert measured == {"12ms": TAKEN | {"state": "idle"}, "4ms": TAKEN | {"state": "idle"}}
    assert [station.scenario.cycle_s for station in stations] == [0.012, 0.004]
    assert {station.daemon for station in stations} == {"linemate.simulators.lab.bench.cpu_daemon"}
    table = list(bench_cpu.rows(measured))
    assert table[:3] == [
        ("12ms: all of 4000 cycles", "770"), ("  tracking", "600"), ("  control", "170"),
    ]  # fmt: skip
    assert ("4ms: resident memory [MiB]", "76") in table


def test_a_run_that_does_not_end_well_is_a_row_and_the_others_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def run(station: demo.DemoStation) -> dict[str, Any]:
        if station.scenario.cycle_s < 0.004:
            raise demo.DemoError("nothing has moved for 30 s")
        Path(station.folder, cpu_daemon.FILE).write_text(json.dumps(TAKEN), encoding="utf-8")
        return {"state": "idle"}

    monkeypatch.setattr(demo, "run_station", run)
    measured = bench_cpu.measure((4, 2))
    assert measured["2ms"] == {"failed": "nothing has moved for 30 s"}
    table = [name for name, _ in bench_cpu.rows(measured)]
    assert table[0] == "4ms: all of 4000 cycles"
    assert table[-1] == "2ms: nothing has moved for 30 s"
