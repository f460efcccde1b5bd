"""Stability map of a contact: car mode by mass, damping, mount and cycle, as JSON.

``python -m linemate.simulators.lab.stability_map --cycle-ms 12 > FILE``
"""

import argparse
import json
from itertools import product
from typing import Any

import numpy as np

from linemate.simulators.lab.two_bodies import CarMode, Cell, Trace, TwoBodies, approached, kicked

MASSES = (100.0, 300.0, 1000.0, 2000.0)  # modal [kg]
FREQUENCIES_HZ = (0.5, 1.0, 2.0, 3.5, 4.7, 7.0, 10.0)  # of the body without the tool
DAMPINGS = (0.005, 0.05)
MOUNTS = (25e3, 50e3, 100e3)  # [N/m]
KICK = 0.001  # amplitude of the body's motion after the kick [m]
SECONDS = 6.0
LARGEST_GROWTH = 1.05  # of the amplitude from the third to the last second; above it, it grows
LEAST_AMPLITUDE = 0.0003  # at the end; below it, it is noise [m]


def figures(trace: Trace, cycle_s: float) -> dict[str, Any]:
    """Return what a case shows: amplitudes, growth, largest force, energy."""
    second = round(1.0 / cycle_s)
    ended = len(trace.times) < round(SECONDS / cycle_s)
    middle = float(np.ptp(trace.moved[2 * second : 3 * second], axis=0).max() / 2.0)
    last = float(np.ptp(trace.moved[-second:], axis=0).max() / 2.0)
    grows = ended or (last > LEAST_AMPLITUDE and last > LARGEST_GROWTH * middle)
    return {
        "third_mm": round(1e3 * middle, 3),
        "last_mm": round(1e3 * last, 3),
        "force_n": round(float(np.linalg.norm(trace.forces, axis=1).max()), 1),
        "energy_j": round(float(trace.energies.max()), 4),
        "classes": sum(not event.startswith(("push", "osc")) for _, event in trace.events),
        "pushes": sum(event == "push confirmed" for _, event in trace.events),
        "grows": bool(grows),
    }


def cases(begun: TwoBodies) -> list[dict[str, Any]]:
    """Return the figures of every body on one mount."""
    found = []
    for mass, frequency_hz, damping in product(MASSES, FREQUENCIES_HZ, DAMPINGS):
        trace = kicked(begun, CarMode(mass, frequency_hz, damping), SECONDS, KICK)
        case = {"mass": mass, "frequency_hz": frequency_hz, "damping": damping}
        mount = {"mount": begun.cell.mount}
        found.append(case | mount | figures(trace, begun.cell.cycle_s))
    return found


def main() -> None:
    """Print the map of one cycle."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycle-ms", type=float, default=12.0)
    parser.add_argument("--dead-time-ms", type=float, default=40.0)
    chosen = parser.parse_args()
    found = []
    for mount in MOUNTS:
        cell = Cell(1e-3 * chosen.cycle_ms, mount, dead_time=1e-3 * chosen.dead_time_ms)
        found += cases(approached(cell))
    plain = {
        "cycle_ms": chosen.cycle_ms,
        "dead_time_ms": chosen.dead_time_ms,
        "kick_mm": 1e3 * KICK,
    }
    print(json.dumps(plain | {"cases": found}, indent=1))


if __name__ == "__main__":
    main()
