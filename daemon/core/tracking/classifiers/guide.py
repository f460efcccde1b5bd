"""Guide: the estimate along the conveyor that leads the target in contact.

The bank's null filter follows the force-torque sensor within a few cycles. It needs that to detect
a stop or a start. A target that followed it would drive a body that gives way, see docs/method.md.
The guide is a second filter of the same model. It takes the class from the bank at once, and a
deflection slowly.

Invariants:
- There is a guide in contact only. On an object that does not give way it follows, but leads no
  target: the null filter does, which may swing with the object as that turns out to give way.
- It leads on when the force is lost or wrong: what that made of the null filter moves no target.
- A null filter that was widened moves it only once that knows the speed again, and the distance
  sensor contradicts the guide too. A body that swings widens the null filter, which follows it.
- A deflection that grows to one side, and would be too large before a decision acts, draws it. One
  that an impulse disturbance explains does not: it swings back.
- An impulse disturbance does not move it; of the sways a slow one that was known before the contact
  does. One that is found in contact may be what the clamped tool itself drives: then the one that
  was known before fades, at its own frequency.
- Where none is known, an object that has not followed its conveyor as a change is declared goes on:
  it sways from there. Bolts in their holes show it before the touch.
"""

import math
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import bank_filter, felt_drift, sway_filter
from linemate.daemon.core.tracking.classifiers.bank_model import (
    ACCELERATION,
    FREQUENCY,
    GAIN,
    HANGING,
    IMPULSE,
    OFFSET,
    PACE,
    RANDOM,
    RIPPLE,
    RIPPLE_FACTORS,
    STATES,
    SWAY,
    SWAY_QUADRATURE,
    BankModel,
    BankState,
    Guide,
    V,
    Y,
)
from linemate.daemon.core.tracking.classifiers.felt_drift import UNFELT, FeltDrift
from linemate.daemon.core.tracking.conveyor import (
    Motion,
    PositionMeasurement,
    Source,
    has_changed_class,
)

_SWING = slice(IMPULSE, RIPPLE)
_SWAY = slice(SWAY, STATES)
CONTRADICTED = 4  # readings beyond the gate in a row that contradict the guide
FARTHEST_HELD = 0.006  # from the null filter's object, where the tool may hold it [m]
FADE_S = 0.5  # time constant of a sway whose frequency has changed in contact [s]
LARGEST_PULL = 0.0003  # of a deflection on it: a body that rings by more is not driven by more [m]
FARTHEST_FELT_N = 100.0  # force of the tool on the object that the guide leaves
BRAKE_S = 0.1  # in which an assumed sway loses the speed by which an object is left behind [s]
LOST_S = 0.1  # for which the distance sensor contradicts it at most, if the filter agrees [s]
HELD_S = 1.5  # for which it leads on without a deflection: a retreat needs 1 s [s]
LARGEST_SURPRISE = 0.005  # by which an end speed may differ from the foreseen one [m/s]
LEAST_LOST = 0.0005  # way of the conveyor that shows whether the object has lost it too [m]
HANGING_OMEGA = 2.0 * math.pi * 0.6  # of such an object: hangers sway with 0.35 to 1 Hz [rad/s]
UNSURE = 0.25  # one sigma of the speed that it has kept, as a share
FASTEST = 2.0 * math.pi * 2.5  # sway that is led [rad/s]: a faster one would be driven by its delay


