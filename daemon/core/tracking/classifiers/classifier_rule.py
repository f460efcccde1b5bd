"""The paper's rule (Sect. III-B): classes switched by prediction errors.

Law of this file: tentative when the old class predicts worse than one threshold, confirmed when
the old class, no longer corrected, goes on getting worse, cancelled when the new one is inferior.
The estimate is (2)-(7) with the states y, x7 and x10 and all sensors. The prediction errors are
those of a watch beside it, on the distance sensor alone, its speed as adaptive as the rule needs it
to be: a stiffer one would perceive a start sooner, but this is the paper's method.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import ramp_check
from linemate.daemon.core.tracking.classifiers.ramp_check import Denial, StartCheck
from linemate.daemon.core.tracking.conveyor import LONGEST_TRIAL, Motion, Row, Source, View, travel
from linemate.daemon.core.tracking.settings import FusionSettings, RuleSettings
from linemate.daemon.core.tracking.task import ConveyorClasses

OFFSET_DEVIATION = 0.1  # of x10 before anything but the distance sensor saw the object [m]
SETTLING = 0.5  # the rule is silent until the speed of a class has been seen [s]
REFUSALS = 3  # gated rows in a row after which the filter widens
FADING = 0.7  # of the squared errors that compare two classes, a reading
ACTING = 0.15  # how long a class has acted as it is tried [s]
BEHIND = 0.5  # share of the error that tries it by which the estimate lags; the rest is noise


class Trial(Struct, frozen=True, eq=False):
    """A class on trial.

    Attributes:
        position, speed: what the old class expects to be read, uncorrected since [m, m/s].
        old_error, new_error: squared prediction errors since, fading.
        age: [s].
    """

    old: Motion
    position: float
    speed: float
    old_error: float
    new_error: float
    age: float


class RuleState(Struct, frozen=True, eq=False):
    """Belief of the rule.

    Attributes:
        x: y [m], x7 [m/s], x10 [m].
        w: the watch: what the distance sensor should read [m], and its speed [m/s].
        cruise: speed at which a start ends [m/s].
        age: of the belief [s].
        since: how long the class has been acting [s].
        refused: rows gated in a row, by sensor.
        wild: readings that the watch gated in a row.
        trial: of a class, or None.
        check: of a start against the readings, or None.
        events: of the last step.
    """

    x: Array
    P: Array
    w: Array
    W: Array
    motion: Motion
    cruise: float
    age: float = 0.0
    since: float = 0.0
    refused: Mapping[Source, int] = {}
    wild: int = 0
    trial: Trial | None = None
    check: StartCheck | None = None
    events: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RuleClassifier:
    """The rule with its thresholds; ``classes`` False keeps the speed constant (ablation)."""

    conveyor: ConveyorClasses
    fusion: FusionSettings
    rule: RuleSettings
    distance_deviation: float
    classes: bool = True

    def initial(self, position: float) -> RuleState:
        """Return the belief at a first distance reading; the speed is not known yet."""
        nominal = self.conveyor.nominal_speed
        variance = self.distance_deviation**2
        offset = OFFSET_DEVIATION**2
        P = np.array(
            ((variance + offset, 0.0, -offset), (0.0, nominal**2, 0.0), (-offset, 0.0, offset))
        )
        x = np.array((position, 0.5 * nominal, 0.0))
        w = np.array((position, 0.5 * nominal))
        return RuleState(x, P, w, np.diag((variance, nominal**2)), Motion.RUNNING, nominal)

    def _acceleration(self, motion: Motion) -> float:
        """Return b's acceleration of a class."""
        if motion is Motion.STOPPING:
            return -self.conveyor.deceleration
        return self.conveyor.acceleration if motion is Motion.STARTING else 0.0

    def _speed_noise(self, bandwidth: float, dt: float) -> float:
        """Return Q77 for a bandwidth [rad/s].

        A filter that sees a position with variance R each dt, its speed walking by q each step,
        settles with both poles at ``w^4 = q / (R dt^2)``, damped by 0.7.
        """
        return self.distance_deviation**2 * bandwidth**4 * dt * dt

    def _predict(self, state: RuleState, dt: float) -> RuleState:
        """Return (5), (6) with the class in A and b."""
        y, v, o = state.x.tolist()
        a = self._acceleration(state.motion)
        times = np.array((dt,))
        way = float(travel(v, a, state.cruise, times)[0])
        speed = v + a * dt
        motion = state.motion
        reading, pace = state.w.tolist()
        reading += float(travel(pace, a, state.cruise, times)[0])
        pace += a * dt
        if motion is Motion.STOPPING and speed <= 0.0:
            speed, pace, motion = 0.0, 0.0, Motion.STANDING
        elif motion is Motion.STARTING and speed >= state.cruise:
            speed, pace, motion = state.cruise, state.cruise, Motion.RUNNING
        F = np.array(((1.0, dt, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
        G = F[:2, :2]
        p, q = (self._speed_noise(w, dt) for w in (self.rule.following, self.rule.bandwidth))
        square = dt * dt / 3.0
        Q = np.diag((p * square + 1e-12, p, self.fusion.offset**2 * dt))
        trial = state.trial
        if trial is not None:
            old = self._acceleration(trial.old)
            moved = float(travel(trial.speed, old, state.cruise, times)[0])
            trial = replace(
                trial,
                position=trial.position + moved,
                speed=min(max(trial.speed + old * dt, 0.0), max(state.cruise, trial.speed)),
                age=trial.age + dt,
            )
        return replace(
            state,
            x=np.array((y + way, speed, o)),
            P=F @ state.P @ F.T + Q,
            w=np.array((reading, pace)),
            W=G @ state.W @ G.T + np.diag((q * square + 1e-12, q)),
            motion=motion,
            age=state.age + dt,
            since=state.since + dt,
            trial=trial,
            events=(),
        )

    def _innovation(self, state: RuleState, row: Row) -> tuple[float, Array, float]:
        """Return innovation, row h and its variance S; delayed rows as in (8)."""
        a = self._acceleration(state.motion)
        seen = 1.0 if row.source is Source.DISTANCE else 0.0
        h = np.array((1.0, -row.delay, seen))
        back = min(row.delay, state.since)
        innovation = row.value - float(h @ state.x) - 0.5 * a * back * back
        return innovation, h, float(h @ state.P @ h) + row.variance

    def _wild(self, error: float, S: float, row: Row) -> bool:
        """Return whether an error is an outlier's, or no number.

        A class that ends is confirmed before its readings err by more than what confirms the next.
        An outlier of 6.5 mm that was let in was taken for a stop; taken back 48 ms later, it had
        moved the horizon's end by 50 mm.
        """
        return not error * error <= max(row.gate**2 * S, self.rule.confirmed**2)

    def _correct(self, state: RuleState, row: Row) -> RuleState:
        """Return (2)-(4) for one row, gated; after some refusals in a row the filter widens."""
        innovation, h, S = self._innovation(state, row)
        if self._wild(innovation, S, row):
            refusals = state.refused.get(row.source, 0) + 1
            if refusals < REFUSALS:
                return replace(state, refused={**state.refused, row.source: refusals})
            wide = (innovation**2, 0.25 * self.conveyor.nominal_speed**2, innovation**2)
            P = state.P + np.diag(wide)
            state = replace(state, P=P)
            S = float(h @ P @ h) + row.variance
        K = state.P @ h / S
        return replace(
            state,
            x=state.x + K * innovation,
            P=state.P - np.outer(K, h @ state.P),
            refused={**state.refused, row.source: 0},
        )

    def _watch(self, state: RuleState, row: Row) -> RuleState:
        """Return the state with its class weighed against one distance reading."""
        a = self._acceleration(state.motion)
        h = np.array((1.0, -row.delay))
        S = float(h @ state.W @ h) + row.variance
        error = row.value - float(h @ state.w) - 0.5 * a * min(row.delay, state.since) ** 2
        wild = self._wild(error, S, row)
        if wild and state.wild + 1 < REFUSALS:
            return replace(state, wild=state.wild + 1)
        if wild:  # it stays: the sensor has moved, or the watch is wrong
            w = np.array((row.value + state.w[1] * row.delay, state.w[1]))
            W = np.diag((row.variance, (0.5 * self.conveyor.nominal_speed) ** 2))
            return replace(state, w=w, W=W, wild=0, age=0.0, trial=None)
        if state.wild:
            state = replace(state, wild=0)
        if self.classes and state.age > SETTLING:
            state = self._judge(state, row, error)
        K = state.W @ h / S
        return replace(state, w=state.w + K * error, W=state.W - np.outer(K, h @ state.W))

    def _judge(self, state: RuleState, row: Row, error: float) -> RuleState:
        """Return the state with a class tried, confirmed or cancelled by a prediction error."""
        trial = state.trial
        if trial is None:
            if abs(error) < self.rule.tentative or state.since < SETTLING:
                return state
            return self._try(state, error)
        old = row.value - trial.position + trial.speed * row.delay
        trial = replace(
            trial,
            old_error=FADING * trial.old_error + old * old,
            new_error=FADING * trial.new_error + error * error,
        )
        word = _word(state.motion)
        worse = old > 0.0 if state.motion is Motion.STARTING else old < 0.0
        if worse and abs(old) > self.rule.confirmed and trial.old_error > trial.new_error:
            events = (*state.events, (word, "confirmed"))
            return replace(state, trial=None, since=0.0, events=events)
        if trial.new_error > trial.old_error or trial.age > LONGEST_TRIAL:
            return self._cancel(state, trial, word)
        return replace(state, trial=trial)

    def _cancel(self, state: RuleState, trial: Trial, word: str) -> RuleState:
        """Return the state in its old class again: an outlier is assumed."""
        x = state.x.copy()
        x[1] += trial.speed - state.w[1]
        return replace(
            state,
            x=x,
            w=np.array((trial.position, trial.speed)),
            motion=trial.old,
            since=SETTLING,
            trial=None,
            events=(*state.events, (word, "cancelled")),
        )

    def _try(self, state: RuleState, error: float) -> RuleState:
        """Return the state with the class of least prediction error applied tentatively.

        A stop of a running conveyor has acted for a while before its error is seen: the speed is
        less by what it did since, and the estimate ahead by what it has not followed. A class
        that began at the old speed would be found a tenth of a second later, all of it latency.
        """
        if error < 0.0 and state.motion in {Motion.RUNNING, Motion.STARTING}:
            new, width = Motion.STOPPING, 0.2 * self.conveyor.deceleration
        elif error > 0.0 and state.motion in {Motion.STANDING, Motion.STOPPING}:
            new, width = Motion.STARTING, 0.8 * self.conveyor.acceleration
        else:
            return state
        trial = Trial(state.motion, float(state.w[0]), float(state.w[1]), error**2, 0.0, 0.0)
        # The speed has changed since the onset by what the filter could not follow.
        wide = np.array((0.0, width * width))
        moved = np.zeros(3)
        if state.motion is Motion.RUNNING:
            moved[:2] = BEHIND * error, ACTING * self._acceleration(new)
        return replace(
            state,
            x=state.x + moved,
            w=state.w + moved[:2],
            P=state.P + np.diag((*wide, 0.0)),
            W=state.W + np.diag(wide),
            motion=new,
            trial=trial,
            since=ACTING,
            events=(*state.events, (_word(new), "tentative")),
        )

    def advance(self, state: RuleState, rows: Sequence[Row], dt: float) -> RuleState:
        """Return the belief one step later."""
        before = state.motion
        state = self._predict(state, dt)
        for row in rows:
            if row.source is Source.DISTANCE:
                state = self._watch(state, row)
            state = self._correct(state, row)
        if self.classes:
            state = self._checked(before, state, rows, dt)
        if state.motion is Motion.RUNNING and state.trial is None and state.age > SETTLING:
            return self._settle(state, dt)
        return state

    def _checked(
        self, before: Motion, state: RuleState, rows: Sequence[Row], dt: float
    ) -> RuleState:
        """Return the state with a start taken back, or ended, if the readings contradict it."""
        # A stop on trial does not end the check of the start before it: it may be cancelled.
        is_start = state.trial is not None and state.trial.old is Motion.STARTING
        motion = Motion.STARTING if is_start else state.motion
        if motion is not Motion.STARTING and state.check is None:
            return state
        check = ramp_check.follow(state.check, before, motion, float(state.x[1]), rows, dt)
        denial = ramp_check.denied(check, self.conveyor, state.cruise, self.distance_deviation)
        if denial is None or is_start:
            return replace(state, check=check)
        return self._denied(state, denial)

    def _denied(self, state: RuleState, denial: Denial) -> RuleState:
        """Return the state in the class that the readings speak for."""
        x, w, P, W = state.x.copy(), state.w.copy(), state.P.copy(), state.W.copy()
        spread = (x[1] - denial.speed) ** 2 + (w[1] - denial.speed) ** 2
        x[1] = w[1] = denial.speed
        P[1, 1] += spread
        W[1, 1] += spread
        events = state.events
        if denial.motion is not Motion.RUNNING or state.trial is not None:
            events = (*events, ("start", "cancelled"))
        return replace(
            state,
            x=x,
            P=P,
            w=w,
            W=W,
            motion=denial.motion,
            since=0.0,
            trial=None,
            check=None,
            events=events,
        )

    def _settle(self, state: RuleState, dt: float) -> RuleState:
        """Return the state with the cruising speed learnt slowly, or found to be standing."""
        speed = float(state.x[1])
        nominal = self.conveyor.nominal_speed
        if self.classes and state.age < SETTLING + 2 * dt and speed < 0.3 * nominal:
            return replace(state, motion=Motion.STANDING, cruise=nominal)
        if speed > 0.8 * nominal:
            return replace(state, cruise=state.cruise + dt * (speed - state.cruise))
        return state

    def outlook(self, state: RuleState, times: Array) -> Array:
        """Return positions (m,) at ``times`` under the class in force, tentative or not."""
        y, v, _ = state.x.tolist()
        positions: Array = y + travel(v, self._acceleration(state.motion), state.cruise, times)
        return positions

    def view(self, state: RuleState) -> View:
        """Return what the rule says."""
        y, v, o = state.x.tolist()
        return View(
            position=y,
            speed=v,
            offset=o,
            deviation=float(np.sqrt(max(state.P[0, 0], 0.0))),
            speed_deviation=float(np.sqrt(max(state.P[1, 1], 0.0))),
            motion=state.motion,
            tentative=state.trial is not None,
            events=state.events,
        )


def _word(motion: Motion) -> str:
    """Return the event's word for a class."""
    return "start" if motion is Motion.STARTING else "stop"
