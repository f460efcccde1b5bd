"""``linemate-sim bench``: turn-around, lateness and computing time next to a bare echo.

A ``BenchJob`` computes in this process; ``bench_turnaround`` measures with processes.

Invariants:
    Compared measurements take turns, round by round, after a warm-up.
    A figure is the median over rounds.
"""

from __future__ import annotations

import argparse
import gc
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step import initial, step
from linemate.daemon.core.step_state import StepState
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.operator import doctor
from linemate.daemon.service.host.idle_spinner import IdleSpinner
from linemate.daemon.transport.client import NoAnswerError, RefusedError
from linemate.simulators.harness import host, setup
from linemate.simulators.harness.lockstep import Lockstep
from linemate.simulators.harness.processes import ChildError, interruptible
from linemate.simulators.judge import report_json
from linemate.simulators.judge.table import DASH, aligned, number
from linemate.simulators.lab.bench import (
    bench_cpu,
    bench_floor,
    bench_start,
    bench_trace,
    bench_turnaround,
)
from linemate.simulators.lab.bench.bench_trace import StationTrace
from linemate.simulators.lab.bench.bench_turnaround import MOVING, Bench, Measured

ROUNDS: Final = 5
HORIZONS: Final = {42: 0.012, 125: 0.004, 500: 0.004}
"""Steps of horizon and the cycle [s]: half a second at 12 and at 4 ms, and 2 s at 4 ms."""

CYCLES_MS: Final = (12, 4, 2, 1)
CPU_CYCLE_MS: Final = 4
PARTS: Final = ("turnaround", "wakeup", "step", "virtual")
LEAD_IN_S: Final = 2.5
VIRTUAL: Final = "virtual_times_realtime"
TURNAROUND_HEAD: Final = (
    "cycle", "mode", "p50 us", "echo", "p99 us", "echo", "p50 ratio", "p99 ratio", "late",
    "unexplained", "echo late", "cycles", "prepared %",
)  # fmt: skip
COUNTS: Final = ("late", "late_unexplained", "echo_late", "cycles")
ECHOES: Final = {"c": "a bare C echo", "python": "a blocking Python echo (no C compiler here)"}
EX_UNAVAILABLE: Final = 69
BEGIN_S: Final = 2.0
LEAST_STEPS: Final = 150
LEAD_IN_CYCLES: Final = 300


@dataclass(frozen=True, slots=True)
class BenchJob:
    """One measurement: `measure()` gives one round's figure, and is called in turns.

    Attributes:
        name: key of its figure.
    """

    name: str
    measure: Callable[[], float]


def interleaved(jobs: Sequence[BenchJob], rounds: int = ROUNDS, warm: int = 1) -> dict[str, float]:
    """Measure all jobs in turns, and take the median of each over the rounds.

    Args:
        jobs: in the order of measuring; every second round goes backwards, so that a drift of
            the machine favours none.
        warm: rounds before them that do not.
    """
    taken: dict[str, list[float]] = {job.name: [] for job in jobs}
    for turn in range(-warm, rounds):
        for job in jobs if turn % 2 == 0 else reversed(jobs):
            figure = job.measure()
            if turn >= 0:
                taken[job.name].append(figure)
    return {name: statistics.median(figures) for name, figures in taken.items()}


@dataclass(frozen=True, slots=True)
class StepTrace:
    """Steps to be measured: a state in mid-approach, and the inputs that followed it."""

    parameters: Parameters
    state: StepState
    inputs: tuple[Inputs, ...]


