"""Mating of tool and hub: capture, clamp, screws, release and collision.

Invariants:
    A state machine over (tool, hub) at the ends of substeps; the effector integrates.
    Bits from the controller: 0 fix the screws, 1 release the wheel.
    Bits to the controller: 0 screws fixed, 1 wheel released.
    The first collision is kept with its time and reason.
"""

import math
import operator
from dataclasses import dataclass
from typing import Literal

from linemate.simulators.plants import rotation
from linemate.simulators.plants.effector import EffectorPlant, Six, deflected, deflection_between
from linemate.simulators.plants.forces.mating_plant import new_mating
from linemate.simulators.plants.rotation import Pose, Rot, Vec
from linemate.simulators.plants.scenario import Contact, Effector

Phase = Literal["free", "clamped", "released"]

FIX_SCREWS = 1
RELEASE_WHEEL = 2
SCREWS_FIXED = 1
WHEEL_RELEASED = 2

_TINY = 1e-9


@dataclass(frozen=True, slots=True)
class Impact:
    """The instant at which the tcp reached the hub plane.

    Attributes:
        position: elastic tcp in the hub frame [m]; z is 0 there, or where the clamp takes it.
        rotation: elastic tcp in the hub frame, rotation vector [rad].
        speed: closing speed along the hub's z [m/s].
    """

    time_s: float
    position: Vec
    rotation: Vec
    speed: float


@dataclass(frozen=True, slots=True)
class Collision:
    """What went wrong, when, and with what figures."""

    time_s: float
    reason: str


