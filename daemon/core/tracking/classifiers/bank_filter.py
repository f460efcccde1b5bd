"""Kalman filter of the bank classifier, (2)-(6), with its onset banks."""

import math
from collections.abc import Sequence
from statistics import median

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import onset_bank, stop_input, sway_bank
from linemate.daemon.core.tracking.classifiers.bank_model import (
    ACCELERATION,
    FREQUENCY,
    GAIN,
    OFFSET,
    PACE,
    RANDOM,
    RIPPLE,
    RIPPLE_FACTORS,
    RIPPLE_QUADRATURE,
    SLIP,
    STATES,
    SWAY,
    SWAY_QUADRATURE,
    BankModel,
    BankState,
    FasterChange,
    Guide,
    V,
    Y,
)
from linemate.daemon.core.tracking.classifiers.distance.distance_repeat import (
    FROZEN_S,
    LARGEST_RAMP,
    STEP_OF_SIGMA,
)
from linemate.daemon.core.tracking.classifiers.onset_bank import NO_POSTERIOR, OnsetBank
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source

SWAY_DEVIATION = 0.001  # of the amplitude of a known sway when the estimate begins [m]
OFFSET_DEVIATION = 0.1  # of x10 before anything but the distance sensor saw the object [m]
SETTLING = 0.6  # the banks are empty until the speed is estimated [s]
KNOWN = 0.003  # deviation of a speed that is known again [m/s]
LEAST_SPREAD_S = 0.05  # root of the rejected readings' squared times: a speed to 8 mm/s [s]
BACK_SHARE = 0.25  # of the nominal speed, backwards: a body that sways is slower
BACK_SIGMAS = 4.0  # of the noise, by which readings have to run backwards
MOST_REJECTED = 8  # measurements of one sensor rejected in a row, after which the filter widens
FARTHEST = 1e3  # beyond it the square leaves too few digits for the other variances [m]
FROZEN_WAY = 0.004  # that a running conveyor makes while a frozen sensor repeats itself [m]
AROUND = 3  # readings before and after a step whose medians are compared
STEP_SIGMAS = 3.0  # by which the speed of readings that run on may differ
STEP_SHARE = 0.5  # of an innovation by which the step may differ, and a conveyor may explain it
REST_DEVIATION = 0.002  # of the speed when a stop ends [m/s]
CREEP_DEVIATION = 0.0005  # of the lasting speed of a conveyor that stands [m/s]
SLOW = 0.004  # speed below which a stop whose deceleration fades is over [m/s]
FADED = 0.3  # share of the nominal deceleration below which it fades
SLOW_SHARE, LONGEST_STOP = 0.3, 3.0  # of nominal speed and duration; later a slow stop is over
FAST_SHARE = 0.7  # of the cruising speed, above which a stop may turn out to be none
STARTED_SHARE = 0.95  # of the cruising speed, below which a conveyor that speeds up still starts
SLOWEST_STOP = 0.5  # of the nominal deceleration, which every stop exceeds

_FIRST = STATES + 1  # column of J, after P and x, from which on the hypotheses stand


def initial(model: BankModel, position: float) -> BankState:
    """Return the estimate at a first reading of the distance sensor [m]; the speed is unknown."""
    nominal = model.conveyor.nominal_speed
    offset = OFFSET_DEVIATION**2
    P = np.zeros((STATES, STATES))
    P[V, V], P[RANDOM, RANDOM], P[OFFSET, OFFSET] = nominal**2, model.fusion.ripple**2, offset
    P[RIPPLE, RIPPLE] = P[RIPPLE_QUADRATURE, RIPPLE_QUADRATURE] = model.ripple.deviation**2
    P[FREQUENCY, FREQUENCY] = model.ripple.spread**2
    P[SLIP, SLIP] = model.fusion.slip**2
    P[Y, Y] = model.distance_deviation**2 + offset
    P[Y, OFFSET] = P[OFFSET, Y] = -offset
    x = np.zeros(STATES)
    x[Y], x[V] = position, 0.5 * nominal
    sway = model.sway
    is_known = sway.is_on and sway.frequency_hz > 0.0
    if is_known:
        P[SWAY, SWAY] = P[SWAY_QUADRATURE, SWAY_QUADRATURE] = SWAY_DEVIATION**2
        P[PACE, PACE], P[GAIN, GAIN] = sway.spread**2, sway.gain_deviation**2
        x[GAIN] = sway.gain
    return BankState(
        x=x,
        P=P,
        motion=Motion.RUNNING,
        cruise=nominal,
        changes=onset_bank.empty(STATES),
        impulses=onset_bank.empty(STATES),
        impulse_omega=2.0 * math.pi * model.impulse.frequencies_hz[0],
        sways=sway_bank.empty(sway) if sway.is_on else None,
        sway_omega=2.0 * math.pi * sway.frequency_hz if is_known else 0.0,
    )


