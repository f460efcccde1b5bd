"""Tool in front of bolts and flange, before the clamp closes.

Invariants:
    It is integrated here alone while it is in reach; everywhere else it swings freely.
    Between grid points the mount is seen without the force of the touch.
"""

import operator

import numpy as np

from linemate.simulators.plants import rotation
from linemate.simulators.plants.effector import EffectorPlant, deflected
from linemate.simulators.plants.forces.touch import Six, Suspension, Touch
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Contact, Effector


class MatingPlant:
    """Tool and hub in reach of each other.

    Attributes:
        touch: forces of the contact.
        tool: tool seen from the hub at the last grid point.
        speed: at which it goes towards the hub there [m/s].
        arrived: it came to the bolts' tips in the last step.
    """

    def __init__(self, contact: Contact, effector: Effector) -> None:
        self._mating = contact.mating
        described = effector.stiffness, effector.frequency_hz, effector.damping
        self.touch = Touch(contact.mating, Suspension.of(*described))
        self.tool: Pose = ((0.0, 0.0, -np.inf), rotation.IDENTITY)
        self.speed = 0.0
        self.arrived = False
        self._hub: Pose | None = None

    @property
    def touching(self) -> bool:
        """Something touched in the last step."""
        return self.touch.touching

    @property
    def seated(self) -> bool:
        """The bolts are in, and the flange is as near as the clamp reaches."""
        return self.touch.entered and self.tool[0][2] >= -self._mating.seat

    def correct(self, hub: Pose) -> None:
        """Set where the hub came to, after it gave way to the last step's force."""
        self._hub = hub

    def advance(
        self, dt: float, effector: EffectorPlant, before: Pose, rigid: Pose, hub: Pose
    ) -> bool:
        """Go on by one substep; arguments as for the contact. False if nothing is in reach."""
        earlier, self._hub = self._hub, hub
        if earlier is None:
            return False
        tool = rotation.relative(earlier, deflected(before, effector.deflection))
        if not self.touch.near(tool):
            self.touch.leave(tool)
            return False
        moved = _seen(before, earlier, hub, dt)
        ways = rotation.relative(earlier, before), rotation.relative(hub, rigid)
        velocity = _six(map(operator.sub, effector.velocity, moved))
        sag = effector.sag(before)
        bent, velocity = self.touch.advance(effector.deflection, velocity, sag, ways, dt)
        effector.strike(before, rigid, bent, _six(map(operator.add, velocity, moved)))
        self.tool = rotation.relative(hub, deflected(rigid, effector.deflection))
        self.speed = (self.tool[0][2] - tool[0][2]) / dt
        tips = -self._mating.bolt_length
        self.arrived = tool[0][2] < tips <= self.tool[0][2]
        return True


def new_mating(contact: Contact, effector: Effector) -> MatingPlant | None:
    """Make the bolts and the flange; None if the clamp catches at once."""
    return MatingPlant(contact, effector) if contact.mating.bolts else None


def _seen(rigid: Pose, before: Pose, after: Pose, dt: float) -> Six:
    """Velocity of the hub from one pose to the next, along and about the axes of the tcp."""
    moved = np.subtract(after[0], before[0]) / dt
    turned = rotation.apply(before[1], rotation.log(rotation.between(before[1], after[1])))
    axes = np.array(rigid[1]).reshape(3, 3).T
    return _six((*(axes @ moved), *(axes @ np.array(turned) / dt)))


def _six(values: object) -> Six:
    x, y, z, a, b, c = map(float, values)  # type: ignore[call-overload]
    return (x, y, z, a, b, c)
