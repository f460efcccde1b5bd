"""Cars of a line: variant, stops of the line, fault, and when they come.

Invariants:
- Values only. Each car has at most one fault.
"""

from dataclasses import dataclass, field
from enum import StrEnum

from linemate.simulators.plants.conveyor_plan import ConveyorEvent
from linemate.simulators.plants.scenario import Vector3


class CarFault(StrEnum):
    """What goes wrong with a car."""

    CAMERA_COVERED = "camera covered"
    ROBOT_RESTARTED = "robot restarted"
    FORCE_SILENT = "force sensor silent"
    PART_MISSING = "part missing"


@dataclass(frozen=True, slots=True)
class Car:
    """One car of a shift.

    Attributes:
        part: identifier that the line's controller announces.
        seed: of the plant's draws.
        events: stops and starts of the line, in time of the car [s].
        fault_s: when the fault begins, in time of the car [s].
    """

    part: str
    variant: str
    seed: int
    events: tuple[ConveyorEvent, ...] = ()
    fault: CarFault | None = None
    fault_s: float = 0.0


@dataclass(frozen=True, slots=True)
class CarTruth:
    """What became of a car in its world.

    Attributes:
        mounted: the wheel is screwed on and released, without a collision.
        impact_mm: distance of tcp and hub across the tool's axis at the touch; None without one.
    """

    mounted: bool
    collision: str | None
    impact_mm: float | None


@dataclass(frozen=True, slots=True)
class LinePlan:
    """Cars that come one after the other.

    Attributes:
        hubs: nominal hub by variant, in base [m].
        takt_s: from one car to the next at least [s].
        entry_s: a car enters this long before the start position [s].
        first_s: from the beginning to the first car [s].
        last_s: from the last car's entry to its end [s].
    """

    cars: tuple[Car, ...]
    hubs: dict[str, Vector3] = field(default_factory=dict)
    takt_s: float = 57.6
    entry_s: float = 6.0
    first_s: float = 2.0
    last_s: float = 45.0
