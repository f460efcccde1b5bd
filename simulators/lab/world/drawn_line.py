"""Lines drawn at random: the plant floor with stops and starts that its task file does not state.

Invariants:
    A seed draws the same line wherever it is run, and the rest of its run is that of the floor.
"""

import json
from dataclasses import dataclass
from random import Random
from typing import Any

from linemate.simulators.plants.conveyor_plan import Conveyor

DURATION_S = 45.0  # long enough to wait for a line that stops four times [s]

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class LineRange:
    """Stops and starts of a row: as stated, or of either range.

    Attributes:
        what: the row, in one line.
        key: what the seeds of its random numbers begin with.
        stops, starts: ranges of their accelerations [m/s^2].
    """

    what: str
    key: str
    stops: tuple[Range, Range]
    starts: tuple[Range, Range]

    def accelerations(self, random: Random) -> tuple[float, float]:
        """Draw those of a stop and of the start after it [m/s^2]."""
        stated = (event.acceleration for event in Conveyor().events)
        stop, start = (
            random.choice((usual, *(random.uniform(*each) for each in ranges)))
            for usual, ranges in zip(stated, (self.stops, self.starts), strict=True)
        )
        return stop, start


NAME, WIDE_NAME = "plant-floor-lines", "plant-floor-lines-wide"
LINES = {
    NAME: LineRange(
        "the plant floor, up to four stops of 50 to 300 and starts of 13 to 100 mm/s^2 drawn",
        "mild",
        ((0.05, 0.3), (0.1, 0.2)),
        ((0.013, 0.1), (0.03, 0.1)),
    ),
    WIDE_NAME: LineRange(
        "the same with stops of 50 to 1000 and starts of 13 to 500 mm/s^2",
        "stops",
        ((0.05, 0.3), (0.3, 1.0)),
        ((0.013, 0.1), (0.1, 0.5)),
    ),
}
"""By the row's name."""


def overrides(name: str, seed: int) -> tuple[str, ...]:
    """Return what a seed of a row changes of the plant floor, as ``KEY=VALUE``."""
    return stops_and_starts(LINES[name], seed)


def stops_and_starts(line: LineRange, seed: int) -> tuple[str, ...]:
    """Return the orders that a seed gives to a conveyor, and how long a run takes then."""
    events = json.dumps(_events(line, seed))
    return f"scenario.conveyor.events={events}", f"scenario.duration_s={DURATION_S}"


def _events(line: LineRange, seed: int) -> list[dict[str, Any]]:
    random = Random(f"{line.key} {seed}")  # noqa: S311 - not for secrets
    # Anywhere in the run, or from the last approach on.
    t = random.choice((random.uniform(1.5, 14.0), random.uniform(7.5, 12.5)))
    events = []
    for _ in range(random.choice((1, 1, 2, 3, 4))):
        stop, start = line.accelerations(random)
        pauses = random.uniform(0.05, 1.2), random.uniform(0.5, 4.0), random.uniform(2.0, 8.0)
        stood_s = random.choice(pauses)
        events += [_event("stop", t, stop), _event("start", t + stood_s, start)]
        t += stood_s + random.choice((random.uniform(0.1, 1.5), random.uniform(1.0, 6.0)))
    return events


def _event(kind: str, onset_s: float, acceleration: float) -> dict[str, Any]:
    rounded = {"onset_s": round(onset_s, 3), "acceleration": round(acceleration, 3)}
    return {"kind": kind, **rounded}
