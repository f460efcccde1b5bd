"""Setpoints of a FANUC controller: limits that stop it, coasting, and the stop.

Invariants:
    Position, speed, acceleration and jerk of each accepted setpoint are within the limits.
    A cycle without a command goes on at the last speed.
    A stop decelerates each axis at its limit.
"""

import math
from collections.abc import Sequence
from operator import sub

from linemate.simulators.devices.limit_judge import AxisLimit

KINDS = ("position", "speed", "acceleration", "jerk")
_HAIR = 1e-6  # share of a limit that rounding may take
_FLOAT_DEG = 1.6e-5  # a reported joint is a 32-bit float: so far from it the first command may be


class SetpointGate:
    """Setpoints in force and their differences.

    Attributes:
        position: A1..A6 [rad], E1 [m].
        speed: of the last cycle [rad/s, m/s].
        acceleration: of the last two cycles [rad/s^2, m/s^2].
    """

    def __init__(
        self, position: Sequence[float], limits: Sequence[AxisLimit], cycle_s: float
    ) -> None:
        self.position = tuple(position)
        self.speed = self.acceleration = (0.0,) * len(self.position)
        self._limits = tuple(limits)
        self._cycle_s = cycle_s
        self._grace = tuple(
            math.radians(_FLOAT_DEG) / cycle_s**order for order in range(len(KINDS))
        )

    def excess(self, wanted: Sequence[float]) -> str | None:
        """Return which limit a setpoint exceeds, None if it is within all."""
        speed, acceleration, jerk = self._differences(wanted)
        for n, limit in enumerate(self._limits):
            if not limit.low - self._grace[0] <= wanted[n] <= limit.high + self._grace[0]:
                return f"axis {n + 1} position {wanted[n]:.6g}, {limit.low:.6g}..{limit.high:.6g}"
            bounds = (limit.speed, limit.acceleration, limit.jerk)
            for order, (value, bound) in enumerate(
                zip((speed[n], acceleration[n], jerk[n]), bounds, strict=True), 1
            ):
                if not abs(value) <= bound * (1.0 + _HAIR) + self._grace[order]:
                    return f"axis {n + 1} {KINDS[order]} {value:.6g}, limit {bound:.6g}"
        return None

    def accept(self, wanted: Sequence[float]) -> None:
        """Go to a setpoint within this cycle."""
        self.speed, self.acceleration, _ = self._differences(wanted)
        self.position = tuple(wanted)

    def coast(self) -> None:
        """Go on at the last speed."""
        self.acceleration = (0.0,) * len(self.position)
        self._move()

    def stop(self) -> None:
        """Decelerate each axis at its limit."""
        self.speed = tuple(
            math.copysign(max(0.0, abs(v) - limit.acceleration * self._cycle_s), v)
            for v, limit in zip(self.speed, self._limits, strict=True)
        )
        self.acceleration = (0.0,) * len(self.position)
        self._move()

    def _move(self) -> None:
        self.position = tuple(
            q + v * self._cycle_s for q, v in zip(self.position, self.speed, strict=True)
        )

    def _differences(
        self, wanted: Sequence[float]
    ) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
        """Return speed, acceleration and jerk of the way to a setpoint."""
        speed = tuple(d / self._cycle_s for d in map(sub, wanted, self.position))
        acceleration = tuple(d / self._cycle_s for d in map(sub, speed, self.speed))
        jerk = tuple(d / self._cycle_s for d in map(sub, acceleration, self.acceleration))
        return speed, acceleration, jerk
