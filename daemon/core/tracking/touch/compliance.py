"""Compliance of a clamped tool: a slow admittance, watched by a passivity observer.

The target follows the object by feed-forward. Measured force moves it by an offset alone, slowly:

    o' = w a r,     r = tcp + F / k - (object + o)

r is how far the measured object is from the target's, beyond a dead band; at rest it is
(F - F_d) / k, with the desired force F_d that the programmed press makes of the mount's stiffness
k. So D = k / w is the damper of the admittance. A delayed motion drives a body above the quarter
of one over the delay, however slow it is. So the energy that the offset gives is observed at the
contact port (Hannaford and Ryu, "Time-domain passivity control of haptic interfaces", IEEE
Transactions on Robotics and Automation 18(1), 2002):

    E += -F_ac . v_o dt - P dt, E >= 0     v_o the offset's speed a delay ago

The gain a falls from 1 to 0 as E reaches its bound: no body gets more than that, and P a second.
An object that does not give way needs none of this: the estimate follows it, the offset stays.
That is proved on a conveyor at rest alone: a body that nothing excites is calm as well.

Invariants:
- The offset has no lead: it is constant over the horizon.
- A growing oscillation stops it altogether. One that lasts is not the offset's: from then on, until
  it is small again, the offset follows the mean deflection, slowly. A force that bends the mount to
  one side, however large, is none.
- A quick oscillation that grows from second to second is driven by the contact. From then on a
  deflection hardly moves the estimate in this contact, and the offset is as slow: a line that is
  askew still moves it. One that is slow, falls, or grows on nonetheless is damped by being
  followed.
- An oscillation that is large and does not fall while the offset is stopped or slow is `unending`:
  the contact itself drives it, and only an end of the contact ends it.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core.tracking.touch import firmness
from linemate.daemon.core.tracking.touch.firmness import STILL, UNKNOWN, Firmness, Swing
from linemate.protocol.stamped_samples import Vector3

ALONG = 1  # axis of c along the conveyor
RATE = 0.7  # w: of the offset [1/s], far below a quarter of one over the delay
SEATING_RATE = 6.0  # added as the tool touches, when its place is known worst [1/s]
SEATING_S = 0.25  # time in which that dies out [s]
SMOOTHING_S = 0.05  # time constant of the deviation that moves the offset [s]
DEAD_BAND = 0.00002  # deviation that moves nothing [m]
SEATED_S = 0.7  # the tool seats and presses until then: its force is no oscillation [s]
SLOW_S = 3.0  # time constant of the force whose work is not counted: the press [s]
QUICK_S = 0.25  # time constant of the mean force; what is faster is an oscillation [s]
MEMORY_S = 0.25  # time constant of the oscillation's mean square [s]
GRAIN_S = 0.1  # its past is kept in such steps [s]
PAST = 30  # and so many of them
SECOND = 10  # steps of the past in a second
REACH = 0.015  # largest offset [m]
LONGEST_GAP_S = 0.012  # between two forces that counts as time; a longer one is a sensor's fault

ENERGY_J = 0.005  # that the offset may give: 0.5 mm of a body of 100 kg at 3.5 Hz
LEAK_W = 0.001  # and so much a second, which the least damping of a body takes

QUIET_N = 6.0  # rms of an oscillation's force that is normal in contact [N]
LARGEST_N = 60.0  # rms of an oscillation's force that softens [N]
GROWN_N = 20.0  # rms that softens while it grows by
GROWTH = 1.5  # this factor in a second
CALM = 0.5  # share of these at which the softening ends
FALLS = 0.9  # of its mean square: what is left more after a second does not fall
UNENDING = 0.25  # share of the overload, as rms, from which an oscillation must fall
UNSECURED = 0.5  # the same while a retreat would drop the wheel: its screws are not fixed
DRIVEN_N = 8.0  # rms from which an oscillation may be driven [N]
DRIVEN_LEAST_N = 3.0  # and rms from which it has grown; less is noise [N]
DRIVEN_GROWTH = 1.15  # of its largest mean square, from each second to the next
KICK = 8.0  # from one second to the next is no growth, but a kick of the object
SLOW_SMOOTHING_S = 0.5  # time constant of the mean deviation that moves the offset then [s]
SLOW_RATE = 0.3  # of the offset then [1/s]: a swing of 3 Hz moves it by 0.2 %, of 1 Hz by 1.5 %
SOFTENED_S = 1.0  # by then an oscillation that only the offset drives falls [s]


@dataclass(frozen=True, slots=True)
class ComplianceModel:
    """What the admittance is built for.

    Attributes:
        stiffness: of the mount [N/m].
        delays: steps from the offset to the tool's motion, along x, y, z of c.
        dt: cycle of the controller [s].
    """

    stiffness: float
    delays: tuple[int, int, int]
    dt: float


class Compliance(Struct, frozen=True):
    """State of the admittance and of its observer; vectors in c.

    Attributes:
        offset: of the target [m].
        smooth: measured object from the target's, smoothed [m].
        press: slow mean of the force [N]; None before the first one.
        mean: quicker mean of it [N].
        power: mean square of the force's deviation from the latter [N^2].
        past: that mean square at steps of ``GRAIN_S``, newest last.
        age: since the newest of them [s].
        moves: of the offset that the tool has not made yet, oldest first [m].
        energy: that the offset has given [J].
        soft: the oscillation stops the offset, or makes it slow.
        softened: for so long [s].
        driven: the contact drives the oscillation; until the contact ends, or it grows too large.
        firmness: whether the object gives way.
        waited: steps without a force since the last one.
        seating: what the force along the conveyor has swung while the tool seats: side and turns.
        ring: mean square of that [N^2].
    """

    offset: Vector3 = (0.0, 0.0, 0.0)
    smooth: Vector3 = (0.0, 0.0, 0.0)
    press: Vector3 | None = None
    mean: Vector3 = (0.0, 0.0, 0.0)
    power: float = 0.0
    past: tuple[float, ...] = ()
    age: float = 0.0
    moves: tuple[Vector3, ...] = ()
    energy: float = 0.0
    soft: bool = False
    softened: float = 0.0
    driven: bool = False
    firmness: Firmness = UNKNOWN
    waited: int = 0
    seating: Swing = STILL
    ring: float = 0.0

    @property
    def is_softened(self) -> bool:
        """Whether an oscillation makes the contact soft."""
        return self.soft or self.driven

    @property
    def is_firm(self) -> bool:
        """Whether the object is known not to give way."""
        return bool(self.firmness.is_firm)


NO_COMPLIANCE = Compliance()
_ZERO: Vector3 = (0.0, 0.0, 0.0)


def advance(
    state: Compliance,
    model: ComplianceModel,
    force: Vector3,
    off: Vector3,
    touching: float,
    *,
    is_pushed: bool = False,
    is_at_rest: bool = False,
) -> Compliance:
    """Return the state one step later, or several: with the next force.

    Args:
        force: on the clamped tool, in c [N].
        off: measured object, seen from the object of the target without its offset [m].
        touching: time since the contact began [s].
        is_pushed: an impulse disturbance of the object was confirmed.
        is_at_rest: the conveyor stands or starts: an object can be proved firm.
    """
    cycles = _cycles(state, model)
    dt = cycles * model.dt
    is_first = state.press is None
    press = force if state.press is None else _toward(state.press, force, dt / SLOW_S)
    mean = force if is_first else _toward(state.mean, force, dt / QUICK_S)
    felt = replace(state, press=press, mean=mean, power=0.0, energy=0.0, soft=False, waited=0)
    if touching > SEATED_S:
        swung = _minus(force, mean)
        quick_s = 2.0 * max(model.delays) * model.dt
        felt = _swinging(state, felt, swung, dt, quick_s, is_pushed, is_at_rest=is_at_rest)
        moved = _delayed(state.moves, model.delays, cycles)
        given = state.energy - _dot(_minus(force, press), moved) - LEAK_W * dt
        felt = replace(felt, energy=max(given, 0.0), ring=0.0)
    else:
        felt = _ringing(felt, force[ALONG] - mean[ALONG], dt)
    led = _led(felt, off, touching, dt)
    still = (_ZERO,) * (cycles - 1)
    moves = (*state.moves, *still, _minus(led.offset, state.offset))[-max(model.delays) :]
    softened = state.softened + dt if led.soft else 0.0
    return replace(led, moves=moves, softened=softened)


def _ringing(state: Compliance, swung: float, dt: float) -> Compliance:
    """Return the state with what the force along the conveyor rings while the tool seats.

    Args:
        swung: force off its mean [N].
    """
    ring = state.ring + dt / MEMORY_S * (swung * swung - state.ring)
    return replace(state, seating=firmness.turned(state.seating, swung, dt), ring=ring)


def _swinging(
    before: Compliance,
    state: Compliance,
    swung: Vector3,
    dt: float,
    quick_s: float,
    is_pushed: bool,
    *,
    is_at_rest: bool,
) -> Compliance:
    """Return the state with what the force's oscillation shows of the object.

    Args:
        before: a step ago; ``state`` has the newest means already.
        swung: force off its mean [N].
        quick_s: half a period of an oscillation which the offset's delay can drive [s].
    """
    power = before.power + dt / MEMORY_S * (_dot(swung, swung) - before.power)
    past, age = before.past, before.age + dt
    if age >= GRAIN_S:
        past, age = (*past, power)[-PAST:], 0.0
    firm = before.firmness
    soft = (before.soft or firm.has_swung) and is_growing(power, past, was=before.soft)
    firm = firmness.advance(
        firm,
        swung,
        dt,
        is_calm=power < QUIET_N**2 and is_at_rest,
        gives_way=soft or is_pushed,
        quick_s=quick_s,
    )
    driven = before.driven or (firm.quick_s > 2.0 * quick_s and is_driven(past))
    return replace(
        state,
        power=power,
        past=past,
        age=age,
        soft=soft,
        # One that grows on nonetheless was damped by being followed: it is followed again.
        driven=driven and power < LARGEST_N**2,
        firmness=firm if is_at_rest else firmness.without_proof(firm),
    )


def _led(state: Compliance, off: Vector3, touching: float, dt: float) -> Compliance:
    """Return the state with the offset that the deviation leads on."""
    is_slow = state.soft or state.driven
    smoothing_s = SLOW_SMOOTHING_S if is_slow else SMOOTHING_S
    smooth = _toward(state.smooth, _minus(off, state.offset), dt / smoothing_s)
    rate = SLOW_RATE if is_slow else RATE + SEATING_RATE * math.exp(-touching / SEATING_S)
    length = math.hypot(*smooth)
    is_stopped = state.is_firm or (state.soft and not state.driven and state.softened < SOFTENED_S)
    moves_on = length > DEAD_BAND and not is_stopped
    share = 1.0 - DEAD_BAND / length if moves_on else 0.0
    step = rate * dt * share * max(1.0 - state.energy / ENERGY_J, 0.0)
    (x, y, z), (a, b, c) = state.offset, smooth
    offset = _bounded((x + step * a, y + step * b, z + step * c))
    return replace(state, smooth=smooth, offset=offset)


def waiting(state: Compliance) -> Compliance:
    """Return the state after a step without a force: the sensor is slower than the cycle."""
    return replace(state, waited=state.waited + 1)


def _cycles(state: Compliance, model: ComplianceModel) -> int:
    """Return the steps since the last force, this one included."""
    most = max(round(LONGEST_GAP_S / model.dt), 1)
    return min(state.waited + 1, most)


def _delayed(moves: tuple[Vector3, ...], delays: tuple[int, int, int], cycles: int = 1) -> Vector3:
    """Return the offset's moves that the tool makes in so many steps, by component [m]."""
    count = len(moves)
    x, y, z = (
        sum([moves[at][axis] for at in range(count - delay, count - delay + cycles) if at >= 0])
        if count >= delay - cycles + 1
        else 0.0
        for axis, delay in enumerate(delays)
    )
    return (x, y, z)


