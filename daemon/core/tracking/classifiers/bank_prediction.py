"""Prediction of the bank classifier: the class in force, mixed with the hypotheses, (9).

The prediction acts before a change is confirmed: hypotheses count by their posterior weight.
"""

import math

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import (
    guide,
    onset_bank,
    stop_input,
    sway_bank,
    sway_filter,
)
from linemate.daemon.core.tracking.classifiers.bank_model import (
    ACCELERATION,
    GAIN,
    IMPULSE,
    IMPULSE_QUADRATURE,
    NEXT,
    OFFSET,
    RAMPS,
    RANDOM,
    RIPPLE,
    RIPPLE_QUADRATURE,
    SWAY,
    SWAY_QUADRATURE,
    BankModel,
    BankState,
    V,
    Y,
)
from linemate.daemon.core.tracking.classifiers.distance import distance_check
from linemate.daemon.core.tracking.conveyor import ConveyorEstimate, Motion, Source, added_way

LEAST_WEIGHT = 1e-4  # of a hypothesis in the prediction
LEAST_RIPPLE = 1e-7  # amplitude of a ripple in the prediction [m]
CONTRADICTED = 2  # readings of the distance sensor rejected in a row; one may be an outlier
UNDECIDED = 12.0  # log odds of a change in contact at most, while the distance sensor is undecided
DENIAL = 4.0  # times that the sensor's own log odds count: at -3 no odds are left
LEAST_SWING = 1e-6  # amplitude of a swing in the prediction [m]


def predict_positions(model: BankModel, state: BankState, times: Array) -> Array:
    """Return positions (m,) [m] at ``times`` from now [s].

    A stop that the line announces moves them by half of its way until readings decide at most, and
    by what a mount withstands: no sensor shows sooner whether the edge is true, and either error is
    least so. In contact the force decides within 0.1 s.
    """
    announced = _with_announcement(model, state)
    alone = _mixed_positions(model, state, times)
    if announced is state:
        return alone
    moved = _mixed_positions(model, announced, times) - alone
    if not state.is_keen:
        spacing = distance_check.SPAN_S / max(state.readings.shape[1], 1)
        way = stop_input.decided_way(model.conveyor, model.distance_deviation, spacing)
        most = max(0.5 * way, stop_input.BORNE)
        moved = most * np.tanh(moved / most)
    positions: Array = alone + moved
    return positions


def _mixed_positions(model: BankModel, state: BankState, times: Array) -> Array:
    """Return the weighted mean of the hypotheses' positions (m,) [m].

    What is linear in the estimate is predicted once, for the weighted mean.
    """
    tau = model.random_ripple(state)[1]
    omega_ripple = model.ripple_omega(state)
    y = v = r = 0.0
    nonlinear: Array | float = 0.0
    for weight, estimate, motion, omega, swaying in _weighted_estimates(model, state):
        x = estimate.tolist()
        y, v, r = y + weight * x[Y], v + weight * x[V], r + weight * x[RANDOM]
        part = _nonlinear_part(model, x, motion, omega, state.cruise, times, omega_ripple)
        nonlinear = nonlinear + weight * part
        if swaying.sway_omega:
            nonlinear = nonlinear + weight * sway_ahead(model, swaying, x, motion, times)
    steady: Array = (y + r * tau) + v * times - (r * tau) * model.ripple_decay(tau, times)
    return steady + nonlinear


def _weighted_estimates(
    model: BankModel, state: BankState
) -> list[tuple[float, Array, Motion, float, BankState]]:
    """Return what the prediction mixes.

    Each has weight, estimate (10,), class, impulse frequency, and the state that knows its sway.
    """
    change, impulse = hypothesis_weights(model, state)
    estimates, rest = [], 1.0
    if change > LEAST_WEIGHT:
        motion, _ = NEXT[state.motion]
        changed = _without_impulse(state, _after_change(state))
        estimates.append((change, changed, motion, state.impulse_omega, state))
        rest -= change
    if impulse > LEAST_WEIGHT and state.guide is None:
        omega = model.likeliest_omega(state)
        estimates.append((impulse, _after_impulse(model, state), state.motion, omega, state))
        rest -= impulse
    led = guide.led_state(state)
    estimates.append((rest, ramp_estimate(model, led), state.motion, state.impulse_omega, led))
    return estimates


