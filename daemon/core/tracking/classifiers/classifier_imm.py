"""IMM classifier: an interacting multiple model filter over the conveyor's classes.

Four Kalman filters, one a class, mixed in each step by a Markov chain of rare stops and starts
(Blom and Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Transactions on Automatic Control, 1988; filterpy's ``IMMEstimator``). The
model's own speed decides where a stop or a start ends, so that those transitions are no rates. The
mixed prediction needs no threshold; the events do.

Invariants:
- A step builds the estimator from the state and keeps none of it: filterpy's filters are mutable.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import IMMEstimator, KalmanFilter
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import start_check
from linemate.daemon.core.tracking.classifiers.start_check import StartCheck, StartRejection
from linemate.daemon.core.tracking.conveyor import (
    LONGEST_TENTATIVE_S,
    ConveyorEstimate,
    Motion,
    PositionMeasurement,
    Source,
    way,
)
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings, ImmSettings
from linemate.daemon.core.tracking.task import ConveyorClasses

STATES = 4
Y, V, RIPPLE, OFFSET = range(STATES)
MODES = (Motion.RUNNING, Motion.STOPPING, Motion.STANDING, Motion.STARTING)
RUN, STOP, STAND, START = range(4)
OFFSET_DEVIATION = 0.1  # of x10 before anything but the distance sensor saw the object [m]
STANDING_VARIANCE = 1e-8  # of the speed of a conveyor that stands [m^2/s^2]
SETTLING = 0.6  # no events until the speed is estimated [s]
MOST_REJECTED = 8  # measurements of one sensor in a row, after which the filter widens
RAMP_S = 0.1  # correlation time of an acceleration's deviation from its nominal one [s]
END = 0.3  # probability a step that a class whose speed has reached its end is left
FLOOR = 1e-9  # of a mode's probability: no class becomes impossible
LEAST_LIKELIHOOD = 1e-60  # of one measurement, likewise within a step
NEGLIGIBLE = 1e-4  # probability of a mode that the prediction leaves out

_EVENTS = {STOP: "stop", STAND: "stop", START: "start", RUN: "start"}
_INITIAL_ODDS = (0.49, 0.01, 0.49, 0.01)


class ImmState(Struct, frozen=True, eq=False):
    """Estimates (4, 4), covariances (4, 4, 4) and probabilities (4,) of the modes.

    Attributes:
        mode: number of the class in force.
        cruise: speed at which a start ends [m/s].
        age: of the estimate [s].
        rejected: measurements rejected in a row, by sensor.
        tentative: a change has been perceived.
        tentative_s: how long it has been tentative [s].
        start_check: of a start against the readings, or None.
        events: of the last step.
    """

    x: Array
    P: Array
    mu: Array
    mode: int
    cruise: float
    age: float = 0.0
    rejected: tuple[tuple[Source, int], ...] = ()
    tentative: bool = False
    tentative_s: float = 0.0
    start_check: StartCheck | None = None
    events: tuple[tuple[str, str], ...] = ()


class _ModeFilter(KalmanFilter):  # type: ignore[misc]  # filterpy is not typed
    """Kalman filter of one class; its likelihood without scipy's distributions (0.3 ms each).

    Attributes:
        acted: way that the acceleration of the class has added since the measurement [m].
    """

    acted = 0.0

    def update(self, z: Array, R: Array | None = None, H: Array | None = None) -> None:
        """Correct by a delayed measurement (1,)."""
        super().update(z - self.acted, R, H)

    @property
    def likelihood(self) -> float:
        """Density of the last measurement."""
        S = float(self.S[0, 0])
        density = math.exp(-0.5 * float(self.y[0]) ** 2 / S) / math.sqrt(2.0 * math.pi * S)
        return max(density, LEAST_LIKELIHOOD)


@dataclass(frozen=True, slots=True, eq=False)
class ImmClassifier:
    """IMM filter with its rates and thresholds; see ``conveyor.Classifier``."""

    conveyor: ConveyorClasses
    fusion: FusionSettings
    bank: BankSettings
    imm: ImmSettings
    distance_deviation: float

    @property
    def _accelerations(self) -> tuple[float, float, float, float]:
        """Nominal acceleration of each mode [m/s^2]."""
        return (0.0, -self.conveyor.deceleration, 0.0, self.conveyor.acceleration)

    def initial(self, position: float) -> ImmState:
        """Return the state at a first distance reading; class and speed are unknown."""
        nominal = self.conveyor.nominal_speed
        offset = OFFSET_DEVIATION**2
        x = np.zeros((4, STATES))
        x[:, Y] = position
        x[RUN, V] = nominal
        x[STOP, V] = x[START, V] = 0.5 * nominal
        P = np.zeros((4, STATES, STATES))
        P[:, Y, Y] = self.distance_deviation**2 + offset
        P[:, OFFSET, OFFSET] = offset
        P[:, Y, OFFSET] = P[:, OFFSET, Y] = -offset
        P[:, RIPPLE, RIPPLE] = self.fusion.ripple**2
        P[:, V, V] = (0.3 * nominal) ** 2
        P[STAND, V, V] = STANDING_VARIANCE
        return ImmState(x, P, np.array(_INITIAL_ODDS), RUN, nominal)

    def _chain(self, state: ImmState, dt: float) -> Array:
        """Return the Markov chain (4, 4) of this step, row: from, column: to."""
        rare = self.imm.rate * dt
        chain = np.zeros((4, 4))
        chain[RUN, STOP] = chain[START, STOP] = rare
        chain[STAND, START] = chain[STOP, START] = rare
        chain[STOP, STAND] = END if state.x[STOP, V] <= 0.0 else 0.0
        chain[START, RUN] = END if state.x[START, V] >= state.cruise else 0.0
        chain[np.arange(4), np.arange(4)] = 1.0 - chain.sum(axis=1)
        return chain

    def _filter(self, state: ImmState, mode: int, dt: float) -> _ModeFilter:
        """Return the Kalman filter of a mode: (5), (6), with its acceleration as control input."""
        kf = _ModeFilter(dim_x=STATES, dim_z=1, dim_u=1)
        kf.x, kf.P = state.x[mode].copy(), state.P[mode].copy()
        decay = math.exp(-dt / self.fusion.ripple_time)
        if mode == STAND:
            kf.F = np.diag((1.0, 0.0, 0.0, 1.0))
            kf.Q = np.diag((1e-12, STANDING_VARIANCE, 0.0, self.fusion.offset**2 * dt))
            return kf
        kf.F[Y, V] = kf.F[Y, RIPPLE] = dt
        kf.F[RIPPLE, RIPPLE] = decay
        acceleration = self._accelerations[mode]
        kf.B = np.array((0.5 * dt * dt, dt, 0.0, 0.0)) * acceleration
        kf.B.shape = (STATES, 1)
        density = self.fusion.speed**2
        density += (self.bank.amplitude_deviation * acceleration) ** 2 * RAMP_S
        share = min(max(float(state.x[mode, V]) / self.conveyor.nominal_speed, 0.0), 1.0)
        kf.Q = np.zeros((STATES, STATES))
        kf.Q[:RIPPLE, :RIPPLE] = Q_continuous_white_noise(2, dt, density)
        kf.Q[RIPPLE, RIPPLE] = (self.fusion.ripple * share) ** 2 * (1.0 - decay * decay)
        kf.Q[OFFSET, OFFSET] = self.fusion.offset**2 * dt
        return kf

    def _estimate(
        self, state: ImmState, measurements: Sequence[PositionMeasurement], dt: float
    ) -> ImmState:
        """Return the state one step later, (2)-(6) in each mode, without a decision."""
        filters = [self._filter(state, mode, dt) for mode in range(4)]
        estimator = IMMEstimator(filters, state.mu, self._chain(state, dt))
        estimator.predict(u=np.ones(1))
        estimator.mu = estimator.cbar.copy()
        # The chain acts once a step, not once a measurement.
        estimator.M = np.eye(4)
        rejected = dict(state.rejected)
        for measurement in measurements:
            innovations, variances = self._innovations(filters, measurement)
            gates = measurement.gate**2 * variances
            is_live = estimator.mu > 0.01
            source = measurement.source
            if not bool((innovations[is_live] ** 2 <= gates[is_live]).any()):
                rejected[source] = rejected.get(source, 0) + 1
                if rejected[source] >= MOST_REJECTED:
                    return self._widened(_merged(state, estimator), float(innovations[is_live][0]))
                continue
            rejected[source] = 0
            estimator.update(np.array((measurement.value,)))
        return replace(
            _merged(state, estimator),
            age=state.age + dt,
            rejected=tuple(rejected.items()),
            events=(),
        )

    def _innovations(
        self, filters: Sequence[_ModeFilter], measurement: PositionMeasurement
    ) -> tuple[Array, Array]:
        """Return the innovations (4,) of the modes and their variances (4,); set h and R."""
        tau, has_offset = measurement.delay, measurement.source is Source.DISTANCE
        h = np.array(((1.0, -tau, -tau, float(has_offset)),))
        innovations, variances = np.empty(4), np.empty(4)
        for mode, kf in enumerate(filters):
            kf.H, kf.R = h, np.array(((measurement.variance,),))
            kf.acted = 0.5 * self._accelerations[mode] * tau * tau
            innovations[mode] = measurement.value - kf.acted - float(h[0] @ kf.x)
            variances[mode] = float(h[0] @ kf.P @ h[0]) + measurement.variance
        return innovations, variances

    def _widened(self, state: ImmState, nu: float) -> ImmState:
        """Return the state with a larger covariance: a sensor that stays rejected is right."""
        P = state.P.copy()
        P[:, Y, Y] += nu * nu
        P[:, OFFSET, OFFSET] += nu * nu
        P[:, V, V] += (0.5 * self.conveyor.nominal_speed) ** 2
        mu = np.array(_INITIAL_ODDS)
        return replace(state, P=P, mu=mu, age=0.0, rejected=(), tentative=False, events=())

    def advance(
        self, state: ImmState, measurements: Sequence[PositionMeasurement], dt: float
    ) -> ImmState:
        """Return the state ``dt`` seconds later, its class decided."""
        before = state
        state = self._decide(self._estimate(state, measurements, dt))
        state = _bound_tentative(state, before, dt)
        return self._learn(self._check_start(before, state, measurements, dt), dt)

    def _check_start(
        self,
        before: ImmState,
        state: ImmState,
        measurements: Sequence[PositionMeasurement],
        dt: float,
    ) -> ImmState:
        """Return the state with a start cancelled, or ended, if the readings contradict it."""
        if state.mode != START and state.start_check is None:
            return state
        speed = float(state.x[START, V])
        check = start_check.update(
            state.start_check, MODES[before.mode], MODES[state.mode], speed, measurements, dt
        )
        rejection = start_check.reject(check, self.conveyor, state.cruise, self.distance_deviation)
        if rejection is None:
            return replace(state, start_check=check)
        return self._reject_start(state, rejection)

    def _reject_start(self, state: ImmState, rejection: StartRejection) -> ImmState:
        """Return the state in the class that the readings speak for."""
        mode = MODES.index(rejection.motion)
        x, P = state.x.copy(), state.P.copy()
        if mode != STAND:  # has a filter of its own, which has no speed
            x[mode], P[mode] = state.x[START], state.P[START]
            P[mode, V, V] += (x[mode, V] - rejection.speed) ** 2
            x[mode, V] = rejection.speed
        events = state.events
        if state.tentative:
            events = (*events, ("stop", "cancelled"))
        if mode != RUN:
            events = (*events, ("start", "cancelled"))
        return replace(
            state,
            x=x,
            P=P,
            mu=_certain(mode),
            mode=mode,
            tentative=False,
            tentative_s=0.0,
            start_check=None,
            events=events,
        )

    def _decide(self, state: ImmState) -> ImmState:
        """Return the state with a change of class perceived, confirmed or cancelled."""
        best = int(np.argmax(state.mu))
        if state.age < SETTLING:
            return replace(state, mode=best)
        is_end = (state.mode, best) in {(STOP, STAND), (START, RUN)}
        if is_end and state.mu[best] > 0.5:
            return replace(state, mode=best, tentative=False)
        other = 1.0 - float(state.mu[state.mode])
        if {state.mode, best} == {STOP, STAND}:
            other = float(state.mu[RUN] + state.mu[START])
        event = _EVENTS[best]
        if best != state.mode and other > self.imm.confirmed:
            events = [(event, "tentative"), (event, "confirmed")]
            if state.tentative:
                events.pop(0)
            return replace(state, mode=best, tentative=False, events=(*state.events, *events))
        if not state.tentative and best != state.mode and other > self.imm.perceived:
            return replace(state, tentative=True, events=(*state.events, (event, "tentative")))
        if state.tentative and other < 0.5 * self.imm.perceived:
            cancelled = (_next_event(state.mode), "cancelled")
            return replace(state, tentative=False, events=(*state.events, cancelled))
        return state

    def _learn(self, state: ImmState, dt: float) -> ImmState:
        """Return the state with the cruising speed averaged slowly."""
        speed = float(state.x[RUN, V])
        if state.mode == RUN and state.age > SETTLING and state.mu[RUN] > 0.9:
            return replace(state, cruise=state.cruise + dt * (speed - state.cruise))
        return state

    def announce_stop(self, state: ImmState) -> ImmState:
        """Return the state as it is: only the sensors show a stop to this classifier."""
        return state

    def predict_positions(self, state: ImmState, times: Array) -> Array:
        """Return positions (m,) at ``times`` from now: the mean over the modes."""
        tau = self.fusion.ripple_time
        fade = tau * (1.0 - np.exp(-times / tau))
        total = np.zeros(len(times))
        for mode, weight in enumerate(state.mu.tolist()):
            if weight > NEGLIGIBLE:
                y, v, ripple, _ = state.x[mode].tolist()
                a = self._accelerations[mode]
                total += weight * (y + way(v, a, state.cruise, times) + ripple * fade)
        return total / float(state.mu[state.mu > NEGLIGIBLE].sum())

    def predict_sway(self, _state: object, times: Array) -> Array:
        """Return 0 (m,): this classifier knows no sway."""
        return np.zeros(len(times))

    def estimate(self, state: ImmState) -> ConveyorEstimate:
        """Return the estimate of the conveyor now, the modes merged."""
        mean = state.mu @ state.x
        off = state.x - mean
        P = np.einsum("i,ijk->jk", state.mu, state.P + off[:, :, None] * off[:, None, :])
        other = min(max(1.0 - float(state.mu[state.mode]), 1e-12), 1.0 - 1e-12)
        return ConveyorEstimate(
            position=float(mean[Y]),
            speed=float(mean[V] + mean[RIPPLE]),
            offset=float(mean[OFFSET]),
            deviation=math.sqrt(max(float(P[Y, Y]), 0.0)),
            speed_deviation=math.sqrt(max(float(P[V, V]), 0.0)),
            motion=MODES[state.mode],
            tentative=state.tentative,
            confidence=math.log(other / (1.0 - other)),
            events=state.events,
        )


def _merged(state: ImmState, estimator: IMMEstimator) -> ImmState:
    """Return the state with the estimator's numbers."""
    mu = np.maximum(estimator.mu, FLOOR)
    return replace(
        state,
        x=np.array([kf.x for kf in estimator.filters]),
        P=np.array([kf.P for kf in estimator.filters]),
        mu=mu / mu.sum(),
    )


def _bound_tentative(state: ImmState, before: ImmState, dt: float) -> ImmState:
    """Return the state with a change cancelled that has been tentative for too long."""
    if not state.tentative:
        return replace(state, tentative_s=0.0) if state.tentative_s else state
    tentative_s = state.tentative_s + dt if before.tentative else 0.0
    if tentative_s < LONGEST_TENTATIVE_S:
        return replace(state, tentative_s=tentative_s)
    return replace(
        state,
        mu=_certain(state.mode),
        tentative=False,
        tentative_s=0.0,
        events=(*state.events, (_next_event(state.mode), "cancelled")),
    )


def _next_event(mode: int) -> str:
    """Return the event that can follow a mode."""
    return "stop" if mode in {RUN, START} else "start"


def _certain(mode: int) -> Array:
    """Return the probabilities (4,) of the modes if one is certain."""
    mu = np.full(4, FLOOR)
    mu[mode] = 1.0 - 3.0 * FLOOR
    return mu
