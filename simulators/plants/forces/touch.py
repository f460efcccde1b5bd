"""Contact of the free tool with bolts and flange: springs, dampers and friction.

The tool hangs in its mount (mass, damper and spring along and about each axis of the rigid tcp)
and meets points of the hub: bolt tips, edges of the holes, rim of the flange.

Invariants:
    Angles between tool and hub are small; larger ones are a miss before anything touches.
    The hub gets the tool's wrench with the opposite sign.
    Steps of at most 0.2 ms, semi-implicit, so that a contact adds no energy.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linemate.simulators.plants import rotation
from linemate.simulators.plants.forces.linear import for_both
from linemate.simulators.plants.forces.switches import Mating
from linemate.simulators.plants.rotation import Pose

Array = NDArray[np.float64]
Six = tuple[float, float, float, float, float, float]

MICRO_S = 0.0002
"""Longest step while something may touch [s]; the stiffest contact has a period of 20 ms."""

_NOTHING = np.zeros(6)
_SURE = 1e-9
"""Distance at which rounding errors make no contact [m]."""

_RIM_POINTS = 8
_SLIDING = 1e-3
"""Friction is proportional to the speed below this [m/s]."""


@dataclass(frozen=True, slots=True)
class Suspension:
    """The tool in its mount, along and about the axes of the rigid tcp, (6,) each."""

    mass: Array
    damping: Array
    stiffness: Array

    @classmethod
    def of(cls, stiffness: Six, frequency_hz: Six, damping: Six) -> "Suspension":
        """Work out mass and damper from what describes the modes."""
        k, omega = np.array(stiffness), math.tau * np.array(frequency_hz)
        return cls(k / omega**2, 2.0 * np.array(damping) * k / omega, k)


@dataclass(frozen=True, slots=True)
class Points:
    """Points of the tool: where they are in the tcp (3n,), and how they follow it (3n, 6)."""

    places: Array
    follows: Array

    def moved(self, tool: Array) -> Array:
        """Where they are for a small motion of the tool from the hub, (n, 3)."""
        return np.asarray((self.places + self.follows @ tool).reshape(-1, 3))

    def speeds(self, velocity: Array) -> Array:
        """How fast they are for a velocity of the tool, (n, 3)."""
        return np.asarray((self.follows @ velocity).reshape(-1, 3))

    def wrench(self, forces: Array) -> Array:
        """Sum of their forces (n, 3) about the tcp, (6,)."""
        return np.asarray(self.follows.T @ forces.ravel())


class Touch:
    """Bolts and flange of one hub.

    Attributes:
        entered: the bolts are in their holes.
        force: mean contact force on the tool in the last step, in the hub's axes [N, Nm], (6,).
        impulse: of all contact on the hub in the last step, in its axes [Ns, Nms], (6,).
        impulse_time: integral of that impulse over the step, (6,).
        expected: mean force on the hub in the step before; the hub's motion has it already, (6,).
        touching: something touched in the last step.
        give_way: returns the inverse mass of the hub in its axes, (6, 6); zeros for a hub that
            stands.
    """

    def __init__(self, mating: Mating, suspension: Suspension) -> None:
        if mating.angle is None:
            raise ValueError("the bolts' angle is open: sample the scenario first")
        self._mating, self._suspension = mating, suspension
        turns = math.tau * np.arange(mating.bolts) / mating.bolts
        self._holes = _circle(mating.bolt_circle, turns)
        bolts = _circle(mating.bolt_circle, turns + mating.angle)
        self._bolts = bolts.moved(np.zeros(6))
        self._rim = _circle(mating.flange, math.tau * np.arange(_RIM_POINTS) / _RIM_POINTS)
        mass = float(suspension.mass[:3].min())
        self._damper = 2.0 * mating.contact_damping * math.sqrt(mating.elasticity * mass)
        self.entered = False
        self.touching = False
        self.force = self.impulse = self.impulse_time = self.expected = _NOTHING
        self.give_way: Callable[[], Array] = lambda: np.zeros((6, 6))

    def begin(self, step_s: float) -> None:
        """Begin a step, in which nothing touches so far."""
        self.expected = self.impulse / step_s if self.touching else _NOTHING
        self.force = self.impulse = self.impulse_time = _NOTHING
        self.touching = False

    def leave(self, tool: Pose) -> None:
        """Note that the tool is out of reach, seen from the hub."""
        if tool[0][2] < -self._mating.bolt_length:
            self.entered = False

    def near(self, tool: Pose) -> bool:
        """Return whether tips or flange may touch the tool, seen from the hub, within a step."""
        x, y, z = tool[0]
        reach = self._mating.bolt_length + 0.005
        return -reach < z < 0.01 and math.hypot(x, y) < 0.02

    def advance(
        self, deflection: Six, velocity: Six, sag: Six, rigid: tuple[Pose, Pose], step_s: float
    ) -> tuple[Six, Six]:
        """Go on by one step.

        Args:
            deflection: of the mount, in the rigid tcp's axes at the beginning of the step.
            velocity: of the tool in the frame in which the hub stands, same axes.
            sag: deflection at which the mount carries the weight.
            rigid: rigid tcp seen from the hub, at the beginning and at the end.

        Returns:
            Deflection and velocity at the end, in the axes of the beginning.
        """
        first, last = (np.array((*p, *rotation.log(r))) for p, r in rigid)
        axes = for_both(np.array(rigid[0][1]).reshape(3, 3))
        count = max(1, math.ceil(step_s / MICRO_S - 1e-9))
        h, held = step_s / count, self._suspension
        drift = (last - first) / step_s
        d, w, rest = np.array(deflection), np.array(velocity), np.array(sag)
        moved, speed = np.zeros(6), np.zeros(6)
        total, lasting = np.zeros(6), np.zeros(6)
        give_way, expected = h * self.give_way(), self.expected
        seen, begun = axes.T @ drift, 0
        if not expected.any():
            begun, d, w = self._swing((first, drift, axes), (d, w, rest, seen), h, count)
        for k in range(begun, count):
            tool = first + drift * (k * h) + axes @ d - moved
            wrench = self._wrench(tool, axes @ w - speed)
            pull = -held.stiffness * (d - rest) - held.damping * (w - seen)
            w = w + h * (pull + axes.T @ wrench) / held.mass
            d = d + h * (w - seen)
            speed = speed - give_way @ (wrench + expected)
            moved = moved + h * speed
            total = total + h * wrench
            lasting = lasting + h * (total - 0.5 * h * wrench)
            self._enter(tool)
        self.force, self.impulse = total / step_s, -total
        self.impulse_time = -lasting
        self.touching = bool(total.any())
        return _six(d), _six(w)

    def _swing(
        self,
        tool: tuple[Array, Array, Array],
        state: tuple[Array, Array, Array, Array],
        h: float,
        count: int,
    ) -> tuple[int, Array, Array]:
        """Go on as ``advance`` does while surely nothing touches: plain floats, the same bits.

        Args:
            tool: where the rigid tcp is, its speed, and its axes in the hub's.
            state: deflection, velocity, deflection in rest, velocity of the rigid tcp, (6,) each.

        Returns:
            Steps done of ``count``, deflection and velocity.
        """
        held, (first, drift, axes) = self._suspension, tool
        d, w, rest, seen = (values.tolist() for values in state)
        modes = np.array((-held.stiffness, held.damping, held.mass, rest, seen)).T.tolist()
        (x, y, z, a, b, _), (vx, vy, vz, va, vb, _) = first.tolist(), drift.tolist()
        r0, r1, r2, r3, r4, r5, r6, r7, r8 = axes[:3, :3].ravel().tolist()
        outside: tuple[float, list[float]] | None = None
        done = 0
        while done < count:
            t, (dx, dy, dz, da, db, dc) = done * h, d
            depth = z + vz * t + (r6 * dx + r7 * dy + r8 * dz) + self._mating.bolt_length
            place = (
                x + vx * t + (r0 * dx + r1 * dy + r2 * dz),
                y + vy * t + (r3 * dx + r4 * dy + r5 * dz),
            )
            tilt = math.hypot(
                a + va * t + (r0 * da + r1 * db + r2 * dc),
                b + vb * t + (r3 * da + r4 * db + r5 * dc),
            )
            if not self._is_apart(depth, math.hypot(*place), tilt):
                break
            if depth < 0.0:
                outside = t, d
            elif outside is not None:  # the bolts' tips have passed the face
                break
            w = [
                v + h * (k * (p - hung) - c * (v - s)) / m
                for p, v, (k, c, m, hung, s) in zip(d, w, modes, strict=True)
            ]
            d = [p + h * (v - s) for p, v, s in zip(d, w, seen, strict=True)]
            done += 1
        if outside is not None:
            self._enter(first + drift * outside[0] + axes @ np.array(outside[1]))
        return done, np.array(d), np.array(w)

    def _is_apart(self, depth: float, lateral: float, tilt: float) -> bool:
        """Return whether surely nothing touches.

        Args:
            depth: of the bolts' tips behind the face of the hub [m].
            lateral: distance of the tool from the hub's axis [m].
            tilt: angle between the axes [rad].
        """
        mating = self._mating
        if depth + mating.bolt_circle * tilt < -_SURE:
            return True
        if depth < _SURE or not self.entered:
            return False
        play = mating.clearance + max(0.0, mating.chamfer - depth)
        flange = depth - mating.bolt_length + mating.flange * tilt
        return flange < -_SURE and lateral < play - _SURE

    def _enter(self, tool: Array) -> None:
        """Let the bolts into their holes when all of them are within the chamfer."""
        depth = tool[2] + self._mating.bolt_length
        if depth < 0.0:
            apart = self._holes.moved(tool) - self._bolts
            error = np.hypot(apart[:, 0], apart[:, 1]).max()
            self.entered = bool(error <= self._mating.chamfer + self._mating.clearance)

    def _wrench(self, tool: Array, velocity: Array) -> Array:
        """Contact wrench on the tool in the hub's axes, about the tcp, (6,)."""
        mating = self._mating
        if not self.entered:
            return self._pressed(self._holes, -mating.bolt_length, tool, velocity)
        wrench = self._pressed(self._rim, 0.0, tool, velocity)
        return wrench + self._guided(tool, velocity)

    def _pressed(self, points: Points, face: float, tool: Array, velocity: Array) -> Array:
        """Push points of the tool back that are behind a face of the hub, with friction."""
        depth = points.moved(tool)[:, 2] - face
        if not (depth > 0.0).any():
            return np.zeros(6)
        speeds = points.speeds(velocity)
        share = 1.0 / len(depth)
        normal = share * (self._mating.elasticity * depth + self._damper * speeds[:, 2])
        normal = np.where(depth > 0.0, np.maximum(normal, 0.0), 0.0)
        sliding = np.maximum(np.hypot(speeds[:, 0], speeds[:, 1]), _SLIDING)
        forces = -normal[:, None] * np.ones(3)
        forces[:, :2] *= self._mating.friction * speeds[:, :2] / sliding[:, None]
        return points.wrench(forces)

    def _guided(self, tool: Array, velocity: Array) -> Array:
        """Draw the tool to the middle: along the chamfer first, within the clearance then.

        The hub turns on its bearing, so that its bolts follow the holes once they are in.
        """
        mating = self._mating
        left = max(0.0, mating.chamfer - max(0.0, tool[2] + mating.bolt_length))
        size = float(np.hypot(tool[0], tool[1]))
        excess = size - mating.clearance - left
        if excess <= 0.0 or tool[2] + mating.bolt_length <= 0.0:
            return np.zeros(6)
        outward = tool[:2] / size
        normal = mating.elasticity * excess + self._damper * float(outward @ velocity[:2])
        normal = max(normal, 0.0)
        # A chamfer of 45 degrees pushes back as hard as it pushes aside; a hole only rubs.
        steep = 1.0 if left > 0.0 else 0.0
        rubbing = mating.friction * float(np.clip(velocity[2] / _SLIDING, -1.0, 1.0))
        force = (*(-normal * outward), -normal * (steep + rubbing))
        return np.array((*force, 0.0, 0.0, 0.0))


def _circle(radius: float, turns: Array) -> Points:
    """Points of the tool on a circle about its axis."""
    x, y, zero = radius * np.cos(turns), radius * np.sin(turns), np.zeros(len(turns))
    # Rotation vector cross (x, y, 0), coordinate by coordinate.
    lever = np.array(((zero, zero, -y), (zero, zero, x), (y, -x, zero))).transpose(2, 0, 1)
    still = np.broadcast_to(np.eye(3), lever.shape)
    follows = np.concatenate((still, lever), axis=2).reshape(-1, 6)
    return Points(np.column_stack((x, y, zero)).ravel(), follows)


def _six(values: Array) -> Six:
    x, y, z, a, b, c = values.tolist()
    return (x, y, z, a, b, c)
