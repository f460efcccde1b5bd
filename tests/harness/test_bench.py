"""The bench measures in turns, and what it measures is the step of a run, the same every round."""

import json
from argparse import Namespace

import pytest

from linemate.daemon.step import State, step
from linemate.simulators.harness import bench, host
from linemate.simulators.harness.bench import Job, Tape, interleaved


def test_jobs_take_turns_and_the_warm_round_does_not_count() -> None:
    order: list[str] = []

    def job(name: str, figures: list[float]) -> Job:
        def measure() -> float:
            order.append(name)
            return figures.pop(0)

        return Job(name, measure)

    jobs = [job("a", [900.0, 1.0, 3.0, 2.0]), job("b", [900.0, 30.0, 10.0, 20.0])]
    assert interleaved(jobs, rounds=3, warm=1) == {"a": 2.0, "b": 20.0}
    assert "".join(order) == "baabbaab"


@pytest.fixture(scope="module")
def tape() -> Tape:
    return bench.record(42, 0.012)


def test_the_tape_is_of_an_approach_with_every_sensor_at_work(tape: Tape) -> None:
    assert len(tape.inputs) == bench.LEAST_STEPS
    assert sum(len(inputs.camera) for inputs in tape.inputs) > 0.5 * 40 * len(tape.inputs) * 0.012
    assert all(inputs.robot is not None for inputs in tape.inputs)
    assert any(inputs.distance for inputs in tape.inputs)
    assert any(inputs.wrench for inputs in tape.inputs)


def test_every_round_does_the_same_work(tape: Tape) -> None:
    def commands() -> list[tuple[float, ...]]:
        state: State = tape.state
        found = []
        for inputs in tape.inputs[:20]:
            state, outputs = step(state, inputs, tape.parameters)
            found.append(outputs.command)
        return found

    once = commands()
    assert once == commands()
    assert len(set(once)) > 1


def test_figures_are_printed_as_json_and_as_a_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = {
        "version": 1,
        "machine": host.machine(),
        "rounds": 5,
        "step_us": {"42": 250.0, "125": 300.5, "500": 420.0},
        bench.VIRTUAL: 21.3,
    }
    monkeypatch.setattr(bench, "measure_all", lambda: measured)
    assert bench.main(Namespace(json=True)) == 0
    assert json.loads(capsys.readouterr().out)["step_us"]["125"] == 300.5
    assert bench.main(Namespace(json=False)) == 0
    told = capsys.readouterr().out
    assert "horizon 42 at 12 ms" in told
    assert "21.3 times real time" in told