def advance(
    model: BankModel,
    before: BankState,
    state: BankState,
    measurements: Sequence[PositionMeasurement],
    dt: float,
) -> BankState:
    """Return the state with its guide one step later.

    None out of contact.

    Args:
        before: of the step before.
        state: one step later, its class decided.
    """
    unfelt_s = 0.0 if state.contact else before.unfelt_s + dt
    if unfelt_s != state.unfelt_s:
        state = replace(state, unfelt_s=unfelt_s)
    is_held = not state.contact and unfelt_s < HELD_S
    if not is_held and not state.contact:
        return state if state.guide is None else replace(state, guide=None)
    guide = before.guide
    waits = guide is not None and (guide.waits or state.age < before.age)
    # Its gate may keep it on a ramp that has ended, 37 mm behind a line that went on: 699 N.
    agrees = not state.rejected.get(Source.DISTANCE)
    longest = CONTRADICTED if waits else round(LOST_S / dt) if agrees else math.inf
    is_wrong = guide is not None and guide.missed >= longest
    is_reset = guide is None or (is_wrong and float(state.P[V, V]) < bank_filter.KNOWN**2)
    if guide is None:
        return replace(state, guide=synchronised(state))
    hangs = guide.hangs
    sways = guide.sways and not sway_filter.has_taken_over(before, state)
    # A sway that fades keeps its own frequency: turned by a quick one it moved the target by 6 mm.
    omega = state.sway_omega if sways and not hangs else guide.sway_omega
    led, missed, felt = _predicted(model, state, guide, omega, dt), guide.missed, guide.felt
    for measurement in measurements:
        corrected = _corrected(model, led, measurement, felt, hangs=hangs)
        if measurement.source is Source.TACTILE:
            off = _deflection(model, corrected, measurement)
            felt = felt_drift.observed(felt, off, before.felt_s + dt)
            if not _is_pushed(state, off):
                corrected, felt = _drawn(corrected, felt)
        if measurement.source is Source.DISTANCE:
            missed = missed + 1 if corrected is led else 0
        led = corrected
    was, has_changed = led, state.motion is not before.motion or state.is_faster
    if is_reset:
        begun = synchronised(state)
        led = replace(led, x=begun.x, P=begun.P, ripple_factor=begun.ripple_factor)
        led, sways, waits, missed = replace(led, sway_omega=begun.sway_omega), True, False, 0
    elif has_changed:
        led = _in_class(model, state, led, measurements, sways=sways)
    if is_reset or has_changed:
        led, hangs = _going_on(model, state, was, led, measurements, felt, hangs=hangs, sways=sways)
        felt = felt_drift.moved(guide.felt if is_reset else felt)
    led = led if sways or hangs else _fading(led, was.x[_SWAY], dt)
    x, P, omega = led.x, led.P, led.sway_omega
    guide = Guide(x, P, led.ripple_factor, sways, waits, missed, felt, omega, hangs)
    return replace(state, guide=guide)


def before_touch(
    model: BankModel, before: BankState, state: BankState, shown: PositionMeasurement, dt: float
) -> BankState:
    """Return the state of an object that hangs, as bolts in their holes show it before the touch.

    A tool that has not reacted to a change yet is bent by an object on a rigid carrier, which has.

    Args:
        before: of the step before.
        state: one step later, its class decided.
        shown: where the tool holds the object.
    """
    # What a change that turns out to be faster adds is none of the object either.
    goes_on = state.hangs and state.is_faster
    if state.contact or not (goes_on or _may_hang(model, state, sways=True)):
        return state
    was = bank_filter.predict(model, before, dt)
    if not goes_on:
        was = _steady(was)
        if not _gone_on(model, was, state, [shown]):
            return state
    # Whatever it hangs on, no force has braked it yet.
    return replace(_held(model, _hanging(was, state, 1.0), [shown]), hangs=True)


def led_state(state: BankState) -> BankState:
    """Return the state with the guide's estimate in place of the null filter's."""
    guide = state.guide
    if guide is None or state.is_firm:
        return state
    return replace(
        state, x=guide.x, P=guide.P, ripple_factor=guide.ripple_factor, sway_omega=guide.sway_omega
    )


def synchronised(state: BankState) -> Guide:
    """Return a guide at the null filter's estimate, without its impulse disturbance."""
    x, P = state.x.copy(), state.P.copy()
    x[_SWING] = 0.0
    if state.sway_omega > FASTEST:
        x[_SWAY] = 0.0
    P, omega = _unled(state, P), state.sway_omega
    return Guide(x, P, state.ripple_factor, sway_omega=omega, hangs=state.hangs)


def _unled(state: BankState, P: Array) -> Array:
    """Return the covariance, changed in place, without what does not lead the target."""
    P[_SWING, :] = P[:, _SWING] = 0.0
    if state.sway_omega > FASTEST:
        P[_SWAY, :] = P[:, _SWAY] = 0.0
    return P


