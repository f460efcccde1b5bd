"""Contact detection: the force along the tool's axis without the tool's own vibration.

A tool on an elastic mount vibrates for seconds after an impulse, with more force than a contact: a
hold of one cycle at 0.5 rad/s left 100 N. Half a period earlier that force was opposite, so the sum
of both is free of it. A constant force (gravity, bias) is the mean of the period before that. A
contact shows in that sum at once and in full.

A mount that is softer or stiffer than configured vibrates with another period: the sum has a
vibration left then. That one changes its side, and a contact does not. So what was left to one
side within the last periods is no contact to the other side.

While replies are lost again and again, each lost one excites the tool. Then a contact is a force
that stays on one side of the free tool's mean for a full period: a vibration changes its side twice
in a period.
"""

import math
from dataclasses import dataclass

from msgspec import Struct
from msgspec.structs import replace

TOUCHES = 2  # in a row that make a contact: steps, or samples of one step
NEAR = 0.008  # least distance before the object from which a force may be a contact [m]
EARLY = 0.003  # a touch this far before the estimated object is early [m]
MARGIN = 0.003  # or this much before the approach is slow: an object that is nearer still [m]

# An object pushes a tool back. So many times the force the other way is a contact too: the sensor's
# axis may be wrong, and the tool must not press on.
PULL = 3.0

STEADY = 0.5  # largest share of a contact's force that there was to the other side before
MEASURED = 0.5  # share of a contact's force that the sensor itself must show
LEFT_NOISE = 0.5  # share of a contact's force: less that is left is noise
GROWTH_S = 0.024  # over which the force of a touch must have grown [s]
GROWTH_SHARE = 0.5  # of what the mount alone gives for the tool's advance in that time
OFF_M = 0.005  # before the object: no touch comes from there to a tool that stands [m]
STOOD_S = 0.12  # after so long without an advance the robot stands as well [s]
STOOD_M = 1e-4  # a lesser advance is none [m]
LEFT_HALVES = 3.0  # half periods over which a remaining vibration is observed: slower modes too


def reach(clearance: float) -> float:
    """Return the distance before the object from which a force may be a contact [m].

    Args:
        clearance: of the guarded approach [m].
    """
    return max(NEAR, clearance + MARGIN)


def may_rub(reach: float, bolts: float) -> bool:
    """Return whether bolts may rub in their holes where a touch is felt.

    Args:
        reach: how far beyond its estimate the object was touched [m].
        bolts: their length from the face [m].
    """
    return -bolts < reach < -EARLY


@dataclass(frozen=True, slots=True)
class ToolVibration:
    """Vibration of the tool along its own axis, in steps.

    Attributes:
        half: half a period, in steps and parts of one.
        kept: share of a deflection that is left after half a period, with its sign turned.
        force: what counts as contact [N].
        mass: of the tool, on its mount's stiffness [kg].
        stiffness: of that mount along the tool's axis [N/m].
        noise: one sigma of a force [N].
        cycle_s: period of the steps [s].
    """

    half: float
    kept: float
    force: float
    mass: float = 0.0
    stiffness: float = 0.0
    noise: float = 0.0
    cycle_s: float = 0.0

    @property
    def memory(self) -> int:
        """Forces that are remembered: half a period, the period before it, and the newest."""
        return math.ceil(self.half) + self.period + 1

    @property
    def period(self) -> int:
        """Steps of a full period."""
        return math.ceil(2.0 * self.half)

    @property
    def observed(self) -> int:
        """Steps over which a remaining vibration is observed."""
        return math.ceil(LEFT_HALVES * self.half)


def tool_vibration(
    frequency_hz: float,
    damping: float,
    stiffness: float,
    force: float,
    cycle_s: float,
    deflection: float = 0.0,
) -> ToolVibration:
    """Return the vibration of a mode, sampled in steps.

    Args:
        frequency_hz: of the mode along the tool's axis.
        damping: of it, as a share of critical.
        stiffness: of the mount along that axis [N/m].
        force: what counts as contact [N].
        deflection: one sigma of the sensor, as the mount's bend [m].
    """
    half = 0.5 / (frequency_hz * cycle_s)
    kept = math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
    mass = stiffness / (2.0 * math.pi * frequency_hz) ** 2
    return ToolVibration(half, kept, force, mass, stiffness, deflection * stiffness, cycle_s)


