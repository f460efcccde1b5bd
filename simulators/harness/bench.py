"""`linemate-sim bench`: what a step costs here, and how fast virtual time runs.

Law of the file: measurements that are compared are taken in turns within one run, round by round,
after a warm-up; a figure is the median over rounds, because a machine's floor is not stable. Every
measurement is a `Job`; a figure that needs another process (the turn-around beside a C echo)
becomes one more job.
"""

from __future__ import annotations

import argparse
import gc
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from linemate.daemon.inputs import Inputs
from linemate.daemon.parameters import Parameters
from linemate.daemon.service.cycle import LogEntry
from linemate.daemon.step import State, initial, step
from linemate.simulators.harness import host, report_json, setup
from linemate.simulators.harness.lockstep import Lockstep
from linemate.simulators.harness.table import aligned

ROUNDS: Final = 5
HORIZONS: Final = {42: 0.012, 125: 0.004, 500: 0.004}
"""Steps of horizon and the cycle [s]: half a second at 12 and at 4 ms, and 2 s at 4 ms."""

VIRTUAL: Final = "virtual_times_realtime"
BEGIN_S: Final = 2.0
LEAST_STEPS: Final = 150
LEAD_IN_CYCLES: Final = 300


@dataclass(frozen=True, slots=True)
class Job:
    """One measurement: `measure()` gives one round's figure, and is called in turns.

    Attributes:
        name: key of its figure.
        measure: runs one round.
    """

    name: str
    measure: Callable[[], float]


def interleaved(jobs: Sequence[Job], rounds: int = ROUNDS, warm: int = 1) -> dict[str, float]:
    """Measure all jobs in turns, and take the median of each over the rounds.

    Args:
        jobs: in the order of measuring; every second round goes backwards, so that a drift of
            the machine favours none.
        rounds: that count.
        warm: rounds before them that do not.
    """
    taken: dict[str, list[float]] = {job.name: [] for job in jobs}
    for number in range(-warm, rounds):
        for job in jobs if number % 2 == 0 else reversed(jobs):
            figure = job.measure()
            if number >= 0:
                taken[job.name].append(figure)
    return {name: statistics.median(figures) for name, figures in taken.items()}


@dataclass(frozen=True, slots=True)
class Tape:
    """Steps to be measured: a state in mid-approach, and the inputs that followed it."""

    parameters: Parameters
    state: State
    inputs: tuple[Inputs, ...]


def record(horizon: int, cycle_s: float) -> Tape:
    """Run into the approach in virtual time, and keep what the daemon was given.

    The step is pure: the state before the window is found again by replaying the inputs, and
    every round can begin from it.

    Args:
        horizon: steps that control looks ahead.
        cycle_s: T0 [s].
    """
    made = setup.make("wheel", cycle_ms=1e3 * cycle_s)
    control = replace(made.control, horizon_s=horizon * cycle_s)
    scenario = replace(
        made.scenario,
        lead_in_s=max(1.0, LEAD_IN_CYCLES * cycle_s),
        duration_s=BEGIN_S + max(1.0, LEAST_STEPS * cycle_s),
    )
    entries: list[LogEntry] = []
    run = Lockstep(
        replace(made, scenario=scenario, control=control), seed=0, on_step=entries.append
    )
    while run.turn():
        pass
    if entries[-1].state != "track":
        raise RuntimeError(f"the bench's run is not in its approach but in {entries[-1].state}")
    parameters, robot = run.cycle.parameters, entries[0].inputs.robot
    if robot is None:
        raise RuntimeError("the bench's run began without a telegram")
    first = round((scenario.lead_in_s + BEGIN_S) / cycle_s)
    state = initial(parameters, robot)
    for entry in entries[:first]:
        state, _ = step(state, entry.inputs, parameters)
    return Tape(parameters, state, tuple(entry.inputs for entry in entries[first:]))


def step_job(horizon: int, cycle_s: float) -> Job:
    """Make a job that gives the median computing time of a step [us]."""
    tape = record(horizon, cycle_s)

    def measure() -> float:
        state, spent = tape.state, []
        for inputs in tape.inputs:
            before = time.perf_counter_ns()
            state, _ = step(state, inputs, tape.parameters)
            spent.append(time.perf_counter_ns() - before)
        return statistics.median(spent) * 1e-3

    return Job(str(horizon), measure)


def virtual_job(name: str) -> Job:
    """Make a job that gives virtual time as a multiple of real time: one whole run, 12 ms."""
    made = setup.make("wheel", cycle_ms=12.0)

    def measure() -> float:
        run = Lockstep(made, seed=0)
        before_s, before_ns = run.world.time_s, time.perf_counter_ns()
        while run.turn():
            pass
        return (run.world.time_s - before_s) / (1e-9 * (time.perf_counter_ns() - before_ns))

    return Job(name, measure)


def measure_all(rounds: int = ROUNDS) -> dict[str, Any]:
    """Measure everything, and return what `bench --json` prints."""
    jobs = [step_job(horizon, cycle_s) for horizon, cycle_s in HORIZONS.items()]
    jobs.append(virtual_job(VIRTUAL))
    gc.collect()
    figures = interleaved(jobs, rounds)
    return {
        "version": 1,
        "machine": host.machine(),
        "rounds": rounds,
        "step_us": {str(n): round(figures[str(n)], 1) for n in HORIZONS},
        VIRTUAL: round(figures[VIRTUAL], 2),
    }


def plain(result: Mapping[str, Any]) -> str:
    """Print a result as text."""
    told = result["machine"]
    real_time = "granted" if told["real_time"] else "not granted"
    lines = [
        f"{told['processor']}, {told['cores']} cores, Linux {told['kernel']}, "
        f"Python {told['python']}, load {told['load_1min']}, real-time rights {real_time}",
        f"medians over {result['rounds']} interleaved rounds, one thread",
        "",
    ]
    rows = [
        (f"a step, horizon {name} at {1e3 * HORIZONS[int(name)]:g} ms", f"{value:.0f} us")
        for name, value in result["step_us"].items()
    ]
    rows.append(("virtual time, whole system", f"{result[VIRTUAL]:.1f} times real time"))
    return "\n".join(lines + aligned(("figure", "here"), rows))


def main(args: argparse.Namespace) -> int:
    """Measure and print: `--json`, or a table.

    Returns:
        0; a bench judges nothing.
    """
    result = measure_all()
    print(report_json.text(result) if args.json else plain(result))
    return 0