def _predicted(
    model: BankModel, state: BankState, guide: Guide, omega: float, dt: float
) -> BankState:
    """Return the guide one step later, (5) and (6), as a state of the bank out of contact.

    Args:
        omega: frequency of its sway [rad/s].
    """
    led = replace(
        state,
        x=guide.x,
        P=guide.P,
        ripple_factor=guide.ripple_factor,
        sway_omega=omega,
        contact=False,
        rejected={},
    )
    F = model.transition(led, dt)
    P = F.dot(guide.P).dot(F.T)
    P.reshape(-1)[:: len(P) + 1] += model.process_noise(led, dt)
    return replace(led, x=model.advanced(led, F, dt), P=_unled(led, P))


def _corrected(
    model: BankModel,
    led: BankState,
    measurement: PositionMeasurement,
    felt: FeltDrift,
    *,
    hangs: bool,
) -> BankState:
    """Return (2)-(4) for one measurement; one beyond its gate changes nothing.

    Args:
        felt: deflection up to now.
        hangs: the sway that leads is assumed, not identified.
    """
    h = model.observation_row(measurement, led)
    variance = measurement.variance
    if measurement.source is Source.TACTILE:
        variance = variance * model.compliance**2
    Ph = led.P.dot(h)
    S = float(Ph.dot(h)) + variance
    value = measurement.value - measurement.complied
    nu = value - float(h.dot(led.x)) + float(h[GAIN] * led.x[GAIN])
    if not nu * nu <= measurement.gate**2 * S:
        return led
    K: Array = Ph / S
    x = led.x + nu * K
    if measurement.source is Source.TACTILE:
        pull, limit = min(max(nu, -LARGEST_PULL), LARGEST_PULL), FARTHEST_FELT_N / model.stiffness
        if felt.is_quick:  # a swing reaches no farther than it did to the side before
            limit = max(limit, felt.reach)
        x = led.x + pull * K
        ahead = nu + felt_drift.drift_ahead(felt)
        far, lost = (each - min(max(each, -limit), limit) for each in (nu, ahead))
        taken = _brake(x, far, lost, led.sway_omega) if hangs and led.sway_omega else 0.0
        way = far - taken
        x[Y] += way
        x[OFFSET] -= way
    low, high = RIPPLE_FACTORS
    factor, x[FREQUENCY] = min(max(led.ripple_factor + float(x[FREQUENCY]), low), high), 0.0
    x[PACE] = 0.0  # the null filter knows the sway's frequency better
    return replace(led, x=x, P=led.P - K[:, None].dot(Ph[None]), ripple_factor=factor)


def _brake(x: Array, far: float, ahead: float, omega: float) -> float:
    """Return the part of a way that an assumed sway takes, which is less and slower then.

    The object is left behind by it, so it hangs on something stiffer. The sway never gains by it:
    it would follow an object that swings, and drive it.

    Args:
        x: states of the guide, changed in place.
        far: way that the deflection is beyond ``FARTHEST_FELT_N`` [m].
        ahead: the same in ``AHEAD_S``: a slower sway shows in the force only then [m].
        omega: frequency of the sway [rad/s].
    """
    taken = _less(float(x[SWAY]), far)
    x[SWAY] += taken
    x[SWAY_QUADRATURE] += _less(float(x[SWAY_QUADRATURE]), ahead / (BRAKE_S * omega))
    return taken


def _less(value: float, change: float) -> float:
    """Return the part of a change that makes a value smaller, at most by itself."""
    if value * change >= 0.0:
        return 0.0
    return math.copysign(min(abs(change), abs(value)), change)


def _deflection(model: BankModel, led: BankState, measurement: PositionMeasurement) -> float:
    """Return how far the tool measures the object from the guide [m], without the offset's part."""
    row = model.observation_row(measurement, led)
    return measurement.value - measurement.complied - float(row.dot(led.x))


def _is_pushed(state: BankState, off: float) -> bool:
    """Return whether an impulse of the last second explains a deflection: it swings back."""
    return state.impulse_age < felt_drift.SWUNG_S and off * float(state.x[IMPULSE]) > 0.0


