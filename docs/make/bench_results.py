"""Tables of docs/performance.md: step, turn-around, processor time, start, and what falls short."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from docs.make.figures import number
from linemate.simulators.lab.bench import bench_start

Figures = Mapping[str, Any]
Load = Callable[[str], Figures]


def step(load: Load) -> str:
    """Return the table of docs/performance.md."""
    timed = load("bench")
    lines = [_host(timed["machine"], "measured"), "|---|---|"]
    lines += [f"| one step, horizon {n} | {number(us)} us |" for n, us in timed["step_us"].items()]
    speed = number(timed["virtual_times_realtime"])
    return "\n".join([*lines, f"| a run in virtual time | {speed} times real time |"])


WANTED = {
    ("4ms", "p50_ratio"): (1.2, 1.3),
    ("4ms", "p99_ratio"): (1.45, 1.45),
    ("4ms", "inline"): (6.0,),
    ("2ms", "answered"): (99.95, 99.95),
}
"""What is wanted of a figure of the turn-around, idle and loaded: ratios at most, % at least."""

NAMES = {
    "p50_ratio": "reply by echo, p50",
    "p99_ratio": "reply by echo, p99",
    "inline": "not prepared, p50",
    "answered": "answered in their cycle",
}


def turnaround(load: Load) -> str:
    """Return the table of replies next to those of a C echo."""
    timed = load("turnaround")
    cycles = timed["turnaround"]
    columns = [
        f"{cycle.replace('ms', ' ms')}, {mode}" for cycle in cycles for mode in ("idle", "loaded")
    ]
    lines = [_host(timed["machine"], " | ".join(columns)), "|---" * (1 + len(columns)) + "|"]
    for name, text in NAMES.items():
        cells = [_reply(name, mode) for modes in cycles.values() for mode in _modes(name, modes)]
        lines.append(f"| {text} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _modes(name: str, modes: Figures) -> tuple[Figures | None, Figures | None]:
    """Return the rounds of a figure, idle and loaded; in line there are idle ones only."""
    return (modes["inline"], None) if name == "inline" else (modes["idle"], modes["loaded"])


def _value(name: str, mode: Figures) -> float:
    """Return a ratio to the echo, or the share of telegrams answered in their cycle [%]."""
    if name == "answered":
        return 100.0 * (1.0 - float(mode["late"]) / float(mode["cycles"]))
    return float(mode["p50_ratio" if name == "inline" else name])


def _limit(name: str, value: float) -> str:
    return f"{value:.4g} %" if name == "answered" else f"{value:.3g}"


def _reply(name: str, mode: Figures | None) -> str:
    """Return a figure, and of a ratio the times that it compares."""
    if mode is None:
        return ""
    shown = _limit(name, _value(name, mode))
    if name == "answered":
        return shown
    rank = "p99" if name == "p99_ratio" else "p50"
    return f"{shown} ({mode[f'{rank}_us']:.0f}/{mode[f'echo_{rank}_us']:.0f} us)"


def missed_turnarounds(cycles: Figures) -> Iterator[tuple[str, str, str]]:
    """Yield label, figure and limit of each turn-around that falls short."""
    for (cycle, name), limits in WANTED.items():
        for load, mode, limit in zip(
            ("idle", "loaded"), _modes(name, cycles[cycle]), limits, strict=False
        ):
            if mode is None:
                continue
            value = _value(name, mode)
            if value < limit if name == "answered" else value > limit:
                label = f"{cycle.replace('ms', ' ms')}, {load}: {NAMES[name]}"
                yield label, _limit(name, value), _limit(name, limit)


def _host(machine: Figures, columns: str) -> str:
    """Return the head of a table with the machine that measured it."""
    host = (
        f"{machine['processor']}, {machine['cores']} cores, Linux {machine['kernel']},"
        f" Python {machine['python']}, load {number(machine['load_1min'])}"
    )
    return f"| {host} | {columns} |"


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
    missed = missed_turnarounds(load("turnaround")["turnaround"])
    starts = zip(bench_start.rows(load("start")["start"]), STARTS, strict=True)
    slow = [(*row, wanted) for row, wanted in starts if wanted and _first(row[1]) > _first(wanted)]
    lines = [
        f"| {name} | {value} | {wanted} |" for name, value, wanted in (*reached, *missed, *slow)
    ]
    return "\n".join(["| figure | reached | wanted |", "|---|---|---|", *lines])


def _first(text: str) -> float:
    return float(text.partition(" ")[0])
