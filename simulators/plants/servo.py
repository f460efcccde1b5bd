"""The axes' servos: interpolation over a cycle, dead time, second order lag, limited acceleration.

Law of this file: setpoints are nodes at cycle starts; between nodes the input is a straight line,
and each axis sees it exactly `dead_time_s` later, wherever that falls within a substep. A substep
is cut at the node it meets, and each piece is solved exactly. Only where the acceleration
saturates is a piece cut into sixteen, each with constant or with unlimited acceleration.
"""

import math
from typing import NamedTuple

from linemate.simulators.plants.oscillator import Transition, transition
from linemate.simulators.plants.scenario import Axis

_SLICES = 16
_TINY = 1e-9


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
        self._cycle = cycle_s
        self._substeps = substeps
        self._step = cycle_s / substeps
        self._lags = tuple(_lag(axis, self._step, substeps) for axis in axes)
        self._slots = 3 + max(piece.back for lag in self._lags for p in lag.plan for piece in p)
        self._nodes = [tuple(start)] * self._slots
        self._slopes = [(0.0,) * len(start)] * self._slots
        self._target = tuple(start)
        self._slack = min(axis.dead_time_s for axis in axes)
        self.positions = tuple(start)
        self.velocities = (0.0,) * len(start)

    def begin_cycle(self, cycle: int) -> None:
        """Arrive at a cycle's start: until a command comes, the last setpoint is held."""
        slot = cycle % self._slots
        self._nodes[slot] = self._target
        self._slopes[slot] = (0.0,) * len(self._target)

    def command(self, cycle: int, age: float, setpoints: tuple[float, ...]) -> None:
        """Set the setpoints that the given cycle moves to.

        Args:
            cycle: the present cycle.
            age: time since its start [s].
            setpoints: reached at the end of the cycle [rad, m].

        Raises:
            ValueError: when an axis has already moved on an input that this would change.
        """
        if age > self._slack + _TINY:
            raise ValueError(f"command {age} s after its cycle began: the motion has passed it")
        slot = cycle % self._slots
        begin = self._nodes[slot]
        self._slopes[slot] = tuple(
            (b - a) / self._cycle for a, b in zip(begin, setpoints, strict=True)
        )
        self._target = setpoints

    def setpoints(self, cycle: int, age: float) -> tuple[float, ...]:
        """The interpolated setpoints `age` after the start of the present cycle."""
        slot = cycle % self._slots
        return tuple(
            a + s * age for a, s in zip(self._nodes[slot], self._slopes[slot], strict=True)
        )

    def advance(self, index: int) -> None:
        """Integrate substep `index` (counted from the start of the run)."""
        cycle, part = divmod(index, self._substeps)
        nodes, slopes, slots = self._nodes, self._slopes, self._slots
        positions, velocities = [], []
        axis = 0
        for lag, y, v in zip(self._lags, self.positions, self.velocities, strict=True):
            for piece in lag.plan[part]:
                back, since, length, (p11, p12, p21, p22) = piece
                slot = (cycle - back) % slots
                slope = slopes[slot][axis]
                u = nodes[slot][axis] + slope * since
                lead = slope * lag.shift
                x, xv = y - u + lead, v - slope
                limit = lag.limit
                x1, xv1 = p11 * x + p12 * xv, p21 * x + p22 * xv
                if (
                    -limit <= lag.stiffness * x + lag.friction * xv <= limit
                    and -limit <= lag.stiffness * x1 + lag.friction * xv1 <= limit
                ):
                    y, v = x1 + u + slope * length - lead, xv1 + slope  # noqa: PLW2901
                else:
                    y, v = _saturated(lag, piece, slope, u, y, v)  # noqa: PLW2901
            positions.append(y)
            velocities.append(v)
            axis += 1  # noqa: SIM113
        self.positions, self.velocities = tuple(positions), tuple(velocities)

    def peek(self, index: int, dt: float) -> tuple[float, ...]:
        """Positions `dt` after the beginning of substep `index`, without advancing."""
        cycle, part = divmod(index, self._substeps)
        positions = []
        for axis, lag in enumerate(self._lags):
            y, v, left = self.positions[axis], self.velocities[axis], dt
            for piece in lag.plan[part]:
                if left <= 0.0:
                    break
                cut = _cut(lag, piece, min(left, piece.length))
                left -= piece.length
                slot = (cycle - piece.back) % self._slots
                slope = self._slopes[slot][axis]
                u = self._nodes[slot][axis] + slope * cut.since
                y, v = _solve(lag, cut, slope, u, y, v)
            positions.append(y)
        return tuple(positions)


def _lag(axis: Axis, step: float, substeps: int) -> _Lag:
    omega = math.tau * axis.frequency_hz
    plan = tuple(_pieces(axis, omega, step, substeps, part) for part in range(substeps))
    return _Lag(
        omega=omega,
        zeta=axis.damping,
        stiffness=omega * omega,
        friction=2.0 * axis.damping * omega,
        shift=2.0 * axis.damping / omega,
        limit=axis.acceleration_limit,
        dead_time=axis.dead_time_s,
        plan=plan,
    )


def _pieces(axis: Axis, omega: float, step: float, substeps: int, part: int) -> tuple[_Piece, ...]:
    """Cut one substep, seen one dead time ago, at the node that may lie in it.

    Args:
        axis: with its dead time.
        omega: natural frequency [rad/s].
        step: length of a substep [s].
        substeps: of a cycle.
        part: which substep of the cycle.

    Returns:
        One or two pieces.
    """
    whole = int(axis.dead_time_s / step + _TINY)
    rest = axis.dead_time_s - whole * step
    if rest < _TINY:
        rest = 0.0
    cycle, offset = divmod(part - whole, substeps)

    def piece(back: int, since: float, length: float) -> _Piece:
        return _Piece(back, since, length, transition(omega, axis.damping, length))

    if rest and offset == 0:
        return piece(1 - cycle, substeps * step - rest, rest), piece(-cycle, 0.0, step - rest)
    return (piece(-cycle, offset * step - rest, step),)


def _cut(lag: _Lag, piece: _Piece, length: float) -> _Piece:
    if length == piece.length:
        return piece
    return _Piece(piece.back, piece.since, length, transition(lag.omega, lag.zeta, length))


def _solve(
    lag: _Lag, piece: _Piece, slope: float, u: float, y: float, v: float
) -> tuple[float, float]:
    p11, p12, p21, p22 = piece.phi
    lead = slope * lag.shift
    x, xv = y - u + lead, v - slope
    x1, xv1 = p11 * x + p12 * xv, p21 * x + p22 * xv
    before = abs(lag.stiffness * x + lag.friction * xv)
    after = abs(lag.stiffness * x1 + lag.friction * xv1)
    if max(before, after) <= lag.limit:
        return x1 + u + slope * piece.length - lead, xv1 + slope
    return _saturated(lag, piece, slope, u, y, v)


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
