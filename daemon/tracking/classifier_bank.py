"""A generalized likelihood ratio test over a bank of onsets (Willsky), acting before it is sure.

Law of this file: one null filter that believes in the class in force, and a bank of hypotheses
"another class began u seconds ago". A hypothesis needs no history: its raw signature is analytic
in its age, what the null filter has absorbed of it is propagated with the filter's own F and K,
and two sums a hypothesis hold all evidence (reading notes, "One bank for everything"):

    rho = d - h'f,   A += rho^2 / S,   B += rho nu / S,   f <- F f + K rho.

The amplitude of a class is N(1, s^2) and integrated out, so that a deceleration known to +-25 %
needs no bank of its own.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from linemate.daemon.horizon import Array
from linemate.daemon.tracking.conveyor import Motion, Row, Source, View, travel
from linemate.daemon.tracking.settings import BankSettings, FusionSettings
from linemate.daemon.tracking.task import ConveyorClasses

Y, V, RIPPLE, OFFSET, ACCELERATION = range(5)
OFFSET_DEVIATION = 0.1  # of x10 before anything but the distance sensor saw the object [m]
SETTLING = 0.6  # the bank is empty until the speed has been seen [s]
REFUSALS = 8  # gated rows in a row after which the filter widens
REST_DEVIATION = 0.002  # of the speed when a stop is taken to have ended [m/s]
CALM = 2.0  # log odds below which a tentative change is cancelled

_STOP = (Motion.STOPPING, "stop")
_START = (Motion.STARTING, "start")
_NEXT = {
    Motion.RUNNING: _STOP,
    Motion.STARTING: _STOP,
    Motion.STANDING: _START,
    Motion.STOPPING: _START,
}


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """Hypotheses by age, youngest first.

    Attributes:
        absorbed: f (m, 5), what the null filter has taken in of each signature.
        A, B: (m,) evidence.
        age: (m,) time since each onset [s].
    """

    absorbed: Array
    A: Array
    B: Array
    age: Array


@lru_cache(maxsize=16)
def _transition(dt: float, ripple_time: float) -> Array:
    """Return A of (5): ripple is a speed that dies out."""
    F = np.eye(5)
    F[Y, V], F[Y, RIPPLE], F[Y, ACCELERATION] = dt, dt, 0.5 * dt * dt
    F[V, ACCELERATION] = dt
    F[RIPPLE, RIPPLE] = math.exp(-dt / ripple_time)
    F.setflags(write=False)
    return F


def empty_bank() -> Bank:
    """Return a bank without hypotheses."""
    return Bank(np.zeros((0, 5)), np.zeros(0), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class BankState:
    """Belief: x = (y, v, ripple, x10, acceleration), its covariance, class and bank."""

    x: Array
    P: Array
    motion: Motion
    cruise: float
    bank: Bank
    age: float = 0.0
    since: float = 0.0
    refused: Mapping[Source, int] = field(default_factory=dict)
    odds: float = -30.0
    tentative: bool = False
    contact: bool = False
    events: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class BankClassifier:
    """The bank with its thresholds; ``mixture`` lets the prediction act before it is sure."""

    conveyor: ConveyorClasses
    fusion: FusionSettings
    bank: BankSettings
    distance_deviation: float
    mixture: bool = True

    def initial(self, position: float) -> BankState:
        """Return the belief at a first distance reading; the speed is not known yet."""
        nominal = self.conveyor.nominal_speed
        offset = OFFSET_DEVIATION**2
        P = np.diag((0.0, nominal**2, self.fusion.ripple**2, offset, 0.0))
        P[Y, Y] = self.distance_deviation**2 + offset
        P[Y, OFFSET] = P[OFFSET, Y] = -offset
        x = np.array((position, 0.5 * nominal, 0.0, 0.0, 0.0))
        return BankState(x, P, Motion.RUNNING, nominal, empty_bank())

    def _change(self, motion: Motion) -> float:
        """Return the acceleration that the change out of a class adds [m/s^2]."""
        stop, start = self.conveyor.deceleration, self.conveyor.acceleration
        return {
            Motion.RUNNING: -stop,
            Motion.STANDING: start,
            Motion.STOPPING: start + stop,
            Motion.STARTING: -(stop + start),
        }[motion]

    def _process_noise(self, state: BankState, dt: float) -> Array:
        """Return the diagonal of Q: the ripple is stationary and stands with the conveyor."""
        fusion = self.fusion
        share = min(max(float(state.x[V]) / self.conveyor.nominal_speed, 0.0), 1.0)
        decay = math.exp(-2.0 * dt / fusion.ripple_time)
        moving = state.motion in {Motion.STOPPING, Motion.STARTING}
        ripple = (fusion.ripple * share) ** 2 * (1.0 - decay)
        rate = (0.05 * abs(self._class_acceleration(state.motion))) ** 2 * dt if moving else 0.0
        speed = fusion.speed * (1.0 if state.motion is not Motion.STANDING else 0.3)
        return np.array((1e-12, speed**2 * dt, ripple, fusion.offset**2 * dt, rate))

    def _class_acceleration(self, motion: Motion) -> float:
        """Return the nominal acceleration of a class [m/s^2]."""
        if motion is Motion.STOPPING:
            return -self.conveyor.deceleration
        return self.conveyor.acceleration if motion is Motion.STARTING else 0.0

    def _predict(self, state: BankState, dt: float) -> BankState:
        """Return (5), (6), the bank one step older, and a new hypothesis "now"."""
        F = _transition(dt, self.fusion.ripple_time)
        x = F @ state.x
        P = F @ state.P @ F.T
        P.flat[::6] += self._process_noise(state, dt)
        bank = state.bank
        if state.age > SETTLING:
            size = min(len(bank.age) + 1, round(self.bank.longest_onset / dt))
            absorbed = np.zeros((size, 5))
            evidence = np.zeros((3, size))
            if size > 1:
                absorbed[1:] = bank.absorbed[: size - 1] @ F.T
                evidence[0, 1:] = bank.A[: size - 1]
                evidence[1, 1:] = bank.B[: size - 1]
                evidence[2, 1:] = bank.age[: size - 1]
            evidence[2] += dt
            bank = Bank(absorbed, evidence[0], evidence[1], evidence[2])
        state = replace(
            state, x=x, P=P, bank=bank, age=state.age + dt, since=state.since + dt, events=()
        )
        return self._end_of_class(state)

    def _end_of_class(self, state: BankState) -> BankState:
        """Return the state past the end of a stop (standing) or a start (running)."""
        v = float(state.x[V])
        if state.motion is Motion.STOPPING and v <= 0.0:
            return _enter(state, Motion.STANDING, max(v, 0.0), REST_DEVIATION)
        if state.motion is Motion.STARTING and v >= state.cruise:
            return _enter(state, Motion.RUNNING, v, 2.0 * REST_DEVIATION)
        return state

    def _row(self, row: Row, since: float) -> Array:
        """Return h of (1), (8), (10) with the delay in it; the class acts since its onset."""
        back = min(row.delay, since)
        seen = 1.0 if row.source is Source.DISTANCE else 0.0
        return np.array((1.0, -row.delay, -row.delay, seen, row.delay * back - 0.5 * back * back))

    def _correct(self, state: BankState, rows: Sequence[Row]) -> BankState:
        """Return (2)-(4) for some rows, null filter and bank alike, each gated."""
        x, P, bank, refused = state.x, state.P, state.bank, state.refused
        absorbed, A, B = bank.absorbed, bank.A, bank.B
        half = 0.5 * self._change(state.motion)
        for row in rows:
            h = self._row(row, state.since)
            Ph = P @ h
            S = float(h @ Ph) + row.variance
            nu = row.value - float(h @ x)
            u = np.maximum(bank.age - row.delay, 0.0)
            rho = half * u * u - absorbed @ h
            gate = row.gate * math.sqrt(S)
            if abs(nu) > gate and not self._plausible(state, nu, rho, gate):
                refusals = refused.get(row.source, 0) + 1
                refused = {**refused, row.source: refusals}
                if refusals >= REFUSALS:
                    return self._widened(replace(state, x=x, P=P), nu)
                continue
            if refused.get(row.source):
                refused = {**refused, row.source: 0}
            K = Ph / S
            x = x + K * nu
            P = P - K[:, None] * Ph
            absorbed = absorbed + rho[:, None] * K
            A = A + rho * rho / S
            B = B + rho * (nu / S)
        return replace(state, x=x, P=P, bank=Bank(absorbed, A, B, bank.age), refused=refused)

    def _widened(self, state: BankState, nu: float) -> BankState:
        """Return the state opened up: the filter is wrong, not eight of one sensor's readings."""
        P = state.P.copy()
        P[Y, Y] += nu * nu
        P[OFFSET, OFFSET] += nu * nu
        P[V, V] += (0.5 * self.conveyor.nominal_speed) ** 2
        return replace(
            state, P=P, bank=empty_bank(), age=0.0, refused={}, odds=-30.0, tentative=False
        )

    def _plausible(self, state: BankState, nu: float, rho: Array, gate: float) -> bool:
        """Tell whether an innovation lies in the range that the live hypotheses span."""
        if not state.tentative or len(rho) == 0:
            return False
        expected = float(self._weights(state.bank) @ rho)
        return min(0.0, expected) - gate < nu < max(0.0, expected) + gate

    def _evidence(self, bank: Bank) -> Array:
        """Return each hypothesis' log likelihood ratio (m,), its amplitude integrated out."""
        s2 = self.bank.amplitude_deviation**2
        spread = 1.0 + s2 * bank.A
        ratio: Array = (bank.B * bank.B * s2 + 2.0 * bank.B - bank.A) / (2.0 * spread)
        evidence: Array = ratio - 0.5 * np.log(spread)
        return evidence

    def _weights(self, bank: Bank) -> Array:
        """Return the posterior weights (m,) of the onsets."""
        evidence = self._evidence(bank)
        weights = np.exp(evidence - evidence.max())
        normed: Array = weights / weights.sum()
        return normed

    def _amplitude(self, bank: Bank) -> Array:
        """Return the posterior mean amplitude (m,) of each hypothesis."""
        s2 = self.bank.amplitude_deviation**2
        mean: Array = (bank.B * s2 + 1.0) / (bank.A * s2 + 1.0)
        return mean

    def _shift(self, state: BankState) -> Array:
        """Return by how much each hypothesis moves the null estimate (m, 5): alpha (D - f)."""
        bank = state.bank
        change = self._change(state.motion)
        raw = np.zeros((len(bank.age), 5))
        raw[:, Y] = 0.5 * change * bank.age**2
        raw[:, V] = change * bank.age
        raw[:, ACCELERATION] = change
        shift: Array = (raw - bank.absorbed) * self._amplitude(bank)[:, None]
        return shift

    def advance(self, state: BankState, rows: Sequence[Row], dt: float) -> BankState:
        """Return the belief one step later, its class decided."""
        state = self._predict(state, dt)
        if rows:
            state = self._correct(state, rows)
        contact = any(row.source is Source.TACTILE for row in rows)
        if contact is not state.contact:
            state = replace(state, contact=contact)
        return self._settle(self._decide(state), dt)

    def _decide(self, state: BankState) -> BankState:
        """Return the state with a change perceived, confirmed or cancelled."""
        if len(state.bank.age) == 0:
            return replace(state, odds=-30.0)
        evidence = self._evidence(state.bank)
        top = float(evidence.max())
        odds = top + math.log(float(np.exp(evidence - top).sum()))
        motion, word = _NEXT[state.motion]
        settings = self.bank
        limit = settings.stop_confirmed if word == "stop" else settings.start_confirmed
        state = replace(state, odds=odds)
        if odds < min(limit, settings.perceived) and not state.tentative:
            return state
        if odds > limit:
            events = [*state.events, (word, "tentative"), (word, "confirmed")]
            if state.tentative:
                events.remove((word, "tentative"))
            return self._accept(replace(state, events=tuple(events)), motion)
        if not state.tentative and odds > settings.perceived:
            return replace(state, tentative=True, events=(*state.events, (word, "tentative")))
        if state.tentative and odds < CALM:
            return replace(state, tentative=False, events=(*state.events, (word, "cancelled")))
        return state

    def _accept(self, state: BankState, motion: Motion) -> BankState:
        """Return the state in its new class: moments over the onsets, the bank cleared."""
        bank = state.bank
        weights = self._weights(bank)
        shift = self._shift(state)
        mean = weights @ shift
        off = shift - mean
        s2 = self.bank.amplitude_deviation**2
        unit = shift / np.maximum(np.abs(self._amplitude(bank)), 1e-3)[:, None]
        spread = (weights * s2 / (1.0 + s2 * bank.A))[:, None] * unit
        P = state.P + off.T @ (weights[:, None] * off) + unit.T @ spread
        x = state.x + mean
        return replace(
            state,
            x=x,
            P=P,
            motion=motion,
            bank=empty_bank(),
            since=float(weights @ bank.age),
            odds=-30.0,
            tentative=False,
        )

    def _settle(self, state: BankState, dt: float) -> BankState:
        """Return the state with its first class found and the cruising speed learnt slowly."""
        if state.motion is not Motion.RUNNING:
            return state
        speed = float(state.x[V])
        nominal = self.conveyor.nominal_speed
        if SETTLING < state.age < SETTLING + 1.5 * dt and speed < 0.3 * nominal:
            return _enter(state, Motion.STANDING, speed, REST_DEVIATION)
        if state.age > SETTLING and not state.tentative and speed > 0.7 * nominal:
            return replace(state, cruise=state.cruise + dt * (speed - state.cruise))
        return state

    def outlook(self, state: BankState, times: Array) -> Array:
        """Return positions (m,) at ``times``: the class in force, mixed with what is suspected."""
        null = self._future(state.x, state.motion, state.cruise, times)
        share = self._share(state)
        if share < 1e-4:
            return null
        bank = state.bank
        mean = state.x + self._weights(bank) @ self._shift(state)
        motion, _ = _NEXT[state.motion]
        other = self._future(mean, motion, state.cruise, times)
        return null + share * (other - null)

    def _share(self, state: BankState) -> float:
        """Return the weight of the suspected change in the prediction.

        Only a running conveyor is doubted: while it brakes or stands, a mixture does harm.
        """
        if not self.mixture or len(state.bank.age) == 0:
            return 0.0
        if state.motion is Motion.RUNNING:
            penalty = self.bank.contact_penalty if state.contact else self.bank.penalty
        elif state.motion is Motion.STANDING:
            penalty = 0.0
        else:
            return 0.0
        return 1.0 / (1.0 + math.exp(min(penalty - state.odds, 50.0)))

    def _future(self, x: Array, motion: Motion, cruise: float, times: Array) -> Array:
        """Return positions (m,) of one hypothesis under its class."""
        y, v, r, _, a = x.tolist()
        tau = self.fusion.ripple_time
        way = travel(v, a if motion in {Motion.STOPPING, Motion.STARTING} else 0.0, cruise, times)
        ripple: Array = y + way + r * tau * (1.0 - np.exp(-times / tau))
        return ripple

    def view(self, state: BankState) -> View:
        """Return what the bank believes."""
        return View(
            position=float(state.x[Y]),
            speed=float(state.x[V] + state.x[RIPPLE]),
            offset=float(state.x[OFFSET]),
            deviation=math.sqrt(max(float(state.P[Y, Y]), 0.0)),
            speed_deviation=math.sqrt(max(float(state.P[V, V] + state.P[RIPPLE, RIPPLE]), 0.0)),
            motion=state.motion,
            tentative=state.tentative,
            confidence=state.odds,
            events=state.events,
        )


def _enter(state: BankState, motion: Motion, speed: float, deviation: float) -> BankState:
    """Return the state in a class without acceleration; the speed stays free to be corrected."""
    x, P = state.x.copy(), state.P.copy()
    x[V], x[ACCELERATION] = speed, 0.0
    P[ACCELERATION, :] = P[:, ACCELERATION] = 0.0
    P[V, V] += deviation**2
    return replace(
        state,
        x=x,
        P=P,
        motion=motion,
        bank=empty_bank(),
        since=0.0,
        odds=-30.0,
        tentative=False,
    )
