"""Plan of a shift: variants, stops of the line and faults, drawn from one seed.

Invariants:
- One seed gives one plan.
- Each car has at most one fault.
"""

import random

from linemate.simulators.devices.line.cars import Car, CarFault
from linemate.simulators.harness.line.line_station import LineStation
from linemate.simulators.plants.conveyor_plan import ConveyorEvent

STOPS = 0.4  # share of cars during whose assembly the line stops
FAULTY = 0.02  # share of cars with a fault
STOPS_UNTIL = 0.8  # of the task's duration


def draw(cars: int, seed: int, station: LineStation, faulty: float = FAULTY) -> list[Car]:
    """Return the cars of a shift in their order.

    Args:
        faulty: share of cars with a fault, of each kind in turn.
    """
    chance = random.Random(seed)  # noqa: S311 - a plan, not a secret
    count = round(faulty * cars)
    kinds = [list(CarFault)[i % len(CarFault)] for i in range(count)]
    faults = dict(zip(chance.sample(range(cars), count), kinds, strict=True))
    return [_car(chance, i, seed, station, faults.get(i)) for i in range(cars)]


def _car(
    chance: random.Random, number: int, seed: int, station: LineStation, fault: CarFault | None
) -> Car:
    events: tuple[ConveyorEvent, ...] = ()
    if chance.random() < STOPS:
        stop_s = round(chance.uniform(0.0, STOPS_UNTIL * station.duration_s), 3)
        events = station.stop(stop_s, chance.uniform(1.5, 6.0))
    return Car(
        part=f"S{seed}-{number + 1:04d}",
        variant=chance.choice(station.variants),
        seed=chance.randrange(2**31),
        events=events,
        fault=fault,
        fault_s=round(chance.uniform(1.0, 3.5), 3),
    )