def record(horizon: int, cycle_s: float) -> StepTrace:
    """Run into the approach in virtual time, and keep what the daemon was given.

    The step is pure: the state before the window is found again by replaying the inputs, and
    every round can begin from it.

    Args:
        horizon: steps that control looks ahead.
    """
    run_setup = setup.make("wheel", cycle_ms=1e3 * cycle_s)
    control = replace(run_setup.control, horizon_s=horizon * cycle_s)
    scenario = replace(
        run_setup.scenario,
        lead_in_s=max(1.0, LEAD_IN_CYCLES * cycle_s),
        duration_s=BEGIN_S + max(1.0, LEAST_STEPS * cycle_s),
    )
    entries: list[LogEntry] = []
    run = Lockstep(
        replace(run_setup, scenario=scenario, control=control), seed=0, on_step=entries.append
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
    return StepTrace(parameters, state, tuple(entry.inputs for entry in entries[first:]))


def step_job(horizon: int, cycle_s: float) -> BenchJob:
    """Make a job that gives the median computing time of a step [us]."""
    trace = record(horizon, cycle_s)

    def measure() -> float:
        state, spent = trace.state, []
        for inputs in trace.inputs:
            before = time.perf_counter_ns()
            state, _ = step(state, inputs, trace.parameters)
            spent.append(time.perf_counter_ns() - before)
        return statistics.median(spent) * 1e-3

    return BenchJob(str(horizon), measure)


def virtual_job(name: str) -> BenchJob:
    """Make a job that gives virtual time as a multiple of real time: one whole run, 12 ms."""
    run_setup = setup.make("wheel", cycle_ms=12.0)

    def measure() -> float:
        run = Lockstep(run_setup, seed=0)
        before_s, before_ns = run.world.time_s, time.perf_counter_ns()
        while run.turn():
            pass
        return (run.world.time_s - before_s) / (1e-9 * (time.perf_counter_ns() - before_ns))

    return BenchJob(name, measure)


@dataclass(frozen=True, slots=True)
class Options:
    """What to measure.

    Attributes:
        round_s: how long one of turn-around or lateness is [s].
        cycles_ms: cycles that are measured [ms].
        idle_spinner: keep the cores from sleeping while processes are measured.
    """

    rounds: int = ROUNDS
    round_s: float = 0.6
    cycles_ms: tuple[int, ...] = CYCLES_MS
    parts: tuple[str, ...] = PARTS
    idle_spinner: bool = False


def measure_all(options: Options) -> dict[str, Any]:
    """Measure everything, and return what `bench --json` prints."""
    result: dict[str, Any] = {
        "version": 1,
        "machine": host.machine(),
        "rounds": options.rounds,
        "notes": [],
    }
    if {"turnaround", "wakeup"} & set(options.parts):
        idle_spinner = IdleSpinner(os.sched_getaffinity(0) if options.idle_spinner else ())
        with closing(idle_spinner), tempfile.TemporaryDirectory(prefix="linemate-bench-") as name:
            _measure_processes(options, Path(name), result)
    jobs = []
    if "step" in options.parts:
        jobs += [step_job(horizon, cycle_s) for horizon, cycle_s in HORIZONS.items()]
    if "virtual" in options.parts:
        jobs.append(virtual_job(VIRTUAL))
    gc.collect()
    figures = interleaved(jobs, options.rounds)
    if "cpu" in options.parts:
        result["cpu"] = bench_cpu.measure(options.cycles_ms)
    if "start" in options.parts:
        result["start"] = bench_start.measure()
    if "step" in options.parts:
        result["step_us"] = {str(n): round(figures[str(n)], 1) for n in HORIZONS}
    if "virtual" in options.parts:
        result[VIRTUAL] = round(figures[VIRTUAL], 2)
    return result


def _measure_processes(options: Options, folder: Path, result: dict[str, Any]) -> None:
    """Measure what needs processes, and put it into the result."""
    refused = host.missing_rights()
    program = bench_floor.compiled(folder)
    if options.idle_spinner:
        result["notes"].append("no core sleeps: --no-awake lets them")
    if refused is not None:
        result["notes"].append(f"no real-time priority for anybody: {refused}")
    if program is None:
        result["notes"].append(
            "no C compiler: the echo is a blocking Python program, there is no probe and no timer"
        )
    bench = Bench(
        folder / "trace.json", program, folder, refused is None, options.rounds, options.round_s,
        tuple(sorted(os.sched_getaffinity(0))),
    )  # fmt: skip
    result["echo"] = "python" if program is None else "c"
    result["fifo"] = bench.fifo
    if "turnaround" in options.parts:
        record_trace().write(bench.trace)
        starts = []
        result["turnaround"] = {}
        for cycle_ms in options.cycles_ms:
            ready = bench_turnaround.measure(bench, 1000 * cycle_ms, prepared=True)
            inline = bench_turnaround.measure(
                bench, 1000 * cycle_ms, prepared=False, modes=("idle",)
            )
            result["notes"] += _resting(f"{cycle_ms} ms", ready)
            result["notes"] += _resting(f"{cycle_ms} ms, in line", inline)
            starts += [ready.start_s, inline.start_s]
            result["turnaround"][f"{cycle_ms}ms"] = {
                **ready.modes, "inline": inline.modes["idle"],
                "cpu_per_cycle_us": ready.cpu_per_cycle_us,
            }  # fmt: skip
            if cycle_ms == CPU_CYCLE_MS or "cpu_per_cycle_us" not in result:
                result["cpu_per_cycle_us"] = ready.cpu_per_cycle_us
        result["start_s"] = statistics.median(starts)
    if "wakeup" in options.parts:
        result["wakeup"] = bench_turnaround.wakeup(bench)


def _resting(name: str, measured: Measured) -> Iterator[str]:
    """Say that the daemon did not move the robot, for its steps are cheaper then."""
    if measured.state not in MOVING:
        yield f"{name}: too much for this machine; the daemon answers but is in {measured.state}"


def record_trace() -> StationTrace:
    """Run the assembly in virtual time until contact, and keep its readings.

    The played robot stands free where the recorded one was in contact. It got no image there, so
    that the daemon would hold the robot from then on.
    """
    run_setup = setup.make("wheel", cycle_ms=12.0)
    scenario = replace(run_setup.scenario, lead_in_s=LEAD_IN_S)
    entries: list[LogEntry] = []
    run = Lockstep(replace(run_setup, scenario=scenario), seed=0, on_step=entries.append)
    while run.turn() and run.cycle.machine.state is not State.CONTACT:
        pass
    return bench_trace.from_entries(entries)


def plain(result: Mapping[str, Any]) -> str:
    """Print a result as text."""
    machine = result["machine"]
    real_time = "granted" if machine["real_time"] else "not granted"
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, Linux {machine['kernel']}, "
        f"Python {machine['python']}, load {machine['load_1min']}, real-time rights {real_time}",
        f"medians over {result['rounds']} interleaved rounds",
        *(f"note: {note}" for note in result["notes"]),
    ]
    if "turnaround" in result:
        lines += ["", f"Turn-around at the controller, next to {ECHOES[result['echo']]}"]
        lines += aligned(TURNAROUND_HEAD, list(_turnaround_rows(result["turnaround"])))
    rows = list(_rows(result))
    if rows:
        lines += ["", *aligned(("figure", "here"), rows)]
    if "cpu" in result:
        lines += ["", "Processor time and memory of the daemon in a live assembly"]
        lines += aligned(bench_cpu.HEAD, list(bench_cpu.rows(result["cpu"])))
    if "start" in result:
        lines += ["", *aligned(bench_start.HEAD, list(bench_start.rows(result["start"])))]
    return "\n".join(lines)


