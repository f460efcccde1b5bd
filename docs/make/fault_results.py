"""Tables of faults: the campaign, the catalogue's rows, the cell without a force-torque sensor."""

from collections.abc import Callable
from typing import Any

from docs.make.figures import number

Result = dict[str, Any]
Load = Callable[[str], Result]

COMMANDS = {
    "faults": "python -m linemate.simulators.lab.faults.dst 20000:30000 --every --seconds 60"
    " --workers 1 --forget --json",
    "no-force": "python -m docs.make.no_force",
    "catalogue": "python -m docs.make.catalogue",
    "floods": "python tests/floods.py --json",
}


def whole(raw: Result) -> Result:
    """Return the counts as they were printed."""
    return raw


def campaigns(load: Load) -> str:
    """Return a row for each cycle and cell, and what was violated."""
    lines = ["| cell | cycle, ms | seeds | runs | violations | largest force of the others, N |"]
    lines += ["|---" * 6 + "|"]
    violated = []
    for row in load("faults")["campaigns"]:
        failed = row["violations"]
        cells = (row["cell"], row["cycle_ms"], row["seeds"], row["runs"], len(failed))
        lines.append(f"| {' | '.join(map(str, cells))} | {row['force_n']:.0f} |")
        violated += [
            f"| {row['cell']}, {row['cycle_ms']} ms, {run['seed']} | {run['what'][0]} |"
            for run in failed
        ]
    if violated:
        lines += ["", "| cell, cycle, seed | violation |", "|---|---|", *violated]
    return "\n".join(lines)


def no_force(load: Load) -> str:
    """Return the largest force at the mount for each kind of trouble."""
    lines = ["| trouble | runs | largest force at the mount | violations |", "|---" * 4 + "|"]
    for row in load("no-force")["rows"]:
        force, count = f"{row['force_n']:.0f} N", row["violations"]
        lines.append(f"| {row['row']} | {row['runs']} | {force} | {count} |")
    return "\n".join(lines)


def catalogue(load: Load) -> str:
    """Return the figures of the catalogue's rows, each next to the bound of its test."""
    lines = ["| id | its test says | figure | runs | measured | bound |", "|---" * 6 + "|"]
    for row in load("catalogue")["rows"]:
        figures = f"{row['count']} | {number(row['measured'])} | {number(row['most'])}"
        lines.append(f"| {row['row']} | {row['test']} | {row['what']} | {figures} |")
    return "\n".join(lines)


def floods(load: Load) -> str:
    """Return a row for each flooded port: what the robot missed, and what else came through."""
    lines = ["| port | datagrams | telegrams | missed | good poses taken | a status after, ms |"]
    lines += ["|---" * 6 + "|"]
    for row in load("floods")["rows"]:
        poses = f"{row['samples']} of {row['poses']}"
        status_ms = "-" if row["answered_s"] is None else number(1e3 * row["answered_s"])
        cells = (row["port"], row["sent"], row["cycles"], row["missed"], poses, status_ms)
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)
