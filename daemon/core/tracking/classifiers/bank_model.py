"""Models of the bank classifier: state, transition, process noise and observation rows.

The conveyor's speed has two kinds of ripple: a random one, which is a speed that decays, and a
periodic one of drive or chain, which turns with the way: a rotating pair of way and quadrature
whose frequency at full speed is estimated. While the tool is in contact the body may be pushed: an
impulse disturbance makes it swing like a damped sine. Camera and force-torque sensor see that, the
distance sensor does not.
"""

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array, ComplexArray, KeptValues, exponential
from linemate.daemon.core.tracking.classifiers import onset_bank, sway_bank
from linemate.daemon.core.tracking.classifiers.distance.distance_check import NO_READINGS, has_say
from linemate.daemon.core.tracking.classifiers.felt_drift import UNFELT, FeltDrift
from linemate.daemon.core.tracking.classifiers.onset_bank import (
    NO_POSTERIOR,
    AmplitudePrior,
    OnsetBank,
    OnsetPosterior,
)
from linemate.daemon.core.tracking.classifiers.start_check import StartCheck
from linemate.daemon.core.tracking.classifiers.sway_bank import SwayBank
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import (
    BankSettings,
    FusionSettings,
    ImpulseSettings,
    RippleSettings,
    SwaySettings,
)
from linemate.daemon.core.tracking.task import ConveyorClasses

STATES = 15
Y, V, RANDOM, OFFSET, ACCELERATION, IMPULSE, IMPULSE_QUADRATURE = range(7)
RIPPLE, RIPPLE_QUADRATURE, FREQUENCY, SLIP, SWAY, SWAY_QUADRATURE, PACE, GAIN = range(7, STATES)
RAMPS = (Motion.STOPPING, Motion.STARTING)
RIPPLE_FACTORS = (0.7, 1.4)  # range of the ripple's frequency over the configured one
EPSILON = 1e-9  # mean of an amplitude whose sign alone is known
LEAST_FASTER = 0.02  # of a faster change that widens the estimate of another
FASTER_SIGMAS = 3.0  # beyond the configured acceleration from which a change is a faster one
MISSED_ODDS = -1.4  # log odds of a faster change before any reading, of one that the bank missed
RAMP_WALK = 0.05  # random walk of a ramp's acceleration, as a share of the nominal one [1/sqrt(s)]
END_WALK = 1.0  # the same at the end of a stop, which may coast out or brake smoothly [1/sqrt(s)]
END_S = 0.25  # time to the end of a stop below which its deceleration is uncertain [s]
DRIVEN_WALK = 0.0003  # of a sway, by what chain and drive do beyond the ripple [m/sqrt(s)]
LEAST_USUAL = 0.1  # least amplitude of a change within a ramp, as a share of the stated one
HANGING = 0.75  # share of a change of the conveyor that an object has not followed, which hangs
NO_SWAY = (0.0,) * 6  # what a row has from the ripple's frequency on
_CONSTANT = (0.0,)  # frequencies of a change of class [rad/s]

# Class and event that can follow each class.
_STOP = (Motion.STOPPING, "stop")
_START = (Motion.STARTING, "start")
NEXT = {
    Motion.RUNNING: _STOP,
    Motion.STARTING: _STOP,
    Motion.STANDING: _START,
    Motion.STOPPING: _START,
}


class Guide(Struct, frozen=True, eq=False):
    """Estimate that leads the target in contact; it takes a deflection slowly.

    Attributes:
        x, P, ripple_factor: as of ``BankState``, without an impulse disturbance.
        sways: a sway leads that was known before the contact.
        waits: the null filter was widened, and has not led the guide since.
        missed: readings of the distance sensor beyond the guide's gate in a row.
        felt: deflection from the guide.
        sway_omega: frequency of the sway that leads, or fades [rad/s].
        hangs: that sway is the one of a body whose own is not identified.
    """

    x: Array
    P: Array
    ripple_factor: float
    sways: bool = True
    waits: bool = False
    missed: int = 0
    felt: FeltDrift = UNFELT
    sway_omega: float = 0.0
    hangs: bool = False


