"""Plan of a shift: variants, stops of the line and faults, drawn from one seed.

Invariants:
- One seed gives one plan.
- Each car has at most one fault.
"""

import random

from linemate.simulators.devices.line.cars import Car, CarFault
from linemate.simulators.plants.conveyor_plan import ConveyorEvent

STOPS = 0.4  # share of cars during whose assembly the line stops
FAULTY = 0.02  # share of cars with a fault
DECELERATION, ACCELERATION = 0.104, 0.013  # of the line's drive [m/s^2]


def draw(cars: int, seed: int, variants: tuple[str, ...], faulty: float = FAULTY) -> list[Car]:
    """Return the cars of a shift in their order.

    Args:
        variants: names to draw from.
        faulty: share of cars with a fault, of each kind in turn.
    """
    chance = random.Random(seed)  # noqa: S311 - a plan, not a secret
    count = round(faulty * cars)
    kinds = [list(CarFault)[i % len(CarFault)] for i in range(count)]
    faults = dict(zip(chance.sample(range(cars), count), kinds, strict=True))
    return [_car(chance, i, seed, variants, faults.get(i)) for i in range(cars)]


def _car(
    chance: random.Random, number: int, seed: int, variants: tuple[str, ...], fault: CarFault | None
) -> Car:
    events: tuple[ConveyorEvent, ...] = ()
    if chance.random() < STOPS:
        stop_s = round(chance.uniform(0.0, 14.0), 3)
        start_s = round(stop_s + chance.uniform(1.5, 6.0), 3)
        events = (
            ConveyorEvent("stop", stop_s, DECELERATION),
            ConveyorEvent("start", start_s, ACCELERATION),
        )
    return Car(
        part=f"S{seed}-{number + 1:04d}",
        variant=chance.choice(variants),
        seed=chance.randrange(2**31),
        events=events,
        fault=fault,
        fault_s=round(chance.uniform(1.0, 3.5), 3),
    )
