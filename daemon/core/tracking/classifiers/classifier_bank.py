"""A generalized likelihood ratio test over a bank of onsets, acting before it is sure.

Law of this file: one null filter that believes in the class in force, and two banks beside it:
"another class began u seconds ago", whose deceleration is known to +-25 %, and, while the tool
touches the object, "somebody pushed the body u seconds ago", a damped sine that force sensor and
camera see and the distance sensor does not. They compete: a stop counts by its odds against no
change *and* against a push. The conveyor's periodic ripple is a rotating pair like a swing, its
frequency known to some share only and estimated beside it; it fades with the speed, and a
conveyor that has stood begins it anew.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import hypotheses, ramp_check
from linemate.daemon.core.tracking.classifiers.hypotheses import NOTHING, Bank, Prior, Verdict
from linemate.daemon.core.tracking.classifiers.ramp_check import Denial, StartCheck
from linemate.daemon.core.tracking.conveyor import LONGEST_TRIAL, Motion, Row, Source, View, gained
from linemate.daemon.core.tracking.settings import (
    BankSettings,
    FusionSettings,
    JerkSettings,
    WaveSettings,
)
from linemate.daemon.core.tracking.task import ConveyorClasses

Y, V, RIPPLE, OFFSET, ACCELERATION, PUSH, QUADRATURE, WAVE, CREST, PACE = range(10)
STATES = 10
FIRST = STATES + 1  # column of J, after P and x, from which on the hypotheses stand
OFFSET_DEVIATION = 0.1  # of x10 before anything but the distance sensor saw the object [m]
SETTLING = 0.6  # the bank is empty until the speed has been seen [s]
PACES = (0.9, 1.1)  # of the wave's frequency, between which the estimate stays
UNLIKELY = 1e-4  # weight of a hypothesis that is left out of the prediction
UNSEEN = 1e-7  # amplitude of a wave too small to be predicted [m]
REFUSALS = 8  # gated rows of one sensor in a row after which the filter widens
REST_DEVIATION = 0.002  # of the speed when a stop is taken to have ended [m/s]
STILL_FAST = 0.7  # of the cruising speed, above which a stop may turn out to be none
NO_STOP = 0.5  # of the nominal deceleration, which every stop exceeds
CALM = 2.0  # log odds below which a tentative change is cancelled
STILL = (0.0,)  # the frequencies of a change of class: none

RAMPS = (Motion.STOPPING, Motion.STARTING)

_STOP = (Motion.STOPPING, "stop")
_START = (Motion.STARTING, "start")
_NEXT = {
    Motion.RUNNING: _STOP,
    Motion.STARTING: _STOP,
    Motion.STANDING: _START,
    Motion.STOPPING: _START,
}


class BankState(Struct, frozen=True, eq=False):
    """Belief of the bank.

    Attributes:
        x: y, speed, ripple, x10, acceleration, a push with its quadrature [m], the conveyor's
            wave at full speed with its quadrature [m], and the error of the wave's pace, which is
            folded into ``pace`` after each correction and then 0.
        cruise: speed at which a start ends [m/s].
        bank: of changes of class.
        pushes: of pushes of the body.
        omega: frequency of the push in x [rad/s].
        pace: the wave's frequency, as a multiple of the one that is set.
        age: of the belief [s].
        since: how long the class has been acting [s].
        refused: rows gated in a row, by sensor.
        change, push: what the two banks say after the last step.
        odds: of a change, log, against no change and against a push.
        push_odds: of a push, log, against both others.
        tentative: a change has been perceived.
        trial_s: how long it has been tentative [s].
        is_spent: it was cancelled for its duration, and its odds have not been calm since.
        check: of a start against the readings, or None.
        contact: the tactile sensor took part in the last step.
        events: of the last step.
    """

    x: Array
    P: Array
    motion: Motion
    cruise: float
    bank: Bank
    pushes: Bank
    omega: float
    pace: float = 1.0
    age: float = 0.0
    since: float = 0.0
    refused: Mapping[Source, int] = {}
    change: Verdict = NOTHING
    push: Verdict = NOTHING
    odds: float = -30.0
    push_odds: float = -30.0
    tentative: bool = False
    trial_s: float = 0.0
    is_spent: bool = False
    check: StartCheck | None = None
    contact: bool = False
    events: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, eq=False)
class BankClassifier:
    """The bank with its thresholds; ``mixture`` lets the prediction act before it is sure."""

    conveyor: ConveyorClasses
    fusion: FusionSettings
    bank: BankSettings
    distance_deviation: float
    mixture: bool = True
    jerk: JerkSettings = field(default_factory=JerkSettings)
    wave: WaveSettings = field(default_factory=WaveSettings)

    def initial(self, position: float) -> BankState:
        """Return the belief at a first distance reading; the speed is not known yet."""
        nominal = self.conveyor.nominal_speed
        offset = OFFSET_DEVIATION**2
        P = np.zeros((STATES, STATES))
        P[V, V], P[RIPPLE, RIPPLE], P[OFFSET, OFFSET] = nominal**2, self.fusion.ripple**2, offset
        P[WAVE, WAVE] = P[CREST, CREST] = self.wave.deviation**2
        P[PACE, PACE] = self.wave.spread**2
        P[Y, Y] = self.distance_deviation**2 + offset
        P[Y, OFFSET] = P[OFFSET, Y] = -offset
        x = np.zeros(STATES)
        x[Y], x[V] = position, 0.5 * nominal
        return BankState(
            x=x,
            P=P,
            motion=Motion.RUNNING,
            cruise=nominal,
            bank=hypotheses.empty(STATES),
            pushes=hypotheses.empty(STATES),
            omega=2.0 * math.pi * self.jerk.frequencies_hz[0],
        )

    # The models.

    def _change(self, motion: Motion) -> float:
        """Return the acceleration that the change out of a class adds [m/s^2]."""
        return self._changes[motion]

    @cached_property
    def _changes(self) -> dict[Motion, float]:
        stop, start = self.conveyor.deceleration, self.conveyor.acceleration
        return {
            Motion.RUNNING: -stop,
            Motion.STANDING: start,
            Motion.STOPPING: start + stop,
            Motion.STARTING: -(stop + start),
        }

    @cached_property
    def _changes_now(self) -> dict[Motion, Bank]:
        """Return the hypothesis that a change out of each class begins now."""
        now = {}
        for motion, change in self._changes.items():
            error = np.zeros(STATES)
            error[ACCELERATION] = -change
            now[motion] = hypotheses.begun(error, STILL)
        return now

    @cached_property
    def _pushes_now(self) -> Bank:
        """Return the hypotheses that a push begins now."""
        return hypotheses.begun(np.zeros(STATES), self.jerk.omegas)

    @cached_property
    def _prior(self) -> Prior:
        """Return what is known of a change's amplitude, as a share of its nominal one."""
        return Prior(1.0, self.bank.amplitude_deviation**2)

    @cached_property
    def _push_prior(self) -> Prior:
        """Return what is known of a push's amplitude [m]."""
        return Prior(0.0, self.jerk.deviation**2)

    def _class_acceleration(self, motion: Motion) -> float:
        """Return the nominal acceleration of a class [m/s^2]."""
        if motion is Motion.STOPPING:
            return -self.conveyor.deceleration
        return self.conveyor.acceleration if motion is Motion.STARTING else 0.0

    def _ripple(self, state: BankState) -> tuple[float, float]:
        """Return the ripple's deviation [m/s] and its correlation time [s]."""
        if state.contact or self._sees_ripple:
            return self.fusion.contact_ripple, self.fusion.contact_ripple_time
        return self.fusion.ripple, self.fusion.ripple_time

    @cached_property
    def _sees_ripple(self) -> bool:
        """Tell whether the distance sensor is so fine that it sees every ripple by itself.

        A stop is told from what the ripple cannot do: one that is modelled too calm is taken for
        a stop as soon as a sensor sees the way that it goes.
        """
        way = self.fusion.contact_ripple * self.fusion.contact_ripple_time
        return self.distance_deviation < 0.5 * way

    def _process_noise(self, state: BankState, dt: float) -> Array:
        """Return the diagonal of Q (10,): the ripple is stationary and stands with the conveyor."""
        fusion = self.fusion
        share = self._share(float(state.x[V]))
        ripple, time = self._ripple(state)
        moving = state.motion in RAMPS
        ripple = (ripple * share) ** 2 * (1.0 - math.exp(-2.0 * dt / time))
        rate = (0.05 * abs(self._class_acceleration(state.motion))) ** 2 * dt if moving else 0.0
        speed = fusion.speed * (1.0 if state.motion is not Motion.STANDING else 0.3)
        wave = pace = 0.0
        if self.wave.deviation > 0.0:
            wave = (self.wave.walk * share) ** 2 * dt
            pace = (self.wave.pace * share) ** 2 * dt
        offset = fusion.offset**2 * dt
        return np.array([1e-12, speed**2 * dt, ripple, offset, rate, 0.0, 0.0, wave, wave, pace])

    def _share(self, speed: float) -> float:
        """Return the share of the nominal speed, with which every ripple fades."""
        return min(max(speed / self.conveyor.nominal_speed, 0.0), 1.0)

    def _wave_omega(self, state: BankState) -> float:
        """Return the wave's frequency as it is known now [rad/s]."""
        return 2.0 * math.pi * self.wave.frequency_hz * state.pace

    def _waving(self, F: Array, state: BankState, dt: float) -> Array:
        """Return A with the wave's turn in it, and how an error of its pace enters that."""
        F = F.copy()
        angle = self._wave_omega(state) * dt
        way = 2.0 * math.pi * self.wave.frequency_hz * dt
        c, s = math.cos(angle), math.sin(angle)
        wave, crest = state.x[WAVE:PACE].tolist()
        F[WAVE, WAVE] = F[CREST, CREST] = c
        F[WAVE, CREST], F[CREST, WAVE] = s, -s
        F[WAVE, PACE], F[CREST, PACE] = way * (c * crest - s * wave), -way * (c * wave + s * crest)
        return F

    def _row(self, row: Row, state: BankState) -> Array:
        """Return h (10,) of (1), (8), (10) with the delay in it; the class acts since its onset."""
        tau = row.delay
        back = min(tau, state.since)
        acted = tau * back - 0.5 * back * back
        share, angle = self._share(float(state.x[V])), self._wave_omega(state) * tau
        wave, crest = share * math.cos(angle), -share * math.sin(angle)
        if row.source is Source.DISTANCE:
            return np.array([1.0, -tau, -tau, 1.0, acted, 0.0, 0.0, wave, crest, 0.0])
        w = state.omega
        grown = math.exp(self.jerk.damping * w * tau)
        push, quadrature = grown * math.cos(w * tau), -grown * math.sin(w * tau)
        return np.array([1.0, -tau, -tau, 0.0, acted, push, quadrature, wave, crest, 0.0])

    def _pushed(self, ages: Array, omega: Array) -> tuple[Array, Array]:
        """Return a push of amplitude 1 and its quadrature (m,), ``ages`` after its onset."""
        late = np.maximum(ages, 0.0)
        fade = np.where(ages > 0.0, np.exp(-self.jerk.damping * omega * late), 0.0)
        return fade * np.sin(omega * late), fade * np.cos(omega * late)

    def _swung(self, ages: Array, delay: float, omega: Array) -> Array:
        """Return how far a push of amplitude 1 had moved the body (m,), a delay ago."""
        phase = omega * np.maximum(ages - delay, 0.0)
        swung: Array = np.exp(-self.jerk.damping * phase) * np.sin(phase)
        return swung

    # The filter.

    def _predict(self, state: BankState, dt: float) -> BankState:
        """Return (5), (6), the banks one step older, and new hypotheses "now"."""
        F = _transition(dt, self._ripple(state)[1], state.omega, self.jerk.damping)
        F = self._waving(F, state, dt)
        P = F.dot(state.P).dot(F.T)
        diagonal = P.reshape(-1)[:: STATES + 1]
        diagonal += self._process_noise(state, dt)
        bank, pushes = state.bank, state.pushes
        if state.age > SETTLING:
            began = self._changes_now[state.motion]
            bank = hypotheses.aged(bank, began, F, dt, self.bank.longest_onset)
            if state.contact:
                began, longest = self._pushes_now, self.jerk.longest_onset
                pushes = hypotheses.aged(pushes, began, F, dt, longest)
            elif len(pushes):
                pushes = hypotheses.empty(STATES)
        state = replace(
            state,
            x=F.dot(state.x),
            P=P,
            bank=bank,
            pushes=pushes,
            age=state.age + dt,
            since=state.since + dt,
            events=(),
        )
        return self._end_of_class(state)

    def _end_of_class(self, state: BankState) -> BankState:
        """Return the state past the end of a stop (standing) or a start (running)."""
        v = float(state.x[V])
        if state.motion is Motion.STOPPING and v <= 0.0:
            return self._still(_enter(state, Motion.STANDING, max(v, 0.0), REST_DEVIATION))
        if state.motion is Motion.STOPPING and v > STILL_FAST * state.cruise:
            return self._unless_it_slows(state)
        if state.motion is Motion.STARTING and v >= state.cruise:
            return _enter(state, Motion.RUNNING, v, 2.0 * REST_DEVIATION)
        return state

    def _still(self, state: BankState) -> BankState:
        """Return the state of a conveyor that stands: nobody knows with which phase it will go on.

        The frequency is the drive's and stays known.
        """
        x, P = state.x.copy(), state.P.copy()
        x[WAVE] = x[CREST] = 0.0
        P[WAVE:PACE, :] = P[:, WAVE:PACE] = 0.0
        P[WAVE, WAVE] = P[CREST, CREST] = self.wave.deviation**2
        return replace(state, x=x, P=P)

    def _unless_it_slows(self, state: BankState) -> BankState:
        """Return the state running again if a stop has turned out not to slow the conveyor.

        A stop that was none would otherwise last for ever: its deceleration is soon known to be
        nothing, and neither a start nor the next stop looks like what can follow it.
        """
        slowest = -NO_STOP * self.conveyor.deceleration
        sigma = math.sqrt(float(state.P[ACCELERATION, ACCELERATION]))
        if float(state.x[ACCELERATION]) - 2.0 * sigma <= slowest:
            return state
        state = _enter(state, Motion.RUNNING, float(state.x[V]), REST_DEVIATION)
        return replace(state, events=(*state.events, ("stop", "cancelled")))

    def _correct(self, state: BankState, rows: Sequence[Row]) -> BankState:
        """Return (2)-(4) for some rows, null filter and banks alike, each gated.

        What is linear is corrected as one: ``J = [P, x, f_1 .. f_m]`` (10, 11 + m) becomes
        ``J - K (h'J - z)``, z being 0 for P, the row's value for x and, for each f, what of its
        signature does not go with F.
        """
        bank, pushes, refused = state.bank, state.pushes, state.refused
        changes, swings = slice(FIRST, FIRST + len(bank)), slice(FIRST + len(bank), None)
        J = np.concatenate((state.P, state.x[:, None], bank.error, pushes.error), axis=1)
        sums = np.concatenate((bank.sums, pushes.sums), axis=1)
        A, B = sums[0], sums[1]
        change = self._change(state.motion)
        for row in rows:
            h = self._row(row, state)
            off = h.dot(J)
            Ph, missed = off[:STATES], off[FIRST:]  # missed: -rho of the banks
            S = float(Ph.dot(h)) + row.variance
            nu = row.value - float(off[STATES])
            off[STATES] = -nu
            later = int(bank.age.searchsorted(row.delay))
            if later:  # they had not begun when this was measured: without h'D, which is in f
                ages, acted = bank.age[:later], float(h[ACCELERATION])
                missed[:later] += change * (ages * (0.5 * ages - row.delay) + acted)
            if len(pushes) and row.source is not Source.DISTANCE:
                missed[len(bank) :] -= self._swung(pushes.age, row.delay, pushes.omega)
            gate = row.gate * math.sqrt(S)
            # Written so that a NaN is refused too.
            if not abs(nu) <= gate and not self._plausible(state, nu, -off[changes], gate):
                refusals = refused.get(row.source, 0) + 1
                refused = {**refused, row.source: refusals}
                if refusals >= REFUSALS:
                    return self._widened(replace(state, x=J[:, STATES], P=J[:, :STATES]), nu)
                continue
            if refused.get(row.source):
                refused = {**refused, row.source: 0}
            J = J - (Ph / S)[:, None].dot(off[None])
            weighted = missed / S
            A += missed * weighted
            B -= weighted * nu
        x = J[:, STATES].copy()
        low, high = PACES
        pace, x[PACE] = min(max(state.pace + float(x[PACE]), low), high), 0.0
        return replace(
            state,
            x=x,
            P=J[:, :STATES],
            bank=Bank(J[:, changes], sums[:, : len(bank)]),
            pushes=Bank(J[:, swings], sums[:, len(bank) :]),
            refused=refused,
            pace=pace,
        )

    def _widened(self, state: BankState, nu: float) -> BankState:
        """Return the state opened up: the filter is wrong, not eight of one sensor's readings."""
        P = state.P.copy()
        # What the wave has learnt from a wrong filter would be predicted for seconds.
        P[Y, Y] += nu * nu
        P[OFFSET, OFFSET] += nu * nu
        P[V, V] += (0.5 * self.conveyor.nominal_speed) ** 2
        return replace(self._still(_cleared(replace(state, P=P))), age=0.0, refused={})

    def _plausible(self, state: BankState, nu: float, rho: Array, gate: float) -> bool:
        """Tell whether an innovation lies in the range that the live hypotheses span.

        Perceived or not: a fine sensor's gate is narrower than the way of a stop that nobody has
        perceived yet, and readings refused there never let it be perceived.
        """
        if len(rho) == 0:
            return False
        expected = float(hypotheses.verdict(state.bank, self._prior).weights @ rho)
        return min(0.0, expected) - gate < nu < max(0.0, expected) + gate

    # The decision.

    def advance(self, state: BankState, rows: Sequence[Row], dt: float) -> BankState:
        """Return the belief one step later, its class decided."""
        before = state
        state = self._predict(state, dt)
        if rows:
            state = self._correct(state, rows)
        contact = any(row.source is Source.TACTILE for row in rows)
        if contact is not state.contact:
            state = replace(state, contact=contact)
        state = self._bounded(self._decide(state), before, dt)
        return self._settle(self._checked(before, state, rows, dt), dt)

    def _bounded(self, state: BankState, before: BankState, dt: float) -> BankState:
        """Return the state with a change cancelled that has been tentative for too long."""
        if not state.tentative:
            return replace(state, trial_s=0.0) if state.trial_s else state
        trial_s = state.trial_s + dt if before.tentative else 0.0
        if trial_s < LONGEST_TRIAL:
            return replace(state, trial_s=trial_s)
        event = (_NEXT[state.motion][1], "cancelled")
        # The evidence is kept: a slow change is still confirmed by more of it.
        return replace(
            state, tentative=False, is_spent=True, trial_s=0.0, events=(*state.events, event)
        )

    def _checked(
        self, before: BankState, state: BankState, rows: Sequence[Row], dt: float
    ) -> BankState:
        """Return the state with a start taken back, or ended, if the readings contradict it."""
        if state.motion is not Motion.STARTING and state.check is None:
            return state
        speed = float(state.x[V])
        check = ramp_check.follow(state.check, before.motion, state.motion, speed, rows, dt)
        denial = ramp_check.denied(check, self.conveyor, state.cruise, self.distance_deviation)
        if denial is None:
            return replace(state, check=check)
        return self._denied(state, denial)

    def _denied(self, state: BankState, denial: Denial) -> BankState:
        """Return the state in the class that the readings speak for."""
        events = state.events
        if state.tentative:
            events = (*events, ("stop", "cancelled"))
        if denial.motion is not Motion.RUNNING:
            events = (*events, ("start", "cancelled"))
        off = float(state.x[V]) - denial.speed
        deviation = math.hypot(off, REST_DEVIATION)
        state = _enter(state, denial.motion, denial.speed, deviation)
        if denial.motion is Motion.STOPPING:
            x, P = state.x.copy(), state.P.copy()
            x[ACCELERATION] = -self.conveyor.deceleration
            P[ACCELERATION, ACCELERATION] = (
                self.bank.amplitude_deviation * self.conveyor.deceleration
            ) ** 2
            state = replace(state, x=x, P=P)
        return replace(state, trial_s=0.0, check=None, events=events)

    def _decide(self, state: BankState) -> BankState:
        """Return the state with a change perceived, confirmed or cancelled, or a push taken."""
        change = hypotheses.verdict(state.bank, self._prior)
        push = hypotheses.verdict(state.pushes, self._push_prior)
        odds = change.odds - _softplus(push.odds)
        push_odds = push.odds - _softplus(change.odds)
        motion, word = _NEXT[state.motion]
        settings = self.bank
        limit = settings.start_confirmed
        if word == "stop":
            limit = settings.contact_confirmed if state.contact else settings.stop_confirmed
        state = replace(state, change=change, push=push, odds=odds, push_odds=push_odds)
        if odds > limit:
            events = [*state.events, (word, "tentative"), (word, "confirmed")]
            if state.tentative:
                events.remove((word, "tentative"))
            return self._accept(replace(state, events=tuple(events)), motion)
        if push_odds > self.jerk.confirmed:
            return self._accept_push(state)
        if state.is_spent:
            return replace(state, is_spent=False) if odds < CALM else state
        if not state.tentative and odds > settings.perceived:
            return replace(state, tentative=True, events=(*state.events, (word, "tentative")))
        if state.tentative and odds < CALM:
            return replace(state, tentative=False, events=(*state.events, (word, "cancelled")))
        return state

    def _raw_push(self, state: BankState) -> Array:
        """Return D (10, m) of the pushes at amplitude 1."""
        raw = np.zeros((STATES, len(state.pushes)))
        raw[PUSH], raw[QUADRATURE] = self._pushed(state.pushes.age, state.pushes.omega)
        return raw

    def _accept(self, state: BankState, motion: Motion) -> BankState:
        """Return the state in its new class, the banks cleared."""
        mean, spread = hypotheses.moments(state.bank, -state.bank.error, self._prior)
        since = float(state.change.weights @ state.bank.age)
        return replace(
            _cleared(state), x=state.x + mean, P=state.P + spread, motion=motion, since=since
        )

    def _accept_push(self, state: BankState) -> BankState:
        """Return the state with the body's swing after a push in it, the banks cleared."""
        prior = self._push_prior
        unit = self._raw_push(state) - state.pushes.error
        mean, spread = hypotheses.moments(state.pushes, unit, prior)
        events = [*state.events, ("push", "confirmed")]
        if state.tentative:
            events.append((_NEXT[state.motion][1], "cancelled"))
        return replace(
            _cleared(state),
            x=state.x + mean,
            P=state.P + spread,
            omega=self._push_omega(state),
            events=tuple(events),
        )

    def _push_omega(self, state: BankState) -> float:
        """Return the frequency that the pushes' evidence prefers [rad/s]."""
        share = state.push.weights
        best = max(self.jerk.omegas, key=lambda w: float(share.dot(state.pushes.omega == w)))
        return float(best)

    def _settle(self, state: BankState, dt: float) -> BankState:
        """Return the state with its first class found and the cruising speed learnt slowly."""
        if state.motion is not Motion.RUNNING:
            return state
        speed = float(state.x[V])
        nominal = self.conveyor.nominal_speed
        if SETTLING < state.age < SETTLING + 1.5 * dt and speed < 0.3 * nominal:
            return self._still(_enter(state, Motion.STANDING, speed, REST_DEVIATION))
        if state.age > SETTLING and not state.tentative and speed > 0.7 * nominal:
            return replace(state, cruise=state.cruise + dt * (speed - state.cruise))
        return state

    # The prediction.

    def outlook(self, state: BankState, times: Array) -> Array:
        """Return positions (m,) at ``times``: the class in force, mixed with what is suspected.

        What is linear in the estimate is foreseen once, for the mean of what is believed.
        """
        tau = self._ripple(state)[1]
        phase = self._wave_omega(state) * times
        turned = np.cos(phase), np.sin(phase)
        y = v = r = 0.0
        own: Array | float = 0.0
        for weight, estimate, motion, omega in self._believed(state):
            x = estimate.tolist()
            y, v, r = y + weight * x[Y], v + weight * x[V], r + weight * x[RIPPLE]
            own = own + weight * self._own(x, motion, omega, state.cruise, times, turned)
        steady: Array = (y + r * tau) + v * times - (r * tau) * np.exp(times * (-1.0 / tau))
        return steady + own

    def _believed(self, state: BankState) -> list[tuple[float, Array, Motion, float]]:
        """Return weight, estimate (10,), class and frequency of a push of all that is believed."""
        change, push = self._shares(state)
        believed, left = [], 1.0
        if change > UNLIKELY:
            motion, _ = _NEXT[state.motion]
            believed.append((change, self._changed(state), motion, state.omega))
            left -= change
        if push > UNLIKELY:
            omega = self._push_omega(state)
            believed.append((push, self._pushed_estimate(state), state.motion, omega))
            left -= push
        believed.append((left, self._as_set(state), state.motion, state.omega))
        return believed

    def _as_set(self, state: BankState) -> Array:
        """Return the estimate (10,), drawn to a ramp as it was set as far as that is likely.

        The filter's belief in the acceleration is wide, for a ramp may be quite another. Most are
        as they were set: a narrow hypothesis beside the wide one. Their odds are the ratio of the
        wide one's density at the value that is set, after and before the readings (Savage and
        Dickey), and the narrow one's estimate is the filter's with that value measured.
        """
        nominal, share = self._class_acceleration(state.motion), self.bank.as_set
        if not nominal or not share:
            return state.x
        narrow = (self.bank.as_set_deviation * nominal) ** 2
        wide = (self.bank.amplitude_deviation * nominal) ** 2 + narrow
        column = state.P[ACCELERATION]
        off = nominal - float(state.x[ACCELERATION])
        left = float(column[ACCELERATION]) + narrow
        odds = share / (1.0 - share) * math.sqrt(wide / left) * math.exp(-0.5 * off * off / left)
        drawn: Array = state.x + column * (odds / (1.0 + odds) * off / left)
        return drawn

    def _changed(self, state: BankState) -> Array:
        """Return the estimate (10,) if the class has changed: ``moments`` without their spread."""
        x: Array = state.x - state.bank.error.dot(state.change.weights * state.change.amplitudes)
        return x

    def _pushed_estimate(self, state: BankState) -> Array:
        """Return the estimate (10,) if somebody has pushed: ``moments`` without their spread."""
        share = state.push.weights * state.push.amplitudes
        push, quadrature = self._pushed(state.pushes.age, state.pushes.omega)
        x: Array = state.x - state.pushes.error.dot(share)
        x[PUSH] += float(share.dot(push))
        x[QUADRATURE] += float(share.dot(quadrature))
        return x

    def _shares(self, state: BankState) -> tuple[float, float]:
        """Return the weights of a suspected change and of a suspected push in the prediction.

        Only a running or standing conveyor is doubted: while it brakes or starts, a mixture does
        harm. A penalty keeps quiet tracking quiet.
        """
        if not self.mixture or not len(state.bank):
            return 0.0, 0.0
        caution, penalty = 1.0, self.bank.penalty
        if state.motion is Motion.RUNNING:
            if state.contact:
                caution, penalty = self.bank.contact_caution, self.bank.contact_penalty
        elif state.motion is Motion.STANDING:
            penalty = 0.0
        else:
            return 0.0, 0.0
        stop = math.exp(min(caution * (state.change.odds - penalty), 50.0))
        push = math.exp(min(state.push.odds - max(penalty, self.jerk.confirmed), 50.0))
        total = 1.0 + stop + push
        return stop / total, push / total

    def _own(
        self,
        x: list[float],
        motion: Motion,
        omega: float,
        cruise: float,
        times: Array,
        turned: tuple[Array, Array],
    ) -> Array | float:
        """Return what one hypothesis' ramp, wave and push (m,) add to its steady run.

        Args:
            omega: of its push [rad/s].
            cruise: speed at which a start ends [m/s].
            times: from now [s].
            turned: cosine and sine (m,) of the wave's phase from now.
        """
        _, v, _, _, a, push, quadrature, wave, crest, _ = x
        ramp = motion in RAMPS
        own = gained(v, a, cruise, times) if ramp else 0.0
        if abs(wave) + abs(crest) > UNSEEN:
            share = self._fading(v, a, times) if ramp else self._share(v)
            c, s = turned
            own = own + share * (wave * c + crest * s)
        if abs(push) + abs(quadrature) > 1e-6:
            pole = complex(-self.jerk.damping * omega, omega)
            own = own + (complex(push, -quadrature) * np.exp(pole * times)).real
        return own

    def _fading(self, v: float, a: float, times: Array) -> Array:
        """Return the shares (m,) of the nominal speed on a ramp."""
        nominal = self.conveyor.nominal_speed
        shares: Array = v / nominal + (a / nominal) * times
        return np.minimum(np.maximum(shares, 0.0), 1.0)

    def view(self, state: BankState) -> View:
        """Return what the bank believes."""
        y, v, ripple, offset, _, push, _, wave, crest, _ = self._as_set(state).tolist()
        variance = state.P.diagonal().tolist()
        share = self._share(v)
        return View(
            position=y + push + share * wave,
            speed=v + ripple + share * crest * self._wave_omega(state),
            offset=offset,
            deviation=math.sqrt(max(variance[Y] + variance[PUSH], 0.0)),
            speed_deviation=math.sqrt(max(variance[V] + variance[RIPPLE], 0.0)),
            motion=state.motion,
            tentative=state.tentative,
            confidence=state.odds,
            events=state.events,
        )


