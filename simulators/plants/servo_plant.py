"""Servos: interpolation over a cycle, dead time, second order lag, limited acceleration.

Invariants:
    Setpoints are nodes at cycle starts with straight lines between them.
    An axis follows the input exactly ``dead_time_s`` later.
    A substep is cut at the node it meets; each piece is solved exactly.
    A saturated piece is cut into sixteen of constant or unlimited acceleration.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from itertools import chain
from operator import add, sub
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from linemate.simulators.plants.oscillator import Transition, solved, transition
from linemate.simulators.plants.scenario import Axis

_SLICES = 16
_TINY = 1e-9
_DIGITS = 12
"""Instants within a substep are rounded to a picosecond, so that they repeat."""
_CUTS = 4096

Array = NDArray[np.float64]
Value = TypeVar("Value", float, Array)
_Motion = tuple[tuple[float, ...], tuple[float, ...]]
"""Positions and velocities of all axes."""


class _Piece(NamedTuple):
    """A stretch of one substep on which one axis sees one straight line."""

    back: int  # cycles before the present one
    since: float  # age of the line at the beginning of the stretch [s]
    length: float  # [s]
    phi: Transition


class _Lag(NamedTuple):
    """Constants of one axis."""

    omega: float
    zeta: float
    stiffness: float  # w^2
    friction: float  # 2 zeta w
    shift: float  # 2 zeta / w: how far a ramp is followed behind [s]
    limit: float
    dead_time: float
    plan: tuple[tuple[_Piece, ...], ...]  # for each substep of the cycle


class ServoBank:
    """All axes, advanced by substeps of the cycle."""

    def __init__(
        self, axes: tuple[Axis, ...], start: tuple[float, ...], cycle_s: float, substeps: int
    ) -> None:
        self._cycle_s = cycle_s
        self._substeps = substeps
        self._step = cycle_s / substeps
        self._lags = tuple(_lag(axis, self._step, substeps) for axis in axes)
        self._reach = max(piece.back for lag in self._lags for p in lag.plan for piece in p)
        self._table = _table(self._lags, self._reach, cycle_s)
        # What the matrix is multiplied by is packed: numpy takes twice as long to read a list.
        self._inputs = np.zeros(self._table.gains.shape[1])
        self._pack = partial(struct.Struct(f"{self._inputs.size}d").pack_into, self._inputs.data, 0)
        self._cuts = lru_cache(_CUTS)(self._cut)
        # Nodes of the lines that are still seen, the present cycle's and its end the last two.
        self._nodes = [tuple(start)] * (self._reach + 2)
        self._rises = [(0.0,) * len(start)] * (self._reach + 1)
        self._cycle, self._is_commanded = 0, False
        self._least_dead_time_s = min(axis.dead_time_s for axis in axes)
        self._ahead: list[_Motion] | None = None
        self.positions = tuple(start)
        self.velocities = (0.0,) * len(start)
        self._begun: _Motion = self.positions, self.velocities

    def begin_cycle(self, cycle: int) -> None:
        """Arrive at a cycle's start: until a command comes, the last setpoint is held."""
        nodes, rises = self._nodes, self._rises
        nodes.append(nodes[-1])
        rises.append((0.0,) * len(nodes[-1]))
        del nodes[0], rises[0]
        self._cycle, self._is_commanded = cycle, False
        self._begun = self.positions, self.velocities
        self._ahead = None

    def command(self, cycle: int, age: float, setpoints: tuple[float, ...]) -> None:
        """Set the setpoints that the given cycle moves to.

        Args:
            cycle: the present cycle, or the one before it.
            age: time since its start [s].
            setpoints: reached at the end of the cycle [rad, m].

        Raises:
            ValueError: when an axis has already moved on an input that this would change.
        """
        if age > self._least_dead_time_s + _TINY:
            raise ValueError(f"command {age} s after its cycle began: the motion has passed it")
        nodes, rises = self._nodes, self._rises
        if cycle == self._cycle:
            nodes[-1] = setpoints
            self._is_commanded = True
        elif cycle == self._cycle - 1:
            nodes[-2] = setpoints
            rises[-2] = tuple(map(sub, setpoints, nodes[-3]))
            if not self._is_commanded:
                nodes[-1] = setpoints
        else:
            raise ValueError(f"command for cycle {cycle} in cycle {self._cycle}")
        rises[-1] = tuple(map(sub, nodes[-1], nodes[-2]))
        self._ahead = None

    def advance(self, index: int) -> None:
        """Integrate substep `index` (counted from the start of the run)."""
        if self._ahead is None:
            # A command after some substeps changes nothing in them: it is seen a dead time later.
            self._ahead = self._look_ahead()
        self.positions, self.velocities = self._ahead[index % self._substeps]

    def peek(self, index: int, dt: float) -> tuple[float, ...]:
        """Positions `dt` after the beginning of substep `index`, without advancing."""
        cuts = self._cuts(index % self._substeps, round(dt, _DIGITS))
        states = zip(cuts, self.positions, self.velocities, strict=True)
        return tuple(
            [self._moved(axis, pieces, y, v)[0] for axis, (pieces, y, v) in enumerate(states)]
        )

    def _look_ahead(self) -> list[_Motion]:
        """Positions and velocities at the end of each substep of this cycle."""
        table, (positions, velocities), origin = self._table, self._begun, self._nodes[0]
        rises = chain.from_iterable(self._rises)
        self._pack(*map(sub, positions, origin), *velocities, *rises)
        # Numpy twice and no more: between other work each of its calls costs as much as ten here.
        values: list[float] = table.gains.dot(self._inputs).tolist()
        n, half = len(origin), table.strains // 2
        ahead = [
            (tuple(map(add, values[i : i + n], origin)), tuple(values[half + i : half + i + n]))
            for i in range(0, half, n)
        ]
        strains = values[table.strains :]
        if min(strains) >= -1.0 and max(strains) <= 1.0:
            return ahead
        return self._one_by_one(ahead[: table.easy(values)])

    def _one_by_one(self, ahead: list[_Motion]) -> list[_Motion]:
        """Go on axis by axis from the first substep in which one saturates."""
        for part in range(len(ahead), self._substeps):
            positions, velocities = ahead[-1] if ahead else self._begun
            moved = [
                self._moved(axis, lag.plan[part], positions[axis], velocities[axis])
                for axis, lag in enumerate(self._lags)
            ]
            ahead.append((tuple(y for y, _ in moved), tuple(v for _, v in moved)))
        return ahead

    def _moved(
        self, axis: int, pieces: tuple[_Piece, ...], y: float, v: float
    ) -> tuple[float, float]:
        """Position and velocity of one axis after some pieces."""
        lag, nodes, cycle_s = self._lags[axis], self._nodes, self._cycle_s
        _, _, stiffness, friction, shift, limit, _, _ = lag
        for piece in pieces:
            back, since, length, (p11, p12, p21, p22) = piece
            begin = nodes[-2 - back][axis]
            slope = (nodes[-1 - back][axis] - begin) / cycle_s
            u = begin + slope * since
            # ``_linear``, written out: a call costs as much as what it computes.
            lead = slope * shift
            x, xv = y - u + lead, v - slope
            y1 = p11 * x + p12 * xv + u + slope * length - lead
            v1 = p21 * x + p22 * xv + slope
            # At both ends it shows whether the axis saturates.
            before = stiffness * (u - y) - friction * v
            after = stiffness * (u + slope * length - y1) - friction * v1
            if -limit <= before <= limit and -limit <= after <= limit:
                y, v = y1, v1
            else:
                y, v = _saturated(lag, piece, slope, u, y, v)
        return y, v

    def _cut(self, part: int, dt: float) -> tuple[tuple[_Piece, ...], ...]:
        """The pieces of the first `dt` of a substep, of each axis."""
        cuts = []
        for lag in self._lags:
            pieces, left = [], dt
            for piece in lag.plan[part]:
                if left <= 0.0:
                    break
                pieces.append(_shortened(lag, piece, min(left, piece.length)))
                left -= piece.length
            cuts.append(tuple(pieces))
        return tuple(cuts)