def predict(model: BankModel, state: BankState, dt: float) -> BankState:
    """Return (5), (6), the banks one step older, and new hypotheses that begin now."""
    F = model.transition(state, dt)
    P = F.dot(state.P).dot(F.T)
    diagonal = P.reshape(-1)[:: STATES + 1]
    diagonal += model.process_noise(state, dt)
    changes, impulses = state.changes, state.impulses
    # The force shows the speed sooner: a start within a stop was missed while the filter settled.
    # On a firm object a force that contradicts the distance sensor shows nothing.
    is_felt = state.contact and not state.is_firm
    if state.age > SETTLING or (is_felt and float(P[V, V]) < KNOWN**2):
        onsets = model.onsets_now(state)
        # Without readings the evidence stays: a stop that was forgotten led a blind tool on.
        longest = model.bank.longest_onset if state.readings.size else math.inf
        changes = onset_bank.propagate(changes, onsets, F, dt, longest)
        if state.contact:
            onsets, longest = model.impulse_onsets, model.impulse.longest_onset
            impulses = onset_bank.propagate(impulses, onsets, F, dt, longest)
        elif len(impulses):
            impulses = onset_bank.empty(STATES)
            if state.impulse_odds > 0.0:  # what the force has shown was rather an impulse
                changes = onset_bank.without_support(changes, model.change_prior)
    state = replace(
        state,
        x=model.advanced(state, F, dt),
        P=P,
        changes=changes,
        impulses=impulses,
        age=state.age + dt,
        class_age=state.class_age + dt,
        impulse_age=state.impulse_age + dt,
        announced_s=state.announced_s + dt,
        is_faster=False,
        faster=state.faster and _later(state.faster, F, dt),
        events=(),
    )
    return _end_class(model, state)


def _later(faster: FasterChange, F: Array, dt: float) -> FasterChange:
    """Return the hypothesis of a faster change one step later."""
    sums = faster.bank.sums.copy()
    sums[2] += dt
    return replace(faster, bank=OnsetBank(F.dot(faster.bank.error), sums))


def _end_class(model: BankModel, state: BankState) -> BankState:
    """Return the state past the end of a stop (standing) or a start (running)."""
    v = float(state.x[V])
    if state.motion is Motion.STOPPING and _is_stopped(model, state):
        return enter_standing(model, state)
    if state.motion is Motion.STOPPING and _may_be_no_stop(state):
        return _cancel_stop(model, state)
    if state.motion is Motion.STARTING and v >= state.cruise:
        return _end_start(state, v)
    return state


def _end_start(state: BankState, speed: float) -> BankState:
    """Return the running state past the end of a start; the hypotheses of a stop are kept.

    One that began 0.2 s before that end was tested again from there on: 0.4 s late.
    """
    bank = state.changes
    error = bank.error.copy()
    error[ACCELERATION] -= state.x[ACCELERATION]  # what the stop adds is less without the start
    running = enter_class(state, Motion.RUNNING, speed, 2.0 * REST_DEVIATION)
    changes, tentative = replace(bank, error=error), state.tentative
    return replace(running, changes=changes, tentative=tentative, is_expired=state.is_expired)


def _may_be_no_stop(state: BankState) -> bool:
    """Return whether a stop may turn out to be none: it is fast still, or certainly speeds up."""
    led = _led(state)
    certain = 3.0 * math.sqrt(float(led.P[ACCELERATION, ACCELERATION]))
    return float(led.x[ACCELERATION]) > certain or float(led.x[V]) > FAST_SHARE * state.cruise


def _is_stopped(model: BankModel, state: BankState) -> bool:
    """Return whether a stop is over: no speed is left, or it fades, or the stop lasts too long."""
    v, slowing = float(state.x[V]), -float(state.x[ACCELERATION])
    if v <= 0.0:
        return True
    deceleration = model.conveyor.deceleration
    if v < SLOW and slowing < FADED * deceleration:
        return True
    slow = SLOW_SHARE * model.conveyor.nominal_speed
    return v < slow and state.class_age > LONGEST_STOP * model.conveyor.nominal_speed / deceleration


