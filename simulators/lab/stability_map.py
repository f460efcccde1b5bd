"""Stability map of a contact: car mode by mass, damping and mount, after a kick of the body.

``python -m linemate.simulators.lab.stability_map --cycle-ms 12 --json > FILE``

Invariants:
    A case is the real step against ``two_bodies``, which has no formula of ``plants``.
    An amplitude is half of the largest side of the box that the hub's motion fills in a window.
    A case that exceeds the breaking force is cut off and counts as growing.
"""

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.simulators.judge.table import aligned
from linemate.simulators.lab.two_bodies import (
    CarMode,
    ContactTrace,
    TwoBodies,
    TwoBodyCell,
    approached,
    kicked,
)
from linemate.simulators.lab.worker_pool import progress_bar, spread

MASSES = (100.0, 300.0, 1000.0, 2000.0)  # modal [kg]
FREQUENCIES_HZ = (0.5, 1.0, 2.0, 3.0, 4.7, 6.0, 8.0, 10.0)  # of the body without the tool
DAMPINGS = (0.009, 0.05)  # share of critical
MOUNTS = (25e3, 50e3, 100e3)  # [N/m]
DEAD_TIME_MS = 40.0
KICK = 0.001  # amplitude of the body's motion after the kick [m]
WINDOW_S = 2.0  # holds a period of the slowest body on the softest mount
WINDOWS = 4
LARGEST_GROWTH = 1.05  # of an amplitude; less is noise
CALM_S = 3.0  # in which the daemon may prove a body firm [s]
SPEED = 0.106  # of the conveyor [m/s]
LEAST_AMPLITUDE = 0.0003  # in the last window; below it, it is noise [m]

GROWS, RISES, STABLE = "grows", "rises", "stable"


@dataclass(frozen=True, slots=True)
class BodyCase:
    """One body on one mount.

    Attributes:
        calm_s: for which the body gives way before the kick, and nothing excites it [s].
    """

    cell: TwoBodyCell
    mode: CarMode
    calm_s: float = 0.0


def cases(
    cycle_ms: float,
    dead_time_ms: float = DEAD_TIME_MS,
    mounts: Sequence[float] = MOUNTS,
    dampings: Sequence[float] = DAMPINGS,
    masses: Sequence[float] = MASSES,
    frequencies_hz: Sequence[float] = FREQUENCIES_HZ,
    line: tuple[float, float] = (SPEED, 0.0),
) -> list[BodyCase]:
    """Return the cases of one cycle, mount by mount.

    Args:
        line: speed of the conveyor [m/s], and for how long nothing excites a body [s].
    """
    speed, calm_s = line
    cells = [
        TwoBodyCell(1e-3 * cycle_ms, mount, dead_time=1e-3 * dead_time_ms, speed=speed)
        for mount in mounts
    ]
    modes = [
        CarMode(mass, frequency_hz, damping)
        for damping, mass, frequency_hz in product(dampings, masses, frequencies_hz)
    ]
    return [BodyCase(cell, mode, calm_s) for cell in cells for mode in modes]


_approached = lru_cache(maxsize=1)(approached)


def measured(case: BodyCase) -> dict[str, Any]:
    """Return what a case is and what it shows."""
    begun: TwoBodies = _approached(case.cell)
    trace = kicked(begun, case.mode, WINDOWS * WINDOW_S, KICK, case.calm_s)
    return {
        "mount": case.cell.mount,
        "damping": case.mode.damping,
        "mass": case.mode.mass,
        "frequency_hz": case.mode.frequency_hz,
        **figures(trace, case.cell.cycle_s),
    }


