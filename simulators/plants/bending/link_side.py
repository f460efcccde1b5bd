"""Link side of the arm: where the joints are when the motors are somewhere.

``link = motor + zero - windup - lost motion - torque * compliance``

Invariants:
    Hysteresis depends on the way, not on time, and each step of it is exact.
    ``at`` changes no state.
    Without any effect there is no ``LinkSide`` (``link_side`` returns None).
"""

import math
from dataclasses import replace

from linemate.simulators.plants.arm import Values, frames, link_constants
from linemate.simulators.plants.scenario import DenavitHartenbergLink, Robot
from linemate.simulators.plants.streams import stream

_GRAVITY = 9.81
_AXES = 6
_ELBOW = 3
"""Axes that carry the forearm; the upper arm hangs on one less."""


class LinkSide:
    """Joints on the link side of the gears, A1..A6 [rad], E1 [m]."""

    def __init__(self, robot: Robot, zero: Values, start: Values) -> None:
        effects = robot.effects
        self._zero = zero
        self._depths, self._travels = effects.windup.depth, effects.windup.travel
        self._gaps = tuple(0.5 * gap for gap in effects.lost_motion)
        self._elasticity = effects.elasticity
        self._is_elastic = any(effects.elasticity.compliance)
        self._arm = _Weights(robot)
        self._motor = start
        self._windup: Values = (0.0,) * _AXES
        self._play: Values = (0.0,) * _AXES
        self._speed: Values = (0.0,) * _AXES
        self._acceleration: Values = (0.0,) * _AXES

    def advance(self, motor: Values, velocities: Values, dt: float) -> Values:
        """Go to the motors' next positions.

        Args:
            motor: A1..A6 [rad], E1 [m].
            velocities: A1..A6 [rad/s], E1 [m/s], at these positions.
            dt: since the last step [s].

        Returns:
            Joints on the link side.
        """
        self._acceleration = tuple(
            (v - before) / dt for v, before in zip(velocities[:_AXES], self._speed, strict=True)
        )
        self._speed = velocities[:_AXES]
        self._windup, self._play = self._hysteresis(motor)
        self._motor = motor
        return self._placed(motor, self._windup, self._play)

    def at(self, motor: Values) -> Values:
        """Joints on the link side for motors that go on to ``motor`` from the last step."""
        return self._placed(motor, *self._hysteresis(motor))

    def _hysteresis(self, motor: Values) -> tuple[Values, Values]:
        """Windup and lost motion of each axis at the end of a way in one direction [rad]."""
        windups, plays = [], []
        for axis in range(_AXES):
            way = motor[axis] - self._motor[axis]
            depth, gap = self._depths[axis], self._gaps[axis]
            windup, play = self._windup[axis], self._play[axis]
            if depth and way:
                goal = math.copysign(depth, way)
                windup = goal + (windup - goal) * math.exp(-abs(way) / self._travels[axis])
            windups.append(windup)
            plays.append(min(max(play + way, -gap), gap))
        return tuple(windups), tuple(plays)

    def _placed(self, motor: Values, windup: Values, play: Values) -> Values:
        bent = self._bend(motor) if self._is_elastic else (0.0,) * _AXES
        joints = [motor[i] + self._zero[i] - windup[i] - play[i] - bent[i] for i in range(_AXES)]
        return (*joints, *motor[_AXES:])

    def _bend(self, motor: Values) -> Values:
        """Deflection of each gear under weight and acceleration [rad]."""
        elasticity, weights = self._elasticity, self._arm.moments(motor)
        return tuple(
            c * (weight + inertia * a)
            for c, weight, inertia, a in zip(
                elasticity.compliance, weights, elasticity.inertia, self._acceleration, strict=True
            )
        )


class _Weights:
    """Moments that the gears carry: weights of upper arm, forearm and hand."""

    def __init__(self, robot: Robot) -> None:
        self._links = link_constants(robot.links)
        self._masses = robot.effects.elasticity.masses
        self._unbalanced = 1.0 - robot.effects.elasticity.balanced

    def moments(self, joints: Values) -> Values:
        """Moment of the weights about each axis, in its sense of rotation [Nm].

        A moment is positive where the motor has to hold the arm by a positive torque.
        """
        origins, axes = frames(self._links, joints)
        _, (x1, y1, _), (x2, y2, _), _, (x4, y4, _), _, (hand_x, hand_y, _) = origins
        upper_x, upper_y = 0.5 * (x1 + x2), 0.5 * (y1 + y2)
        fore_x, fore_y = 0.5 * (x2 + x4), 0.5 * (y2 + y4)
        upper, fore, hand = self._masses
        moments = []
        for joint, ((px, py, _), (ax, ay, _)) in enumerate(zip(origins, axes, strict=False)):
            # The weight m g acts along -z: its moment about the axis is -(r x e_z) . a m g.
            moment = 0.0
            if joint < _ELBOW - 1:
                moment += upper * ((upper_y - py) * ax - (upper_x - px) * ay)
            if joint < _ELBOW:
                moment += fore * ((fore_y - py) * ax - (fore_x - px) * ay)
            moment += hand * ((hand_y - py) * ax - (hand_x - px) * ay)
            moments.append(_GRAVITY * moment)
        moments[1] *= self._unbalanced
        return tuple(moments)


def link_side(robot: Robot, seed: int) -> LinkSide | None:
    """Make the link side of an arm that starts at rest.

    Args:
        seed: of the run; it draws the zeros.

    Returns:
        None for an arm whose joints are where its motors are.
    """
    effects = robot.effects
    sigma = effects.geometry.zero_sigma
    is_bent = any(effects.windup.depth) or any(effects.lost_motion)
    if not (sigma or is_bent or any(effects.elasticity.compliance)):
        return None
    zero = (0.0,) * _AXES
    if sigma:
        draws = stream(seed, "robot.zero").standard_normal(_AXES).tolist()
        zero = tuple(sigma * float(draw) for draw in draws)
    return LinkSide(robot, zero, robot.start)


def true_links(robot: Robot, seed: int) -> tuple[DenavitHartenbergLink, ...]:
    """The table of the real arm, whose lengths and twists are not as the drawing says.

    Args:
        seed: of the run; it draws the errors of the table.
    """
    geometry = robot.effects.geometry
    length, angle = geometry.length_sigma, geometry.angle_sigma
    if not (length or angle):
        return robot.links
    draws = stream(seed, "robot.geometry").standard_normal((len(robot.links), 3)).tolist()
    return tuple(
        replace(link, a=link.a + length * a, d=link.d + length * d, alpha=link.alpha + angle * t)
        for link, (a, d, t) in zip(robot.links, draws, strict=True)
    )