class ContactState(Struct, frozen=True):
    """State of the contact detection.

    Attributes:
        forces: along its axis, the newest last, one a step, without those that accelerate it [N].
        inertial: planned, left out of each of ``forces`` [N]; empty for none.
        calm: steps since the robot last held against its command, as far as memory goes.
        touches: steps in a row with a contact's force; one in whose samples each shows it counts
            as a touch a sample.
        free: smoothed mean force of a full period, before the tool came near the object [N]; None
            while less is known.
        samples: of the newest of ``forces``, off it [N].
        left: least and largest force without the vibration, in each of the last steps [N]. Both
            are 0 for a tool that vibrates as configured.
        distances: programmed, to the object, in each of the last steps [m].
        doubtful: the force is one of a contact, but the object cannot give it.
        across: forces across the tool's axis, one a step, newest last [N].
        unaccelerated: the same without the force that accelerates the tool as planned [N].
    """

    forces: tuple[float, ...] = ()
    calm: int = 0
    touches: int = 0
    free: float | None = None
    samples: tuple[float, ...] = ()
    left: tuple[tuple[float, float], ...] = ()
    inertial: tuple[float, ...] = ()
    distances: tuple[float, ...] = ()
    doubtful: bool = False
    across: tuple[tuple[float, float], ...] = ()
    unaccelerated: tuple[tuple[float, float], ...] = ()


NO_CONTACT = ContactState()


def record_force(
    state: ContactState,
    vibration: ToolVibration,
    force: float | None,
    acceleration: float,
    *,
    held: bool,
    samples: tuple[float, ...] = (),
) -> ContactState:
    """Return the state with the force of one step.

    Args:
        force: along its axis [N], None if none was measured: then it is what it was.
        acceleration: planned, along its axis [m/s^2]. The force that accelerates the tool is
            no contact.
        held: the robot did not get the last command and held.
        samples: of which the force is the mean, off it [N].
    """
    forces = state.forces
    newest = forces[-1] if forces else None
    inertia = state.inertial[-1] if state.inertial else 0.0
    if force is not None:
        inertia = vibration.mass * acceleration
        newest = force + inertia
    inertial = state.inertial
    if newest is not None:
        forces = (*forces, newest)[-vibration.memory :]
        inertial = (*inertial, inertia)[-vibration.memory :]
    calm = 0 if held else min(state.calm + 1, vibration.memory)
    return replace(state, forces=forces, calm=calm, samples=samples, inertial=inertial)


def record_across(
    state: ContactState,
    vibrations: tuple[ToolVibration, ...],
    force: tuple[float, float] | None,
    acceleration: tuple[float, float],
    *,
    held: bool,
) -> ContactState:
    """Return the state with the force across the tool's axis of one step.

    Args:
        vibrations: of the tool along both of these axes.
        force: None if none was measured: then it is what it was.
        acceleration: planned, along both [m/s^2].
        held: the robot did not get the last command and held.
    """
    across, free = ((), ()) if held else (state.across, state.unaccelerated)
    if force is not None:
        (fx, fy), (ax, ay), (first, second) = force, acceleration, vibrations
        newest, left = force, (fx + first.mass * ax, fy + second.mass * ay)
    elif across:
        newest, left = across[-1], free[-1]
    else:
        return state if across is state.across else replace(state, across=(), unaccelerated=())
    count = _whole_period(vibrations)
    return replace(state, across=(*across, newest)[-count:], unaccelerated=(*free, left)[-count:])


def _whole_period(vibrations: tuple[ToolVibration, ...]) -> int:
    """Return the steps that reach over a period of each vibration, both ends counted."""
    return max(each.period for each in vibrations) + 1


def is_held_across(state: ContactState, vibrations: tuple[ToolVibration, ...]) -> bool:
    """Return whether a closed clamp pulls across the tool's axis.

    A clamp that closes on a tool off the object's axis shows there first: along the axis nothing
    presses. It needs as much force as a pull along the axis, as measured and without the vibration,
    and without the force that accelerates the tool: a target that is corrected swings a free one.
    """
    if len(state.across) < _whole_period(vibrations):
        return False
    for axis, vibration in enumerate(vibrations):
        side = math.copysign(1.0, state.across[-1][axis])
        if all(
            _pull_across([side * force[axis] for force in forces], vibration)
            for forces in (state.across, state.unaccelerated)
        ):
            return True
    return False


