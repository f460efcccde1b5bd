"""The emulator's own judgement of the applied setpoints: position, speed, acceleration, jerk.

Law of this file: finite differences of what the controller really applied, one a cycle, against
limits that are the emulator's and not the daemon's. The wire has finite decimals, so each
difference is granted what rounding alone can make of it. In a cycle without a fresh reply the
controller holds by itself; nobody is blamed for that, and the robot counts as at rest after it.
A schedule that slipped held the robot as well for whoever has a clock, and did not for the plant:
what would tell the two apart is not judged.
Source: reference/reliability.md, 2.0 (ENV).
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

KINDS = ("position", "speed", "acceleration", "jerk")
WIRE_DECIMALS = 8
_HAIR = 1e-6
_UNITS = (math.radians(1.0),) * 6 + (1e-3,)
"""What one unit on the wire is worth: a degree [rad] for A1..A6, a millimetre [m] for E1."""


@dataclass(frozen=True, slots=True)
class AxisLimit:
    """What one axis may be asked to do, in rad or m and seconds.

    Attributes:
        low: least position.
        high: greatest position.
        speed: greatest magnitude.
        acceleration: greatest magnitude.
        jerk: greatest magnitude.
    """

    low: float
    high: float
    speed: float
    acceleration: float
    jerk: float


def _rotary(low_deg: float, high_deg: float, speed_deg: float) -> AxisLimit:
    return AxisLimit(
        math.radians(low_deg), math.radians(high_deg), math.radians(speed_deg), 75.0, 25_000.0
    )


LIMITS: tuple[AxisLimit, ...] = (
    _rotary(-185.0, 185.0, 105.0),
    _rotary(-140.0, -5.0, 101.0),
    _rotary(-120.0, 155.0, 107.0),
    _rotary(-350.0, 350.0, 136.0),
    _rotary(-122.5, 122.5, 129.0),
    _rotary(-350.0, 350.0, 206.0),
    AxisLimit(-5.0, 6.5, 1.5, 15.0, 4000.0),
)
"""A heavy six-axis arm on a linear axis, A1..A6 and E1: limits of setpoints, which lead a slow
servo and so ask for several times the acceleration and jerk that the arm itself makes."""


@dataclass(frozen=True, slots=True)
class Violation:
    """One excess.

    Attributes:
        cycle: number of the cycle.
        axis: 0..5 for A1..A6, 6 for E1.
        kind: one of ``KINDS``.
        value: what was asked for [rad, m and seconds].
        limit: what is allowed.
    """

    cycle: int
    axis: int
    kind: str
    value: float
    limit: float


@dataclass(slots=True)
class LimitJudge:
    """Counts excesses of the applied setpoints.

    Attributes:
        cycle_s: the controller's cycle [s].
        limits: for each axis.
        keep: how many violations are kept as evidence.
        counts: violations by kind.
        worst: greatest ratio of value to limit by kind (speed, acceleration, jerk).
        evidence: the first violations.
    """

    cycle_s: float
    limits: tuple[AxisLimit, ...] = LIMITS
    keep: int = 32
    counts: Counter[str] = field(default_factory=Counter)
    worst: dict[str, float] = field(default_factory=dict)
    evidence: list[Violation] = field(default_factory=list)
    _position: tuple[float, ...] | None = None
    _speed: tuple[float, ...] = ()
    _acceleration: tuple[float, ...] = ()
    _cycle: int = 0
    _unsure: int = 0

    @property
    def violations(self) -> int:
        """All violations together."""
        return self.counts.total()

    def start(self, setpoints: Sequence[float]) -> None:
        """A session begins at rest.

        Args:
            setpoints: the start pose, A1..A6 [rad], E1 [m].
        """
        self._rest(tuple(setpoints))

    def hold(self, setpoints: Sequence[float]) -> None:
        """A cycle in which the controller acted by itself.

        Args:
            setpoints: what it applied.
        """
        self._cycle += 1
        self._rest(tuple(setpoints))

    def slip(self) -> None:
        """The schedule slipped between the last cycle and the next one: it may be at rest."""
        self._unsure = 2

    def judge(self, setpoints: Sequence[float]) -> None:
        """A cycle in which a fresh reply was applied.

        Args:
            setpoints: what was applied.
        """
        self._cycle += 1
        position = tuple(setpoints)
        if self._position is None:
            self._rest(position)
        period = self.cycle_s
        speed = _slope(self._position or position, position, period)
        acceleration = _slope(self._speed, speed, period)
        jerk = _slope(self._acceleration, acceleration, period)
        for axis, limit in enumerate(self.limits):
            quantum = 0.5 * 10.0**-WIRE_DECIMALS * _UNITS[axis]
            self._position_within(axis, position[axis], limit, quantum)
            self._within(axis, "speed", speed[axis], limit.speed, 2.0 * quantum / period)
            if self._unsure < 2:
                grace = 4.0 * quantum / period**2
                self._within(axis, "acceleration", acceleration[axis], limit.acceleration, grace)
            if self._unsure < 1:
                self._within(axis, "jerk", jerk[axis], limit.jerk, 8.0 * quantum / period**3)
        self._position, self._speed, self._acceleration = position, speed, acceleration
        self._unsure = max(0, self._unsure - 1)

    def _rest(self, position: tuple[float, ...]) -> None:
        self._position = position
        self._speed = self._acceleration = (0.0,) * len(position)
        self._unsure = 0

    def _position_within(self, axis: int, value: float, limit: AxisLimit, grace: float) -> None:
        if not limit.low - grace <= value <= limit.high + grace:
            bound = limit.low if value < limit.low else limit.high
            self._blame(axis, "position", value, bound)

    def _within(self, axis: int, kind: str, value: float, limit: float, grace: float) -> None:
        magnitude = abs(value)
        self.worst[kind] = max(self.worst.get(kind, 0.0), magnitude / limit)
        if not magnitude <= limit * (1.0 + _HAIR) + grace:
            self._blame(axis, kind, value, limit)

    def _blame(self, axis: int, kind: str, value: float, limit: float) -> None:
        self.counts[kind] += 1
        if len(self.evidence) < self.keep:
            self.evidence.append(Violation(self._cycle, axis, kind, value, limit))


def _slope(before: Sequence[float], now: Sequence[float], period: float) -> tuple[float, ...]:
    return tuple((b - a) / period for a, b in zip(before, now, strict=True))