class VaryingServoBank(ServoBank):
    """Axes whose frequency and dead time change from cycle to cycle."""

    def __init__(
        self,
        axes: tuple[Axis, ...],
        start: tuple[float, ...],
        cycle_s: float,
        substeps: int,
        vary: Callable[[float, tuple[float, ...]], tuple[Axis, ...]],
        dead_time_range: tuple[float, float],
    ) -> None:
        """Begin at rest.

        Args:
            vary: the axes at a time [s] and positions.
            dead_time_range: amplitude by which dead times go up and down, and their growth [s].
        """
        amplitude, growth = dead_time_range
        longest = [replace(a, dead_time_s=a.dead_time_s + amplitude + growth) for a in axes]
        super().__init__(tuple(longest), start, cycle_s, substeps)
        self._vary = vary
        self._least_dead_time_s = min(axis.dead_time_s for axis in axes) - amplitude

    def begin_cycle(self, cycle: int) -> None:
        """Arrive at a cycle's start, with the axes as they are now."""
        super().begin_cycle(cycle)
        axes = self._vary(cycle * self._cycle_s, self.positions)
        self._lags = tuple(_lag(axis, self._step, self._substeps) for axis in axes)
        self._cuts.cache_clear()

    def _look_ahead(self) -> list[_Motion]:
        return self._one_by_one([])


class _CycleMatrix(NamedTuple):
    """A cycle of all axes as one matrix, as long as none saturates.

    Its inputs: position off the oldest node, speed, and the rise of each line from the oldest to
    the present one, each of all axes. Its outputs: for each substep's end the positions off the
    oldest node, then the speeds, then the strains: at the ends of all pieces the accelerations as
    shares of their limits.
    """

    gains: Array
    ends: tuple[int, ...]
    """Behind the last strain of each substep."""
    strains: int
    """The first of them."""

    def easy(self, values: list[float]) -> int:
        """How many substeps pass before the one in which an axis saturates."""
        begin = self.strains
        for part, end in enumerate(self.ends):
            if not all(-1.0 <= strain <= 1.0 for strain in values[begin:end]):
                return part
            begin = end
        return len(self.ends)