def _pull_across(forces: list[float], vibration: ToolVibration) -> bool:
    """Return whether forces of a whole period end with a clamp's, which is positive."""
    whole, part = divmod(vibration.half, 1.0)
    ago = -1 - int(whole)
    opposite = forces[ago] + part * (forces[ago - 1] - forces[ago])
    least = max(PULL * vibration.force, -min(forces) / STEADY)
    return min(forces[-1], forces[-1] + vibration.kept * opposite) > least


def is_observable(state: ContactState, vibration: ToolVibration) -> bool:
    """Return whether the forces go back far enough to separate contact from vibration."""
    return len(state.forces) >= vibration.memory and state.calm >= vibration.memory


def is_contact(state: ContactState, vibration: ToolVibration, least: float | None = None) -> bool:
    """Return whether the force of the tool is a contact.

    Without the planned acceleration of the tool it must show as well, by ``MEASURED`` of the force:
    the servos round off what a plan does within a few milliseconds. Not decided while the forces
    reach back beyond a hold: the tool did not vibrate before it.

    Args:
        least: what counts as contact instead of the force in ``vibration`` [N].
    """
    least = vibration.force if least is None else least
    if not is_observable(state, vibration) or not _shows_contact(state, vibration, least):
        return False
    if len(state.inertial) != len(state.forces):
        return True
    measured = tuple([f - i for f, i in zip(state.forces, state.inertial, strict=True)])
    return _shows_contact(replace(state, forces=measured), vibration, MEASURED * least)


def is_push(state: ContactState, vibration: ToolVibration, least: float) -> bool:
    """Return whether the force is a contact that pushes the tool back.

    Args:
        least: what counts as contact [N].
    """
    return state.forces[-1] < 0.0 and is_contact(state, vibration, least)


def _shows_contact(state: ContactState, vibration: ToolVibration, least: float) -> bool:
    low, high = without_vibration(state, vibration)
    push, pull = remaining(state, vibration)
    return high < -least - pull or low > PULL * least + push


def without_vibration(state: ContactState, vibration: ToolVibration) -> tuple[float, float]:
    """Return the least and the largest force without the vibration, by each of the means [N]."""
    forces = state.forces
    whole, part = divmod(vibration.half, 1.0)
    ago = -1 - int(whole)
    opposite = forces[ago] + part * (forces[ago - 1] - forces[ago])
    pair = forces[-1] + vibration.kept * opposite
    before = sum(forces[: vibration.period]) / vibration.period
    # The mean of the period before is off for a tool that began to ring in it, and the mean of the
    # free tool for one that was kicked then. A contact shows against both.
    means = (before,) if state.free is None else (before, state.free)
    forces_left = [pair - (1.0 + vibration.kept) * mean for mean in means]
    return min(forces_left), max(forces_left)


def remaining(state: ContactState, vibration: ToolVibration) -> tuple[float, float]:
    """Return how far a remaining vibration pushed and pulled of late [N].

    Bounded, so that a contact is never missed by more: to ``PULL`` times the force of a contact.
    """
    if not state.left:
        return 0.0, 0.0
    bound = (PULL - 1.0) * vibration.force
    noise = LEFT_NOISE * vibration.force
    push = -min(low for low, _ in state.left) - noise
    pull = max(high for _, high in state.left) - noise
    return min(max(push, 0.0), bound), min(max(pull, 0.0), bound)


def touches_felt(state: ContactState, vibration: ToolVibration) -> int:
    """Return how many touches the newest step shows: its samples, if each is a contact by itself.

    A slow cycle has several samples. To wait for a second one costs a fast touch 2 mm.
    """
    if not is_contact(state, vibration):
        return 1 if is_lasting_contact(state, vibration) else 0
    *past, newest = state.forces
    each = (replace(state, forces=(*past, newest + off)) for off in state.samples)
    alike = len(state.samples) > 1 and all(is_contact(sample, vibration) for sample in each)
    return len(state.samples) if alike else 1