@lru_cache(maxsize=32)
def _transition(dt: float, ripple_time: float, omega: float, damping: float) -> Array:
    """Return A of (5): ripple is a speed that dies out, a push a swing that does.

    The wave turns as its pace is known, which is written into a copy.
    """
    F = np.eye(STATES)
    F[Y, V], F[Y, RIPPLE], F[Y, ACCELERATION] = dt, dt, 0.5 * dt * dt
    F[V, ACCELERATION] = dt
    F[RIPPLE, RIPPLE] = math.exp(-dt / ripple_time)
    fade = math.exp(-damping * omega * dt)
    c, s = fade * math.cos(omega * dt), fade * math.sin(omega * dt)
    F[PUSH, PUSH] = F[QUADRATURE, QUADRATURE] = c
    F[PUSH, QUADRATURE], F[QUADRATURE, PUSH] = s, -s
    F.setflags(write=False)
    return F


def _softplus(value: float) -> float:
    """Return ln(1 + e^value)."""
    return value if value > 30.0 else math.log1p(math.exp(value))


def _cleared(state: BankState) -> BankState:
    """Return the state without a hypothesis."""
    return replace(
        state,
        bank=hypotheses.empty(STATES),
        pushes=hypotheses.empty(STATES),
        change=NOTHING,
        push=NOTHING,
        odds=-30.0,
        push_odds=-30.0,
        tentative=False,
        is_spent=False,
    )


def _enter(state: BankState, motion: Motion, speed: float, deviation: float) -> BankState:
    """Return the state in a class without acceleration; the speed stays free to be corrected."""
    x, P = state.x.copy(), state.P.copy()
    x[V], x[ACCELERATION] = speed, 0.0
    P[ACCELERATION, :] = P[:, ACCELERATION] = 0.0
    P[V, V] += deviation**2
    return replace(_cleared(state), x=x, P=P, motion=motion, since=0.0)
