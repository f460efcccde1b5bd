"""Whether the tool touches: the force along its axis, less what a tool that rings feels in the air.

Law of this file: pure, plain floats. A tool on an elastic mount rings for seconds once it was
kicked, with more force than a contact's: a robot that held for one cycle at 0.5 rad/s, because a
reply came late, left 100 N behind. Half a period ago that force was the opposite one, so the sum of
both is free of it; what presses for longer (gravity, a bias) is the mean of the period before that.
A contact, which was there at neither time, shows at once and in full.

Replies that are lost again and again leave no such time: each lost one kicks the tool. Then a
contact is a force that stays on one side of the free tool's mean for a full period. A tool that
rings changes its side twice in a period, however often it is kicked.
"""

import math
from dataclasses import dataclass

from msgspec import Struct

TOUCHES = 2  # steps in a row that make a contact
NEAR = 0.008  # least distance before the object from which a force may be a contact [m]
MARGIN = 0.003  # or this much before the approach is slow: an object that is nearer still [m]

# An object pushes a tool back. So many times the force the other way is a contact too: the sensor's
# axis may be wrong, and the tool must not press on.
PULL = 3.0


@dataclass(frozen=True, slots=True)
class Ringing:
    """The tool's mode along its own axis, in steps.

    Attributes:
        half: half a period, in steps and parts of one.
        kept: share of a deflection that is left after half a period, with its sign turned.
        force: what counts as contact [N].
        mass: of the tool, on its mount's stiffness [kg].
    """

    half: float
    kept: float
    force: float
    mass: float = 0.0

    @property
    def memory(self) -> int:
        """Forces that are remembered: half a period, the period before it, and the newest."""
        return math.ceil(self.half) + self.period + 1

    @property
    def period(self) -> int:
        """Steps of a full period."""
        return math.ceil(2.0 * self.half)


def ringing(
    frequency_hz: float, damping: float, stiffness: float, force: float, cycle_s: float
) -> Ringing:
    """Return the mode as the steps see it.

    Args:
        frequency_hz: of the mode along the tool's axis.
        damping: of it, as a share of critical.
        stiffness: of the mount along that axis [N/m].
        force: what counts as contact [N].
        cycle_s: T0 [s].
    """
    half = 0.5 / (frequency_hz * cycle_s)
    kept = math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
    return Ringing(half, kept, force, stiffness / (2.0 * math.pi * frequency_hz) ** 2)


class Feeling(Struct, frozen=True):
    """What the tool has felt.

    Attributes:
        forces: along its axis, the newest last, one a step, without those that accelerate it [N].
        calm: steps since the robot last held against its command, as far as memory goes.
        touches: steps in a row with a contact's force.
        free: mean force of the last full period before the tool came near the object [N]; None
            while less is known.
    """

    forces: tuple[float, ...] = ()
    calm: int = 0
    touches: int = 0
    free: float | None = None


NOTHING = Feeling()


def feel(
    feeling: Feeling, ringing: Ringing, force: float | None, acceleration: float, *, held: bool
) -> Feeling:
    """Return the feeling one step later.

    Args:
        force: along its axis [N], None if none was measured: then it is what it was.
        acceleration: planned, along its axis [m/s^2]. The force that accelerates the tool is
            no contact.
        held: the robot did not get the last command and held.
    """
    forces = feeling.forces
    newest = forces[-1] if forces else None
    if force is not None:
        newest = force + ringing.mass * acceleration
    if newest is not None:
        forces = (*forces, newest)[-ringing.memory :]
    calm = 0 if held else min(feeling.calm + 1, ringing.memory)
    return Feeling(forces, calm, feeling.touches, feeling.free)


def can_feel(feeling: Feeling, ringing: Ringing) -> bool:
    """Return whether the forces go back far enough to tell a contact from ringing."""
    return len(feeling.forces) >= ringing.memory and feeling.calm >= ringing.memory


def presses(feeling: Feeling, ringing: Ringing) -> bool:
    """Tell whether the tool feels a contact.

    As long as it remembers the time before the robot held nothing is said: then it did not ring.
    """
    forces = feeling.forces
    if not can_feel(feeling, ringing):
        return False
    whole, part = divmod(ringing.half, 1.0)
    ago = -1 - int(whole)
    opposite = forces[ago] + part * (forces[ago - 1] - forces[ago])
    pair = forces[-1] + ringing.kept * opposite
    before = sum(forces[: ringing.period]) / ringing.period
    # The mean of the period before is off for a tool that began to ring in it, and the mean of the
    # free tool for one that was kicked then. A contact shows against both.
    means = (before,) if feeling.free is None else (before, feeling.free)
    pushes = [pair - (1.0 + ringing.kept) * mean for mean in means]
    return max(pushes) < -ringing.force or min(pushes) > PULL * ringing.force


def presses_for_long(feeling: Feeling, ringing: Ringing) -> bool:
    """Return whether a contact's force has been on one side for a full period."""
    free, newest = feeling.free, feeling.forces[-ringing.period :]
    if free is None or len(newest) < ringing.period:
        return False
    return min(newest) > free + ringing.force or max(newest) < free - ringing.force


def touched(feeling: Feeling, ringing: Ringing, distance: float, near: float) -> Feeling:
    """Return the feeling with its touches counted.

    Args:
        distance: programmed, to the object [m].
        near: distance before the object from which a force may be a contact [m].
    """
    forces, free = feeling.forces, feeling.free
    # Beyond the estimated object too: the tool may search for it there.
    if not -near < distance < math.inf:
        if len(forces) >= ringing.period:
            free = sum(forces[-ringing.period :]) / ringing.period
        return Feeling(forces, feeling.calm, 0, free)
    is_pressed = presses(feeling, ringing) or presses_for_long(feeling, ringing)
    return Feeling(forces, feeling.calm, feeling.touches + 1 if is_pressed else 0, free)


def assumed(feeling: Feeling, distance: float, *, is_due: bool) -> Feeling:
    """Return the feeling of a tool without a force sensor: it touches at its place.

    Args:
        distance: programmed, to the object [m].
        is_due: the programme has reached its waypoint of contact and the clamp may be closed.
    """
    near = is_due and -NEAR < distance < math.inf
    return Feeling(feeling.forces, feeling.calm, feeling.touches + 1 if near else 0, feeling.free)