def _table(lags: tuple[_Lag, ...], reach: int, cycle_s: float) -> _CycleMatrix:
    """Solve each axis once for a unit of each of its inputs."""
    n, width = len(lags), reach + 3
    units = np.eye(width)
    positions: list[Array] = []
    speeds: list[Array] = []
    strains: list[Array] = []
    ends: list[int] = []

    def append_row(rows: list[Array], axis: int, gains: Array) -> None:
        row = np.zeros(width * n)
        row[axis::n] = gains
        rows.append(row)

    def strain(lag: _Lag, u: Array, y: Array, v: Array) -> Array:
        return np.asarray((lag.stiffness * (u - y) - lag.friction * v) / lag.limit)

    states = [(units[0], units[1])] * n
    for part in range(len(lags[0].plan)):
        for axis, lag in enumerate(lags):
            y, v = states[axis]
            for number, piece in enumerate(lag.plan[part]):
                line = reach - piece.back
                slope = units[2 + line] / cycle_s
                u = units[2 : 2 + line].sum(axis=0) + slope * piece.since
                if part == number == 0:
                    append_row(strains, axis, strain(lag, u, y, v))
                y, v = _linear(lag, piece, slope, u, y, v)
                # What a piece ends with the next one begins with.
                append_row(strains, axis, strain(lag, u + slope * piece.length, y, v))
            states[axis] = y, v
            append_row(positions, axis, y)
            append_row(speeds, axis, v)
        ends.append(len(strains))
    first = len(positions) + len(speeds)
    rows = np.array(positions + speeds + strains)
    return _CycleMatrix(rows, tuple(first + end for end in ends), first)


def _lag(axis: Axis, step: float, substeps: int) -> _Lag:
    omega = math.tau * axis.frequency_hz
    return _Lag(
        omega=omega,
        zeta=axis.damping,
        stiffness=omega * omega,
        friction=2.0 * axis.damping * omega,
        shift=2.0 * axis.damping / omega,
        limit=axis.acceleration_limit,
        dead_time=axis.dead_time_s,
        plan=_plan(axis, omega, step, substeps),
    )


def _plan(axis: Axis, omega: float, step: float, substeps: int) -> tuple[tuple[_Piece, ...], ...]:
    """Cut each substep, seen one dead time ago, at the node that may lie in it.

    Args:
        axis: with its dead time.
        step: length of a substep [s].

    Returns:
        One or two pieces a substep of the cycle.
    """
    whole = int(axis.dead_time_s / step + _TINY)
    rest = axis.dead_time_s - whole * step
    if rest < _TINY:
        rest = 0.0
    phi: Transition | None = None
    plan: list[tuple[_Piece, ...]] = []
    for part in range(substeps):
        cycle, offset = divmod(part - whole, substeps)
        if rest and offset == 0:
            left = step - rest
            before, behind = (solved(omega, axis.damping, t) for t in (rest, left))
            first = _Piece(1 - cycle, substeps * step - rest, rest, before)
            plan.append((first, _Piece(-cycle, 0.0, left, behind)))
        else:
            # A cycle of one substep is cut in each of them.
            phi = phi or solved(omega, axis.damping, step)
            plan.append((_Piece(-cycle, offset * step - rest, step, phi),))
    return tuple(plan)


def _shortened(lag: _Lag, piece: _Piece, length: float) -> _Piece:
    if length == piece.length:
        return piece
    return _Piece(piece.back, piece.since, length, transition(lag.omega, lag.zeta, length))


def _linear(
    lag: _Lag, piece: _Piece, slope: Value, u: Value, y: Value, v: Value
) -> tuple[Value, Value]:
    """Follow a line that begins at `u`, without limit."""
    _, _, length, (p11, p12, p21, p22) = piece
    lead = slope * lag.shift
    x, xv = y - u + lead, v - slope
    return p11 * x + p12 * xv + u + slope * length - lead, p21 * x + p22 * xv + slope


def _saturated(
    lag: _Lag, piece: _Piece, slope: float, u: float, y: float, v: float
) -> tuple[float, float]:
    dt = piece.length / _SLICES
    p11, p12, p21, p22 = transition(lag.omega, lag.zeta, dt)
    lead = slope * lag.shift
    for i in range(_SLICES):
        now = u + slope * (i * dt) - lead
        x, xv = y - now, v - slope
        wish = -(lag.stiffness * x + lag.friction * xv)
        if abs(wish) > lag.limit:
            a = math.copysign(lag.limit, wish)
            y, v = y + (v + 0.5 * a * dt) * dt, v + a * dt
        else:
            y = p11 * x + p12 * xv + now + slope * dt
            v = p21 * x + p22 * xv + slope
    return y, v
