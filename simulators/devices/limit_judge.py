"""Judgement of applied setpoints: position, speed, acceleration and jerk.

Invariants:
    Limits are the emulator's own, not the daemon's.
    Finite differences allow for the rounding of the decimals on the wire.
    A cycle without a fresh reply is not judged; the robot counts as at rest after it.
    A slipped schedule is not judged: wall time and plant time differ there.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_TOGETHER = 256
"""Cycles that are judged at once at the latest."""

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

KINDS = ("position", "speed", "acceleration", "jerk")
WIRE_DECIMALS = 8
_HAIR = 1e-6
_UNITS = (math.radians(1.0),) * 6 + (1e-3,)
"""What one unit on the wire is worth: a degree [rad] for A1..A6, a millimetre [m] for E1."""


@dataclass(frozen=True, slots=True)
class AxisLimit:
    """What one axis may be asked to do, in rad or m and seconds.

    Attributes:
        low: least position [rad or m].
        high: greatest position [rad or m].
        speed: greatest magnitude [rad/s or m/s].
        acceleration: greatest magnitude [rad/s^2 or m/s^2].
        jerk: greatest magnitude [rad/s^3 or m/s^3].
    """

    low: float
    high: float
    speed: float
    acceleration: float
    jerk: float


def _rotary(
    low_deg: float, high_deg: float, speed_deg: float, acceleration: float, jerk: float
) -> AxisLimit:
    low, high, speed = map(math.radians, (low_deg, high_deg, speed_deg))
    return AxisLimit(low, high, speed, acceleration, jerk)


KEPT = 32  # violations that are kept as evidence
LIMITS: tuple[AxisLimit, ...] = (
    _rotary(-185.0, 185.0, 105.0, 40.0, 15_000.0),
    _rotary(-140.0, -5.0, 101.0, 40.0, 15_000.0),
    _rotary(-120.0, 155.0, 107.0, 40.0, 15_000.0),
    _rotary(-350.0, 350.0, 136.0, 60.0, 20_000.0),
    _rotary(-122.5, 122.5, 129.0, 60.0, 20_000.0),
    _rotary(-350.0, 350.0, 206.0, 60.0, 20_000.0),
    AxisLimit(-1.5, 6.0, 1.5, 12.0, 3000.0),
)
"""A heavy six-axis arm on a linear axis, A1..A6 and E1: limits of setpoints, which lead a slow
servo and so ask for several times the acceleration and jerk that the arm itself makes."""


@dataclass(frozen=True, slots=True)
class Violation:
    """One excess.

    Attributes:
        axis: 0..5 for A1..A6, 6 for E1.
        value: what was asked for [rad, m and seconds].
    """

    cycle: int
    axis: int
    kind: str
    value: float
    limit: float


class LimitJudge:
    """Counts excesses of the applied setpoints.

    A cycle's setpoints are only put down; they are judged many at once, when somebody asks or
    when there are enough of them.
    """

    def __init__(self, cycle_s: float, limits: tuple[AxisLimit, ...] = LIMITS) -> None:
        """Begin before the first setpoint."""
        self.cycle_s, self.limits = cycle_s, limits
        self._counts: Counter[str] = Counter()
        self._worst: dict[str, float] = {}
        self._evidence: list[Violation] = []
        self._bounds = _bounds(limits, cycle_s)
        self._cycle = 0
        self._unsure = 0
        # Waiting to be judged: the setpoints, and how many derivatives of them count: 3 in a
        # cycle that others stand behind, none where the robot rests.
        self._positions: list[tuple[float, ...]] = []
        self._depths: list[int] = []
        # Before them: position, speed and acceleration.
        self._past: Floats | None = None

    @property
    def counts(self) -> Counter[str]:
        """All violations by kind."""
        self._judge_all()
        return self._counts

    @property
    def worst(self) -> dict[str, float]:
        """Greatest ratio of value to limit by kind (speed, acceleration, jerk)."""
        self._judge_all()
        return self._worst

    @property
    def evidence(self) -> list[Violation]:
        """The first violations."""
        self._judge_all()
        return self._evidence

    @property
    def violations(self) -> int:
        """All violations together."""
        return self.counts.total()

    @property
    def violations_so_far(self) -> int:
        """Violations in what has been judged so far; it costs nothing to ask."""
        return self._counts.total()

    def start(self, setpoints: Sequence[float]) -> None:
        """A session begins at rest.

        Args:
            setpoints: the start pose, A1..A6 [rad], E1 [m].
        """
        self._judge_all()
        self._past = np.zeros((3, len(setpoints)))
        self._past[0] = setpoints
        self._unsure = 0

    def hold(self, setpoints: Sequence[float]) -> None:
        """A cycle in which the controller acted by itself."""
        self._unsure = 0
        self._queue_setpoints(setpoints, 0)

    def slip(self) -> None:
        """The schedule slipped between the last cycle and the next one: it may be at rest."""
        self._unsure = 2

    def judge(self, setpoints: Sequence[float]) -> None:
        """A cycle in which a fresh reply was applied."""
        if self._past is None:
            self.start(setpoints)
        self._queue_setpoints(setpoints, 3 - self._unsure)
        self._unsure = max(0, self._unsure - 1)

    def _queue_setpoints(self, setpoints: Sequence[float], depth: int) -> None:
        self._positions.append(tuple(setpoints))
        self._depths.append(depth)
        if len(self._depths) >= _TOGETHER:
            self._judge_all()

    def _judge_all(self) -> None:
        """Judge what waits."""
        if not self._depths:
            return
        positions, depths = np.array(self._positions), np.array(self._depths)
        self._positions.clear()
        self._depths.clear()
        past = np.zeros((3, positions.shape[1])) if self._past is None else self._past
        fresh = depths > 0
        excesses = np.empty((len(past) + 1, *positions.shape))  # kind, cycle, axis
        excesses[0] = positions
        for order, before in enumerate(past):
            slope = excesses[order + 1]
            slope[0] = excesses[order, 0] - before
            np.subtract(excesses[order, 1:], excesses[order, :-1], out=slope[1:])
            slope /= self.cycle_s
            slope[~fresh] = 0.0
        counted = fresh & (np.arange(len(excesses))[:, np.newaxis] <= depths)
        self._note(excesses, counted[:, :, np.newaxis])
        self._past = excesses[:3, -1].copy()
        self._cycle += len(depths)

    def _note(self, excesses: Floats, counted: Flags) -> None:
        low, high, limit = self._bounds
        if counted.any():
            greatest = np.where(counted, np.abs(excesses), 0.0).max(axis=1, keepdims=True)
            shares = (greatest / limit).max(axis=(1, 2))
            for name, share in zip(KINDS[1:], shares[1:].tolist(), strict=True):
                self._worst[name] = max(self._worst.get(name, 0.0), share)
        beyond = counted & ~((low <= excesses) & (excesses <= high))
        if not beyond.any():
            return
        for cycle, axis, kind in np.argwhere(beyond.transpose(1, 2, 0)).tolist():
            name, value = KINDS[kind], float(excesses[kind, cycle, axis])
            self._counts[name] += 1
            if len(self._evidence) < KEPT:
                self._evidence.append(
                    Violation(
                        self._cycle + cycle + 1, axis, name, value, self._limit(axis, kind, value)
                    )
                )

    def _limit(self, axis: int, kind: int, value: float) -> float:
        limit = self.limits[axis]
        if kind == 0:
            return limit.low if value < limit.low else limit.high
        return (limit.speed, limit.acceleration, limit.jerk)[kind - 1]


def _bounds(limits: tuple[AxisLimit, ...], period: float) -> tuple[Floats, Floats, Floats]:
    """The least and the greatest value, and the limit, of each kind and axis, (4, 1, axes)."""
    low, high, limit = (np.zeros((4, 1, len(limits))) for _ in range(3))
    for axis, axis_limit in enumerate(limits):
        quantum = 0.5 * 10.0**-WIRE_DECIMALS * _UNITS[axis]
        low[0, 0, axis], high[0, 0, axis] = axis_limit.low - quantum, axis_limit.high + quantum
        limit[:, 0, axis] = math.inf, axis_limit.speed, axis_limit.acceleration, axis_limit.jerk
        for order in (1, 2, 3):
            grace = 2.0**order * quantum / period**order
            high[order, 0, axis] = limit[order, 0, axis] * (1.0 + _HAIR) + grace
    low[1:] = -high[1:]
    return low, high, limit