def _with_announcement(model: BankModel, state: BankState) -> BankState:
    """Return the state with the odds of a stop that the line announces.

    They count for the prediction alone: the sensors must confirm a stop without them. The line
    knows of it by no sensor, so they add to what each of these says.
    """
    if state.announced_s == math.inf or state.motion is not Motion.RUNNING:
        return state
    odds = stop_input.onset_odds(model.conveyor.stop_input, state.announced_s, state.changes.age)
    if odds is None:
        return state
    # The penalty is for a stop that no line announces.
    penalty = model.bank.contact_penalty if state.is_keen else model.bank.penalty
    odds = np.where(odds, odds + penalty, 0.0)
    change = onset_bank.posterior(state.changes, model.change_prior, odds)
    gained, distance_odds = change.odds - state.change.odds, state.distance_odds
    return replace(
        state,
        change=change,
        change_odds=state.change_odds + gained,
        distance_odds=None if distance_odds is None else distance_odds + gained,
    )


def ramp_estimate(model: BankModel, state: BankState) -> Array:
    """Return the estimate (10,), drawn to the configured ramp as far as that is likely.

    The filter's prior of the acceleration is wide, for ramps differ. Most ramps are as configured:
    a narrow hypothesis next to the wide one. Its odds are the ratio of the wide hypothesis' density
    at the configured value after and before the readings (Savage-Dickey density ratio). Its
    estimate is the filter's with that value measured.
    """
    nominal, share = model.class_acceleration(state.motion), model.bank.as_set
    if not nominal or not share:
        return state.x
    narrow = (model.bank.as_set_deviation * nominal) ** 2
    wide = (model.bank.amplitude_deviation * nominal) ** 2 + narrow
    column = state.P[ACCELERATION]
    off = nominal - float(state.x[ACCELERATION])
    left = float(column[ACCELERATION]) + narrow
    odds = share / (1.0 - share) * math.sqrt(wide / left) * math.exp(-0.5 * off * off / left)
    drawn: Array = state.x + column * (odds / (1.0 + odds) * off / left)
    return drawn


def _after_change(state: BankState) -> Array:
    """Return the estimate (10,) if the class has changed: ``merge_moments`` without the spread.

    A stop ends at speed 0. Without a reading that confirms it, its way went back from there.
    """
    x: Array = state.x - state.changes.error.dot(state.change.weights * state.change.amplitudes)
    speed, acceleration = float(x[V]), float(x[ACCELERATION])
    if state.motion is Motion.RUNNING and speed < 0.0 > acceleration:
        x[Y] -= 0.5 * speed * speed / acceleration
        x[V] = x[ACCELERATION] = 0.0
    return x


def _without_impulse(state: BankState, x: Array) -> Array:
    """Return an estimate (10,) without the body's swing after an impulse, if a guide leads."""
    if state.guide is not None:
        x[IMPULSE] = x[IMPULSE_QUADRATURE] = 0.0
    return x


def _after_impulse(model: BankModel, state: BankState) -> Array:
    """Return the estimate (10,) after an impulse: ``merge_moments`` without the spread."""
    weights = state.impulse.weights * state.impulse.amplitudes
    swing, quadrature = model.impulse_response(state.impulses.age, state.impulses.omega)
    x: Array = state.x - state.impulses.error.dot(weights)
    x[IMPULSE] += float(weights.dot(swing))
    x[IMPULSE_QUADRATURE] += float(weights.dot(quadrature))
    return x


def hypothesis_weights(model: BankModel, state: BankState) -> tuple[float, float]:
    """Return the weights of a change of class and of an impulse in the prediction.

    On a ramp a mixture does harm, but for a start that the force shows within a stop. A penalty
    keeps quiet tracking quiet. Neither counts while the distance sensor is rejected: no class
    explains its readings, so the ones before are no evidence of a stop. The sensor may be frozen.
    """
    # The null filter does not know where an object is that hangs: it was 30 mm off.
    hangs = state.guide is not None and state.guide.hangs and not state.is_firm
    if hangs or (state.contact and not state.is_keen):
        return 0.0, 0.0
    if not model.mixture or not len(state.changes):
        return 0.0, 0.0
    if state.rejected.get(Source.DISTANCE, 0) >= CONTRADICTED:
        return 0.0, 0.0
    caution, penalty = 1.0, model.bank.penalty
    stops = state.motion is Motion.STOPPING
    if state.motion is Motion.STANDING:
        penalty = 0.0
    elif state.motion is Motion.STARTING or (stops and not state.is_keen):
        return 0.0, 0.0
    elif state.is_keen:
        caution, penalty = model.bank.contact_caution, model.bank.contact_penalty
    odds = state.change.odds
    if state.distance_odds is not None and not state.is_firm:
        # What the distance sensor denies is a body that swings. Undecided, as it is in the first
        # 0.1 s of each stop, it denies nothing: a target that waited for it was 0.1 s late.
        # A body that a stop has made swing looks like a start: there it decides.
        undecided = penalty if stops else UNDECIDED
        odds = min(odds, undecided + DENIAL * state.distance_odds)
    change = caution * (odds - penalty)
    impulse = state.impulse.odds - max(penalty, model.impulse.confirmed)
    if state.is_keen and not state.is_firm:
        # A body that is pushed begins to move as on a conveyor that stops. No impulse leads the
        # guide: its odds, which nothing bounds, would hide the stop.
        return _sigmoid(state.change_odds) * _sigmoid(change), 0.0
    largest = max(change, impulse, 0.0)
    change, impulse = math.exp(change - largest), math.exp(impulse - largest)
    total = math.exp(-largest) + change + impulse
    return change / total, impulse / total