class FasterChange(Struct, frozen=True, eq=False):
    """Hypothesis that a change that was confirmed as a usual one is a faster one.

    Attributes:
        bank: one hypothesis; at amplitude 1 it makes the estimate that of the faster change.
        odds: log odds against the usual change before what its sums contain.
        variance: of its amplitude, before what its sums contain.
        acceleration, usual: that the faster and the usual change add [m/s^2].
        speed: steady one before them [m/s].
        ahead_until: time since its onset until which the tool is ahead of the object [s].
        ahead_odds: log odds that count until then alone.
    """

    bank: OnsetBank
    odds: float
    variance: float
    acceleration: float
    usual: float
    speed: float
    ahead_until: float = math.inf
    ahead_odds: float = 0.0

    def posterior(self) -> OnsetPosterior:
        """Return the posterior of the hypothesis."""
        return onset_bank.posterior(self.bank, AmplitudePrior(1.0, self.variance, odds=self.odds))


class BankState(Struct, frozen=True, eq=False):
    """Estimate of the null filter, and the onset banks.

    Attributes:
        x: (15,) position y [m], speed [m/s], random ripple [m/s], offset x10 of the distance sensor
            [m], acceleration [m/s^2], swing after an impulse and its quadrature [m], periodic
            ripple and its quadrature [m], the error of the ripple's frequency as a
            share, the way that the distance sensor reads too much as a share, sway s and s'/w [m],
            the error of its frequency as a share, and its gain. The errors are folded into
            ``ripple_factor`` and ``sway_omega`` after each correction.
        cruise: speed at which a start ends [m/s].
        changes: onsets of the next class.
        impulses: onsets of impulse disturbances.
        impulse_omega: frequency of the swing in x [rad/s].
        impulse_age: time since an impulse was accepted [s].
        ripple_factor: frequency of the periodic ripple over the configured one.
        sways: what identifies the sway; None where it is not looked for.
        sway_omega: its frequency [rad/s], 0 before it is found.
        hangs: that sway is the one of an object that bolts in their holes have shown to hang.
        age: of the estimate [s].
        class_age: time since the class began to act [s].
        within_ramp: it began on a ramp: before it there was no steady motion.
        rejected: measurements rejected in a row, by sensor.
        change, impulse: posteriors of the two banks after the last step.
        change_odds: log odds of a change against no change and against an impulse.
        impulse_odds: log odds of an impulse against both others.
        distance_odds: log odds of a change by the distance sensor alone, None if it has no say or
            was not asked.
        readings: (2, m) of the distance sensor, ages [s] and positions [m].
        is_repeating: the distance sensor certainly repeated itself as it was last read.
        tentative: a change has been perceived.
        tentative_s: how long it has been tentative [s].
        is_expired: it was cancelled for its duration, and its odds have not been calm since.
        is_faster: the change into the class in force turned out to be a faster one in this step.
        faster: the change into the class in force as a faster one, while that is not decided.
        start_check: of a start against the readings, or None.
        contact: the force-torque sensor takes part.
        is_keen: it measured the object better than the distance sensor: nothing oscillates.
        is_firm: the object in contact does not give way.
        unfelt_s: time without contact [s].
        felt_s: time since the last deflection [s].
        complied: offset of the target from its estimate along the conveyor with it [m].
        guide: leads the target in contact; None without contact.
        announced_s: time since the line announced a stop [s].
        events: of the last step.
    """

    x: Array
    P: Array
    motion: Motion
    cruise: float
    changes: OnsetBank
    impulses: OnsetBank
    impulse_omega: float
    impulse_age: float = math.inf
    ripple_factor: float = 1.0
    sways: SwayBank | None = None
    sway_omega: float = 0.0
    hangs: bool = False
    age: float = 0.0
    class_age: float = 0.0
    within_ramp: bool = False
    rejected: Mapping[Source, int] = {}
    change: OnsetPosterior = NO_POSTERIOR
    impulse: OnsetPosterior = NO_POSTERIOR
    change_odds: float = -30.0
    impulse_odds: float = -30.0
    distance_odds: float | None = None
    readings: Array = NO_READINGS
    is_repeating: bool = False
    tentative: bool = False
    tentative_s: float = 0.0
    is_expired: bool = False
    is_faster: bool = False
    faster: FasterChange | None = None
    start_check: StartCheck | None = None
    contact: bool = False
    is_keen: bool = False
    is_firm: bool = False
    unfelt_s: float = math.inf
    felt_s: float = math.inf
    complied: float = 0.0
    guide: Guide | None = None
    announced_s: float = math.inf
    events: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, eq=False)