def is_growing(power: float, past: tuple[float, ...], *, was: bool) -> bool:
    """Return whether an oscillation is too large, or grows and is not small.

    Args:
        power: mean square of its force [N^2].
        past: at earlier times, oldest first.
        was: it was so in the step before; then it must have become small to end.
    """
    if was:
        return power > (CALM * GROWN_N) ** 2
    if power > LARGEST_N**2:
        return True
    recent = past[-SECOND:]
    has_grown = len(recent) == SECOND and power > GROWTH**2 * recent[0]
    return has_grown and power > GROWN_N**2 and all(a <= b for a, b in pairwise(recent))


def is_driven(past: tuple[float, ...]) -> bool:
    """Return whether an oscillation has grown for three seconds, each beyond that before.

    One that was kicked is largest in its first second, and jumps there from less.

    Args:
        past: mean square of its force, oldest first [N^2].
    """
    if len(past) < 3 * SECOND:
        return False
    first, second, third = (max(past[-n * SECOND :][:SECOND]) for n in (3, 2, 1))
    grows = all(DRIVEN_GROWTH * a < b < KICK * a for a, b in pairwise((first, second, third)))
    return grows and first > DRIVEN_LEAST_N**2 and third > DRIVEN_N**2


def unending(state: Compliance, overload: float, share: float = UNENDING) -> float | None:
    """Return the rms force of an oscillation that softening does not make smaller [N], or None.

    The largest of the last second is compared with that of the second before: one second is longer
    than a period of the slowest sway that a contact is known to drive. One that has become small
    since then falls.

    Args:
        overload: force that the tool withstands [N].
        share: of it, as rms, from which an oscillation must fall.
    """
    if state.softened < SOFTENED_S or len(state.past) < 2 * SECOND:
        return None
    before, largest = (max(state.past[-n * SECOND :][:SECOND]) for n in (2, 1))
    limit = (share * overload) ** 2
    if state.power < limit:
        return None
    # One that is kicked again gets its second to fall.
    least = max(FALLS * before, limit) if before >= limit else math.inf
    return math.sqrt(largest) if largest >= least else None


