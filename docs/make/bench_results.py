"""Tables of docs/performance.md: step, turn-around, processor time, start, and what falls short."""

from collections.abc import Callable, Iterable
from typing import Any

from docs.make.figures import number
from linemate.simulators.lab.bench import bench_start

Load = Callable[[str], dict[str, Any]]


def step(load: Load) -> str:
    """Return the table of docs/performance.md."""
    timed = load("bench")
    machine = timed["machine"]
    host = (
        f"{machine['processor']}, {machine['cores']} cores, Linux {machine['kernel']},"
        f" Python {machine['python']}, load {number(machine['load_1min'])}"
    )
    lines = ["| figure | measured |", "|---|---|", f"| machine | {host} |"]
    lines += [f"| one step, horizon {n} | {number(us)} us |" for n, us in timed["step_us"].items()]
    speed = number(timed["virtual_times_realtime"])
    return "\n".join([*lines, f"| a run in virtual time | {speed} times real time |"])


def by_part(load: Load) -> str:
    """Return the table of processor time and memory by part of docs/performance.md."""
    timed = load("cpu")
    runs = {cycle: run for cycle, run in timed["cpu"].items() if "failed" not in run}
    parts = {part for run in runs.values() for part in run["parts_us"]}
    first = next(iter(runs.values()))

    def line(name: str, values: Iterable[float | None]) -> str:
        cells = " | ".join("" if value is None else str(round(value)) for value in values)
        return f"| {name} | {cells} |"

    load_1min = number(timed["machine"]["load_1min"])
    lines = [
        f"| part, load {load_1min} | {' | '.join(cycle.replace('ms', ' ms') for cycle in runs)} |",
        "|---|" + "---|" * len(runs),
        line("processor time a cycle [us]", (run["all_us"] for run in runs.values())),
    ]
    lines += [
        line(part, (run["parts_us"].get(part) for run in runs.values()))
        for part in sorted(parts, key=lambda part: -first["parts_us"].get(part, 0.0))
    ]
    memory = "resident memory [MiB]"
    lines.append(line(memory, (sum(run["memory_mib"].values()) for run in runs.values())))
    lines += [
        line(part, (run["memory_mib"].get(part) for run in runs.values()))
        for part in sorted(first["memory_mib"], key=lambda part: -first["memory_mib"][part])
    ]
    return "\n".join(lines)


STARTS = ("", "1.0 s", "", "1.5 s", "60 ms", "5 %", "", "5 %", "5 %")
"""What is wanted of each row of ``bench_start.rows``."""


def by_start(load: Load) -> str:
    """Return the table of start, restart and rest of docs/performance.md."""
    timed = load("start")
    lines = [
        f"| figure, load {number(timed['machine']['load_1min'])} | measured | wanted |",
        "|---|---|---|",
    ]
    lines += [
        f"| {name} | {value} | {wanted} |"
        for (name, value), wanted in zip(bench_start.rows(timed["start"]), STARTS, strict=True)
    ]
    return "\n".join(lines)


def by_shortfall(load: Load) -> str:
    """Return the table of what falls short in docs/performance.md, from the other results."""
    timed = load("bench"), load("cpu")["cpu"]["4ms"]
    reached = (
        ("a run in virtual time, by real time", number(timed[0]["virtual_times_realtime"]), "25"),
        (
            "processor time a cycle at 4 ms, in an assembly",
            f"{number(1e-3 * (timed[1]['all_us'] - timed[1]['measurement_us']))} ms",
            "0.75 ms",
        ),
    )
    starts = zip(bench_start.rows(load("start")["start"]), STARTS, strict=True)
    slow = [(*row, wanted) for row, wanted in starts if wanted and _first(row[1]) > _first(wanted)]
    lines = [f"| {name} | {value} | {wanted} |" for name, value, wanted in (*reached, *slow)]
    return "\n".join(["| figure | reached | wanted |", "|---|---|---|", *lines])


def _first(text: str) -> float:
    return float(text.partition(" ")[0])
