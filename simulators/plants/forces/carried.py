"""Two-way contact of the car in its carrier with the tool that the clamp holds.

Invariants:
    The caller, who advances the world, calls ``hub`` and then ``settle``, once a substep.
    The mount's force on tool and car is the one on the robot, with the opposite sign.
"""

import math
from collections.abc import Callable

import numpy as np

from linemate.simulators.plants import rotation
from linemate.simulators.plants.body import C_IN_BASE
from linemate.simulators.plants.contact_plant import ContactPlant
from linemate.simulators.plants.effector import EffectorPlant
from linemate.simulators.plants.forces import linear
from linemate.simulators.plants.forces.carrier import CarrierPlant, Mount, swayed
from linemate.simulators.plants.forces.linear import Array
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Scenario

_TINY = 1e-9
_TO_C = linear.for_both(np.array(C_IN_BASE).reshape(3, 3).T)


class CarriedBody:
    """Hub of a car whose carrier sways and gives way."""

    def __init__(
        self,
        scenario: Scenario,
        speeds: Callable[[Array], Array],
        start_s: float,
        step_s: float,
        contact: ContactPlant,
        effector: EffectorPlant,
    ) -> None:
        """Keep the parts of a world.

        Args:
            speeds: of the conveyor at ascending scenario times, (n,) [m/s].
        """
        self._carrier = CarrierPlant(scenario.body.carrier, speeds, start_s, step_s)
        self._contact, self._effector, self._h = contact, effector, step_s
        self._close_s = scenario.contact.close_s
        stiffness = np.array(scenario.effector.stiffness)
        omega = math.tau * np.array(scenario.effector.frequency_hz)
        zeta = np.array(scenario.effector.damping)
        self._values = (stiffness / omega**2, 2.0 * zeta * stiffness / omega, stiffness)
        self._mount: Mount | None = None
        self._closing: Array | None = None
        self._before: Pose | None = None

    @property
    def sway(self) -> Array:
        """Displacement [m] and rotation [rad] of the hub by the carrier in c, now, (6,)."""
        return self._carrier.sway

    @property
    def energy(self) -> float:
        """Work that the robot has done on the car in contact, relative to the conveyor [J]."""
        return self._carrier.energy

    def hub(self, t: float, rigid: Pose, unmoved: Pose) -> Pose:
        """Go on to the next grid point.

        Args:
            t: scenario time there [s].
            rigid: tcp there without elasticity.
            unmoved: hub there if the carrier did not move.

        Returns:
            The hub there, without the step of the screws.
        """
        self._carrier.advance(self._pull(t, rigid, unmoved))
        hub = swayed(unmoved, self._carrier.sway)
        mating = self._contact.mating
        if mating is not None and self._carrier.yields:
            mating.touch.give_way = lambda: self._carrier.inverse_mass(_to_c(hub))
        return hub

    def foresee(self, times: Array) -> None:
        """Compute at once what ``hub_within`` needs of the conveyor at ascending times, (n,)."""
        self._carrier.foresee(times)

    def hub_within(self, t: float, rigid: Pose, unmoved: Pose) -> Pose:
        """The hub within the substep that comes next; arguments as for ``hub``."""
        return swayed(unmoved, self._carrier.peek(t, self._pull(t, rigid, unmoved)))

    def hub_at(self, t: float, unmoved: Pose) -> Pose:
        """The hub at any time; in the future without a force of contact."""
        return swayed(unmoved, self._carrier.at(t))

    def settle(self, t: float, rigid: Pose, hub: Pose, unmoved: Pose) -> Pose:
        """Exchange momentum as the clamp has caught, closed or opened at the grid point.

        Args:
            hub: hub there, as the contact saw it.
            unmoved: hub there if the carrier did not move.

        Returns:
            The hub after that.
        """
        before, self._before = self._before, unmoved
        hub = self._strike(t, hub, unmoved) if self._carrier.yields else hub
        carrier, clamped = self._carrier, self._contact.phase == "clamped"
        if clamped and carrier.yields and not carrier.held:
            self._mount = Mount.at(rigid, *self._values)
            self._closing = self._closing_velocity(hub)
            still = np.zeros(6) if before is None else _velocity(before, unmoved, self._h)
            tool = self._mount.axes @ np.array(self._effector.velocity)
            carrier.seize(self._mount, tool - still - self._closing)
        elif carrier.held and not clamped:
            carrier.let_go()
        elif self._closing is not None and self._mount is not None and self._is_closed(t):
            carrier.push(self._mount, self._closing)
            self._closing = None
        if carrier.held:
            carrier.begin_pull(np.subtract(self._effector.deflection, self._effector.sag(rigid)))
        return hub

    def _strike(self, t: float, hub: Pose, unmoved: Pose) -> Pose:
        """Let the hub give way to what touched it in the step that has ended."""
        mating = self._contact.mating
        if mating is None or not (mating.touching or self._carrier.expects):
            return hub
        to_c, touch = _to_c(hub), mating.touch
        self._carrier.strike(to_c @ touch.impulse, to_c @ touch.impulse_time)
        hub = self._contact.turned(swayed(unmoved, self._carrier.sway), t)
        mating.correct(hub)
        return hub

    def _pull(self, t: float, rigid: Pose, unmoved: Pose) -> Array | None:
        if not self._carrier.held:
            return None
        hub = self._contact.turned(swayed(unmoved, self._carrier.sway), t)
        held = self._contact.held_deflection(t, rigid, hub)
        return np.asarray(np.subtract(held, self._effector.sag(rigid)))

    def _is_closed(self, t: float) -> bool:
        caught = self._contact.clamped_s
        return caught is not None and t >= caught + self._close_s - _TINY

    def _closing_velocity(self, hub: Pose) -> Array:
        """Velocity of the tool against the hub while the clamp closes, in c, (6,)."""
        place, turn = self._contact.caught
        return np.asarray(-(_to_c(hub) @ np.array((*place, *turn))) / self._close_s)


def _to_c(hub: Pose) -> Array:
    """Axes of the hub in c, for vectors of six, (6, 6)."""
    return np.asarray(_TO_C @ linear.for_both(np.array(hub[1]).reshape(3, 3)))


def _velocity(before: Pose, after: Pose, dt: float) -> Array:
    """Mean velocity from one pose in base to the next, in c, (6,)."""
    turned = rotation.apply(before[1], rotation.log(rotation.between(before[1], after[1])))
    moved = np.subtract(after[0], before[0])
    return np.asarray(_TO_C @ np.concatenate((moved, turned)) / dt)
