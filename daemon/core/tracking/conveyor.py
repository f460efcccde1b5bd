"""Interface of a conveyor classifier: longitudinal Kalman filter and class decision.

Positions along the conveyor [m], speeds [m/s], times from now [s]. A classifier owns the states y,
x7 and x10 of the paper. The rows of (1), (7), (8) and (10) for y read no other state, so that the
filter separates there without loss.
"""

from collections.abc import Sequence
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array

# A change that is neither confirmed nor cancelled for so long is cancelled [s]. The slowest
# confirmation in the detection benchmark comes 0.55 s after the onset.
LONGEST_TENTATIVE_S = 1.0


class Motion(StrEnum):
    """Class of the conveyor's motion (Sect. III-B); a stop ends in standing."""

    RUNNING = "running"
    STOPPING = "stopping"
    STANDING = "standing"
    STARTING = "starting"


class Source(StrEnum):
    """Sensor of a measurement."""

    DISTANCE = "distance"
    CAMERA = "camera"
    TACTILE = "tactile"


class PositionMeasurement(Struct, frozen=True):
    """One measured position along the conveyor, (1), (8) and (10).

    Attributes:
        source: only the distance sensor measures with the offset x10.
        delay: tau, from the measurement to now [s]; any real number.
        variance: sigma_i of (3) [m^2].
        gate: reject an innovation beyond this many sigma.
        is_firm: of the force-torque sensor: the object does not give way, so that a target may
            follow a deflection at once.
        complied: of the force-torque sensor: what an offset of the target has taken up of it [m].
        pushed: of the force-torque sensor: one sigma of the speed that bolts in their holes have
            given the object before the touch [m/s].
        ringing: of the force-torque sensor: variance that a ring of the tool as it seats adds to
            what it shows of the class, where the body's sway is not identified [m^2].
        play: of bolts in their holes, to each side: so far the object is off unfelt [m].
    """

    source: Source
    value: float
    delay: float
    variance: float
    gate: float
    is_firm: bool = False
    complied: float = 0.0
    pushed: float = 0.0
    ringing: float = 0.0
    play: float = 0.0


class ConveyorEstimate(Struct, frozen=True):
    """Estimate of a classifier now.

    Attributes:
        position: of the object along the conveyor [m].
        offset: of the distance sensor, x10 [m].
        deviation: one sigma of the position [m].
        speed_deviation: one sigma of the speed [m/s].
        sway: of the object against the conveyor unit, in the position [m].
        swayed: of the object against the conveyor, as it leads the target [m].
        unknown_sway: one sigma of the sway that a change of class excites beyond its prediction,
            for each m/s^2 of its acceleration [s^2].
        tentative: a change of class is tentative.
        confidence: log odds of the change that was last evaluated.
        events: of this step, for example ``("stop", "confirmed")``.
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
    sway: float = 0.0
    swayed: float = 0.0
    unknown_sway: float = 0.0

    @property
    def unit(self) -> float:
        """Position of the conveyor unit, as the distance sensor sees it [m]."""
        return self.position - self.sway + self.offset


def has_changed_class(events: tuple[tuple[str, str], ...]) -> bool:
    """Return whether a stop or a start was confirmed, or taken back."""
    return any(kind != "push" and what != "tentative" for kind, what in events)


class Classifier(Protocol):
    """A longitudinal Kalman filter with a class decision. Its state is a frozen value."""

    def initial(self, position: float) -> Any:
        """Return the state at a first reading of the distance sensor [m]."""

    def advance(self, state: Any, measurements: Sequence[PositionMeasurement], dt: float) -> Any:
        """Return the state ``dt`` seconds later, corrected by the measurements of that moment."""

    def announce_stop(self, state: Any) -> Any:
        """Return the state as the line announces a stop."""

    def predict_positions(self, state: Any, times: Array) -> Array:
        """Return the object's positions (m,) along the conveyor at ``times`` from now [s]."""

    def predict_sway(self, state: Any, times: Array) -> Array:
        """Return the part (m,) of these positions that is the body's sway [m]."""

    def estimate(self, state: Any) -> ConveyorEstimate:
        """Return the estimate of the conveyor now."""


def way(speed: float, acceleration: float, nominal: float, times: Array) -> Array:
    """Return the way (m,) [m] at ``times``, the acceleration ending at speed 0 or nominal."""
    return speed * times + added_way(speed, acceleration, nominal, times)


def added_way(speed: float, acceleration: float, nominal: float, times: Array) -> Array | float:
    """Return what an acceleration that ends at speed 0 or nominal adds to the way (m,) [m]."""
    if acceleration < 0.0 < speed:
        end = speed / -acceleration
    elif acceleration > 0.0:
        end = max(nominal - speed, 0.0) / acceleration
    else:
        return 0.0
    span = np.minimum(times, end)
    added: Array = acceleration * span * (times - 0.5 * span)
    return added
