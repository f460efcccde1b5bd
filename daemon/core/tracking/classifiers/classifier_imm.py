"""An interacting multiple model filter over the conveyor's classes.

Law of this file: four Kalman filters, one a class, mixed each step by a Markov chain of rare stops
and starts (Blom and Bar-Shalom). A stop ends and a start ends where the model's own speed says so,
so those transitions are not rates. The mixed prediction needs no threshold; the events do.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import ramp_check
from linemate.daemon.core.tracking.classifiers.ramp_check import Denial, StartCheck
from linemate.daemon.core.tracking.conveyor import LONGEST_TRIAL, Motion, Row, Source, View, travel
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings, ImmSettings
from linemate.daemon.core.tracking.task import ConveyorClasses

Y, V, RIPPLE, OFFSET, ACCELERATION = range(5)
MODES = (Motion.RUNNING, Motion.STOPPING, Motion.STANDING, Motion.STARTING)
RUN, STOP, STAND, START = range(4)
OFFSET_DEVIATION = 0.1  # of x10 before anything but the distance sensor saw the object [m]
SETTLING = 0.6  # no events until the speed has been seen [s]
REFUSALS = 8  # of one sensor in a row, after which the filter widens
END = 0.3  # chance a step that a class whose speed has reached its end is left
FLOOR = 1e-9  # of a mode's probability: leakage bounds the odds, nothing may be impossible

_WORDS = {STOP: "stop", STAND: "stop", START: "start", RUN: "start"}


class ImmState(Struct, frozen=True, eq=False):
    """One estimate (4, 5) and covariance (4, 5, 5) a mode, and the modes' odds (4,).

    Attributes:
        mode: number of the class in force.
        trial_s: how long a change has been tentative [s].
        check: of a start against the readings, or None.
    """

    x: Array
    P: Array
    mu: Array
    mode: int
    cruise: float
    age: float = 0.0
    refused: tuple[tuple[Source, int], ...] = ()
    tentative: bool = False
    trial_s: float = 0.0
    check: StartCheck | None = None
    events: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ImmClassifier:
    """The mixing filter with its rates and thresholds."""

    conveyor: ConveyorClasses
    fusion: FusionSettings
    bank: BankSettings
    imm: ImmSettings
    distance_deviation: float

    @property
    def _accelerations(self) -> tuple[float, float, float, float]:
        """Return each mode's nominal acceleration [m/s^2]."""
        return (0.0, -self.conveyor.deceleration, 0.0, self.conveyor.acceleration)

    def initial(self, position: float) -> ImmState:
        """Return the belief at a first distance reading; class and speed are not known yet."""
        nominal = self.conveyor.nominal_speed
        offset = OFFSET_DEVIATION**2
        x = np.zeros((4, 5))
        x[:, Y] = position
        x[RUN, V] = nominal
        x[STOP, V] = x[START, V] = 0.5 * nominal
        x[:, ACCELERATION] = self._accelerations
        P = np.zeros((4, 5, 5))
        P[:, Y, Y] = self.distance_deviation**2 + offset
        P[:, OFFSET, OFFSET] = offset
        P[:, Y, OFFSET] = P[:, OFFSET, Y] = -offset
        P[:, RIPPLE, RIPPLE] = self.fusion.ripple**2
        P[:, V, V] = (0.3 * nominal) ** 2
        P[STAND, V, V] = 1e-8
        share = self.bank.amplitude_deviation
        P[:, ACCELERATION, ACCELERATION] = (share * np.array(self._accelerations)) ** 2
        return ImmState(x, P, np.array((0.49, 0.01, 0.49, 0.01)), RUN, nominal)

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

    def _mix(self, state: ImmState, dt: float) -> tuple[Array, Array, Array]:
        """Return estimates, covariances and odds of the modes after the chain's step."""
        chain = self._chain(state, dt)
        odds = np.maximum(state.mu @ chain, FLOOR)
        x, P = state.x.copy(), state.P.copy()
        nominal = self._accelerations
        for to in range(4):
            weights = chain[:, to] * state.mu / odds[to]
            if weights[to] > 1.0 - 1e-12:
                continue
            sources = state.x.copy()
            spreads = state.P.copy()
            for source in range(4):
                if source != to:
                    # Who enters a class does not bring an acceleration along.
                    sources[source, ACCELERATION] = nominal[to]
                    spreads[source, ACCELERATION, :] = spreads[source, :, ACCELERATION] = 0.0
                    deviation = self.bank.amplitude_deviation * nominal[to]
                    spreads[source, ACCELERATION, ACCELERATION] = deviation**2
            x[to] = weights @ sources
            off = sources - x[to]
            P[to] = np.einsum("i,ijk->jk", weights, spreads + off[:, :, None] * off[:, None, :])
        return x, P, odds / odds.sum()

    def _predict(self, state: ImmState, dt: float) -> ImmState:
        """Return (5), (6) for each mode."""
        x, P, mu = self._mix(state, dt)
        F = np.eye(5)
        F[Y, V], F[Y, RIPPLE], F[Y, ACCELERATION] = dt, dt, 0.5 * dt * dt
        F[V, ACCELERATION] = dt
        F[RIPPLE, RIPPLE] = math.exp(-dt / self.fusion.ripple_time)
        x = x @ F.T
        P = F @ P @ F.T
        decay = 1.0 - F[RIPPLE, RIPPLE] ** 2
        share = np.clip(x[:, V] / self.conveyor.nominal_speed, 0.0, 1.0)
        P[:, Y, Y] += 1e-12
        P[:, V, V] += self.fusion.speed**2 * dt
        P[:, RIPPLE, RIPPLE] += (self.fusion.ripple * share) ** 2 * decay
        P[:, OFFSET, OFFSET] += self.fusion.offset**2 * dt
        x[STAND, V] = x[STAND, RIPPLE] = 0.0
        P[STAND, V, :] = P[STAND, :, V] = 0.0
        P[STAND, RIPPLE, :] = P[STAND, :, RIPPLE] = 0.0
        P[STAND, V, V] = 1e-8
        return replace(state, x=x, P=P, mu=mu, age=state.age + dt, events=())

    def _correct(self, state: ImmState, row: Row) -> ImmState:
        """Return (2)-(4) for one row in each mode, and the modes' odds by their likelihood."""
        seen = 1.0 if row.source is Source.DISTANCE else 0.0
        h = np.array((1.0, -row.delay, -row.delay, seen, 0.5 * row.delay**2))
        Ph = state.P @ h  # (4, 5)
        S = Ph @ h + row.variance
        nu = row.value - state.x @ h
        counts = dict(state.refused)
        live = state.mu > 0.01
        if not bool((nu[live] ** 2 <= row.gate**2 * S[live]).any()):
            counts[row.source] = counts.get(row.source, 0) + 1
            if counts[row.source] < REFUSALS:
                return replace(state, refused=tuple(counts.items()))
            return self._widened(state, float(nu[live][0]))
        counts[row.source] = 0
        K = Ph / S[:, None]
        fit = -0.5 * (nu * nu / S + np.log(S))
        mu = np.maximum(state.mu * np.exp(fit - fit.max()), FLOOR)
        return replace(
            state,
            x=state.x + K * nu[:, None],
            P=state.P - K[:, :, None] * Ph[:, None, :],
            mu=mu / mu.sum(),
            refused=tuple(counts.items()),
        )

    def _widened(self, state: ImmState, nu: float) -> ImmState:
        """Return the state opened up: a sensor that stays refused is right."""
        P = state.P.copy()
        P[:, Y, Y] += nu * nu
        P[:, OFFSET, OFFSET] += nu * nu
        P[:, V, V] += (0.5 * self.conveyor.nominal_speed) ** 2
        return replace(
            state, P=P, mu=np.array((0.49, 0.01, 0.49, 0.01)), age=0.0, refused=(), tentative=False
        )

    def advance(self, state: ImmState, rows: Sequence[Row], dt: float) -> ImmState:
        """Return the belief one step later, its class decided."""
        before = state
        state = self._predict(state, dt)
        for row in rows:
            state = self._correct(state, row)
        state = self._bounded(self._decide(state), before, dt)
        return self._learn(self._checked(before, state, rows, dt), dt)

    def _bounded(self, state: ImmState, before: ImmState, dt: float) -> ImmState:
        """Return the state with a change cancelled that has been tentative for too long."""
        if not state.tentative:
            return replace(state, trial_s=0.0) if state.trial_s else state
        trial_s = state.trial_s + dt if before.tentative else 0.0
        if trial_s < LONGEST_TRIAL:
            return replace(state, trial_s=trial_s)
        event = ("stop" if state.mode in {RUN, START} else "start", "cancelled")
        return replace(
            state,
            mu=_certain(state.mode),
            tentative=False,
            trial_s=0.0,
            events=(*state.events, event),
        )

    def _checked(
        self, before: ImmState, state: ImmState, rows: Sequence[Row], dt: float
    ) -> ImmState:
        """Return the state with a start taken back, or ended, if the readings contradict it."""
        if state.mode != START and state.check is None:
            return state
        speed = float(state.x[START, V])
        check = ramp_check.follow(
            state.check, MODES[before.mode], MODES[state.mode], speed, rows, dt
        )
        denial = ramp_check.denied(check, self.conveyor, state.cruise, self.distance_deviation)
        if denial is None:
            return replace(state, check=check)
        return self._denied(state, denial)

    def _denied(self, state: ImmState, denial: Denial) -> ImmState:
        """Return the state in the class that the readings speak for."""
        mode = MODES.index(denial.motion)
        x, P = state.x.copy(), state.P.copy()
        if mode != STAND:  # that one has a filter of its own, which knows no speed
            x[mode], P[mode] = state.x[START], state.P[START]
            P[mode, V, V] += (x[mode, V] - denial.speed) ** 2
            x[mode, V], x[mode, ACCELERATION] = denial.speed, self._accelerations[mode]
            P[mode, ACCELERATION, :] = P[mode, :, ACCELERATION] = 0.0
            spread = self.bank.amplitude_deviation * self._accelerations[mode]
            P[mode, ACCELERATION, ACCELERATION] = spread**2
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
            trial_s=0.0,
            check=None,
            events=events,
        )

    def _decide(self, state: ImmState) -> ImmState:
        """Return the state with a change of class perceived, confirmed or cancelled."""
        best = int(np.argmax(state.mu))
        if state.age < SETTLING:
            return replace(state, mode=best)
        ending = (state.mode, best) in {(STOP, STAND), (START, RUN)}
        if ending and state.mu[best] > 0.5:
            return replace(state, mode=best, tentative=False)
        other = 1.0 - float(state.mu[state.mode])
        if {state.mode, best} == {STOP, STAND}:
            other = float(state.mu[RUN] + state.mu[START])
        word = _WORDS[best]
        if best != state.mode and other > self.imm.confirmed:
            events = [(word, "tentative"), (word, "confirmed")]
            if state.tentative:
                events.pop(0)
            return replace(state, mode=best, tentative=False, events=(*state.events, *events))
        if not state.tentative and best != state.mode and other > self.imm.perceived:
            return replace(state, tentative=True, events=(*state.events, (word, "tentative")))
        if state.tentative and other < 0.5 * self.imm.perceived:
            word = "stop" if state.mode in {RUN, START} else "start"
            return replace(state, tentative=False, events=(*state.events, (word, "cancelled")))
        return state

    def _learn(self, state: ImmState, dt: float) -> ImmState:
        """Return the state with the cruising speed learnt slowly."""
        speed = float(state.x[RUN, V])
        if state.mode == RUN and state.age > SETTLING and state.mu[RUN] > 0.9:
            return replace(state, cruise=state.cruise + dt * (speed - state.cruise))
        return state

    def outlook(self, state: ImmState, times: Array) -> Array:
        """Return positions (m,) at ``times``: each mode's future by its odds."""
        tau = self.fusion.ripple_time
        fade = tau * (1.0 - np.exp(-times / tau))
        total = np.zeros(len(times))
        for mode, weight in enumerate(state.mu.tolist()):
            if weight > 1e-4:
                y, v, r, _, a = state.x[mode].tolist()
                total += weight * (y + travel(v, a, state.cruise, times) + r * fade)
        return total / float(state.mu[state.mu > 1e-4].sum())

    def view(self, state: ImmState) -> View:
        """Return what the mixture believes."""
        mean = state.mu @ state.x
        off = state.x - mean
        P = np.einsum("i,ijk->jk", state.mu, state.P + off[:, :, None] * off[:, None, :])
        other = min(max(1.0 - float(state.mu[state.mode]), 1e-12), 1.0 - 1e-12)
        return View(
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


def _certain(mode: int) -> Array:
    """Return the odds (4,) of the modes if one is certain."""
    mu = np.full(4, FLOOR)
    mu[mode] = 1.0 - 3.0 * FLOOR
    return mu
