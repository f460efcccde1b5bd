"""Sway in the bank's filter: found by the regressions, then followed by two states.

The regressions (``sway_bank``) read what the body does against the conveyor. Once a sway is found,
its frequency, gain and state go to the Kalman filter, which then refines the frequency. An onset's
signature contains the sway that it forces, because both go through the same transition.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.tracking.classifiers import sway_bank
from linemate.daemon.core.tracking.classifiers.bank_model import (
    ACCELERATION,
    GAIN,
    IMPULSE,
    IMPULSE_QUADRATURE,
    OFFSET,
    PACE,
    RAMPS,
    RIPPLE,
    STATES,
    SWAY,
    SWAY_QUADRATURE,
    BankModel,
    BankState,
    V,
    Y,
)
from linemate.daemon.core.tracking.classifiers.sway_bank import SwayBank, SwayFit
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source

WIDENING = 4.0  # of the regression's covariance: neighbouring readings are not independent
TOUCHED = 0.001  # one sigma of what the body has moved unseen when the tool touches it [m]
SETTLED_S = 0.6  # after which the speed is estimated [s]
LEAST_SPREAD = 0.01  # of the frequency, as a share
RAMP_S = 0.05  # one sigma of when a ramp ends: it coasts, or is smooth [s]
CAUTION = 2.5  # times the deviation of a gain that no recording shows, for what may go wrong
JUMP = 0.1  # of the logarithm of the frequency in a step, which only another sway makes
GAIN_PART = 2  # place of the gain in a fit
LEAST_OFFSET = 0.001  # that is corrected at once; the filter corrects the rest [m]
OTHER = 0.12  # difference of two frequencies, as a share, that makes them two sways
BETTER = 10.0  # log odds by which another frequency must be likelier


def predict(model: BankModel, state: BankState, dt: float) -> BankState:
    """Return the state with its regressions one step later."""
    if state.sways is None:
        return state
    acceleration = float(state.x[ACCELERATION]) if state.motion in RAMPS else 0.0
    stands = state.motion is Motion.STANDING
    ripple = model.unit_acceleration(state) - float(state.x[ACCELERATION])
    sways = sway_bank.predict(
        model.sway, state.sways, dt, acceleration, stands=stands, ripple=ripple
    )
    return replace(state, sways=sways)


def follow(
    model: BankModel,
    predicted: BankState,
    state: BankState,
    measurements: Sequence[PositionMeasurement],
) -> BankState:
    """Return the state with its sway identified from the readings of a step.

    Args:
        predicted: the state before they corrected it.
        state: after that, its class decided.
    """
    state = with_held_frequency(model, predicted, state)
    if state.sways is None:
        return state
    sways = _read(model, predicted, state.sways, measurements, state.rejected)
    sways = _changed_class(model, predicted, state, sways)
    if ("push", "confirmed") in state.events:
        sways = sway_bank.count_push(sways)
    if not sway_bank.is_due(sways):
        return replace(state, sways=sways)
    sways, best = sway_bank.evaluate(model.sway, sways, state.sway_omega, BETTER)
    state = replace(state, sways=sways)
    return state if best is None else _adopt(model, state, sways, best)


def with_held_frequency(model: BankModel, before: BankState, state: BankState) -> BankState:
    """Return the state whose identified frequency counts as exact until the conveyor stands.

    A chain that drove the body at 1.06 Hz made 1.12 Hz of a sway of 1.2 Hz.
    """
    if not state.sway_omega:
        return state
    if model.holds_pace(state):
        variance = 0.0
    elif model.holds_pace(before):
        variance = model.sway.spread**2
    else:
        return state
    if state.P[PACE, PACE] == variance:
        return state
    P = state.P.copy()
    P[PACE, :] = P[:, PACE] = 0.0
    P[PACE, PACE] = variance
    return replace(state, P=P)


def unknown_sway(model: BankModel, state: BankState) -> float:
    """Return one sigma of the sway that a change of class excites beyond its prediction [s^2].

    It is for each m/s^2 of the conveyor's acceleration a: a body on a hanger of frequency w is
    displaced by ``g a (1 - cos w t) / w^2``, at most twice ``g a / w^2``.
    """
    settings, omega = model.sway, state.sway_omega
    if omega:
        is_known = settings.frequency_hz > 0.0
        shape = min(omega * RAMP_S, 1.0) if is_known else 0.0
        gain = math.sqrt(max(float(state.P[GAIN, GAIN]), 0.0))
        return 2.0 * math.hypot(gain if is_known else CAUTION * gain, shape) / omega**2
    if settings.frequency_hz:  # known, but not followed
        omega = 2.0 * math.pi * settings.frequency_hz
        return 2.0 * math.hypot(settings.gain, settings.gain_deviation) / omega**2
    return 2.0 * settings.gain_deviation / (2.0 * math.pi * settings.range_hz[0]) ** 2


def has_taken_over(before: BankState, state: BankState) -> bool:
    """Return whether the state follows a sway that the step before it did not follow."""
    if not state.sway_omega or before.sway_omega == state.sway_omega:
        return False
    return not before.sway_omega or abs(math.log(state.sway_omega / before.sway_omega)) > JUMP


def touched(state: BankState, pushed: float = 0.0) -> BankState:
    """Return the state as the tool comes into contact with the body.

    Where the body is against the conveyor was seen by another sensor, or not for a while.

    Args:
        pushed: one sigma of the speed that the tool has given it before [m/s].
    """
    P, variance = state.P.copy(), TOUCHED**2
    if pushed and state.sway_omega:
        P[SWAY_QUADRATURE, SWAY_QUADRATURE] += (pushed / state.sway_omega) ** 2
    elif pushed:
        P[IMPULSE_QUADRATURE, IMPULSE_QUADRATURE] += (pushed / state.impulse_omega) ** 2
    P[Y, Y] += variance
    P[OFFSET, OFFSET] += variance
    P[Y, OFFSET] -= variance
    P[OFFSET, Y] -= variance
    return replace(state, P=P)


def _read(
    model: BankModel,
    state: BankState,
    sways: SwayBank,
    measurements: Sequence[PositionMeasurement],
    rejected: Mapping[Source, int],
) -> SwayBank:
    """Return the regressions after the readings.

    Args:
        rejected: by the filter in a row, by sensor.
    """
    acceleration = float(state.x[ACCELERATION]) if state.motion in RAMPS else 0.0
    for measurement in measurements:
        if measurement.source is Source.DISTANCE:
            if state.age > SETTLED_S:
                speed, is_accepted = float(state.x[V]), not rejected.get(Source.DISTANCE)
                sways = sway_bank.read_unit(sways, measurement, speed, is_accepted=is_accepted)
                sways = sway_bank.with_unit_found(model.sway, sways, measurement, speed)
        else:
            sways = sway_bank.read(model.sway, sways, measurement, acceleration, state.class_age)
    return sways


def _changed_class(
    model: BankModel, before: BankState, state: BankState, sways: SwayBank
) -> SwayBank:
    """Return the regressions with what a change of class has forced since its onset."""
    if before.motion is state.motion:
        return sways
    was = float(before.x[ACCELERATION]) if before.motion in RAMPS else 0.0
    now = float(state.x[ACCELERATION]) if state.motion in RAMPS else 0.0
    if any(what == "cancelled" for _, what in state.events) and state.motion not in RAMPS:
        return sway_bank.change_class(model.sway, sways, -was, before.class_age)
    return sway_bank.change_class(model.sway, sways, now - was, state.class_age)


def _adopt(model: BankModel, state: BankState, sways: SwayBank, best: SwayFit) -> BankState:
    """Return the state with a sway that is certain, or another than the one that it follows."""
    if sway_bank.is_pushed(sways) or not _is_large(model, state, best):
        return state
    if state.sway_omega and model.holds_pace(state):
        return state
    if state.sway_omega and abs(math.log(best.omega / state.sway_omega)) <= OTHER:
        return state
    return _with_sway(state, sways, best)


def _is_large(model: BankModel, state: BankState, fit: SwayFit) -> bool:
    """Return whether a sway is large enough to be followed."""
    deviation = math.sqrt(float(np.trace(fit.covariance[:2, :2])))
    least = model.sway.contact_least if state.contact else model.sway.least
    return fit.amplitude > max(least, 2.0 * deviation)


def _with_sway(state: BankState, sways: SwayBank, fit: SwayFit) -> BankState:
    """Return the state that follows a sway; what was taken for an offset is none."""
    x, P = state.x.copy(), state.P.copy()
    # What was counted as a push is in the fit as well.
    x[IMPULSE] = x[IMPULSE_QUADRATURE] = 0.0
    P[IMPULSE:RIPPLE, :] = P[:, IMPULSE:RIPPLE] = 0.0
    P[SWAY:STATES, :] = P[:, SWAY:STATES] = 0.0
    variance = max(fit.spread, LEAST_SPREAD) ** 2
    covariance = WIDENING * fit.covariance
    widest = sway_bank.gain_deviation(sways)
    shrunk = min(widest / math.sqrt(float(covariance[GAIN_PART, GAIN_PART])), 1.0)
    covariance[GAIN_PART] *= shrunk
    covariance[:, GAIN_PART] *= shrunk
    sway, body = fit.values[:3], float(fit.values[3]) + (sways.base or 0.0)
    of_sway = np.array((SWAY, SWAY_QUADRATURE, GAIN))
    slope = fit.slope[:3, None]
    x[of_sway], x[PACE] = sway, 0.0
    P[of_sway[:, None], of_sway] = covariance[:3, :3] + variance * slope.dot(slope.T)
    P[PACE, of_sway] = P[of_sway, PACE] = variance * fit.slope[:3]
    P[PACE, PACE] = variance
    if abs(body + float(x[OFFSET])) > LEAST_OFFSET and sways.unit is not None:
        x[Y], x[OFFSET] = sways.unit.position + body, -body
    spread = float(covariance[3, 3])
    P[Y, Y], P[OFFSET, OFFSET] = P[Y, Y] + spread, P[OFFSET, OFFSET] + spread
    P[Y, OFFSET] = P[OFFSET, Y] = P[Y, OFFSET] - spread
    return replace(state, x=x, P=P, sway_omega=fit.omega, hangs=False)