def is_lasting_contact(state: ContactState, vibration: ToolVibration) -> bool:
    """Return whether a contact's force has been on one side for a full period."""
    free, newest = state.free, state.forces[-vibration.period :]
    if free is None or len(newest) < vibration.period:
        return False
    return min(newest) > free + vibration.force or max(newest) < free - vibration.force


def has_grown(state: ContactState, vibration: ToolVibration, distance: float) -> bool:
    """Return whether a contact's force has grown as the tool advanced.

    An object pushes back the more the farther the tool goes; a sensor that drifts does not. The
    shortest advance decides whose force exceeds the noise: a slow tool needs longer for it. Not
    decided without one, or while the forces reach back beyond a hold.

    Args:
        distance: programmed, to the object [m].
    """
    if not state.left or not vibration.cycle_s or not is_observable(state, vibration):
        return True
    low, high = without_vibration(state, vibration)
    for steps in range(max(round(GROWTH_S / vibration.cycle_s), 1), len(state.left) + 1):
        advance = distance - state.distances[-steps]
        expected = GROWTH_SHARE * vibration.stiffness * advance
        if LEFT_NOISE * vibration.force <= expected < math.inf:
            before_low, before_high = state.left[-steps]
            return before_high - high >= expected or low - before_low >= expected
    return True


def is_doubtful(state: ContactState, vibration: ToolVibration, distance: float, off: float) -> bool:
    """Return whether the force before the object is none that the object can give.

    It gives none to a tool that stands, and it does not pull at one that it has not touched.

    Args:
        distance: programmed, to the object [m].
        off: distance before the object from which on that is sure [m].
    """
    steps = round(STOOD_S / vibration.cycle_s) if vibration.cycle_s else 0
    if distance >= -off or not 0 < steps <= len(state.distances):
        return False
    low, _ = without_vibration(state, vibration)
    advance = distance - min(state.distances[-steps:])
    return low > 0.0 or advance < STOOD_M


def backs_off(state: ContactState, vibration: ToolVibration, distance: float) -> bool:
    """Return whether the tool backs off, so that no face of an object pushes it any more.

    Args:
        distance: programmed, to the object [m].
    """
    steps = round(STOOD_S / vibration.cycle_s) if vibration.cycle_s else 0
    if not 0 < steps <= len(state.distances):
        return False
    return distance < state.distances[-steps] - STOOD_M


def count_touches(
    state: ContactState,
    vibration: ToolVibration,
    distance: float,
    near: float,
    *,
    is_new: bool = True,
    off: float = OFF_M,
) -> ContactState:
    """Return the state with its touches counted.

    A step without a sample has the force of the one before, which counts once.

    Args:
        distance: programmed, to the object [m].
        near: distance before the object from which a force may be a contact [m].
        is_new: a force was measured since the last step.
        off: distance before the object from which on a force may be doubted [m].
    """
    forces, free = state.forces, state.free
    # Beyond the estimated object too: the tool may search for it there.
    is_near = -near < distance < math.inf
    if not is_near and len(forces) >= vibration.period:
        mean = sum(forces[-vibration.period :]) / vibration.period
        # Smoothed: over a configured period a mode of another one has a mean.
        free = mean if free is None else free + (mean - free) / vibration.observed
    felt = touches_felt(state, vibration) if is_near else 0
    doubtful = bool(felt) and is_doubtful(state, vibration, distance, off)
    if doubtful or (felt and not has_grown(state, vibration, distance)):
        felt = 0
    newly = felt if is_new else 0
    return replace(
        state,
        touches=state.touches + newly if felt else 0,
        free=free,
        left=_observed(state, vibration),
        distances=(*state.distances, distance)[-vibration.observed :],
        doubtful=doubtful,
    )


def _observed(state: ContactState, vibration: ToolVibration) -> tuple[tuple[float, float], ...]:
    """Return what was left of the vibration, with the newest step."""
    if not is_observable(state, vibration):
        return ()
    return (*state.left, without_vibration(state, vibration))[-vibration.observed :]


def assume_touch(state: ContactState, distance: float, *, is_due: bool) -> ContactState:
    """Return the state of a tool without a force sensor: it touches at its place.

    Args:
        distance: programmed, to the object [m].
        is_due: the programme has reached its waypoint of contact and the clamp may be closed.
    """
    near = is_due and -NEAR < distance < math.inf
    return replace(state, touches=state.touches + 1 if near else 0)