def _drawn(led: BankState, felt: FeltDrift) -> tuple[BankState, FeltDrift]:
    """Return the guide drawn after an object that drifts away, and the deflection that is left."""
    share = felt_drift.share_taken(felt)
    if not share or felt.off is None:
        return led, felt
    way, speed = share * felt.off, share * felt.speed
    x, P = led.x.copy(), led.P.copy()
    x[Y] += way
    x[OFFSET] -= way
    x[V] += speed
    P[V, V] += speed * speed
    return replace(led, x=x, P=P), felt_drift.taken(felt, share)


def _fading(led: BankState, sway: Array, dt: float) -> BankState:
    """Return the guide with the sway that it led so far: that fades, and nothing excites it.

    The mount stiffens what the body hangs on, so another frequency is found in contact while the
    body swings on. Dropped within a step, the sway moved the target by its whole size.

    Args:
        sway: of the guide before the class was decided, (4,).
    """
    x, P = led.x.copy(), led.P.copy()
    x[_SWAY] = sway * math.exp(-dt / FADE_S)
    x[PACE] = x[GAIN] = 0.0
    P[_SWAY, :] = P[:, _SWAY] = 0.0
    return replace(led, x=x, P=P)


def _swayed(guide: Guide, own: float) -> Guide:
    """Return the guide with the null filter's sway as a part of the object's position.

    Dropped, a slow sway that was found in contact moved the target by 12 mm as a stop was declared.

    Args:
        own: sway that the guide still leads [m].
    """
    T = np.eye(STATES)
    T[Y, SWAY], T[OFFSET, SWAY] = 1.0, -1.0
    x = T.dot(guide.x)
    x[Y] -= own
    x[OFFSET] += own
    x[SWAY] = own
    return replace(guide, x=x, P=T.dot(guide.P).dot(T.T))


def _held(
    model: BankModel, led: BankState, measurements: Sequence[PositionMeasurement]
) -> BankState:
    """Return the guide with the object where the tool measures it: the rest is an offset.

    A class that is declared late has moved the conveyor by millimetres. A body that sways has not
    followed it yet: a target that went there at once would make it ring on the mount.
    """
    felt = [each for each in measurements if each.source is Source.TACTILE]
    if not felt:
        return led
    off = _deflection(model, led, felt[-1])
    if has_changed_class(led.events):
        off += felt[-1].complied  # the guide takes the target's offset over
    off = min(max(off, -FARTHEST_HELD), FARTHEST_HELD)
    x = led.x.copy()
    x[Y] += off
    x[OFFSET] -= off
    return replace(led, x=x)


def _going_on(
    model: BankModel,
    state: BankState,
    was: BankState,
    led: BankState,
    measurements: Sequence[PositionMeasurement],
    drift: FeltDrift,
    *,
    hangs: bool,
    sways: bool,
) -> tuple[BankState, bool]:
    """Return the guide after a change of its conveyor, and whether its object hangs from that.

    Args:
        was: the guide without the change.
        led: the guide with the change, for an object on a rigid carrier.
        drift: deflection up to now.
        hangs: the object hung before.
        sways: a sway leads the target.
    """
    gain = float(was.x[GAIN]) if hangs else 0.0
    if not hangs and _may_hang(model, state, sways=sways):
        gain, was = _gone_on(model, was, led, measurements, drift), _steady(was)
    if not gain:
        return led, False
    hung = _hanging(was, led, gain)
    return (hung if _comes_to_rest(state) else _held(model, hung, measurements)), True


def _may_hang(model: BankModel, state: BankState, *, sways: bool) -> bool:
    """Return whether the object may hang from its conveyor by a sway that is not identified."""
    is_led = sways and state.sway_omega > 0.0
    # Within a ramp an object is swinging from its begin: one that hangs has shown it then.
    is_first = has_changed_class(state.events) and not state.within_ramp
    return model.may_hang and not is_led and is_first