def enter_standing(model: BankModel, state: BankState) -> BankState:
    """Return the state of a conveyor that stands.

    The speed that is left becomes one that dies out. The lasting speed is a creep.
    """
    x, P = state.x.copy(), state.P.copy()
    x[RANDOM] += x[V]
    P[RANDOM, :] += P[V, :]
    P[:, RANDOM] += P[:, V]
    P[V, :] = P[:, V] = 0.0
    P[RANDOM, RANDOM] += REST_DEVIATION**2
    standing = enter_class(replace(state, x=x, P=P), Motion.STANDING, 0.0, CREEP_DEVIATION)
    return reset_ripple(model, standing)


def reset_ripple(model: BankModel, state: BankState) -> BankState:
    """Return the state of a conveyor that stands: the phase of its next ripple is unknown.

    The frequency belongs to the drive and stays known. The unit is where it was: the way of the
    old ripple is added to its position.
    """
    x, P = state.x.copy(), state.P.copy()
    x[Y] += x[RIPPLE]
    P[Y, :] += P[RIPPLE, :]
    P[:, Y] += P[:, RIPPLE]
    x[RIPPLE] = x[RIPPLE_QUADRATURE] = 0.0
    P[RIPPLE:FREQUENCY, :] = P[:, RIPPLE:FREQUENCY] = 0.0
    variance = model.ripple.deviation**2
    P[RIPPLE, RIPPLE] = P[RIPPLE_QUADRATURE, RIPPLE_QUADRATURE] = variance
    P[Y, Y] += variance
    P[Y, RIPPLE] = P[RIPPLE, Y] = -variance
    return replace(state, x=x, P=P)


def _led(state: BankState) -> BankState | Guide:
    """Return the estimate that leads the target.

    A body that sways on as its conveyor stops keeps the null filter fast.
    """
    return state if state.guide is None or state.is_firm else state.guide


def _cancel_stop(model: BankModel, state: BankState) -> BankState:
    """Return the state without a stop that has turned out not to slow the conveyor.

    Without this a wrong stop would last for ever. Its deceleration is soon estimated as zero, and
    neither a start nor the next stop looks like what can follow it. One that was declared within a
    start speeds up: the start goes on.
    """
    slowest = -SLOWEST_STOP * model.conveyor.deceleration
    led = _led(state)
    acceleration = float(led.x[ACCELERATION])
    sigma = math.sqrt(float(led.P[ACCELERATION, ACCELERATION]))
    if acceleration - 2.0 * sigma <= slowest:
        return state
    events = (*state.events, ("stop", "cancelled"))
    fastest = float(led.x[V]) + 2.0 * math.sqrt(float(led.P[V, V]))
    if fastest < STARTED_SHARE * state.cruise:
        started = clear_banks(state)
        return replace(started, motion=Motion.STARTING, class_age=0.0, events=events)
    state = enter_class(state, Motion.RUNNING, float(state.x[V]), REST_DEVIATION)
    return replace(state, events=events)


def correct(
    model: BankModel, state: BankState, measurements: Sequence[PositionMeasurement]
) -> BankState:
    """Return (2)-(4) for some measurements, null filter and banks alike, each gated.

    All that is linear is corrected as one array: ``J = [P, x, f_1 .. f_m]`` (15, 16 + m) becomes
    ``J - K (h'J - z)``. Here z is 0 for P, the measured value for x, and for each f the part of
    its signature that F does not propagate.
    """
    changes, impulses, rejected = state.changes, state.impulses, state.rejected
    announced_s, faster = state.announced_s, state.faster
    count = len(changes)
    middle, both = _FIRST + count, _FIRST + count + len(impulses)
    banks = (changes, impulses) if faster is None else (changes, impulses, faster.bank)
    J = np.concatenate((state.P, state.x[:, None], *[bank.error for bank in banks]), axis=1)
    sums = np.concatenate([bank.sums for bank in banks], axis=1)
    A, B = sums[0], sums[1]
    for measurement in measurements:
        off, S = _innovation(model, state, measurement, J, (_FIRST, middle, both))
        Ph, nu, minus_rho = off[:STATES], -float(off[STATES]), off[_FIRST:]
        gate = measurement.gate * math.sqrt(S)
        # Written so that a NaN is rejected too.
        if not abs(nu) <= gate and not _is_plausible(model, state, nu, -off[_FIRST:middle], gate):
            rejections = rejected.get(measurement.source, 0) + 1
            rejected = {**rejected, measurement.source: rejections}
            is_faulty = _is_frozen(model, state, measurement) or _runs_back(
                model, state, measurement
            )
            may_widen = abs(nu) < FARTHEST and not is_faulty
            if rejections >= MOST_REJECTED and may_widen:
                state = replace(state, x=J[:, STATES], P=J[:, :STATES])
                return _widened(model, state, nu, measurement.source, rejections)
            continue
        if rejected.get(measurement.source):
            rejected = {**rejected, measurement.source: 0}
        if measurement.source is Source.DISTANCE and math.isfinite(announced_s):
            # Only a reading decides: the target of a blind tool jumped by 4 mm, and it swung.
            counted_s = stop_input.counted_for(model.conveyor, model.distance_deviation)
            announced_s = announced_s if announced_s < counted_s else math.inf
        J -= (Ph / S)[:, None].dot(off[None])
        weighted = minus_rho / S
        A += minus_rho * weighted
        B -= weighted * nu
    x = J[:, STATES].copy()
    low, high = RIPPLE_FACTORS
    factor, x[FREQUENCY] = min(max(state.ripple_factor + float(x[FREQUENCY]), low), high), 0.0
    omega, x[PACE] = state.sway_omega * (1.0 + min(max(float(x[PACE]), -0.1), 0.1)), 0.0
    return replace(
        state,
        x=x,
        P=J[:, :STATES],
        changes=OnsetBank(J[:, _FIRST:middle], sums[:, :count], changes.shares),
        impulses=OnsetBank(J[:, middle:both], sums[:, count : both - _FIRST], impulses.shares),
        faster=faster and replace(faster, bank=OnsetBank(J[:, both:], sums[:, both - _FIRST :])),
        rejected=rejected,
        ripple_factor=factor,
        sway_omega=omega,
        announced_s=announced_s,
    )


