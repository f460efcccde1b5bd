"""The conveyor unit as the distance sensor alone sees it, under the class in force."""

import math

from msgspec import Struct

from linemate.daemon.core.tracking.conveyor import PositionMeasurement

STANDING_WALK = 0.00003  # random walk of a standing unit [m/sqrt(s)]
SPEED_WALK = 0.0008  # of the speed of a running one [m/s/sqrt(s)]
CHANGED_POSITION, CHANGED_SPEED = 0.0003, 0.005  # sigma when the class changes [m], [m/s]
FAR_READING = 0.001  # beyond the gate, where a reading is an outlier [m]


def first_estimate(measurement: PositionMeasurement, speed: float) -> "UnitEstimate":
    """Return the estimate at a first reading; the speed is known roughly [m/s]."""
    return UnitEstimate(measurement.value, speed, measurement.variance, 0.0, CHANGED_SPEED**2)


class UnitEstimate(Struct, frozen=True):
    """The conveyor as the distance sensor alone sees it.

    Attributes:
        position, speed: along the conveyor [m], [m/s].
        variance, covariance, speed_variance: of position and speed [m^2, m^2/s, m^2/s^2].
    """

    position: float
    speed: float
    variance: float
    covariance: float
    speed_variance: float

    def past(self, delay: float, acceleration: float, acted: float) -> float:
        """Return the position ``delay`` s ago [m], the acceleration being ``acted`` s old."""
        return self.position - self.speed * delay + acceleration * acted * (delay - 0.5 * acted)

    def moved(self, dt: float, acceleration: float, *, stands: bool) -> "UnitEstimate":
        """Return the estimate one step later."""
        if stands:
            grown = self.variance + STANDING_WALK**2 * dt
            return UnitEstimate(self.position, 0.0, grown, 0.0, 0.0)
        p, c, v = self.variance, self.covariance, self.speed_variance
        return UnitEstimate(
            self.position + (self.speed + 0.5 * acceleration * dt) * dt,
            self.speed + acceleration * dt,
            p + (2.0 * c + v * dt) * dt,
            c + v * dt,
            v + SPEED_WALK**2 * dt,
        )

    def read(self, value: float, variance: float, gate: float) -> "UnitEstimate":
        """Return the estimate after a reading of the distance sensor [m]."""
        innovation, S = value - self.position, self.variance + variance
        if not abs(innovation) <= gate * math.sqrt(S) + FAR_READING:
            return self
        k, m = self.variance / S, self.covariance / S
        return UnitEstimate(
            self.position + k * innovation,
            self.speed + m * innovation,
            (1.0 - k) * self.variance,
            (1.0 - k) * self.covariance,
            self.speed_variance - m * self.covariance,
        )

    def changed(self, position: float, speed: float) -> "UnitEstimate":
        """Return the estimate where the class has changed."""
        return UnitEstimate(
            self.position + position,
            self.speed + speed,
            self.variance + CHANGED_POSITION**2,
            0.0,
            CHANGED_SPEED**2,
        )
