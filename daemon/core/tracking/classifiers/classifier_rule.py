"""Rule classifier: the paper's rule (Sect. III-B), classes switched by prediction errors.

A class is tentative when the old class predicts worse than one threshold. It is confirmed when the
old class, no longer corrected, goes on getting worse, and cancelled when the new one is inferior.
The estimate is (2)-(7) with the states y, x7 and x10 and all sensors. The prediction errors are
those of a monitor: a second filter on the distance sensor alone, with the bandwidth that the rule
needs. A stiffer one would perceive a start sooner, but this is the paper's method.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from filterpy.common import Q_continuous_white_noise
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
from linemate.daemon.core.tracking.settings import FusionSettings, RuleSettings
from linemate.daemon.core.tracking.task import ConveyorClasses

OFFSET_DEVIATION = 0.1  # of x10 before anything but the distance sensor saw the object [m]
SETTLING_S = 0.5  # no class is tried before the speed has settled [s]
MOST_REJECTED = 3  # measurements rejected in a row, after which the filter widens
FADING = 0.7  # of the squared errors that compare two classes, a reading
ACTING_S = 0.15  # how long a class has acted when it becomes tentative [s]
LAG_SHARE = 0.5  # share of the prediction error by which the estimate lags; the rest is noise


class TentativeClass(Struct, frozen=True, eq=False):
    """A class that is compared with the one before it.

    Attributes:
        position, speed: prediction of the old class, uncorrected since [m, m/s].
        old_error, new_error: squared prediction errors since, fading [m^2].
    """

    old: Motion
    position: float
    speed: float
    old_error: float
    new_error: float
    age: float


class RuleState(Struct, frozen=True, eq=False):
    """Estimate and class of the rule.

    Attributes:
        x: (3,) y [m], x7 [m/s], x10 [m].
        P: (3, 3) covariance of x.
        monitor: (2,) predicted reading of the distance sensor [m] and its speed [m/s].
        monitor_P: (2, 2) covariance of the monitor.
        cruise: speed at which a start ends [m/s].
        age: of the estimate [s].
        class_age: time since the class began to act [s].
        rejected: measurements rejected in a row, by sensor.
        outliers: readings that the monitor rejected in a row.
        tentative: comparison of a tentative class, or None.
        start_check: of a start against the readings, or None.
        events: of the last step.
    """

    x: Array
    P: Array
    monitor: Array
    monitor_P: Array
    motion: Motion
    cruise: float
    age: float = 0.0
    class_age: float = 0.0
    rejected: Mapping[Source, int] = {}
    outliers: int = 0
    tentative: TentativeClass | None = None
    start_check: StartCheck | None = None
    events: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RuleClassifier:
    """Filter and rule with their thresholds; see ``conveyor.Classifier``.

    Attributes:
        distance_deviation: one sigma of a reading of the distance sensor [m].
        classes: False keeps the speed constant (ablation).
    """

    conveyor: ConveyorClasses
    fusion: FusionSettings
    rule: RuleSettings
    distance_deviation: float
    classes: bool = True

    def initial(self, position: float) -> RuleState:
        """Return the state at a first reading of the distance sensor [m]; the speed is unknown."""
        nominal = self.conveyor.nominal_speed
        variance = self.distance_deviation**2
        offset = OFFSET_DEVIATION**2
        P = np.array(
            ((variance + offset, 0.0, -offset), (0.0, nominal**2, 0.0), (-offset, 0.0, offset))
        )
        x = np.array((position, 0.5 * nominal, 0.0))
        monitor = np.array((position, 0.5 * nominal))
        return RuleState(x, P, monitor, np.diag((variance, nominal**2)), Motion.RUNNING, nominal)

    def _acceleration(self, motion: Motion) -> float:
        """Return b's acceleration of a class."""
        if motion is Motion.STOPPING:
            return -self.conveyor.deceleration
        return self.conveyor.acceleration if motion is Motion.STARTING else 0.0

    def _process_noise(self, bandwidth: float, dt: float) -> Array:
        """Return Q (2, 2) of position and speed for a bandwidth w [rad/s].

        A filter that measures a position with variance R in each step, its speed walking by q a
        step, settles with both poles at ``w^4 = q / (R dt^2)``, damped by 0.7.
        """
        density = self.distance_deviation**2 * bandwidth**4 * dt
        Q: Array = Q_continuous_white_noise(2, dt, density)
        return Q

    def _predict(self, state: RuleState, dt: float) -> RuleState:
        """Return (5), (6) with the class in A and b."""
        y, v, o = state.x.tolist()
        a = self._acceleration(state.motion)
        times = np.array((dt,))
        distance = float(way(v, a, state.cruise, times)[0])
        speed = v + a * dt
        motion = state.motion
        monitor_position, monitor_speed = state.monitor.tolist()
        monitor_position += float(way(monitor_speed, a, state.cruise, times)[0])
        monitor_speed += a * dt
        if motion is Motion.STOPPING and speed <= 0.0:
            speed, monitor_speed, motion = 0.0, 0.0, Motion.STANDING
        elif motion is Motion.STARTING and speed >= state.cruise:
            speed, monitor_speed, motion = state.cruise, state.cruise, Motion.RUNNING
        F = np.array(((1.0, dt, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
        G = F[:2, :2]
        Q = np.zeros((3, 3))
        Q[:2, :2] = self._process_noise(self.rule.following, dt)
        Q[2, 2] = self.fusion.offset**2 * dt
        tentative = state.tentative
        if tentative is not None:
            old = self._acceleration(tentative.old)
            moved = float(way(tentative.speed, old, state.cruise, times)[0])
            tentative = replace(
                tentative,
                position=tentative.position + moved,
                speed=min(max(tentative.speed + old * dt, 0.0), max(state.cruise, tentative.speed)),
                age=tentative.age + dt,
            )
        return replace(
            state,
            x=np.array((y + distance, speed, o)),
            P=F @ state.P @ F.T + Q,
            monitor=np.array((monitor_position, monitor_speed)),
            monitor_P=G @ state.monitor_P @ G.T + self._process_noise(self.rule.bandwidth, dt),
            motion=motion,
            age=state.age + dt,
            class_age=state.class_age + dt,
            tentative=tentative,
            events=(),
        )

    def _innovation(
        self, state: RuleState, measurement: PositionMeasurement
    ) -> tuple[float, Array, float]:
        """Return the innovation, the row h and the variance S; the delay enters as in (8)."""
        a = self._acceleration(state.motion)
        seen = 1.0 if measurement.source is Source.DISTANCE else 0.0
        h = np.array((1.0, -measurement.delay, seen))
        back = min(measurement.delay, state.class_age)
        innovation = measurement.value - float(h @ state.x) - 0.5 * a * back * back
        return innovation, h, float(h @ state.P @ h) + measurement.variance

    def _is_outlier(self, error: float, S: float, measurement: PositionMeasurement) -> bool:
        """Return whether a prediction error is an outlier, or no number.

        Errors that confirm a class are never outliers. Without this gate an outlier of 6.5 mm
        became a tentative stop: cancelled 48 ms later, it had moved the horizon's end by 50 mm.
        """
        return not error * error <= max(measurement.gate**2 * S, self.rule.confirmed**2)

    def _correct(self, state: RuleState, measurement: PositionMeasurement) -> RuleState:
        """Return (2)-(4) for one measurement, gated; after some rejections the filter widens."""
        innovation, h, S = self._innovation(state, measurement)
        if self._is_outlier(innovation, S, measurement):
            rejections = state.rejected.get(measurement.source, 0) + 1
            if rejections < MOST_REJECTED:
                return replace(state, rejected={**state.rejected, measurement.source: rejections})
            wide = (innovation**2, 0.25 * self.conveyor.nominal_speed**2, innovation**2)
            P = state.P + np.diag(wide)
            state = replace(state, P=P)
            S = float(h @ P @ h) + measurement.variance
        K = state.P @ h / S
        return replace(
            state,
            x=state.x + K * innovation,
            P=state.P - np.outer(K, h @ state.P),
            rejected={**state.rejected, measurement.source: 0},
        )

    def _monitor(self, state: RuleState, measurement: PositionMeasurement) -> RuleState:
        """Return the state with its class compared with one reading of the distance sensor."""
        a = self._acceleration(state.motion)
        h = np.array((1.0, -measurement.delay))
        S = float(h @ state.monitor_P @ h) + measurement.variance
        error = (
            measurement.value
            - float(h @ state.monitor)
            - 0.5 * a * min(measurement.delay, state.class_age) ** 2
        )
        if self._is_outlier(error, S, measurement):
            if state.outliers + 1 < MOST_REJECTED:
                return replace(state, outliers=state.outliers + 1)
            # Outliers that persist: the sensor has moved, or the monitor is wrong.
            speed = state.monitor[1]
            return replace(
                state,
                monitor=np.array((measurement.value + speed * measurement.delay, speed)),
                monitor_P=np.diag((measurement.variance, (0.5 * self.conveyor.nominal_speed) ** 2)),
                outliers=0,
                age=0.0,
                tentative=None,
            )
        if state.outliers:
            state = replace(state, outliers=0)
        if self.classes and state.age > SETTLING_S:
            state = self._judge_class(state, measurement, error)
        K = state.monitor_P @ h / S
        monitor_P = state.monitor_P - np.outer(K, h @ state.monitor_P)
        return replace(state, monitor=state.monitor + K * error, monitor_P=monitor_P)

    def _judge_class(
        self, state: RuleState, measurement: PositionMeasurement, error: float
    ) -> RuleState:
        """Return the state with a class tentative, confirmed or cancelled by a prediction error."""
        tentative = state.tentative
        if tentative is None:
            if abs(error) < self.rule.tentative or state.class_age < SETTLING_S:
                return state
            return self._start_tentative(state, error)
        old = measurement.value - tentative.position + tentative.speed * measurement.delay
        tentative = replace(
            tentative,
            old_error=FADING * tentative.old_error + old * old,
            new_error=FADING * tentative.new_error + error * error,
        )
        event = _event(state.motion)
        worse = old > 0.0 if state.motion is Motion.STARTING else old < 0.0
        if worse and abs(old) > self.rule.confirmed and tentative.old_error > tentative.new_error:
            events = (*state.events, (event, "confirmed"))
            return replace(state, tentative=None, class_age=0.0, events=events)
        if tentative.new_error > tentative.old_error or tentative.age > LONGEST_TENTATIVE_S:
            return self._cancel(state, tentative, event)
        return replace(state, tentative=tentative)

    def _cancel(self, state: RuleState, tentative: TentativeClass, event: str) -> RuleState:
        """Return the state in its old class again: the error is taken for an outlier."""
        x = state.x.copy()
        x[1] += tentative.speed - state.monitor[1]
        return replace(
            state,
            x=x,
            monitor=np.array((tentative.position, tentative.speed)),
            motion=tentative.old,
            class_age=SETTLING_S,
            tentative=None,
            events=(*state.events, (event, "cancelled")),
        )

    def _start_tentative(self, state: RuleState, error: float) -> RuleState:
        """Return the state with the class of least prediction error applied tentatively.

        A stop of a running conveyor has acted for a while before its error shows. The speed is
        lower by what it did since, and the estimate ahead by what it has not followed. A class that
        began at the old speed would be confirmed a tenth of a second later.
        """
        if error < 0.0 and state.motion in {Motion.RUNNING, Motion.STARTING}:
            new, width = Motion.STOPPING, 0.2 * self.conveyor.deceleration
        elif error > 0.0 and state.motion in {Motion.STANDING, Motion.STOPPING}:
            new, width = Motion.STARTING, 0.8 * self.conveyor.acceleration
        else:
            return state
        position, speed = state.monitor.tolist()
        tentative = TentativeClass(state.motion, position, speed, error**2, 0.0, 0.0)
        # The speed has changed since the onset by what the filter could not follow.
        wide = np.array((0.0, width * width))
        moved = np.zeros(3)
        if state.motion is Motion.RUNNING:
            moved[:2] = LAG_SHARE * error, ACTING_S * self._acceleration(new)
        return replace(
            state,
            x=state.x + moved,
            monitor=state.monitor + moved[:2],
            P=state.P + np.diag((*wide, 0.0)),
            monitor_P=state.monitor_P + np.diag(wide),
            motion=new,
            tentative=tentative,
            class_age=ACTING_S,
            events=(*state.events, (_event(new), "tentative")),
        )

    def advance(
        self, state: RuleState, measurements: Sequence[PositionMeasurement], dt: float
    ) -> RuleState:
        """Return the state ``dt`` seconds later, its class decided."""
        before = state.motion
        state = self._predict(state, dt)
        for measurement in measurements:
            if measurement.source is Source.DISTANCE:
                state = self._monitor(state, measurement)
            state = self._correct(state, measurement)
        if self.classes:
            state = self._check_start(before, state, measurements, dt)
        if state.motion is Motion.RUNNING and state.tentative is None and state.age > SETTLING_S:
            return self._settle(state, dt)
        return state

    def _check_start(
        self,
        before: Motion,
        state: RuleState,
        measurements: Sequence[PositionMeasurement],
        dt: float,
    ) -> RuleState:
        """Return the state with a start cancelled, or ended, if the readings contradict it."""
        # A tentative stop does not end the check of the start before it: it may be cancelled.
        is_start = state.tentative is not None and state.tentative.old is Motion.STARTING
        motion = Motion.STARTING if is_start else state.motion
        if motion is not Motion.STARTING and state.start_check is None:
            return state
        check = start_check.update(
            state.start_check, before, motion, float(state.x[1]), measurements, dt
        )
        rejection = start_check.reject(check, self.conveyor, state.cruise, self.distance_deviation)
        if rejection is None or is_start:
            return replace(state, start_check=check)
        return self._reject_start(state, rejection)

    def _reject_start(self, state: RuleState, rejection: StartRejection) -> RuleState:
        """Return the state in the class that the readings speak for."""
        x, P = state.x.copy(), state.P.copy()
        monitor, monitor_P = state.monitor.copy(), state.monitor_P.copy()
        spread = (x[1] - rejection.speed) ** 2 + (monitor[1] - rejection.speed) ** 2
        x[1] = monitor[1] = rejection.speed
        P[1, 1] += spread
        monitor_P[1, 1] += spread
        events = state.events
        if rejection.motion is not Motion.RUNNING or state.tentative is not None:
            events = (*events, ("start", "cancelled"))
        return replace(
            state,
            x=x,
            P=P,
            monitor=monitor,
            monitor_P=monitor_P,
            motion=rejection.motion,
            class_age=0.0,
            tentative=None,
            start_check=None,
            events=events,
        )

    def _settle(self, state: RuleState, dt: float) -> RuleState:
        """Return the state with the cruising speed averaged slowly, or standing."""
        speed = float(state.x[1])
        nominal = self.conveyor.nominal_speed
        if self.classes and state.age < SETTLING_S + 2 * dt and speed < 0.3 * nominal:
            return replace(state, motion=Motion.STANDING, cruise=nominal)
        if speed > 0.8 * nominal:
            return replace(state, cruise=state.cruise + dt * (speed - state.cruise))
        return state

    def announce_stop(self, state: RuleState) -> RuleState:
        """Return the state as it is: only the sensors show a stop to this classifier."""
        return state

    def predict_positions(self, state: RuleState, times: Array) -> Array:
        """Return positions (m,) at ``times`` under the class in force, tentative or not."""
        y, v, _ = state.x.tolist()
        positions: Array = y + way(v, self._acceleration(state.motion), state.cruise, times)
        return positions

    def predict_sway(self, _state: object, times: Array) -> Array:
        """Return 0 (m,): this classifier knows no sway."""
        return np.zeros(len(times))

    def estimate(self, state: RuleState) -> ConveyorEstimate:
        """Return the estimate of the conveyor now."""
        y, v, o = state.x.tolist()
        return ConveyorEstimate(
            position=y,
            speed=v,
            offset=o,
            deviation=float(np.sqrt(max(state.P[0, 0], 0.0))),
            speed_deviation=float(np.sqrt(max(state.P[1, 1], 0.0))),
            motion=state.motion,
            tentative=state.tentative is not None,
            events=state.events,
        )


def _event(motion: Motion) -> str:
    """Return the event that begins a class."""
    return "start" if motion is Motion.STARTING else "stop"