class ContactPlant:
    """What tool and hub do to each other."""

    def __init__(self, contact: Contact, effector: Effector | None = None) -> None:
        """Keep the parts that mate.

        Args:
            effector: the mount; without it the contact has no forces of bolts and flange.
        """
        self._contact = contact
        self.mating = None if effector is None else new_mating(contact, effector)
        self._tear_off = contact.mating.tear_off
        self._stiffness = (0.0,) * 3 if effector is None else effector.stiffness[:3]
        self._whole_step = rotation.exp(contact.step)
        self.phase: Phase = "free"
        self.impact: Impact | None = None
        self.collision: Collision | None = None
        self.clamped_s: float | None = None
        self.fixed_s: float | None = None
        self.released_s: float | None = None
        self._orders = 0
        self._screwing_s: float | None = None
        self._releasing_s: float | None = None
        self._caught: tuple[Vec, Vec] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        # The tool off the hub a substep ago, in base, and the hub's orientation then.
        self._before: tuple[Vec, Rot] | None = None
        self._cleared = False

    def order(self, bits: int) -> None:
        """Take the controller's bits; they count from the next substep on."""
        self._orders = bits

    @property
    def signals(self) -> int:
        """The tool's bits to the controller."""
        fixed = SCREWS_FIXED if self.fixed_s is not None else 0
        return fixed | (WHEEL_RELEASED if self.released_s is not None else 0)

    @property
    def caught(self) -> tuple[Vec, Vec]:
        """Where the clamp caught the hub: tcp in the hub frame, position and rotation vector."""
        return self._caught

    def turned(self, hub: Pose, t: float) -> Pose:
        """The hub at time t with the step that the tight screws gave it."""
        if self._screwing_s is None:
            return hub
        age = t - self._screwing_s - self._contact.nutrunner_s
        if age <= 0.0:
            return hub
        if age >= self._contact.step_s:
            return hub[0], rotation.compose(hub[1], self._whole_step)
        share = age / self._contact.step_s
        x, y, z = self._contact.step
        step = rotation.exp((share * x, share * y, share * z))
        return hub[0], rotation.compose(hub[1], step)

    def advance(
        self, t: float, dt: float, effector: EffectorPlant, before: Pose, rigid: Pose, hub: Pose
    ) -> None:
        """One substep that ends at t.

        Args:
            t: scenario time at its end [s].
            effector: integrated here, freely or held.
            before: rigid tcp at its beginning.
            rigid: rigid tcp at its end.
            hub: hub at its end, the screws' step included.
        """
        if self.mating is not None:
            self.mating.touch.begin(dt)
        if self._screwing_s is not None and self.fixed_s is None:
            self._tighten(t, self._screwing_s)
        if self.phase == "clamped":
            self._hold(t, effector, before, rigid, hub)
            if self.phase != "clamped":
                effector.drop_wheel()
            return
        if self.mating is not None and self._touches(t, dt, effector, before, rigid, hub):
            return
        effector.swing_free(before, rigid)
        if self.collision is None:
            self._watch(t, dt, rigid, effector.deflection, hub)

    def held_deflection(self, t: float, rigid: Pose, hub: Pose) -> Six:
        """Deflection of the clamped tool; the clamp closes from where it caught the hub."""
        age = t - (self.clamped_s if self.clamped_s is not None else t)
        share = max(0.0, 1.0 - age / self._contact.close_s) if self._contact.close_s > 0 else 0.0
        if share == 0.0:
            return deflection_between(rigid, hub)
        (x, y, z), (a, b, c) = self._caught
        turned = rotation.exp((share * a, share * b, share * c))
        return deflection_between(
            rigid, rotation.multiply(hub, ((share * x, share * y, share * z), turned))
        )

    def _hold(
        self, t: float, effector: EffectorPlant, before: Pose, rigid: Pose, hub: Pose
    ) -> None:
        deflection = self.held_deflection(t, rigid, hub)
        effector.hold(before, rigid, deflection)
        # The mount is sized for the weight that it carries: only what is added overloads it.
        x, y, z, a, b, c = map(operator.sub, deflection, effector.sag(rigid))
        bent, twisted = rotation.norm((x, y, z)), rotation.norm((a, b, c))
        if self._tears(t, (x, y, z)):
            return
        if bent > self._contact.deflection_limit or twisted > self._contact.deflection_angle_limit:
            self._collide(t, f"mount overloaded: {_figures(bent, twisted)}")
            self._open(t)
            return
        self._work(t)

    def _tears(self, t: float, bent: Vec) -> bool:
        """Tear the wheel off the clamp where the contact force is beyond its strength."""
        if not self._tear_off:
            return False
        force = rotation.norm(tuple(map(operator.mul, bent, self._stiffness)))
        if force <= self._tear_off:
            return False
        self._collide(t, f"wheel torn off: {force:.0f} N, limit {self._tear_off:.0f} N")
        self._open(t)
        return True

    def _touches(
        self, t: float, dt: float, effector: EffectorPlant, before: Pose, rigid: Pose, hub: Pose
    ) -> bool:
        """One substep in reach of bolts and flange; False if the tool swings freely."""
        mating = self.mating
        if mating is None or self.phase != "free" or self.collision is not None:
            return False
        if not mating.advance(dt, effector, before, rigid, hub):
            return False
        (place, turned), contact = mating.tool, self._contact
        self._before = (rotation.apply(hub[1], place), hub[1])
        bent = tuple(map(operator.sub, effector.deflection, effector.sag(rigid)))
        lateral, twist = math.hypot(place[0], place[1]), rotation.angle(turned)
        if mating.arrived and (lateral > contact.capture_lateral or twist > contact.capture_angle):
            self._collide(t, f"missed the hub: {_figures(lateral, twist)}")
        elif mating.touching and rotation.norm(bent[:3]) > contact.deflection_limit:
            length = rotation.norm(bent[:3])
            self._collide(t, f"mount overloaded before the clamp closed: {1e3 * length:.1f} mm")
        elif mating.seated:
            self.impact = Impact(t, place, rotation.log(turned), mating.speed)
            self.phase = "clamped"
            self.clamped_s = t
            self._caught = (place, self.impact.rotation)
        return True

    def _work(self, t: float) -> None:
        """Start and stop the tool's timers as the controller's bits say."""
        if self._orders & FIX_SCREWS:
            if self._screwing_s is None:
                self._screwing_s = t
        else:
            self._stop_nutrunner(t)
        if not self._orders & RELEASE_WHEEL:
            self._releasing_s = None
            return
        if self._releasing_s is None:
            self._releasing_s = t
        if t - self._releasing_s >= self._contact.release_s - _TINY:
            self._open(t)

    def _tighten(self, t: float, begun_s: float) -> None:
        done = begun_s + self._contact.nutrunner_s + self._contact.step_s
        if t >= done - _TINY:
            self.fixed_s = t

    def _stop_nutrunner(self, t: float) -> None:
        # Once the wheel begins to seat itself, the screws hold whatever is ordered.
        if self._screwing_s is not None and t < self._screwing_s + self._contact.nutrunner_s:
            self._screwing_s = None

    def _open(self, t: float) -> None:
        self._stop_nutrunner(t)
        self.phase = "released"
        self.released_s = t

    def _watch(self, t: float, dt: float, rigid: Pose, deflection: Six, hub: Pose) -> None:
        """Judge the free tool: does it reach the hub plane, where, and how?"""
        (px, py, pz), (r0, r1, r2, r3, r4, r5, r6, r7, r8) = rigid
        (hx, hy, hz), turn = hub
        dx, dy, dz, *_ = deflection
        away = (
            px + (r0 * dx + r1 * dy + r2 * dz) - hx,
            py + (r3 * dx + r4 * dy + r5 * dz) - hy,
            pz + (r6 * dx + r7 * dy + r8 * dz) - hz,
        )
        before, self._before = self._before, (away, turn)
        depth = turn[2] * away[0] + turn[5] * away[1] + turn[8] * away[2]
        # Before the hub plane there is nothing that a tool could hit.
        if self.phase == "released" and not self._cleared:
            self._watch_clearing(t, rotation.unapply(turn, away))
        elif depth >= 0.0:
            self._pass_plane(t, dt, before, (rotation.unapply(turn, away), turn), rigid, deflection)

    def _watch_clearing(self, t: float, tcp: Vec) -> None:
        """Judge the tool that was just released and has to get away."""
        contact, (x, y, z) = self._contact, tcp
        lateral = math.hypot(x, y)
        if z > contact.deflection_limit:
            self._collide(t, f"pushed into the hub after release by {1e3 * z:.1f} mm")
        elif lateral > contact.drag_limit:
            self._collide(t, f"dragged along the hub after release by {1e3 * lateral:.1f} mm")
        self._cleared = z < -contact.clearance

    def _pass_plane(
        self,
        t: float,
        dt: float,
        earlier: tuple[Vec, Rot] | None,
        tcp: tuple[Vec, Rot],
        rigid: Pose,
        deflection: Six,
    ) -> None:
        """Judge a tool behind the hub plane.

        Args:
            dt: length of the substep [s].
            earlier: the tool off the hub a substep ago, in base, and the hub's orientation then.
            tcp: the tool in the hub's frame, and the hub's orientation.
        """
        (x, y, _), turn = tcp
        lateral = math.hypot(x, y)
        if lateral > self._contact.hub_radius:
            return
        turned = rotation.between(turn, deflected(rigid, deflection)[1])
        twist = rotation.angle(turned)
        before = None if earlier is None else rotation.unapply(earlier[1], earlier[0])
        if before is None or before[2] >= 0.0:
            self._collide(t, f"hit the hub from the side: {_figures(lateral, twist)}")
            return
        self._reach(t, dt, before, (tcp[0], turned), twist)

    def _reach(self, t: float, dt: float, before: Vec, tcp: Pose, twist: float) -> None:
        (x, y, z), turned = tcp
        share = before[2] / (before[2] - z)
        at = (before[0] + share * (x - before[0]), before[1] + share * (y - before[1]), 0.0)
        when = t - dt * (1.0 - share)
        impact = Impact(when, at, rotation.log(turned), (z - before[2]) / dt)
        lateral = math.hypot(at[0], at[1])
        figures = _figures(lateral, twist)
        if self.phase == "released":
            self._collide(when, f"hit the hub again after release: {figures}")
            return
        self.impact = impact
        if lateral > self._contact.capture_lateral or twist > self._contact.capture_angle:
            self._collide(when, f"missed the hub: {figures}")
            return
        self.phase = "clamped"
        self.clamped_s = t
        self._caught = (tcp[0], impact.rotation)

    def _collide(self, t: float, reason: str) -> None:
        self.collision = Collision(t, reason)


def _figures(length: float, turn: float) -> str:
    return f"{1e3 * length:.1f} mm, {1e3 * turn:.1f} mrad"