def _sigmoid(odds: float) -> float:
    """Return the probability of log odds."""
    return 1.0 / (1.0 + math.exp(-min(max(odds, -30.0), 30.0)))


def _nonlinear_part(
    model: BankModel,
    x: list[float],
    motion: Motion,
    omega: float,
    cruise: float,
    times: Array,
    ripple_omega: float,
) -> Array | float:
    """Return what ramp, ripple and swing of one hypothesis (m,) add to its steady motion.

    Args:
        omega: of its swing [rad/s].
        cruise: speed at which a start ends [m/s].
        ripple_omega: of the periodic ripple at full speed [rad/s].
    """
    v, a, swing, swing_quadrature = x[V], x[ACCELERATION], x[IMPULSE], x[IMPULSE_QUADRATURE]
    ripple, quadrature = x[RIPPLE], x[RIPPLE_QUADRATURE]
    is_ramp = motion in RAMPS
    part = added_way(v, a, cruise, times) if is_ramp else 0.0
    if abs(ripple) + abs(quadrature) > LEAST_RIPPLE:
        nominal = model.conveyor.nominal_speed
        way = v * times + part if is_ramp else model.speed_share(v) * nominal * times
        # One complex exponential is cosine and sine at once.
        turning = np.exp((-1j * ripple_omega / nominal) * way)
        part = part + (complex(ripple, quadrature) * turning).real
    if abs(swing) + abs(swing_quadrature) > LEAST_SWING:
        pole = complex(-model.impulse.damping * omega, omega)
        part = part + (complex(swing, -swing_quadrature) * np.exp(pole * times)).real
    return part


def sway_ahead(
    model: BankModel, state: BankState, x: list[float], motion: Motion, times: Array
) -> Array:
    """Return the sway (m,) [m] at ``times``, forced by the acceleration until the ramp's end."""
    omega, pole = state.sway_omega, model.sway_pole(state)
    sway = complex(x[SWAY], -x[SWAY_QUADRATURE]) * model.sway_turning(pole, times)
    v, a = x[V], x[ACCELERATION]
    if motion in RAMPS and x[GAIN] and a:
        end = max(state.cruise - v, 0.0) / a if a > 0.0 else max(v, 0.0) / -a
        after = np.maximum(times - end, 0.0)
        acted = model.sway_response((omega, pole), times) - sway_bank.response(omega, pole, after)
        sway = sway + x[GAIN] * a * acted
    ahead: Array = sway.real
    return ahead


def estimate(model: BankModel, state: BankState) -> ConveyorEstimate:
    """Return the estimate of the conveyor now."""
    x = ramp_estimate(model, state).tolist()
    v, random = x[V], x[RANDOM]
    variance, led = state.P.diagonal().tolist(), guide.led_state(state).x
    return ConveyorEstimate(
        position=x[Y] + x[IMPULSE] + x[SWAY] + x[RIPPLE],
        speed=v + random + x[RIPPLE_QUADRATURE] * model.ripple_rate(state),
        offset=x[OFFSET],
        deviation=math.sqrt(max(variance[Y] + variance[IMPULSE] + variance[SWAY], 0.0)),
        speed_deviation=math.sqrt(max(variance[V] + variance[RANDOM], 0.0)),
        motion=state.motion,
        tentative=state.tentative,
        confidence=state.change_odds,
        events=state.events,
        sway=x[SWAY],
        swayed=float(led[SWAY] - led[OFFSET]),
        unknown_sway=sway_filter.unknown_sway(model, state),
    )