def _innovation(
    model: BankModel,
    state: BankState,
    measurement: PositionMeasurement,
    J: Array,
    ends: tuple[int, int, int],
) -> tuple[Array, float]:
    """Return ``h'J - z`` (16 + m,) and the variance S of its innovation.

    Its element ``STATES`` is minus the innovation, those behind it are minus each bank's rho.

    Args:
        J: P, x and the signatures of the banks (15, 16 + m).
        ends: columns at which changes begin, impulses begin, and impulses end.
    """
    first, middle, end = ends
    h = model.observation_row(measurement, state)
    off: Array = h.dot(J)
    S = float(off[:STATES].dot(h)) + model.variance(measurement)
    nu = measurement.value - float(off[STATES]) + float(h[GAIN] * J[GAIN, STATES])
    off[STATES] = -nu
    ages = state.changes.age
    later = int(ages.searchsorted(measurement.delay))
    if later:  # not begun when this was measured: without h'D, which is in f
        acted = float(h[ACCELERATION])
        way = model.acted_way(state, measurement.delay, ages[:later], measurement.source)
        off[first : first + later] += model.changes[state.motion] * (acted - way)
    if end > middle and measurement.source is not Source.DISTANCE:
        impulses = state.impulses
        off[middle:end] -= model.delayed_response(impulses.age, measurement.delay, impulses.omega)
    return off, S


def _since_change(state: BankState, measurement: PositionMeasurement) -> float:
    """Return the age of the newest reading that differs from this one [s], infinity without one."""
    ages, values = state.readings
    return float(ages[values != measurement.value].min(initial=math.inf))


def _is_frozen(model: BankModel, state: BankState, measurement: PositionMeasurement) -> bool:
    """Return whether the distance sensor repeats itself while the conveyor runs.

    No conveyor stands from one reading to the next. The sensor's health needs longer to exclude it
    than the filter to be widened, which then brakes a tool that is about to touch, and detects no
    stop in contact until it has settled again.
    """
    speed = float(state.x[V])
    if measurement.source is not Source.DISTANCE:
        return False
    since = _since_change(state, measurement)
    way = max(FROZEN_WAY, STEP_OF_SIGMA * model.distance_deviation)
    return abs(speed) * since > way and since < FROZEN_S


def _runs_back(model: BankModel, state: BankState, measurement: PositionMeasurement) -> bool:
    """Return whether the distance sensor shows a conveyor that runs backwards: its sign is wrong.

    A filter widened for it would lead the tool backwards.
    """
    rate = _reading_rate(state)
    if measurement.source is not Source.DISTANCE or rate is None:
        return False
    speed, spread = rate
    noise = BACK_SIGMAS * model.distance_deviation / math.sqrt(spread)
    return speed < -max(noise, BACK_SHARE * model.conveyor.nominal_speed)