class BankModel:
    """Settings of the bank classifier, and the models that follow from them.

    Attributes:
        distance_deviation: one sigma of a reading of the distance sensor [m].
        mixture: the prediction weighs the hypotheses; False takes the class in force.
        compliance: times the sigma of a deflection with which the guide takes it.
        stiffness: of the mount across the tool's axis [N/m].
    """

    conveyor: ConveyorClasses
    fusion: FusionSettings
    bank: BankSettings
    distance_deviation: float
    mixture: bool = True
    impulse: ImpulseSettings = field(default_factory=ImpulseSettings)
    ripple: RippleSettings = field(default_factory=RippleSettings)
    compliance: float = 1.0
    sway: SwaySettings = field(default_factory=SwaySettings)
    stiffness: float = 50e3

    @cached_property
    def may_hang(self) -> bool:
        """Whether the object may hang from its conveyor by a sway that is not identified."""
        sway = self.sway
        return sway.is_on and not sway.frequency_hz and sway.gain_deviation > HANGING

    @cached_property
    def ripple_decay(self) -> KeptValues[float]:
        """Decay of the random ripple over the horizon, by its correlation time."""
        return KeptValues(_decay)

    @cached_property
    def sway_turning(self) -> KeptValues[complex]:
        """Turn and decay of the sway over the horizon, by its pole."""
        return KeptValues(exponential)

    @cached_property
    def sway_response(self) -> KeptValues[tuple[float, complex]]:
        """Response of the sway to an acceleration of 1, by its frequency and pole."""
        return KeptValues(_response)

    @cached_property
    def changes(self) -> dict[Motion, float]:
        """Acceleration that the change out of each class adds [m/s^2]."""
        stop, start = self.conveyor.deceleration, self.conveyor.acceleration
        return {
            Motion.RUNNING: -stop,
            Motion.STANDING: start,
            Motion.STOPPING: start + stop,
            Motion.STARTING: -(stop + start),
        }

    @cached_property
    def change_onsets(self) -> dict[Motion, OnsetBank]:
        """The hypothesis that a change out of each class begins now."""
        onsets = {}
        for motion, change in self.changes.items():
            error = np.zeros(STATES)
            error[ACCELERATION] = -change
            onsets[motion] = onset_bank.begin(error, _CONSTANT)
        return onsets

    def onsets_now(self, state: BankState) -> OnsetBank:
        """Return the hypothesis that a change out of the class in force begins now.

        A change within a ramp ends that: it adds as much more as the ramp is steeper than stated.
        """
        onsets, motion = self.change_onsets[state.motion], state.motion
        if motion not in RAMPS:
            return onsets
        off = self.class_acceleration(motion) - float(state.x[ACCELERATION])
        sums = onsets.sums.copy()
        sums[4] = max(1.0 + off / self.changes[motion], LEAST_USUAL)
        return OnsetBank(onsets.error, sums)

    @cached_property
    def impulse_onsets(self) -> OnsetBank:
        """The hypotheses that an impulse disturbance begins now."""
        return onset_bank.begin(np.zeros(STATES), self.impulse.omegas)

    @cached_property
    def change_prior(self) -> AmplitudePrior:
        """Prior of a change's amplitude, as a share of its nominal one."""
        return AmplitudePrior(1.0, self.bank.amplitude_deviation**2)

    @cached_property
    def faster_priors(self) -> dict[Motion, AmplitudePrior | None]:
        """Prior of the amplitude of a change that is faster than configured, by class."""
        least = 1.0 + FASTER_SIGMAS * self.bank.amplitude_deviation
        return {motion: self._faster(motion, 1.0, least) for motion in Motion}

    @cached_property
    def stronger_priors(self) -> dict[Motion, AmplitudePrior | None]:
        """Prior of what a ramp adds that is stronger than estimated, by class.

        It is the opposite of the change out of that class.
        """
        return {motion: self._faster(motion, -EPSILON, -math.inf) for motion in RAMPS}

    @cached_property
    def shown_priors(self) -> dict[Motion, tuple[AmplitudePrior, ...]]:
        """Priors of the amplitude of a change that the distance sensor alone shows, by class.

        The bank has missed it, so it is rather another one than the one configured.
        """
        shown = {}
        for motion, faster in self.faster_priors.items():
            wider = () if faster is None else (replace(faster, odds=MISSED_ODDS),)
            shown[motion] = (self.change_prior, *wider)
        return shown

    def _faster(self, motion: Motion, mean: float, least: float) -> AmplitudePrior | None:
        faster = self.bank.faster
        if not faster:
            return None
        variance = (self.bank.faster_deviation / self.changes[motion]) ** 2
        return AmplitudePrior(mean, variance, least, math.log(faster / (1.0 - faster)))

    def change_posterior(self, state: BankState) -> OnsetPosterior:
        """Return the posterior of a change of class, as configured or faster."""
        result = onset_bank.posterior(state.changes, self.change_prior)
        faster = self._faster_prior(state)
        if faster is None:
            return result
        return onset_bank.likelier(state.changes, result, faster, self.bank.perceived)

    def faster_amplitude(self, state: BankState) -> float:
        """Return one sigma of a change's amplitude, as far as it may be a faster one; 0 if not."""
        faster = self._faster_prior(state)
        if faster is None or not len(state.changes):
            return 0.0
        usual = onset_bank.posterior(state.changes, self.change_prior)
        wider = onset_bank.posterior(state.changes, faster)
        share = 1.0 / (1.0 + math.exp(min(usual.odds - wider.odds, 30.0)))
        if share < LEAST_FASTER:
            return 0.0
        return math.sqrt(share) * float(wider.weights.dot(wider.amplitudes))

    def _faster_prior(self, state: BankState) -> AmplitudePrior | None:
        """Return the prior of a faster change; None where a force alone would show one.

        A mount shows how far the object has gone. It does not show how: a stop as configured of
        which the distance sensor missed the begin looked 2.9 times as strong.
        """
        return self.faster_priors[state.motion] if has_say(state.readings) else None

    @cached_property
    def impulse_prior(self) -> AmplitudePrior:
        """Prior of the amplitude of an impulse disturbance [m]."""
        return AmplitudePrior(0.0, self.impulse.deviation**2)

    def variance(self, measurement: PositionMeasurement) -> float:
        """Return the variance of a measurement as evidence of a class [m^2].

        A ring on a body whose sway is not identified looks like a stop or like an impulse.
        """
        return measurement.variance + (measurement.ringing if self.may_hang else 0.0)

    def class_acceleration(self, motion: Motion) -> float:
        """Return the nominal acceleration of a class [m/s^2]."""
        if motion is Motion.STOPPING:
            return -self.conveyor.deceleration
        return self.conveyor.acceleration if motion is Motion.STARTING else 0.0

    def random_ripple(self, state: BankState) -> tuple[float, float]:
        """Return the random ripple's standard deviation [m/s] and correlation time [s].

        At standstill it is what is left of the speed, and dies out.
        """
        if state.motion is Motion.STANDING or state.contact or self._is_fine_sensor:
            return self.fusion.contact_ripple, self.fusion.contact_ripple_time
        return self.fusion.ripple, self.fusion.ripple_time

    @cached_property
    def _is_fine_sensor(self) -> bool:
        """Whether the distance sensor alone resolves the ripple.

        A stop is detected as motion that the ripple cannot make. With a ripple that is modelled too
        small, a sensor that resolves its way would take every ripple for a stop.
        """
        way = self.fusion.contact_ripple * self.fusion.contact_ripple_time
        return self.distance_deviation < 0.5 * way

    def process_noise(self, state: BankState, dt: float) -> Array:
        """Return the diagonal of Q (15,) of (6): independent random walks and a stationary ripple.

        filterpy's white-noise matrices couple position and speed. The walk of the speed is slow
        enough (0.5 mm/s after 1 s) that its share of the position is left out.
        """
        fusion = self.fusion
        share = self.speed_share(float(state.x[V]))
        ripple, time = self.random_ripple(state)
        ripple = (ripple * share) ** 2 * (1.0 - math.exp(-2.0 * dt / time))
        rate = (self._ramp_walk(state) * self.class_acceleration(state.motion)) ** 2 * dt
        speed = fusion.speed * (1.0 if state.motion is not Motion.STANDING else 0.3)
        amplitude = frequency = 0.0
        if self.ripple.deviation > 0.0:
            amplitude = (self.ripple.walk * share) ** 2 * dt
            frequency = (self.ripple.pace * share) ** 2 * dt
        offset = fusion.offset**2 * dt
        walk = pace = driven = 0.0
        if state.sway_omega:
            sway, quadrature = float(state.x[SWAY]), float(state.x[SWAY_QUADRATURE])
            size = self.sway.least + math.hypot(sway, quadrature)
            walk, pace = (self.sway.walk * size) ** 2 * dt, self.sway.pace**2 * dt
            if self.holds_pace(state) and state.guide is None:
                # A frequency that is held may be off: by its spread, over a second of phase.
                off = self.sway.spread * state.sway_omega * size
                walk, pace = walk + (off * off + DRIVEN_WALK**2) * dt, 0.0
            if state.contact:
                driven = self.sway.driven**2 * dt
        known = [1e-12, speed**2 * dt, ripple, offset, rate, 0.0, 0.0]
        slip = (fusion.slip_walk * share) ** 2 * dt
        return np.array(
            [*known, amplitude, amplitude, frequency, slip, walk, walk + driven, pace, 0.0]
        )

    def _ramp_walk(self, state: BankState) -> float:
        """Return the random walk of a ramp's acceleration, as a share [1/sqrt(s)]."""
        v = float(state.x[V])
        if state.motion is Motion.STOPPING:
            left = max(v, 0.0) / self.conveyor.deceleration
        else:
            left = max(state.cruise - v, 0.0) / self.conveyor.acceleration
        return RAMP_WALK + END_WALK * math.exp(-left / END_S)

    def speed_share(self, speed: float) -> float:
        """Return the share of the nominal speed, with which every ripple fades."""
        share = speed / self.conveyor.nominal_speed
        return share if 0.0 <= share <= 1.0 else min(max(share, 0.0), 1.0)

    @cached_property
    def _ripple_omega(self) -> float:
        """The configured frequency of the periodic ripple at full speed [rad/s]."""
        return 2.0 * math.pi * self.ripple.frequency_hz

    def ripple_omega(self, state: BankState) -> float:
        """Return the estimated frequency of the periodic ripple at full speed [rad/s]."""
        return self._ripple_omega * state.ripple_factor

    def ripple_rate(self, state: BankState) -> float:
        """Return its frequency now [rad/s]: a sprocket turns with the conveyor's way."""
        return self._ripple_omega * state.ripple_factor * self.speed_share(float(state.x[V]))

    def transition(self, state: BankState, dt: float) -> Array:
        """Return A (15, 15) of (5), linearised in the errors of the frequencies."""
        time, x = self.random_ripple(state)[1], state.x.tolist()
        F = _fixed_transition(dt, time, state.impulse_omega, self.impulse.damping).copy()
        rate = self.ripple_omega(state) * self.speed_share(x[V])
        angle = rate * dt
        way = angle / state.ripple_factor
        c, s = math.cos(angle), math.sin(angle)
        ripple, quadrature = x[RIPPLE], x[RIPPLE_QUADRATURE]
        F[OFFSET, SLIP] = x[V] * dt
        F[RIPPLE, RIPPLE] = F[RIPPLE_QUADRATURE, RIPPLE_QUADRATURE] = c
        F[RIPPLE, RIPPLE_QUADRATURE], F[RIPPLE_QUADRATURE, RIPPLE] = s, -s
        F[RIPPLE, FREQUENCY] = way * (c * quadrature - s * ripple)
        F[RIPPLE_QUADRATURE, FREQUENCY] = -way * (c * ripple + s * quadrature)
        if state.sway_omega:
            self._set_sway(F, state, x, rate**2, dt)
        return F

    def holds_pace(self, state: BankState) -> bool:
        """Return whether the sway's frequency is held: it is identified, and the conveyor moves.

        Chain and drive of a running conveyor drive the body at frequencies of their own, and a ramp
        is not quite what the model has. A body on a conveyor that stands sways freely. In contact
        the mount gives it another frequency.
        """
        is_free = state.motion is Motion.STANDING or state.contact
        return self.sway.frequency_hz > 0.0 and not is_free

    def sway_pole(self, state: BankState) -> complex:
        """Return the pole of the sway [1/s]."""
        return state.sway_omega * complex(-self.sway.damping, 1.0)

    def _set_sway(
        self, F: Array, state: BankState, x: list[float], stiffness: float, dt: float
    ) -> None:
        """Set the rows of the sway in A: it turns, and the unit's acceleration forces it.

        Args:
            stiffness: how much the unit accelerates against its ripple, for each metre [1/s^2].
        """
        omega, pole = state.sway_omega, self.sway_pole(state)
        turn = cmath.exp(pole * dt)
        c, s = turn.real, turn.imag
        forced = (1j / omega) * (turn - 1.0) / pole
        sway, quadrature, gain, way = x[SWAY], x[SWAY_QUADRATURE], x[GAIN], omega * dt
        a, of_ripple = x[ACCELERATION] - stiffness * x[RIPPLE], gain * stiffness
        F[SWAY, SWAY] = F[SWAY_QUADRATURE, SWAY_QUADRATURE] = c
        F[SWAY, SWAY_QUADRATURE], F[SWAY_QUADRATURE, SWAY] = s, -s
        F[SWAY, ACCELERATION] = gain * forced.real
        F[SWAY_QUADRATURE, ACCELERATION] = -gain * forced.imag
        F[SWAY, RIPPLE] = -of_ripple * forced.real
        F[SWAY_QUADRATURE, RIPPLE] = of_ripple * forced.imag
        F[SWAY, GAIN], F[SWAY_QUADRATURE, GAIN] = a * forced.real, -a * forced.imag
        F[SWAY, PACE] = way * (c * quadrature - s * sway)
        F[SWAY_QUADRATURE, PACE] = gain * a * dt / omega - way * (c * sway + s * quadrature)

    def unit_acceleration(self, state: BankState) -> float:
        """Return the acceleration of the conveyor's unit, by class and periodic ripple [m/s^2].

        A chain or a drive excites the body's sway long before the first stop, often near its own
        frequency. That shows the gain with which a stop will excite it.
        """
        ripple = self.ripple_rate(state) ** 2 * float(state.x[RIPPLE])
        return float(state.x[ACCELERATION]) - ripple

    def advanced(self, state: BankState, F: Array, dt: float) -> Array:
        """Return the states (15,) of (5).

        What the sway gains is the product of two states. Each has its column in A, so A counts the
        product twice.
        """
        x: Array = F.dot(state.x)
        gain = float(state.x[GAIN])
        product = gain and gain * self.unit_acceleration(state)
        if product:
            pole = self.sway_pole(state)
            forced = product * sway_bank.response_at(state.sway_omega, pole, dt)
            x[SWAY] -= forced.real
            x[SWAY_QUADRATURE] += forced.imag
        return x

    def _set_past_sway(self, h: list[float], state: BankState, delay: float, acted: float) -> None:
        """Set what the past's sway makes of the states now.

        Args:
            acted: how long the acceleration has acted, at most ``delay`` [s].
        """
        pole, values = self.sway_pole(state), state.x.tolist()
        back = cmath.exp(-pole * delay)
        c, s = back.real, back.imag
        unforced = -(sway_bank.response_at(state.sway_omega, pole, acted) * back).real
        h[ACCELERATION] += values[GAIN] * unforced
        h[SWAY], h[SWAY_QUADRATURE], h[GAIN] = c, s, values[ACCELERATION] * unforced
        way = state.sway_omega * delay
        h[PACE] = -way * (c * values[SWAY_QUADRATURE] - s * values[SWAY])

    def acted_way(self, state: BankState, delay: float, ages: Array, source: Source) -> Array:
        """Return how much an acceleration of 1 since ``ages`` (m,) counts for a reading's past."""
        way: Array = ages * (delay - 0.5 * ages)
        if state.sway_omega and source is not Source.DISTANCE:
            pole = self.sway_pole(state)
            forced = sway_bank.response(state.sway_omega, pole, ages) * cmath.exp(-pole * delay)
            way = way - float(state.x[GAIN]) * forced.real
        return way

    def observation_row(self, measurement: PositionMeasurement, state: BankState) -> Array:
        """Return h (15,) of (1), (8), (10), with the delay in it.

        The acceleration of the class acts since its onset only.
        """
        tau = measurement.delay
        back = min(tau, state.class_age)
        acted = tau * back - 0.5 * back * back
        angle = self.ripple_rate(state) * tau
        ripple, quadrature = math.cos(angle), -math.sin(angle)
        if measurement.source is Source.DISTANCE:
            return np.array([1.0, -tau, -tau, 1.0, acted, 0.0, 0.0, ripple, quadrature, *NO_SWAY])
        w = state.impulse_omega
        grown = math.exp(self.impulse.damping * w * tau)
        swing, swing_quadrature = grown * math.cos(w * tau), -grown * math.sin(w * tau)
        h = [1.0, -tau, -tau, 0.0, acted, swing, swing_quadrature, ripple, quadrature, *NO_SWAY]
        if state.sway_omega:
            self._set_past_sway(h, state, tau, back)
        return np.array(h)

    def impulse_response(self, ages: Array, omega: Array) -> tuple[Array, Array]:
        """Return swing and quadrature (m,) for amplitude 1, ``ages`` after the impulse."""
        late = np.maximum(ages, 0.0)
        fade = np.where(ages > 0.0, np.exp(-self.impulse.damping * omega * late), 0.0)
        return fade * np.sin(omega * late), fade * np.cos(omega * late)

    def delayed_response(self, ages: Array, delay: float, omega: Array) -> Array:
        """Return the swing (m,) for amplitude 1, ``delay`` s ago."""
        phase = omega * np.maximum(ages - delay, 0.0)
        swing: Array = np.exp(-self.impulse.damping * phase) * np.sin(phase)
        return swing

    def likeliest_omega(self, state: BankState) -> float:
        """Return the impulse frequency with the largest posterior weight [rad/s]."""
        weights = state.impulse.weights
        best = max(self.impulse.omegas, key=lambda w: float(weights.dot(state.impulses.omega == w)))
        return float(best)


def _decay(tau: float, times: Array) -> Array:
    """Return e^(-t / tau) (m,)."""
    return np.asarray(np.exp(times * (-1.0 / tau)))


def _response(sway: tuple[float, complex], times: Array) -> ComplexArray:
    """Return the response (m,) of a sway, by its frequency and pole."""
    return sway_bank.response(*sway, times)


@lru_cache(maxsize=32)
def _fixed_transition(dt: float, ripple_time: float, omega: float, damping: float) -> Array:
    """Return A of (5) without the periodic ripple."""
    F = np.eye(STATES)
    F[Y, V], F[Y, RANDOM], F[Y, ACCELERATION] = dt, dt, 0.5 * dt * dt
    F[V, ACCELERATION] = dt
    F[RANDOM, RANDOM] = math.exp(-dt / ripple_time)
    fade = math.exp(-damping * omega * dt)
    c, s = fade * math.cos(omega * dt), fade * math.sin(omega * dt)
    F[IMPULSE, IMPULSE] = F[IMPULSE_QUADRATURE, IMPULSE_QUADRATURE] = c
    F[IMPULSE, IMPULSE_QUADRATURE], F[IMPULSE_QUADRATURE, IMPULSE] = s, -s
    F.setflags(write=False)
    return F