def figures(trace: ContactTrace, cycle_s: float) -> dict[str, Any]:
    """Return amplitudes window by window, largest force and energy, and how it ends.

    ``calm_mm`` and ``calm_n`` are amplitude and force before the kick.
    """
    length, calm = round(WINDOW_S / cycle_s), trace.calm
    amplitudes = [
        _amplitude_mm(trace.moved[begin : begin + length])
        for begin in range(calm, len(trace.times) - length // 2, length)
    ]
    broke = len(trace.times) < calm + round(WINDOWS * WINDOW_S / cycle_s)
    unkicked = {}
    if calm:
        unkicked = {
            "calm_mm": round(_amplitude_mm(trace.moved[:calm]), 3),
            "calm_n": round(float(np.linalg.norm(trace.forces[:calm], axis=1).max()), 1),
        }
    return unkicked | {
        "amplitudes_mm": [round(amplitude, 3) for amplitude in amplitudes],
        "force_n": round(float(np.linalg.norm(trace.forces, axis=1).max()), 1),
        "energy_j": round(float(trace.energies.max()), 4),
        "broke": broke,
        "ends": GROWS if broke else _ending(amplitudes),
    }


def _amplitude_mm(moved: Array) -> float:
    """Return half of the largest side of the box that the hub's motion (n, 3) fills [mm]."""
    return 1e3 * float(np.ptp(moved, axis=0).max() / 2.0)


def _ending(amplitudes_mm: Sequence[float]) -> str:
    """Compare the last window with those before it."""
    last = amplitudes_mm[-1] / LARGEST_GROWTH
    if amplitudes_mm[-1] < 1e3 * LEAST_AMPLITUDE:
        return STABLE
    if last > amplitudes_mm[0]:
        return GROWS
    return RISES if last > min(amplitudes_mm[1:-1]) else STABLE


def growth(case: Mapping[str, Any]) -> float:
    """Return the amplitude of the last window, as a share of that after the kick."""
    amplitudes = case["amplitudes_mm"]
    return float("inf") if case["broke"] else float(amplitudes[-1] / amplitudes[0])


def text(whole: Mapping[str, Any]) -> str:
    """Print a line for each mount and damping, and below it each case that is not stable."""
    cases = whole["cases"]
    head = ("mount N/mm", "damping %", "cases", GROWS, RISES, "growth", "force N", "energy J")
    lines = [
        (
            f"{mount / 1e3:g}",
            f"{100.0 * damping:g}",
            str(len(part)),
            *(str(sum(case["ends"] == ends for case in part)) for ends in (GROWS, RISES)),
            f"{max(map(growth, part)):.2f}",
            f"{max(case['force_n'] for case in part):.0f}",
            f"{max(case['energy_j'] for case in part):.3f}",
        )
        for (mount, damping), part in grouped(cases)
    ]
    return "\n".join([*aligned(head, lines), "", *map(line, filter(is_unstable, cases))])


def grouped(
    cases: Iterable[Mapping[str, Any]],
) -> list[tuple[tuple[float, float], list[Mapping[str, Any]]]]:
    """Return the cases of each mount and damping."""
    groups: dict[tuple[float, float], list[Mapping[str, Any]]] = {}
    for case in cases:
        groups.setdefault((case["mount"], case["damping"]), []).append(case)
    return list(groups.items())


def is_unstable(case: Mapping[str, Any]) -> bool:
    """Return whether a case grows or rises, or swings before it is kicked."""
    return bool(case["ends"] != STABLE or case.get("calm_mm", 0.0) > 1e3 * LEAST_AMPLITUDE)


def line(case: Mapping[str, Any]) -> str:
    """Return a case in one line."""
    amplitudes = " ".join(f"{amplitude:.2f}" for amplitude in case["amplitudes_mm"])
    if "calm_mm" in case:
        amplitudes = f"{case['calm_mm']:.2f} mm, {case['calm_n']:.0f} N unkicked, then {amplitudes}"
    return (
        f"{case['ends']}: {case['mass']:g} kg, {case['frequency_hz']:g} Hz,"
        f" {100.0 * case['damping']:g} %, {case['mount'] / 1e3:g} N/mm: {amplitudes} mm,"
        f" {case['force_n']:.0f} N, {case['energy_j']:.3f} J"
    )


def _numbers(words: str) -> tuple[float, ...]:
    return tuple(map(float, words.split(",")))


def main(words: Sequence[str] | None = None) -> int:
    """Print the map of one cycle."""
    parser = argparse.ArgumentParser(
        prog="python -m linemate.simulators.lab.stability_map", description=__doc__
    )
    parser.add_argument("--cycle-ms", type=float, default=12.0)
    parser.add_argument("--dead-time-ms", type=float, default=DEAD_TIME_MS)
    parser.add_argument("--mounts", type=_numbers, default=MOUNTS, help="N/m, by commas")
    parser.add_argument("--dampings", type=_numbers, default=DAMPINGS, help="shares of critical")
    parser.add_argument("--masses", type=_numbers, default=MASSES, help="kg")
    parser.add_argument("--frequencies", type=_numbers, default=FREQUENCIES_HZ, help="Hz")
    parser.add_argument("--speed", type=float, default=SPEED, help="of the conveyor, m/s")
    parser.add_argument(
        "--calm-s", type=float, default=0.0, help=f"before the kick; {CALM_S:g} s after the touch"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="print every case")
    args = parser.parse_args(words)
    chosen = cases(
        args.cycle_ms,
        args.dead_time_ms,
        args.mounts,
        args.dampings,
        args.masses,
        args.frequencies,
        (args.speed, args.calm_s),
    )
    with progress_bar(len(chosen), "cases") as progress:
        measured_cases = spread(measured, chosen, args.workers, progress)
    whole = {
        "cycle_ms": args.cycle_ms,
        "dead_time_ms": args.dead_time_ms,
        "kick_mm": 1e3 * KICK,
        "speed": args.speed,
        "calm_s": args.calm_s,
        "window_s": WINDOW_S,
        "cases": measured_cases,
    }
    print(json.dumps(whole, indent=1) if args.json else text(whole))
    return 0


if __name__ == "__main__":
    sys.exit(main())