def _widened(
    model: BankModel, state: BankState, nu: float, source: Source, rejections: int
) -> BankState:
    """Return the state with a larger covariance: the filter is wrong, not eight readings.

    A body that is elsewhere while the distance sensor agrees has moved against the conveyor: the
    conveyor's speed and class are right. So they are if the distance sensor steps: that is an
    offset, and the object has not moved.
    """
    P = state.P.copy()
    P[OFFSET, OFFSET] += nu * nu
    if source is not Source.DISTANCE and not state.rejected.get(Source.DISTANCE):
        P[Y, Y] += nu * nu
        P[Y, OFFSET] -= nu * nu
        P[OFFSET, Y] -= nu * nu
        return replace(state, P=P, rejected={})
    if source is Source.DISTANCE and _has_stepped(model, state, nu, rejections - 1):
        return replace(clear_banks(state), P=P, rejected={})
    P[Y, Y] += nu * nu
    P[V, V] += _speed_variance(model, state)
    # A ripple that was estimated by a wrong filter would be predicted for seconds.
    state = reset_ripple(model, clear_banks(replace(state, P=P)))
    return replace(state, age=0.0, rejected={})


def _has_stepped(model: BankModel, state: BankState, nu: float, count: int) -> bool:
    """Return whether the distance sensor stepped, and its rejected readings run on as before.

    No conveyor that is as fast after it goes so far from one reading to the next, not even one that
    brakes and speeds up again. A sensor that becomes late shows nothing for as long.

    Args:
        nu: innovation of the newest reading [m].
        count: readings rejected before it.
    """
    ages, values = state.readings
    rate = _reading_rate(state)
    if rate is None or not AROUND <= count <= len(ages) - AROUND:
        return False
    speed = float(state.x[V])
    way = values + speed * ages
    first = len(way) - count
    after, before = way[first : first + AROUND], way[first - AROUND : first]
    step = median(after.tolist()) - median(before.tolist())
    slowed = 0.25 * LARGEST_RAMP * float(ages[first - 1] - ages[first]) ** 2
    runs_on = abs(rate[0] - speed) < STEP_SIGMAS * model.distance_deviation / math.sqrt(rate[1])
    return runs_on and max(abs(step - nu), slowed) < STEP_SHARE * abs(nu)


def _speed_variance(model: BankModel, state: BankState) -> float:
    """Return how wrong the speed of a wrong filter may be, as a variance [m^2/s^2].

    The rejected readings show it: those of a sensor that became late run on at the right speed.
    """
    unknown = (0.5 * model.conveyor.nominal_speed) ** 2
    rate = _reading_rate(state)
    if rate is None:
        return unknown
    speed, spread = rate
    off = speed - float(state.x[V])
    return min(max(off * off - model.distance_deviation**2 / spread, 0.0), unknown)


def _reading_rate(state: BankState) -> tuple[float, float] | None:
    """Return the speed that the last readings show [m/s] and the spread of their times [s^2].

    None where they are too few, or too near to each other.
    """
    ages, values = state.readings[:, 1 - MOST_REJECTED :]
    if len(ages) < MOST_REJECTED - 1:
        return None
    times = ages.mean() - ages
    spread = float(times @ times)
    return None if spread < LEAST_SPREAD_S**2 else (float(times @ values) / spread, spread)


def _is_plausible(model: BankModel, state: BankState, nu: float, rho: Array, gate: float) -> bool:
    """Return whether an innovation lies in the range that the hypotheses span.

    The gate of a fine sensor is narrower than the way of a stop that is not perceived yet. Readings
    that are rejected there would keep the stop from being perceived.
    """
    if len(rho) == 0:
        return False
    change = model.change_posterior(state)
    is_faster = change.variance != model.change_prior.variance
    expected = float(change.weights @ (rho * change.amplitudes if is_faster else rho))
    return min(0.0, expected) - gate < nu < max(0.0, expected) + gate


def clear_banks(state: BankState) -> BankState:
    """Return the state without hypotheses."""
    return replace(
        state,
        changes=onset_bank.empty(STATES),
        impulses=onset_bank.empty(STATES),
        change=NO_POSTERIOR,
        impulse=NO_POSTERIOR,
        change_odds=-30.0,
        impulse_odds=-30.0,
        distance_odds=None,
        tentative=False,
        is_expired=False,
        faster=None,
    )


def enter_class(state: BankState, motion: Motion, speed: float, deviation: float) -> BankState:
    """Return the state in a class without acceleration; later measurements correct the speed."""
    x, P = state.x.copy(), state.P.copy()
    x[V], x[ACCELERATION] = speed, 0.0
    P[ACCELERATION, :] = P[:, ACCELERATION] = 0.0
    P[V, V] += deviation**2
    return replace(clear_banks(state), x=x, P=P, motion=motion, class_age=0.0)