def uncertainty(state: Compliance, model: ComplianceModel) -> float:
    """Return the variance that an oscillation adds to a measured deflection [m^2].

    The largest of the last seconds: a body that has swung may swing again. Not that of the last two
    tenths of a second, so that a stop is detected before it counts itself. None as long as the
    force has not swung to and fro: a stop that is followed late bends the mount to one side.
    """
    if len(state.past) < 3 or not state.firmness.has_swung:
        return 0.0
    power = max(state.past[:-2])
    return max(power - QUIET_N**2, 0.0) / model.stiffness**2


def ringing(state: Compliance, model: ComplianceModel) -> float:
    """Return the variance that a ring adds to a deflection as evidence of a class [m^2].

    A tool that seats on a body rings with it, and its force looks like a stop or an impulse.
    """
    if not state.seating.turns:
        return 0.0
    return max(state.ring - QUIET_N**2, 0.0) / model.stiffness**2


def displaced(way: Vector3) -> Compliance:
    """Return the state of a tool that has touched the object away from its estimate."""
    return Compliance(offset=_bounded(way))


def shifted(state: Compliance, way: Vector3) -> Compliance:
    """Return the state with its offset moved on by a way [m]."""
    x, y, z = (o + w for o, w in zip(state.offset, way, strict=True))
    return replace(state, offset=_bounded((x, y, z)))


def taken_over(state: Compliance, axis: int) -> Compliance:
    """Return the state with no offset along an axis: the feed-forward has taken it over."""
    x, y, z = (0.0 if i == axis else o for i, o in enumerate(state.offset))
    return replace(state, offset=(x, y, z))


def _bounded(offset: Vector3) -> Vector3:
    """Return an offset no longer than ``REACH``."""
    length = math.hypot(*offset)
    if length <= REACH:
        return offset
    x, y, z = (REACH / length * o for o in offset)
    return (x, y, z)


def _toward(old: Vector3, new: Vector3, gain: float) -> Vector3:
    """Return a first-order lag one step later."""
    (a, b, c), (x, y, z) = old, new
    return (a + gain * (x - a), b + gain * (y - b), c + gain * (z - c))


def _minus(a: Vector3, b: Vector3) -> Vector3:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _dot(a: Vector3, b: Vector3) -> float:
    """Return the inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
