"""Bank classifier: generalised likelihood ratio tests over onset banks.

The null filter assumes the class in force. Two banks compete with it: a change of class that began
u seconds ago, whose acceleration is known to some share, and, in contact, an impulse disturbance
of the body. A change counts by its odds against no change *and* against an impulse.
"""

import math
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import (
    bank_filter,
    bank_prediction,
    guide,
    onset_bank,
    start_check,
    sway_filter,
)
from linemate.daemon.core.tracking.classifiers.bank_filter import (
    REST_DEVIATION,
    SETTLING,
    clear_banks,
    enter_class,
)
from linemate.daemon.core.tracking.classifiers.bank_model import (
    ACCELERATION,
    IMPULSE,
    IMPULSE_QUADRATURE,
    MISSED_ODDS,
    NEXT,
    OFFSET,
    RAMPS,
    RANDOM,
    RIPPLE,
    RIPPLE_QUADRATURE,
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
from linemate.daemon.core.tracking.classifiers.distance import (
    distance_change,
    distance_check,
    distance_repeat,
    distance_step,
)
from linemate.daemon.core.tracking.classifiers.distance.distance_change import DistanceChange
from linemate.daemon.core.tracking.classifiers.distance.distance_check import RAMP_DEVIATION, Ramp
from linemate.daemon.core.tracking.classifiers.distance.distance_step import DistanceStep
from linemate.daemon.core.tracking.classifiers.onset_bank import AmplitudePrior, OnsetBank
from linemate.daemon.core.tracking.classifiers.start_check import StartRejection
from linemate.daemon.core.tracking.conveyor import (
    LONGEST_TENTATIVE_S,
    ConveyorEstimate,
    Motion,
    PositionMeasurement,
    Source,
)

CALM = 2.0  # log odds below which a tentative change is cancelled
ASKED = -2.0  # log odds of a change in contact above which the distance sensor is asked
# Least log odds by the distance sensor alone with which a change in contact is confirmed.
SUPPORT = {"stop": 0.0, "start": 1.5}
MOVED = 1.5  # log odds of a change by the distance sensor alone above which no impulse is accepted
RUNNING_DEVIATION = 0.003  # of the steady speed of a running conveyor, for the distance check [m/s]
STANDING_DEVIATION = 0.0003  # the same of one that stands [m/s]
ASKING_S = 0.012  # the distance sensor alone is asked for a change once in this time [s]
SURE_STOP = 100.0  # log odds of a stop by the sensor alone; a chain's ripple looks like its begin
SURE_ON_RAMP = 17.0  # the same of a change on a ramp, which a push would hide
LED_DEVIATION = 0.03  # one sigma of the guide's speed, which a stop has slowed already [m/s]
HELD_DEVIATION = 0.001  # one sigma of where the tool holds an object that gives way [m]
TAKEN = 0.5  # share of a step of the distance sensor that the position may have taken
FELT_S = 0.008  # a contact is known for so long after a deflection: two samples of 250 Hz [s]
UNSURE = 0.5  # share of what a ramp turns out to be stronger that may be wrong
EXPLAINED = -20.0  # log odds of a change below which none of its hypotheses is left
FOLLOWED_S = 0.1  # in which the tool follows a change: dead time and merge [s]
LEFT_S = 0.2  # in which the speed that is left when a stop ends dies out [s]

_SWAY = np.array((SWAY, SWAY_QUADRATURE))


class BankClassifier(BankModel):
    """Classifier with onset banks; see ``conveyor.Classifier``."""

    def initial(self, position: float) -> BankState:
        """Return the estimate at a first reading of the distance sensor [m]."""
        return bank_filter.initial(self, position)

    def advance(
        self, state: BankState, measurements: Sequence[PositionMeasurement], dt: float
    ) -> BankState:
        """Return the estimate ``dt`` seconds later, its class decided."""
        state, measurements = distance_repeat.without_repeated(self, state, measurements, dt)
        before = state
        state = sway_filter.predict(self, bank_filter.predict(self, state, dt), dt)
        felt = [each for each in measurements if each.source is Source.TACTILE]
        if felt and not state.contact:
            state = sway_filter.touched(state, felt[0].pushed)
        predicted = state
        if measurements:
            state = bank_filter.correct(self, state, measurements)
        readings = distance_check.keep(state.readings, measurements, dt)
        state = self._in_contact(replace(state, readings=readings), felt, dt)
        changed = self._by_distance(state, state.complied, dt)
        state = _bound_tentative(changed or self._decide(state), before, dt)
        state = self._settle(self._check_start(before, state, measurements, dt), dt)
        if state.motion is not before.motion:
            state = replace(state, within_ramp=before.motion in RAMPS)
        state = sway_filter.follow(self, predicted, state, measurements)
        return guide.advance(self, before, state, measurements, dt)

    def _in_contact(
        self, state: BankState, felt: Sequence[PositionMeasurement], dt: float
    ) -> BankState:
        """Return the state with what the force-torque sensor showed.

        A sensor that is slower than the cycle shows it in some steps: until then it holds.

        Args:
            felt: deflections of this step.
        """
        felt_s = 0.0 if felt else state.felt_s + dt
        if not felt and felt_s < FELT_S:
            return replace(state, felt_s=felt_s)
        is_keen = bool(felt) and min(map(self.variance, felt)) < self.distance_deviation**2
        is_firm = is_keen and any(each.is_firm for each in felt)
        now = bool(felt), is_keen, is_firm
        if now != (state.contact, state.is_keen, state.is_firm):
            state = replace(state, contact=now[0], is_keen=is_keen, is_firm=is_firm)
        complied = sum([each.complied for each in felt])
        if (felt_s, complied) != (state.felt_s, state.complied):
            state = replace(state, felt_s=felt_s, complied=complied)
        return state

    def announce_stop(self, state: BankState) -> BankState:
        """Return the state as the line announces a stop."""
        return replace(state, announced_s=0.0)

    def hang(
        self, before: BankState, state: BankState, shown: PositionMeasurement, dt: float
    ) -> BankState:
        """Return the estimate of an object that bolts in their holes show to hang."""
        return guide.before_touch(self, before, state, shown, dt)

    def predict_positions(self, state: BankState, times: Array) -> Array:
        """Return the object's positions (m,) along the conveyor at ``times`` from now [s]."""
        return bank_prediction.predict_positions(self, state, times)

    def predict_sway(self, state: BankState, times: Array) -> Array:
        """Return the part (m,) of these positions that is the body's sway [m]."""
        led = guide.led_state(state)
        if not led.sway_omega:
            return np.zeros(len(times))
        return bank_prediction.sway_ahead(self, led, led.x.tolist(), led.motion, times)

    def estimate(self, state: BankState) -> ConveyorEstimate:
        """Return the estimate of the conveyor now."""
        return bank_prediction.estimate(self, state)

    def _check_start(
        self,
        before: BankState,
        state: BankState,
        measurements: Sequence[PositionMeasurement],
        dt: float,
    ) -> BankState:
        """Return the state with a start cancelled, or ended, if the readings contradict it."""
        if state.motion is not Motion.STARTING and state.start_check is None:
            return state
        speed = float(state.x[V])
        # A stop that was taken back was none: the start before it goes on.
        was = Motion.STARTING if ("stop", "cancelled") in state.events else before.motion
        check = start_check.update(state.start_check, was, state.motion, speed, measurements, dt)
        sigma = self.distance_deviation
        if check is not None and state.start_check is None and was is not Motion.STARTING:
            check = replace(check, acceleration=float(state.x[ACCELERATION]))
            if was is Motion.STOPPING:
                check = replace(check, braking=self._ramp(before), braked=before.class_age)
            elif was is Motion.STANDING:
                check = replace(check, stood=before.class_age)
        rejection = start_check.reject(check, self.conveyor, state.cruise, sigma)
        if rejection is None:
            rejection = start_check.deny(
                check, state.readings, state.class_age, STANDING_DEVIATION, sigma
            )
        if rejection is None:
            return replace(state, start_check=check)
        return self._reject_start(state, rejection)

    def _reject_start(self, state: BankState, rejection: StartRejection) -> BankState:
        """Return the state in the class that the readings speak for."""
        events = state.events
        if state.tentative:
            events = (*events, ("stop", "cancelled"))
        if rejection.motion is not Motion.RUNNING:
            events = (*events, ("start", "cancelled"))
        off = float(state.x[V]) - rejection.speed
        deviation = math.hypot(off, REST_DEVIATION)
        state = enter_class(state, rejection.motion, rejection.speed, deviation)
        if rejection.motion is Motion.STOPPING:
            x, P = state.x.copy(), state.P.copy()
            x[ACCELERATION] = -self.conveyor.deceleration
            P[ACCELERATION, ACCELERATION] = (
                self.bank.amplitude_deviation * self.conveyor.deceleration
            ) ** 2
            state = replace(state, x=x, P=P)
        return replace(state, tentative_s=0.0, start_check=None, events=events)

    def _decide(self, state: BankState) -> BankState:
        """Return the state with a change perceived, confirmed or cancelled, or an impulse."""
        change = self.change_posterior(state)
        impulse = onset_bank.posterior(state.impulses, self.impulse_prior)
        change_odds = change.odds - _softplus(impulse.odds)
        impulse_odds = impulse.odds - _softplus(change.odds)
        motion, _ = NEXT[state.motion]
        settings, limit = self.bank, self._limit(state)
        state = replace(
            state,
            change=change,
            impulse=impulse,
            change_odds=change_odds,
            impulse_odds=impulse_odds,
            distance_odds=None,
        )
        if self._asks_distance(state, limit):
            state = replace(state, distance_odds=self._distance_odds(state))
        if state.motion in RAMPS and (state.distance_odds or 0.0) > SURE_ON_RAMP:
            # An impulse moves the body, and not its conveyor: it explains the force alone.
            state = replace(state, change_odds=change.odds)
        stronger = self._stronger(state)
        if stronger is not None:
            return stronger
        step = None
        # A step of the readings moves no force: what the clamped tool measures well is a stop.
        may_step = state.motion is Motion.RUNNING and not (state.contact and state.is_keen)
        if may_step and change_odds > settings.perceived:
            step = self._step(state, self._readings(state))
        if step is not None and step.is_certain:
            return self._accept_step(state, step)
        if step is not None:
            # The prediction follows no stop either, as long as a step is likelier.
            state = replace(state, distance_odds=-step.odds)
        return self._declare(state, motion, limit)

    def _limit(self, state: BankState) -> float:
        """Return the log odds from which the change out of the class in force is confirmed."""
        if NEXT[state.motion][1] != "stop":
            return self.bank.start_confirmed
        # A drive that starts is less even than one that runs.
        is_quick = state.is_keen and state.motion is Motion.RUNNING
        return self.bank.contact_confirmed if is_quick else self.bank.stop_confirmed

    def _declare(self, state: BankState, motion: Motion, limit: float) -> BankState:
        """Return the state with a change declared as its odds say, or an impulse.

        Args:
            motion: class after the change.
            limit: log odds from which the change is confirmed.
        """
        settings, event = self.bank, NEXT[state.motion][1]
        change_odds, impulse_odds = state.change_odds, state.impulse_odds
        odds = state.distance_odds
        if change_odds > limit and (odds is None or odds > SUPPORT[event]):
            events = [*state.events, (event, "tentative"), (event, "confirmed")]
            if state.tentative:
                events.remove((event, "tentative"))
            return self._accept_change(replace(state, events=tuple(events)), motion)
        is_apart = state.impulse_age >= self.impulse.apart
        if is_apart and impulse_odds > self.impulse.confirmed and (odds is None or odds < MOVED):
            return self._accept_impulse(state)
        if state.is_expired:
            return replace(state, is_expired=False) if change_odds < CALM else state
        if not state.tentative and change_odds > settings.perceived:
            return replace(state, tentative=True, events=(*state.events, (event, "tentative")))
        if state.tentative and change_odds < CALM:
            return replace(state, tentative=False, events=(*state.events, (event, "cancelled")))
        return state

    def _stronger(self, state: BankState) -> BankState | None:
        """Return the state on a ramp that turns out to be stronger than estimated, or None.

        The distance sensor must agree: a body that sways looks like it.
        """
        prior = self.stronger_priors.get(state.motion)
        if prior is None or not len(state.changes):
            return None
        faster = self._as_faster(state)
        if faster is not None:
            return faster
        bank = onset_bank.oldest(state.changes)
        stronger = onset_bank.posterior(bank, prior)
        if stronger.odds < max(self.bank.perceived, state.change.odds):
            return None
        shown = replace(state, changes=bank, change=stronger)
        if not (self._distance_odds(shown) or 0.0) > SUPPORT["start"]:
            return None
        mean, spread = onset_bank.merge_moments(bank, -bank.error, stronger)
        spread[[V, ACCELERATION], [V, ACCELERATION]] += (UNSURE * mean[[V, ACCELERATION]]) ** 2
        return replace(clear_banks(state), x=state.x + mean, P=state.P + spread)

    def _as_faster(self, state: BankState) -> BankState | None:
        """Return the state with the confirmed change as a faster one; None if it is none.

        It is as soon as that is likelier: its odds contain how likely a change is a faster one.
        """
        faster = state.faster
        if faster is None:
            return None
        result = faster.posterior()
        lent = faster.ahead_odds if float(faster.bank.age[0]) > faster.ahead_until else 0.0
        # That the class has ended is as seldom as it is for the prediction.
        is_likelier = result.odds - lent >= max(0.0, state.change.odds - self.bank.penalty)
        if not is_likelier or not self._shows_faster(state, faster):
            return None
        mean, spread = onset_bank.merge_moments(faster.bank, -faster.bank.error, result)
        return replace(
            clear_banks(state),
            x=state.x + mean,
            P=state.P + spread,
            class_age=float(faster.bank.age[0]),
            is_faster=True,
        )

    def _shows_faster(self, state: BankState, faster: FasterChange) -> bool:
        """Return whether the distance sensor alone supports the faster change."""
        deviation = STANDING_DEVIATION if state.motion is Motion.STARTING else RUNNING_DEVIATION
        usual, other = (
            distance_check.log_odds(
                state.readings, age, change, deviation, self.distance_deviation, speed=faster.speed
            )
            for age, change in (
                (state.class_age, faster.usual),
                (float(faster.bank.age[0]), faster.acceleration),
            )
        )
        return usual is not None and other is not None and other > usual

    def _faster_change(self, state: BankState, mean: Array) -> FasterChange | None:
        """Return the hypothesis that a change that is confirmed as a usual one is a faster one.

        Both explain the readings so far: the faster one began later. Its odds are those of the two
        priors, and go on from there.

        Args:
            mean: by how much the usual one moves the estimate.
        """
        prior, bank, usual = self._faster_prior(state), state.changes, state.change
        if prior is None or state.motion in RAMPS or usual.variance != self.change_prior.variance:
            return None
        # The tool is ahead of the object: if it takes a usual stop for a faster one, it waits. Once
        # it has followed, readings in steps of 1 cm took a usual one for a faster one: 223 N.
        sooner = AmplitudePrior(prior.mean, prior.variance, prior.least, MISSED_ODDS)
        wider = onset_bank.posterior(bank, sooner)
        if wider.odds < EXPLAINED:
            return None
        nominal, weights, shares = self.changes[state.motion], wider.weights, wider.amplitudes
        share = float(weights.dot(shares))
        moved, _ = onset_bank.merge_moments(bank, -bank.error, wider)
        spread = (shares - share) ** 2 + 1.0 / (bank.A + 1.0 / prior.variance)
        return FasterChange(
            onset_bank.begin(mean - moved, (0.0,), float(weights.dot(bank.age))),
            wider.odds - usual.odds,
            float(weights.dot(spread)) / share**2,
            nominal * share,
            nominal * float(usual.weights.dot(usual.amplitudes)),
            state.cruise if state.motion is Motion.RUNNING else 0.0,
            float(weights.dot(bank.age)) + FOLLOWED_S,
            MISSED_ODDS - prior.odds,
        )

    def _step(self, state: BankState, readings: Array) -> DistanceStep | None:
        """Return the step of the readings that looks like a change; None without one."""
        change = self.changes[state.motion]
        prior = AmplitudePrior(change, (self.bank.amplitude_deviation * change) ** 2)
        faster = self.faster_priors[state.motion]
        return distance_step.find(
            readings,
            prior,
            *_steady_speed(state),
            self.distance_deviation,
            faster
            and AmplitudePrior(change, faster.variance * change**2, faster.least, faster.odds),
        )

    def _accept_step(self, state: BankState, step: DistanceStep) -> BankState:
        """Return the state after a step of the distance sensor, the banks cleared.

        The step is an offset from now on. What the filter has taken of it, later readings correct.
        """
        x, P = state.x.copy(), state.P.copy()
        x[OFFSET] += step.size
        P[OFFSET, OFFSET] += step.deviation**2
        P[Y, Y] += (TAKEN * step.size) ** 2
        cancelled = ((NEXT[state.motion][1], "cancelled"),) if state.tentative else ()
        events = (*state.events, *cancelled)
        readings = distance_step.levelled(state.readings, step)
        return replace(clear_banks(state), x=x, P=P, readings=readings, events=events)

    def _by_distance(self, state: BankState, complied: float, dt: float) -> BankState | None:
        """Return the state after a change that the distance sensor alone shows; None without one.

        For an object that gives way: what it does in contact hides a start or is taken for one.

        Args:
            complied: offset of the target from its estimate in contact [m].
        """
        is_due = int(state.age / ASKING_S) != int((state.age - dt) / ASKING_S)
        if state.guide is None or state.is_firm or not is_due or state.motion in RAMPS:
            return None
        # Late readings that end look like the begin of a stop: 268 N.
        if state.is_repeating or not distance_check.has_say(state.readings):
            return None
        stands = state.motion is Motion.STANDING
        speed, deviation, limit = float(state.guide.x[V]), LED_DEVIATION, SURE_STOP
        priors = self.shown_priors[state.motion]
        if stands:
            speed, deviation = _steady_speed(state)
            limit = self.bank.start_confirmed
        elif self._has_stop(state):
            # The bank has it, as one that the sensor denies, or behind a swing of the body.
            speed, deviation = _steady_speed(state)
            limit = self.bank.stop_confirmed
        else:
            priors = priors[:1]  # a frozen sensor looks like a stop that is fast enough
        # Readings of the class before show a change that was decided already.
        readings = distance_check.since(self._readings(state), state.class_age)
        change = distance_change.find(
            readings,
            self.changes[state.motion],
            speed,
            deviation,
            self.distance_deviation,
            priors,
            limit,
            OnsetBank(state.changes.error[_SWAY], state.changes.sums),
        )
        if change is None:
            return None
        step = self._step(state, readings)
        if step is not None:
            # A frozen sensor that shows the object again steps: no start goes so far at once. Nor
            # is one that becomes late a stop: the force showed none, and it was confirmed, 227 N.
            return self._accept_step(state, step) if stands and step.is_certain else None
        if stands and state.class_age < distance_check.SPAN_S:
            nominal = self.changes[state.motion]
            change = distance_change.begun_before(
                readings, change, nominal, deviation, self.distance_deviation
            )
        return self._accept_by_distance(state, change, state.guide, complied)

    def _has_stop(self, state: BankState) -> bool:
        """Return whether the bank is certain of a stop, or hides it behind a swing of the body."""
        limit = self._limit(state)
        if state.change_odds > limit:
            return state.tentative
        is_hidden = state.impulse_odds > self.impulse.confirmed
        return is_hidden and state.change is not None and state.change.odds > limit

    def _accept_by_distance(
        self, state: BankState, declared: DistanceChange, led: Guide, complied: float
    ) -> BankState:
        """Return the state in the class that the distance sensor shows, the banks cleared.

        The object is where the tool holds it. What the conveyor has moved against it is an offset.
        """
        motion, event = NEXT[state.motion]
        events = [*state.events, (event, "tentative"), (event, "confirmed")]
        if state.tentative:
            events.remove((event, "tentative"))
        reading, speed, change, *sway = declared.values.tolist()
        x, P = state.x.copy(), state.P.copy()
        # The null filter has taken a part of the change for a sway.
        x[_SWAY[: len(sway)]] += sway
        x[Y] = float(led.x[Y] + led.x[SWAY] - x[SWAY]) + complied
        x[V] = max(speed, 0.0)
        x[RANDOM], x[ACCELERATION] = 0.0, change
        x[OFFSET] = reading - float(x[Y])
        known = [Y, V, RANDOM, OFFSET, ACCELERATION]
        P[known, :] = P[:, known] = 0.0
        shown = np.array((OFFSET, V, ACCELERATION, *_SWAY[: len(sway)]))
        P[shown[:, None], shown] += declared.covariance
        P[V, V] += REST_DEVIATION**2
        P[OFFSET, OFFSET] += HELD_DEVIATION**2
        P[Y, Y] = HELD_DEVIATION**2
        P[RANDOM, RANDOM] = self.fusion.contact_ripple**2
        return replace(
            clear_banks(state),
            x=x,
            P=P,
            motion=motion,
            class_age=declared.onset,
            events=tuple(events),
        )

    def _asks_distance(self, state: BankState, limit: float) -> bool:
        """Return whether the distance sensor alone is asked for a change: it costs 30 us.

        It is asked in contact, on ramps and at rest, wherever its answer can change a decision or
        the prediction.

        Args:
            limit: log odds at which the change is confirmed.
        """
        if not (state.contact or state.motion is not Motion.RUNNING) or state.change.odds <= ASKED:
            return False
        if state.change.odds > limit or state.impulse_odds > self.impulse.confirmed:
            return True
        if state.announced_s < math.inf:  # the announcement raises the odds later
            return True
        weight, _ = bank_prediction.hypothesis_weights(self, state)
        return weight > bank_prediction.LEAST_WEIGHT

    def _readings(self, state: BankState) -> Array:
        """Return the readings (2, m) of the distance sensor, without the ripple of a running drive.

        A chain wheel of eight teeth brakes by 0.1 m/s^2 for 0.2 s, as a stop does at first.
        """
        if state.motion is not Motion.RUNNING or not self.ripple.deviation:
            return state.readings
        phase = self.ripple_rate(state) * state.readings[0]
        ripple, quadrature = state.x[RIPPLE : RIPPLE_QUADRATURE + 1].tolist()
        readings = state.readings.copy()
        readings[1] -= ripple * np.cos(phase) - quadrature * np.sin(phase)
        return readings

    def _distance_odds(self, state: BankState) -> float | None:
        """Return the log odds of a change by the distance sensor alone, None if it has no say."""
        weights, readings, ramp = state.change.weights, self._readings(state), None
        change = self.changes[state.motion] * float(weights.dot(state.change.amplitudes))
        speed, deviation = _steady_speed(state)
        if state.within_ramp or state.motion is Motion.STANDING:
            # The ramp before is no steady motion: that of a start hid a stop 0.5 s after it.
            readings = distance_check.since(readings, state.class_age)
        if state.motion in RAMPS:
            acceleration, stated = self._ramp(state), self.class_acceleration(state.motion)
            # One that was taken as a faster one may be as stated: its end is no other change.
            unsure = abs(acceleration - stated) / max(abs(acceleration), abs(stated))
            ramp = Ramp(state.class_age, acceleration, max(unsure, RAMP_DEVIATION))
        return distance_check.log_odds(
            readings,
            float(weights.dot(state.changes.age)),
            change,
            deviation,
            self.distance_deviation,
            ramp,
            speed,
        )

    def _ramp(self, state: BankState) -> float:
        """Return the acceleration of the class in force before the change that is tested [m/s^2].

        The null filter has taken a part of the change for another acceleration.
        """
        shares = state.change.weights * state.change.amplitudes
        taken = float(shares.dot(state.changes.error[ACCELERATION]))
        change = self.changes[state.motion] * float(shares.sum())
        return float(state.x[ACCELERATION]) - taken - change

    def _accept_change(self, state: BankState, motion: Motion) -> BankState:
        """Return the state in its new class, the banks cleared."""
        bank = state.changes
        mean, spread = onset_bank.merge_moments(bank, -bank.error, state.change)
        if state.change.variance == self.change_prior.variance:
            faster = -self.faster_amplitude(state) * bank.error.dot(state.change.weights)
            spread = spread + np.outer(faster, faster)
        class_age = float(state.change.weights @ bank.age)
        return replace(
            clear_banks(state),
            x=state.x + mean,
            P=state.P + spread,
            motion=motion,
            class_age=class_age,
            faster=self._faster_change(state, mean),
        )

    def _accept_impulse(self, state: BankState) -> BankState:
        """Return the state with the body's swing after an impulse in it.

        The onsets of both banks are kept for one that gives way. It may be pushed as its conveyor
        stops already. What the impulse leaves, another explains as well as a stop.
        """
        bank = state.impulses
        response = np.zeros((STATES, len(bank)))
        response[IMPULSE], response[IMPULSE_QUADRATURE] = self.impulse_response(
            bank.age, bank.omega
        )
        mean, spread = onset_bank.merge_moments(bank, response - bank.error, state.impulse)
        events = [*state.events, ("push", "confirmed")]
        if state.tentative:
            events.append((NEXT[state.motion][1], "cancelled"))
        after = clear_banks(state)
        if not state.is_firm:  # a firm one moves with its conveyor: its force shows one cause
            changes = onset_bank.without_support(state.changes, self.change_prior)
            impulses = onset_bank.without_support(bank, self.impulse_prior)
            after = replace(after, changes=changes, impulses=impulses)
        return replace(
            after,
            x=state.x + mean,
            P=state.P + spread,
            impulse_omega=self.likeliest_omega(state),
            impulse_age=0.0,
            faster=state.faster and against_impulse(state.faster, state.impulse.odds, mean),
            events=tuple(events),
        )

    def _settle(self, state: BankState, dt: float) -> BankState:
        """Return the state with its first class decided and the cruising speed averaged slowly."""
        if state.motion is not Motion.RUNNING:
            return state
        speed = float(state.x[V])
        nominal = self.conveyor.nominal_speed
        if SETTLING < state.age < SETTLING + 1.5 * dt and speed < 0.3 * nominal:
            return bank_filter.enter_standing(self, state)
        if state.age > SETTLING and not state.tentative and speed > 0.7 * nominal:
            return replace(state, cruise=state.cruise + dt * (speed - state.cruise))
        return state


def against_impulse(faster: FasterChange, odds: float, mean: Array) -> FasterChange:
    """Return the hypothesis of a faster change after an impulse is accepted in its place.

    Soon after a touch an impulse explains a deflection as well as a stop does. It swings back.

    Args:
        odds: log odds of the impulse against no change.
        mean: by how much it moves the estimate.
    """
    result, bank = faster.posterior(), faster.bank
    share = float(result.amplitudes[0])
    return replace(
        faster,
        bank=onset_bank.begin(share * bank.error[:, 0] + mean, (0.0,), float(bank.age[0])),
        odds=result.odds - odds,
        variance=1.0 / (float(bank.A[0]) + 1.0 / faster.variance) / share**2,
        acceleration=faster.usual + share * (faster.acceleration - faster.usual),
    )


def _bound_tentative(state: BankState, before: BankState, dt: float) -> BankState:
    """Return the state with a change cancelled that has been tentative for too long."""
    if not state.tentative:
        return replace(state, tentative_s=0.0) if state.tentative_s else state
    tentative_s = state.tentative_s + dt if before.tentative else 0.0
    if tentative_s < LONGEST_TENTATIVE_S:
        return replace(state, tentative_s=tentative_s)
    event = (NEXT[state.motion][1], "cancelled")
    # The evidence is kept: more of it still confirms a slow change.
    return replace(
        state, tentative=False, is_expired=True, tentative_s=0.0, events=(*state.events, event)
    )


def _steady_speed(state: BankState) -> tuple[float, float]:
    """Return the speed of a steady conveyor, and one sigma of it [m/s]."""
    if state.motion is not Motion.STANDING:
        return state.cruise, RUNNING_DEVIATION
    # What is left of the stop before dies out.
    left = REST_DEVIATION * math.exp(-state.class_age / LEFT_S)
    return 0.0, math.hypot(STANDING_DEVIATION, left)


def _softplus(value: float) -> float:
    """Return ln(1 + e^value)."""
    return value if value > 30.0 else math.log1p(math.exp(value))