def _turnaround_rows(turnaround: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for cycle, modes in turnaround.items():
        for mode in (*bench_turnaround.MODES, "inline"):
            figures = modes[mode]
            names = ("p50_us", "echo_p50_us", "p99_us", "echo_p99_us")
            yield (
                cycle,
                mode,
                *(number(figures[name], 0) for name in names),
                number(figures["p50_ratio"]),
                number(figures["p99_ratio"]),
                *(number(figures[name]) for name in COUNTS),
                number(100.0 * figures["prepared"], 1) if figures["prepared"] is not None else DASH,
            )


def _rows(result: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    wakeup = result.get("wakeup")
    if wakeup:
        yield "the clock's wake, p99", f"{wakeup['p99_us']:.0f} us"
        yield "a C timer's wake, p99", f"{wakeup['c_p99_us']:.0f} us"
        yield "ratio, median of rounds", f"{wakeup['p99_ratio']:.2f}"
    if "cpu_per_cycle_us" in result:
        yield "processor time a cycle", f"{result['cpu_per_cycle_us']:.0f} us"
        yield "start to ready", f"{result['start_s']:.2f} s"
    for name, value in result.get("step_us", {}).items():
        yield f"a step, horizon {name} at {1e3 * HORIZONS[int(name)]:g} ms", f"{value:.0f} us"
    if VIRTUAL in result:
        yield "virtual time, whole system", f"{result[VIRTUAL]:.1f} times real time"


def main(args: argparse.Namespace) -> int:
    """Measure and print: `--json`, or a table.

    Returns:
        0; a bench judges nothing. 69 when it could not be brought to its end.
    """
    idle_spinner = (
        doctor.is_virtual(doctor.Host()) if args.idle_spinner is None else args.idle_spinner
    )
    options = Options(args.rounds, args.round_s, args.cycles, args.parts, idle_spinner)
    try:
        with interruptible():
            result = measure_all(options)
    except (ChildError, NoAnswerError, RefusedError, TimeoutError) as error:
        print(f"linemate-sim bench: {error}", file=sys.stderr)
        return EX_UNAVAILABLE
    if args.plot is not None:
        from linemate.simulators.lab.bench import bench_plot

        bench_plot.draw(result, args.plot)
    print(report_json.text(result) if args.json else plain(result))
    return 0
