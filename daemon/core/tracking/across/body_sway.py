"""Sway of the object along the conveyor, in contact."""

from msgspec import Struct

FASTEST_SWAY = 0.15  # a quicker way of a sway is another estimate of it [m/s]
SWAY_S = 1.5  # time constant of its mean: what sags or drifts is no sway [s]


class BodySway(Struct, frozen=True):
    """Sway of the object along the conveyor, in contact.

    Attributes:
        at: where the object is against the conveyor unit [m]; None out of contact.
        off: the same from its slow mean [m].
        way: of that in the last step [m].
    """

    at: float | None = None
    off: float = 0.0
    way: float = 0.0

    def moved(self, at: float, dt: float) -> "BodySway":
        """Return the sway one step later."""
        way = 0.0 if self.at is None else at - self.at
        way = way if abs(way) < FASTEST_SWAY * dt else 0.0
        off = (self.off + way) * (1.0 - dt / SWAY_S)
        return BodySway(at, off, off - self.off)


NO_SWAY = BodySway()
