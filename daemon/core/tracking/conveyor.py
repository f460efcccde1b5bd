"""What a conveyor can do, and what a classifier says of it: the terms all classifiers share.

Law of this file: the classes of Sect. III-B as motion along one axis, and the small interface
behind which classifiers are interchangeable. Positions along the conveyor [m], speeds [m/s],
times from now [s]. A classifier owns its longitudinal filter (states y, x7 and x10 of the paper):
the rows of (1), (7), (8) and (10) for y touch no other state, so the filter falls apart there
without any loss.
"""

from collections.abc import Sequence
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array

LONGEST_TRIAL = 1.0
"""A change that is neither confirmed nor cancelled for so long is cancelled [s]: the slowest
confirmation in the detection benchmark comes 0.55 s after the onset."""


class Motion(StrEnum):
    """The class of the conveyor's motion; standing is what a stop ends in."""

    RUNNING = "running"
    STOPPING = "stopping"
    STANDING = "standing"
    STARTING = "starting"


class Source(StrEnum):
    """The sensor a row comes from."""

    DISTANCE = "distance"
    CAMERA = "camera"
    TACTILE = "tactile"


class Row(Struct, frozen=True):
    """One measured component along the conveyor, (1), (8) and (10).

    Attributes:
        source: only the distance sensor sees the offset x10.
        value: measured position [m].
        delay: tau, from the measurement to now [s]; any real number, each its own.
        variance: sigma_i of (3) [m^2].
        gate: refuse beyond this many sigma.
    """

    source: Source
    value: float
    delay: float
    variance: float
    gate: float


class View(Struct, frozen=True):
    """What a classifier believes now.

    Attributes:
        position: of the object along the conveyor [m].
        speed: [m/s].
        offset: of the distance sensor, x10 [m].
        deviation: one sigma of the position [m].
        speed_deviation: one sigma of the speed [m/s].
        motion: the class in force.
        tentative: it is on trial.
        confidence: log odds of the change that is on trial or was last weighed.
        refused: measurements gated in a row, by source.
        events: what happened in this step, such as ``("stop", "confirmed")``.
    """

    position: float
    speed: float
    offset: float
    deviation: float
    speed_deviation: float
    motion: Motion
    tentative: bool = False
    confidence: float = 0.0
    events: tuple[tuple[str, str], ...] = ()


class Classifier(Protocol):
    """A longitudinal filter with an opinion. Its state is a frozen value of its own."""

    def initial(self, position: float) -> Any:
        """Return the belief at a first reading of the distance sensor [m]."""

    def advance(self, state: Any, rows: Sequence[Row], dt: float) -> Any:
        """Return the belief ``dt`` seconds later, corrected by the rows of that moment."""

    def outlook(self, state: Any, times: Array) -> Array:
        """Return the object's positions (m,) along the conveyor at ``times`` from now [s]."""

    def view(self, state: Any) -> View:
        """Return what the belief says."""


def travel(speed: float, acceleration: float, nominal: float, times: Array) -> Array:
    """Return the way (m,) gone at ``times``, the acceleration ending at speed 0 or nominal."""
    return speed * times + gained(speed, acceleration, nominal, times)


def gained(speed: float, acceleration: float, nominal: float, times: Array) -> Array | float:
    """Return what an acceleration that ends at speed 0 or nominal adds to the way (m,)."""
    if acceleration < 0.0 < speed:
        end = speed / -acceleration
    elif acceleration > 0.0:
        end = max(nominal - speed, 0.0) / acceleration
    else:
        return 0.0
    span = np.minimum(times, end)
    way: Array = acceleration * span * (times - 0.5 * span)
    return way


def change_of(before: Motion, after: Motion) -> str:
    """Return the word for a change of class: a stop or a start."""
    return "stop" if after in {Motion.STOPPING, Motion.STANDING} and before != after else "start"
