"""The bench measures in turns, and what it measures is the step of a run, the same every round."""

import json
from argparse import Namespace
from pathlib import Path

import pytest

from linemate.daemon.core.step import step
from linemate.daemon.core.step_state import StepState
from linemate.simulators.harness import host
from linemate.simulators.lab.bench import bench
from linemate.simulators.lab.bench.bench import BenchJob, StepTrace, interleaved


def test_jobs_take_turns_and_the_warm_round_does_not_count() -> None:
    order: list[str] = []

    def job(name: str, figures: list[float]) -> BenchJob:
        def measure() -> float:
            order.append(name)
            return figures.pop(0)

        return BenchJob(name, measure)

    jobs = [job("a", [900.0, 1.0, 3.0, 2.0]), job("b", [900.0, 30.0, 10.0, 20.0])]
    assert interleaved(jobs, rounds=3, warm=1) == {"a": 2.0, "b": 20.0}
    assert "".join(order) == "baabbaab"


@pytest.fixture(scope="module")
def trace() -> StepTrace:
    return bench.record(42, 0.012)


def test_the_trace_is_of_an_approach_with_every_sensor_at_work(trace: StepTrace) -> None:
    assert len(trace.inputs) == bench.LEAST_STEPS
    assert sum(len(inputs.camera) for inputs in trace.inputs) > 0.5 * 40 * len(trace.inputs) * 0.012
    assert all(inputs.robot is not None for inputs in trace.inputs)
    assert any(inputs.distance for inputs in trace.inputs)
    assert any(inputs.wrench for inputs in trace.inputs)


def test_every_round_does_the_same_work(trace: StepTrace) -> None:
    def commands() -> list[tuple[float, ...]]:
        state: StepState = trace.state
        found = []
        for inputs in trace.inputs[:20]:
            state, outputs = step(state, inputs, trace.parameters)
            found.append(outputs.command)
        return found

    once = commands()
    assert once == commands()
    assert len(set(once)) > 1


MODE = {
    "p50_us": 90.0, "p99_us": 160.0, "echo_p50_us": 60.0, "echo_p99_us": 110.0, "p50_ratio": 1.5,
    "p99_ratio": 1.45, "late": 2, "late_unexplained": 0, "echo_late": 1, "cycles": 500,
    "prepared": 0.998,
}  # fmt: skip
MEASURED = {
    "version": 1,
    "machine": host.machine(),
    "rounds": 5,
    "notes": ["a remark"],
    "echo": "c",
    "turnaround": {
        "4ms": {"idle": MODE, "loaded": MODE, "inline": MODE | {"p99_us": None, "prepared": 0.0}}
    },
    "cpu_per_cycle_us": 350.0,
    "start_s": 1.5,
    "wakeup": {"p99_us": 80.0, "c_p99_us": 62.0, "p99_ratio": 1.29},
    "step_us": {"42": 250.0, "125": 300.5, "500": 420.0},
    bench.VIRTUAL: 21.3,
}
ARGUMENTS = {
    "idle_spinner": None,
    "rounds": 5,
    "round_s": 0.8,
    "cycles": (4,),
    "parts": bench.PARTS,
    "plot": None,
}


def test_figures_are_printed_as_json_and_as_a_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(bench, "measure_all", lambda _: MEASURED)
    assert bench.main(Namespace(json=True, **ARGUMENTS)) == 0
    assert json.loads(capsys.readouterr().out)["step_us"]["125"] == 300.5
    picture = tmp_path / "bench.png"
    assert bench.main(Namespace(json=False, **(ARGUMENTS | {"plot": picture}))) == 0
    output = capsys.readouterr().out
    assert "horizon 42 at 12 ms" in output
    assert "21.3 times real time" in output
    assert "next to a bare C echo" in output
    assert "note: a remark" in output
    (line,) = [line for line in output.splitlines() if "inline" in line]
    assert line.split() == ["4ms", "inline", "90", "60", "\N{EN DASH}", "110", "1.50", "1.45", "2",
                            "0", "1", "500", "0.0"]  # fmt: skip
    assert picture.stat().st_size > 1000


def test_a_bench_measures_only_what_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "HORIZONS", {42: 0.012})
    options = bench.Options(rounds=1, parts=("step",))
    result = bench.measure_all(options)
    assert set(result) == {"version", "machine", "rounds", "notes", "step_us"}
    assert set(result["step_us"]) == {"42"}
    assert result["step_us"]["42"] > 0.0
