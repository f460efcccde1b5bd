"""Drives of a real arm: friction on top of the servos, servos that vary, a controller that warms.

Invariants:
    Friction adds to the linear servo's motion: both are solved by themselves and summed.
    Without an effect ``drives`` returns the plain ``ServoBank``.
"""

import math
from collections.abc import Callable
from operator import add

from linemate.simulators.plants.arm import Values, frames, link_constants
from linemate.simulators.plants.bending.effects_arm import Friction
from linemate.simulators.plants.oscillator import transition
from linemate.simulators.plants.scenario import Axis, Robot
from linemate.simulators.plants.servo_plant import ServoBank, VaryingServoBank


class _Rub:
    """Friction of one axis.

    Attributes:
        q, v: motion it adds to the servo's [rad], [rad/s].
    """

    def __init__(self, axis: Axis, coulomb: float, friction: Friction) -> None:
        self._omega, self._zeta = math.tau * axis.frequency_hz, axis.damping
        self._coulomb, self._friction = coulomb, friction
        self.q = self.v = 0.0
        self._state = 0.0
        self._removed = 0.0

    def moved(self, way: float, speed: float, dt: float) -> tuple[float, float, float, float]:
        """Position, speed, friction and what is removed of it, after a way of the motor."""
        if not self._coulomb:
            return 0.0, 0.0, 0.0, 0.0
        f = self._friction
        slow = math.exp(-((speed / f.stribeck_speed) ** 2))
        goal = math.copysign(self._coulomb * (1.0 + f.breakaway * slow), way)
        state = goal + (self._state - goal) * math.exp(-abs(way) / f.presliding)
        removed = self._removed
        if f.recovery_s:
            removed = state + (removed - state) * math.exp(-dt / f.recovery_s)
        rest = removed - state
        p11, p12, p21, p22 = transition(self._omega, self._zeta, dt)
        off = self.q - rest
        return p11 * off + p12 * self.v + rest, p21 * off + p22 * self.v, state, removed

    def advance(self, way: float, speed: float, dt: float) -> None:
        """Go a way with the motor."""
        self.q, self.v, self._state, self._removed = self.moved(way, speed, dt)


class RoughServos:
    """A servo bank whose axes rub."""

    def __init__(
        self, bank: ServoBank, axes: tuple[Axis, ...], friction: Friction, step_s: float
    ) -> None:
        self._bank, self._step = bank, step_s
        self._rubs = [
            _Rub(axis, coulomb, friction)
            for axis, coulomb in zip(axes, friction.coulomb, strict=True)
        ]
        self.begin_cycle = bank.begin_cycle
        self.command = bank.command
        self.positions, self.velocities = bank.positions, bank.velocities

    def advance(self, index: int) -> None:
        """Integrate substep `index` (counted from the start of the run)."""
        before = self._bank.positions
        self._bank.advance(index)
        motions = zip(self._rubs, before, self._bank.positions, self.velocities, strict=True)
        for rub, old, new, speed in motions:
            rub.advance(new - old + rub.v * self._step, speed, self._step)
        self.positions = tuple(map(add, self._bank.positions, [rub.q for rub in self._rubs]))
        self.velocities = tuple(map(add, self._bank.velocities, [rub.v for rub in self._rubs]))

    def peek(self, index: int, dt: float) -> Values:
        """Positions `dt` after the beginning of substep `index`, without advancing."""
        later, before = self._bank.peek(index, dt), self._bank.positions
        motions = zip(self._rubs, before, later, self.velocities, strict=True)
        return tuple(
            new + rub.moved(new - old + rub.v * dt, speed, dt)[0]
            for rub, old, new, speed in motions
        )


def _varied(robot: Robot) -> Callable[[float, Values], tuple[Axis, ...]]:
    """Make the axes for a time and positions."""
    posture, warming = robot.effects.posture, robot.effects.warming
    links = link_constants(robot.links)

    def vary(time_s: float, positions: Values) -> tuple[Axis, ...]:
        x, y, _ = frames(links, positions)[0][-1]
        share = 1.0 - posture.frequency_share * (math.hypot(x, y) - posture.reach)
        sine = math.sin(math.tau * time_s / posture.dead_time_period_s)
        warm = min(max((time_s - warming.begin_s) / warming.duration_s, 0.0), 1.0)
        later = posture.dead_time_amplitude * sine + warming.growth_s * warm
        return tuple(
            Axis(
                share * axis.frequency_hz,
                axis.damping,
                axis.dead_time_s + later,
                axis.acceleration_limit,
                axis.encoder_sigma,
            )
            for axis in robot.axes
        )

    return vary


def drives(robot: Robot, cycle_s: float, substeps: int) -> "ServoBank | RoughServos":
    """Make the servos of a robot that stands at its start."""
    effects = robot.effects
    amplitude, growth = effects.posture.dead_time_amplitude, effects.warming.growth_s
    if effects.posture.frequency_share or amplitude or growth:
        bank: ServoBank = VaryingServoBank(
            robot.axes, robot.start, cycle_s, substeps, _varied(robot), (amplitude, growth)
        )
    else:
        bank = ServoBank(robot.axes, robot.start, cycle_s, substeps)
    if any(effects.friction.coulomb):
        return RoughServos(bank, robot.axes, effects.friction, cycle_s / substeps)
    return bank