def _gone_on(
    model: BankModel,
    was: BankState,
    led: BankState,
    measurements: Sequence[PositionMeasurement],
    drift: FeltDrift = UNFELT,
) -> float:
    """Return the share of a change of the conveyor that the object has not followed, or 0.

    The mount shows it: what an object on a rigid carrier loses bends it. One that hangs goes on at
    its speed for a fifth of its period, whatever that is.

    Args:
        was: the guide without the change.
        led: the guide with the change, for an object on a rigid carrier.
        drift: deflection up to now: of one that swings quickly the mean counts.
    """
    felt = [each for each in measurements if each.source is Source.TACTILE]
    lost = float(was.x[Y] + was.x[OFFSET] - led.x[Y] - led.x[OFFSET])
    # Bolts with play show no more of an object that stops at once until they meet their holes.
    if not felt or abs(lost) < LEAST_LOST + 2.0 * felt[-1].play:
        return 0.0
    off = drift.mean if drift.is_quick else _deflection(model, was, felt[-1])
    # A guide that was drawn after the object has followed a part of what the object has lost.
    share = 1.0 + (off + drift.drawn) / lost
    # Farther on than at the speed that it had it is driven by something else: it swings.
    return min(share, model.sway.gain_deviation) if HANGING < share < 2.0 - HANGING else 0.0


def _steady(led: BankState) -> BankState:
    """Return the guide with its sway as a part of the position, before an object hangs."""
    x = led.x.copy()
    x[Y] += x[SWAY]
    x[OFFSET] -= x[SWAY]
    x[_SWAY] = 0.0
    return replace(led, x=x, sway_omega=HANGING_OMEGA)


def _hanging(was: BankState, led: BankState, gain: float) -> BankState:
    """Return the guide of an object that goes on as its conveyor turns out to be slower, or faster.

    What the guide changes of the conveyor is none of the object: it is its sway, by the gain.

    Args:
        was: the guide without the change.
        led: with it, for an object that is as fast as its conveyor.
        gain: share of the conveyor's acceleration that the object does not follow.
    """
    omega = was.sway_omega
    unit = float(led.x[Y] + led.x[OFFSET])
    lost, slower = float(was.x[Y] + was.x[OFFSET]) - unit, float(was.x[V] - led.x[V])
    x, T = led.x.copy(), np.eye(STATES)
    x[SWAY] = was.x[SWAY] + gain * lost
    x[SWAY_QUADRATURE] = was.x[SWAY_QUADRATURE] + gain * slower / omega
    x[PACE], x[GAIN] = 0.0, gain
    x[Y] = was.x[Y] + was.x[SWAY] - x[SWAY]
    x[OFFSET] = unit - x[Y]
    # Nor is what later readings correct of the conveyor's speed.
    T[SWAY_QUADRATURE, V] = -gain / omega
    T[_SWAY, _SWAY] = 0.0
    P = T.dot(led.P).dot(T.T)
    P[SWAY_QUADRATURE, SWAY_QUADRATURE] += (UNSURE * gain * slower / omega) ** 2
    return replace(led, x=x, P=P, sway_omega=omega)


def _comes_to_rest(state: BankState) -> bool:
    """Return whether a stop that was known has ended."""
    return state.motion is Motion.STANDING and not has_changed_class(state.events)


def _in_class(
    model: BankModel,
    state: BankState,
    led: BankState,
    measurements: Sequence[PositionMeasurement],
    *,
    sways: bool,
) -> BankState:
    """Return the guide in another class.

    What the bank has confirmed or taken back, the guide takes over whole, but for where the tool
    holds the object. Where a stop or a start ends it takes the speed. One that it did not foresee
    it takes over whole too: its own position lags by then, and would be read as a speed.

    A conveyor that comes to rest moves no object. Its guide held one that swung where it was just
    then, and the object swung back from there: 232 N.

    Args:
        sways: a sway leads the target.
    """
    if _comes_to_rest(state):
        x = led.x.copy()
        x[V] = state.x[RANDOM]  # what is left of the speed dies out
        return bank_filter.enter_standing(model, replace(led, x=x))
    surprise = float(state.x[V]) - float(led.x[V])
    is_new = state.is_faster or has_changed_class(state.events)
    if is_new or abs(surprise) > LARGEST_SURPRISE:
        guide = synchronised(state)
        if not sways:
            guide = _swayed(guide, float(led.x[SWAY]))
        return _held(model, replace(led, x=guide.x, P=guide.P), measurements)
    x, P = led.x.copy(), led.P.copy()
    x[V], x[ACCELERATION] = state.x[V], 0.0
    P[ACCELERATION, :] = P[:, ACCELERATION] = 0.0
    P[V, V] += surprise * surprise
    return replace(led, x=x, P=P)
