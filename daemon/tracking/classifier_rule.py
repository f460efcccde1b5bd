"""The paper's rule (Sect. III-B): classes switched by prediction errors.

Law of this file: tentative when the old class predicts worse than one threshold, confirmed when
the old class, no longer corrected, goes on getting worse, cancelled when the new one is inferior.
The filter is (2)-(7) with the states y, x7 and x10, its speed as adaptive as the rule needs it to
be: a stiffer speed state would perceive a start sooner, but this is the paper's method.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from linemate.daemon.horizon import Array
from linemate.daemon.tracking.conveyor import Motion, Row, Source, View, travel
from linemate.daemon.tracking.settings import FusionSettings, RuleSettings
from linemate.daemon.tracking.task import ConveyorClasses

OFFSET_DEVIATION = 0.1  # of x10 before anything but the distance sensor saw the object [m]
SETTLING = 0.5  # the rule is silent until the speed has been seen [s]
REFUSALS = 3  # gated rows in a row after which the filter widens


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A class on trial.

    Attributes:
        old: class before.
        position, speed: where the old class has the object, uncorrected since.
        old_error, new_error: squared prediction errors since, fading.
        age: [s].
    """

    old: Motion
    position: float
    speed: float
    old_error: float
    new_error: float
    age: float


@dataclass(frozen=True, slots=True, eq=False)
class RuleState:
    """Belief of the rule: x = (y, x7 [m/s], x10), its covariance, the class and its trial."""

    x: Array
    P: Array
    motion: Motion
    cruise: float
    age: float = 0.0
    since: float = 0.0
    refused: Mapping[Source, int] = field(default_factory=dict)
    trial: Trial | None = None
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
        return RuleState(x, P, Motion.RUNNING, nominal)

    def _acceleration(self, motion: Motion) -> float:
        """Return b's acceleration of a class."""
        if motion is Motion.STOPPING:
            return -self.conveyor.deceleration
        return self.conveyor.acceleration if motion is Motion.STARTING else 0.0

    def _speed_noise(self, dt: float) -> float:
        """Return Q77 for the bandwidth that is set.

        A filter that sees the position with variance R each dt and lets the speed walk by q each
        step has its poles at ``w^4 = q / (R dt^3)`` or so; solved for q.
        """
        w = self.rule.bandwidth
        return self.distance_deviation**2 * (w * w * dt) ** 2 * dt

    def _predict(self, state: RuleState, dt: float) -> RuleState:
        """Return (5), (6) with the class in A and b."""
        y, v, o = state.x.tolist()
        a = self._acceleration(state.motion)
        times = np.array((dt,))
        way = float(travel(v, a, state.cruise, times)[0])
        speed = v + a * dt
        motion = state.motion
        if motion is Motion.STOPPING and speed <= 0.0:
            speed, motion = 0.0, Motion.STANDING
        elif motion is Motion.STARTING and speed >= state.cruise:
            speed, motion = state.cruise, Motion.RUNNING
        F = np.array(((1.0, dt, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
        q = self._speed_noise(dt)
        Q = np.diag((q * dt * dt / 3.0 + 1e-12, q, self.fusion.offset**2 * dt))
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

    def _correct(self, state: RuleState, row: Row) -> RuleState:
        """Return (2)-(4) for one row, gated; after some refusals in a row the filter widens."""
        innovation, h, S = self._innovation(state, row)
        if innovation * innovation > row.gate**2 * max(S, (self.rule.confirmed / 2.0) ** 2):
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

    def _judge(self, state: RuleState, row: Row) -> RuleState:
        """Return the state with its class weighed against one row, before the correction."""
        if not self.classes or row.source is Source.CAMERA or state.age < SETTLING:
            return state
        innovation, _, S = self._innovation(state, row)
        if state.trial is None:
            big = abs(innovation) > self.rule.tentative
            if not big or innovation**2 > row.gate**2 * max(S, (self.rule.confirmed / 2.0) ** 2):
                return state
            return self._try(state, innovation)
        trial = state.trial
        offset = float(state.x[2]) if row.source is Source.DISTANCE else 0.0
        old = row.value - trial.position - offset + trial.speed * row.delay
        fade = 0.7
        trial = replace(
            trial,
            old_error=fade * trial.old_error + old * old,
            new_error=fade * trial.new_error + innovation * innovation,
        )
        worse = old > 0.0 if state.motion is Motion.STARTING else old < 0.0
        if worse and abs(old) > self.rule.confirmed and trial.old_error > trial.new_error:
            word = _word(state.motion)
            return replace(state, trial=None, events=(*state.events, (word, "confirmed")))
        if trial.new_error > trial.old_error or trial.age > 1.0:
            word = _word(state.motion)
            x = np.array((trial.position, trial.speed, state.x[2]))
            return replace(
                state,
                x=x,
                motion=trial.old,
                trial=None,
                events=(*state.events, (word, "cancelled")),
            )
        return replace(state, trial=trial)

    def _try(self, state: RuleState, innovation: float) -> RuleState:
        """Return the state with the class of least prediction error applied tentatively."""
        motion = state.motion
        if innovation < 0.0 and motion in {Motion.RUNNING, Motion.STARTING}:
            new, width = Motion.STOPPING, 0.2 * self.conveyor.deceleration
        elif innovation > 0.0 and motion in {Motion.STANDING, Motion.STOPPING}:
            new, width = Motion.STARTING, 0.8 * self.conveyor.acceleration
        else:
            return state
        trial = Trial(motion, float(state.x[0]), float(state.x[1]), innovation**2, 0.0, 0.0)
        # The speed has changed since the onset by what the filter could not follow.
        P = state.P + np.diag((0.0, width * width, 0.0))
        event = (_word(new), "tentative")
        return replace(
            state, P=P, motion=new, trial=trial, since=0.15, events=(*state.events, event)
        )

    def advance(self, state: RuleState, rows: Sequence[Row], dt: float) -> RuleState:
        """Return the belief one step later."""
        state = self._predict(state, dt)
        for row in rows:
            state = self._correct(self._judge(state, row), row)
        if state.motion is Motion.RUNNING and state.trial is None and state.age > SETTLING:
            return self._settle(state, dt)
        return state

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
        return y + travel(v, self._acceleration(state.motion), state.cruise, times)

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
