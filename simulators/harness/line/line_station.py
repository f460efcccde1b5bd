"""The station of a shift: five variants of the shipped task, and cars without a fault.

Invariants:
- The daemon's sections have the variants' files and where a car is announced, and nothing else of
  the plant.
"""

import random
from functools import cache
from pathlib import Path
from typing import Any, Final

from linemate.daemon.config import task_file
from linemate.simulators import harness
from linemate.simulators.devices.line.cars import Car, LinePlan
from linemate.simulators.plants.conveyor_plan import ConveyorEvent
from linemate.simulators.plants.scenario import Vector3

FOLDER: Final = Path(harness.__path__[0]) / "data" / "shift"
STATION: Final = FOLDER / "station.yaml"
VARIANTS: Final = ("sedan", "coupe", "wagon", "suv", "van")
ENTRY_S: Final = 6.0  # a car enters this long before the start position [s]
SPEED: Final = 0.106  # of the line [m/s]


@cache
def hubs() -> dict[str, Vector3]:
    """Return the nominal hub of each variant in base [m]."""
    tasks = {name: task_file.load(FOLDER / f"{name}.yaml") for name in VARIANTS}
    return {name: task.file.object.nominal.position for name, task in tasks.items()}


def daemon_sections(records: str) -> dict[str, Any]:
    """Return the sections of the daemon's file.

    Args:
        records: directory of the quality records.
    """
    return {
        "task": str(FOLDER / "sedan.yaml"),
        "production": {
            "variants": {name: str(FOLDER / f"{name}.yaml") for name in VARIANTS},
            "window": {"start": -0.6, "latest_start": -0.05, "abort": 2.6},
            "announced_at": -ENTRY_S * SPEED,
            "records": records,
        },
    }


def plan(cars: int, seed: int, takt_s: float) -> LinePlan:
    """Return cars of all variants; every second one has a stop of the line.

    Args:
        takt_s: from one car to the next at least [s].
    """
    chance = random.Random(seed)  # noqa: S311 - a plan, not a secret
    drawn = []
    for number in range(cars):
        events: tuple[ConveyorEvent, ...] = ()
        if number % 2:
            stop_s = round(chance.uniform(2.0, 10.0), 3)
            start = ConveyorEvent("start", round(stop_s + 3.0, 3), 0.013)
            events = (ConveyorEvent("stop", stop_s, 0.104), start)
        variant = VARIANTS[(number + seed) % len(VARIANTS)]
        drawn.append(Car(f"D{seed}-{number + 1:03d}", variant, chance.randrange(2**31), events))
    return LinePlan(tuple(drawn), hubs(), takt_s, ENTRY_S, first_s=3.0, last_s=30.0)
