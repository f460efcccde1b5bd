"""Filter of the object across the conveyor: x, z, orientation and swing, (2)-(7).

An error-state filter with the rows of (8) for all components but y. Orientation is multiplicative:
the estimate is a rotation matrix, and the filter's states are a small rotation about the axes of c.
A conveyor that is askew moves the object in x and z as well: by two slopes times its way along y.
A body that pitches as it sways along the conveyor lifts its object by a ratio of that way, in x.
Swing states are in the rotating form of (8): the oscillator is in A, and no phase grows with k. The
frequency of a swing is estimated with it.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array, KeptValues, exponential
from linemate.daemon.core.lapack import dposv as _solve
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.settings import CameraNoise, FusionSettings, SwingMode

X, Z, TURN = 0, 1, 2  # rows of x, z, and of the first of three rotations
STATIC = 5  # states without the swings
_MEASURED = np.array((0, 2, 3, 4, 5))  # components of a pose without y
FREQUENCY_FACTORS = (0.9, 1.1)  # range of the estimated frequency over the identified one
SWING_DEVIATION = 0.008  # initial sigma of a swing [rad]
CAMERA = 5  # states of the camera's errors: stamp, three biases, offset along the conveyor
LASTING_NOISE = 6  # states of its correlated noise: along its axes, and three rotations
STAMP_WALK = 0.05  # random walk of the stamp's error, as a share of its sigma [1/sqrt(s)]
BIAS_WALK = 0.02  # of a bias, likewise
RATIO_DEVIATION = 0.4  # initial sigma of an object's way in x for each metre of sway
RATIO_WALK = 0.05  # random walk of that ratio [1/sqrt(s)]
RATIO_NOISE = 0.0005  # of a felt x next to it: what else bends the mount lasts 1 s [m sqrt(s)]
FASTEST_SWAY = 0.15  # a quicker way of a sway is another estimate of it [m/s]
SWAY_S = 1.5  # time constant of its mean: what sags or drifts is no sway [s]
ALONG_DEVIATION = 0.1  # initial sigma of the object's offset from the conveyor unit [m]
ALONG_WALK = 0.0002  # random walk of that offset [m/sqrt(s)]
ALONG_NOISE = 0.0005  # sigma of the unit's position at an exposure [m]
ALONG_LEAK = 0.1  # share of a rejected innovation by which that offset becomes less certain
ALONG_GATE = 4.0  # reject an innovation along the conveyor beyond this many sigma
LARGEST_LATE = 0.005  # way of the conveyor that its filter may take back in a step [m]
SPEED_SPAN_S = 0.02  # over which the object's speed is taken [s]
NONE_ODDS = 4.0  # prior odds that an error of the camera or the conveyor's direction is not there
LASTING = 20.0  # images over which an unknown error of the camera stays the same
MOST_REJECTED = 4  # measurements rejected in a row, after which the filter widens
JUMP = 3.0  # times the gate: beyond it the model is not the cause, and more rejections are needed
MOST_JUMPS = 20  # jumps rejected in a row (half a second), after which the filter widens
LEAST_INFLATION = 2.0  # NIS from which the variance of a camera is inflated
LARGEST_INFLATION = 25.0  # of a camera's variance
MEMORY = 40  # measurements over which the NIS is averaged; a correct camera reaches 1.2


class BodySway(Struct, frozen=True):
    """Sway of the object along the conveyor, in contact.

    Attributes:
        at: where the object is against the conveyor unit [m]; None out of contact.
        off: the same from its slow mean [m].
        way: of that in the last step [m].
    """

    at: float | None = None
    off: float = 0.0
    way: float = 0.0

    def moved(self, at: float, dt: float) -> "BodySway":
        """Return the sway one step later."""
        way = 0.0 if self.at is None else at - self.at
        way = way if abs(way) < FASTEST_SWAY * dt else 0.0
        off = (self.off + way) * (1.0 - dt / SWAY_S)
        return BodySway(at, off, off - self.off)


NO_SWAY = BodySway()


class TransverseState(Struct, frozen=True, eq=False):
    """Estimate across the conveyor.

    Attributes:
        x: (8 + 2 m + p + g,): x, z [m], a small rotation [rad]; for each swing its angle and
            quadrature [rad]; the slopes of x and z for each metre of the conveyor's way; the ratio
            of x for each metre of sway along it; for each swing with a ``spread`` the error of its
            frequency as a share; for each with a ``gain`` that gain. Rotation and frequency errors
            are folded into the fields below after each correction, then 0.
        rotation: (3, 3) the object at rest in c.
        rejected: measurements rejected in a row.
        frequency_factors: each swing's frequency over the identified one.
        nis: average normalised innovation squared of the camera's poses.
        speed: of the conveyor in the last step [m/s].
        unit: position of the conveyor unit in the last step [m], None before.
        swaying: speed of the object against the conveyor in the last step [m/s].
        felt: slow mean of felt poses off x [m]; None before the first one.
        shrinkage: (n,) what ``believed`` adds to x: it takes back errors that may not be there.
        errors: (4, 4) covariance of the camera's errors with that shrinkage.
    """

    x: Array
    P: Array
    rotation: Array
    rejected: int = 0
    frequency_factors: tuple[float, ...] = ()
    nis: float = 1.0
    speed: float = 0.0
    unit: float | None = None
    swaying: float = 0.0
    felt: float | None = None
    shrinkage: Array | None = None
    errors: Array | None = None

    @property
    def inflation(self) -> float:
        """Factor of a camera's stated variance: 1 while its NIS is plausible."""
        return min(self.nis, LARGEST_INFLATION) if self.nis > LEAST_INFLATION else 1.0


@dataclass(frozen=True, slots=True)
class _Swing:
    """A swing in the filter.

    Attributes:
        i: where its angle is in x; its quadrature is next to it.
        j: where the error of its factor is in x, -1 if it has none.
        g: where its gain is in x, -1 if it has none.
    """

    mode: SwingMode
    omega: float
    i: int
    j: int
    g: int

    def advance(self, dt: float, factor: float) -> tuple[float, float]:
        """Return the factors of angle and quadrature now in the angle after ``dt`` s."""
        w = self.omega * factor
        decay = math.exp(-self.mode.damping * w * dt)
        return decay * math.cos(w * dt), decay * math.sin(w * dt)


@dataclass(frozen=True, eq=False)
class Transverse:
    """The filter's model."""

    fusion: FusionSettings
    swing: tuple[SwingMode, ...]
    camera: CameraNoise | None = None

    @cached_property
    def size(self) -> int:
        """Length of the state's x."""
        return self._first_gain + sum(mode.gain > 0.0 for mode in self.swing)

    @cached_property
    def _slope(self) -> int:
        """Index of the slope of x; that of z is next to it."""
        return STATIC + 2 * len(self.swing)

    @cached_property
    def _first_factor(self) -> int:
        """Index of the first frequency error in x."""
        return self._lasting + (LASTING_NOISE if self._has_lasting else 0)

    @cached_property
    def _lasting(self) -> int:
        """Index of the camera's correlated noise, in its sigma."""
        return self._camera + (CAMERA if self.camera is not None else 0)

    @cached_property
    def _has_lasting(self) -> bool:
        """Whether the camera's noise is correlated from image to image."""
        return self.camera is not None and self.camera.lasting > 0.0

    @cached_property
    def _first_gain(self) -> int:
        """Index of the first gain in x."""
        return self._first_factor + sum(mode.spread > 0.0 for mode in self.swing)

    @cached_property
    def _ratio(self) -> int:
        """Index of the ratio of x to a sway along the conveyor."""
        return self._slope + 2

    @cached_property
    def _camera(self) -> int:
        """Index of the stamp's error; behind it three biases and the offset along the conveyor."""
        return self._ratio + 1

    @cached_property
    def _swings(self) -> tuple[_Swing, ...]:
        """Each swing with its indices in x."""
        swings, j, g = [], self._first_factor, self._first_gain
        for m, mode in enumerate(self.swing):
            has_factor, has_gain = mode.spread > 0.0, mode.gain > 0.0
            i, omega = STATIC + 2 * m, 2.0 * math.pi * mode.frequency_hz
            swings.append(_Swing(mode, omega, i, j if has_factor else -1, g if has_gain else -1))
            j, g = j + has_factor, g + has_gain
        return tuple(swings)

    @cached_property
    def _still(self) -> Array:
        """Rows (5, n) of (8) without the swings."""
        H = np.eye(STATIC, self.size)
        H.setflags(write=False)
        return H

    @cached_property
    def _drift(self) -> Array:
        """Growth of the variance (5,) of the static states, per second."""
        x, turn = self.fusion.position**2, self.fusion.angle**2
        return np.array((x, x, turn, turn, turn))

    @cached_property
    def _ones(self) -> tuple[float, ...]:
        """Frequency factors by default."""
        return (1.0,) * len(self.swing)

    def _with_factors(self, state: TransverseState) -> Iterable[tuple[_Swing, float]]:
        """Return each swing with its frequency factor, 1 by default."""
        return zip(self._swings, state.frequency_factors or self._ones, strict=True)

    def initial(self, measurements: list[PoseMeasurement]) -> TransverseState:
        """Return the estimate from some measurements: their median, robust to outliers."""
        middle = _median([each.position for each in measurements])
        first = measurements[len(measurements) // 2].rotation
        turns = [rotations.log(each.rotation @ first.T) for each in measurements]
        rotation = rotations.exp(_median(turns)) @ first
        size = self.size
        x = np.zeros(size)
        x[X], x[Z] = middle[0], middle[2]
        variance = measurements[-1].variance
        P = np.zeros((size, size))
        P[X, X], P[Z, Z] = 0.02**2 + variance[0], 0.02**2 + variance[2]
        for i in range(3):
            P[TURN + i, TURN + i] = 0.02**2 + variance[3 + i]
        for swing in self._swings:
            i, j = swing.i, swing.j
            P[i, i] = P[i + 1, i + 1] = (SWING_DEVIATION / swing.mode.lever) ** 2
            if j >= 0:
                P[j, j] = swing.mode.spread**2
            if swing.g >= 0:
                x[swing.g], P[swing.g, swing.g] = swing.mode.gain, swing.mode.gain_deviation**2
        k = self._slope
        P[k, k] = P[k + 1, k + 1] = self.fusion.askew**2
        P[k + 2, k + 2] = RATIO_DEVIATION**2
        if self.camera is not None:
            k = self._camera
            P[k, k] = self.camera.stamp_offset**2
            P[k + 1, k + 1] = P[k + 2, k + 2] = P[k + 3, k + 3] = self.camera.bias**2
            P[k + 4, k + 4] = ALONG_DEVIATION**2
        if self._has_lasting:
            np.fill_diagonal(P[self._lasting : self._first_factor, self._lasting :], 1.0)
        return TransverseState(x, P, rotation, frequency_factors=(1.0,) * len(self.swing))

    def slopes(self, state: TransverseState) -> tuple[float, float]:
        """Return the way of the object in x and z for each metre of the conveyor's way."""
        k = self._slope
        x, z = state.x[k : k + 2].tolist()
        return x, z

    def ratio(self, state: TransverseState) -> float:
        """Return the way of the object in x for each metre of its sway along the conveyor."""
        return float(state.x[self._ratio])

    def predict(
        self,
        state: TransverseState,
        dt: float,
        *,
        seating: bool = False,
        speed: float = 0.0,
        unit: float | None = None,
        swayed: float = 0.0,
    ) -> TransverseState:
        """Return (5), (6).

        While the tool seats on the object, the orientation may step: its process noise is larger.
        Without that the step is estimated as a swing, 1 mm at the hub for each milliradian.

        Args:
            speed: of the conveyor since the last step [m/s].
            unit: position of the conveyor unit at its begin [m], None if it is not known.
            swayed: way of the object's sway along the conveyor in the last step [m].
        """
        F, Q = self._matrices(dt, seating)
        F = self._set_frequencies(F, state, dt)
        F[X, self._slope] = F[Z, self._slope + 1] = speed * dt
        F[X, self._ratio] = swayed
        late = _late_way(state, dt, unit)
        for swing, factor in self._with_factors(state):
            # A speed of 0 is one that is not known yet, or was not: no stop or start is in it.
            if swing.g >= 0 and state.speed:
                # A change of speed within a step is a blow: it moves the quadrature by the speed
                # that it leaves over the frequency. One that only becomes known is in the prior.
                left = (speed - state.speed) / (swing.mode.lever * swing.omega * factor)
                blow = np.array((late / swing.mode.lever, left))
                both = slice(swing.i, swing.i + 2)
                F[both, swing.g] = -F[both, both].dot(blow)
        P = F.dot(state.P).dot(F.T)
        P += Q
        shrinkage = None if state.shrinkage is None else F.dot(state.shrinkage)
        return replace(
            state,
            x=F.dot(state.x),
            P=P,
            speed=speed,
            unit=unit,
            swaying=swayed / dt,
            shrinkage=shrinkage,
        )

    def _set_frequencies(self, F: Array, state: TransverseState, dt: float) -> Array:
        """Return a copy of A with each swing at its frequency, linearised in that one's error."""
        F, values = F.copy(), state.x.tolist()
        for swing, factor in self._with_factors(state):
            i, k, j = swing.i, swing.i + 1, swing.j
            if j >= 0:
                c, s = swing.advance(dt, factor)
                angle, quadrature, way = values[i], values[k], swing.omega * dt
                F[i, i], F[i, k], F[i, j] = c, s, way * (c * quadrature - s * angle)
                F[k, i], F[k, k], F[k, j] = -s, c, -way * (c * angle + s * quadrature)
        return F

    @cached_property
    def _compiled(self) -> dict[tuple[float, bool], tuple[Array, Array]]:
        """Matrices by cycle time and seating; a cell has one cycle time."""
        return {}

    def _matrices(self, dt: float, seating: bool) -> tuple[Array, Array]:
        """Return A of (5) at the identified frequencies, and Q."""
        compiled = self._compiled.get((dt, seating))
        if compiled is None:
            # Settings as a key of a common cache would be hashed in each step.
            compiled = self._compiled[dt, seating] = self._make_matrices(dt, seating)
        return compiled

    def _make_matrices(self, dt: float, seating: bool) -> tuple[Array, Array]:
        turning = self.fusion.seating if seating else self.fusion.angle
        F = np.eye(self.size)
        noise = np.empty(self.size)
        noise[:TURN] = self.fusion.position**2 * dt
        noise[TURN:STATIC] = turning**2 * dt
        noise[STATIC : self._slope] = self.fusion.swing**2 * dt
        noise[self._slope : self._ratio] = self.fusion.askew_walk**2 * dt
        noise[self._ratio] = RATIO_WALK**2 * dt
        if self.camera is not None:
            k = self._camera
            noise[k] = (STAMP_WALK * self.camera.stamp_offset) ** 2 * dt
            noise[k + 1 : k + 4] = (BIAS_WALK * self.camera.bias) ** 2 * dt
            noise[k + 4] = ALONG_WALK**2 * dt
        if self.camera is not None and self._has_lasting:
            # Gauss-Markov: its variance stays 1.
            kept, both = (
                math.exp(-dt / self.camera.lasting_s),
                slice(self._lasting, self._first_factor),
            )
            noise[both] = 1.0 - kept**2
            F[both, both] *= kept
        noise[self._first_factor : self._first_gain] = self.fusion.pace**2 * dt
        noise[self._first_gain :] = 0.0
        for swing in self._swings:
            i = swing.i
            c, s = swing.advance(dt, 1.0)
            F[i : i + 2, i : i + 2] = (c, s), (-s, c)
            noise[i : i + 2] /= swing.mode.lever**2
        Q = np.diag(noise)
        F.setflags(write=False)
        Q.setflags(write=False)
        return F, Q

    def widened(self, state: TransverseState, deviation: float) -> TransverseState:
        """Return the estimate with ``deviation`` [m] added to its position's standard deviation."""
        P = state.P.copy()
        P[X, X] += deviation**2
        P[Z, Z] += deviation**2
        return replace(state, P=P)

    def unsure_across(self, state: TransverseState, deviation: float) -> TransverseState:
        """Return the estimate with ``deviation`` [m] added to that of x, and not of its depth."""
        P = state.P.copy()
        P[X, X] += deviation**2
        return replace(state, P=P)

    def pushed(self, state: TransverseState) -> TransverseState:
        """Return the estimate of an object that was pushed: how its carrier sways is not known."""
        P = state.P.copy()
        for swing in self._swings:
            if swing.g >= 0:
                both = (swing.i, swing.i + 1)
                P[both, both] += (SWING_DEVIATION / swing.mode.lever) ** 2
        return replace(state, P=P)

    def observation_rows(self, state: TransverseState, delay: float) -> Array:
        """Return the rows (5, n) of (8) for x, z and the three turns, ``delay`` s ago."""
        H, values = self._still.copy(), state.x.tolist()
        for swing, factor in self._with_factors(state):
            i, k, j = swing.i, swing.i + 1, swing.j
            c, s = swing.advance(-delay, factor)
            (x, _, z), axis = swing.mode.levers, TURN + swing.mode.axis
            H[X, i], H[Z, i], H[axis, i] = x * c, z * c, c
            H[X, k], H[Z, k], H[axis, k] = x * s, z * s, s
            if j >= 0:
                slope = -swing.omega * delay * (c * values[k] - s * values[i])
                H[X, j], H[Z, j], H[axis, j] = x * slope, z * slope, slope
        # The speed now is good enough: at 10 mrad a stop in the delay is 5 um of error.
        H[X, self._slope] = H[Z, self._slope + 1] = -delay * state.speed
        H[X, self._ratio] = -delay * state.swaying
        return H

    def correct(
        self,
        state: TransverseState,
        measured: PoseMeasurement,
        gate: float,
        *,
        is_camera: bool = False,
    ) -> tuple[TransverseState, bool]:
        """Return the estimate after one measured pose, and whether it was accepted.

        (2)-(4) for all components at once, which for independent noise equals one after another. A
        pose with a component beyond the gate is rejected. After some rejections in a row the filter
        widens instead: else it would reject a real step of the object for ever.

        Args:
            gate: reject beyond this many sigma.
            is_camera: inflate its variance by the NIS of earlier poses.
        """
        H = self.observation_rows(state, measured.delay)
        sensitivity = self.sensitivity(state, measured)
        if sensitivity is not None:
            H[:, self._camera : self._camera + CAMERA - 1] = sensitivity[_MEASURED]
        if self._has_lasting and measured.lasting is not None:
            k = self._lasting
            places, turned = measured.lasting
            H[:TURN, k : k + 3] = places[::2]
            for i in range(3):
                H[TURN + i, k + 3 + i] = turned
        innovation = _innovation(state, measured, H)
        P, variance = state.P, measured.variance[_MEASURED] + self._walk(measured.delay)
        inflation = state.inflation if is_camera else 1.0
        if inflation != 1.0:
            variance = inflation * variance
        PH = P.dot(H.T)
        S = H.dot(PH)
        S.reshape(-1)[:: STATIC + 1] += variance
        squared = innovation * innovation
        ratios = squared / S.diagonal()
        # argmax takes a NaN for the largest, and costs half of max.
        beyond = float(ratios[ratios.argmax()]) / (gate * gate)
        nis = state.nis
        if not beyond <= 1.0:
            # The gate widens with the time since the last accepted pose: a jump stays one.
            is_jump = beyond > JUMP * JUMP or state.rejected >= MOST_REJECTED
            enough = MOST_JUMPS if is_jump else MOST_REJECTED
            if state.rejected + 1 < enough:
                return replace(state, rejected=state.rejected + 1), False
            P = P.copy()
            P.flat[: STATIC * (len(P) + 1) : len(P) + 1] += squared
            PH = P.dot(H.T)
            S = H.dot(PH)
            S.reshape(-1)[:: STATIC + 1] += variance
        elif is_camera:
            nis = _average_nis(nis, inflation, squared - S.diagonal(), variance)
        # LAPACK directly: numpy's wrapper costs three times as much for five rows.
        _, K, failed = _solve(S, PH.T)
        if failed:
            return replace(state, rejected=state.rejected + 1, nis=nis), False
        x = state.x + innovation.dot(K)
        P = P - PH.dot(K)
        P = 0.5 * (P + P.T.copy())  # the copy has the same order in memory: a faster sum
        shrinkage = (
            None if state.shrinkage is None else state.shrinkage - H.dot(state.shrinkage).dot(K)
        )
        folded = self.folded(state, x, P)
        return replace(folded, rejected=0, nis=nis, shrinkage=shrinkage), True

    def correct_ratio(
        self, state: TransverseState, measured: PoseMeasurement, dt: float
    ) -> TransverseState:
        """Return the estimate whose ratio alone follows a felt pose.

        A target that follows a deflection drives a body. One that follows the sway does not.

        Args:
            dt: since the last felt pose [s].
        """
        k, P = self._ratio, state.P
        h = self.observation_rows(state, measured.delay)[X]
        # What x, and all the rest, would be with another ratio.
        way = P[k] / P[k, k]
        seen = float(h.dot(P[k]))
        S = float(h.dot(P).dot(h)) + RATIO_NOISE**2 / dt
        K = seen / S * way
        off = float(measured.position[0]) - float(h.dot(state.x))
        mean = off if state.felt is None else state.felt + dt / SWAY_S * (off - state.felt)
        # A part that sags, or is not where it was seen, is off in a quiet contact too.
        x = state.x + (off - mean) * K
        before = state.shrinkage
        shrinkage = None if before is None else before - float(h.dot(before)) * K
        later = self.folded(state, x, P - seen * K[:, None] * way)
        return replace(later, shrinkage=shrinkage, felt=mean)

    @cached_property
    def _errors(self) -> tuple[tuple[slice, float], ...]:
        """Errors that may not be there: where they are in x, and the prior variance of each."""
        k, c = self._slope, self._camera
        errors = [(slice(k, k + 2), self.fusion.askew**2)]
        if self.camera is not None:
            errors.append((slice(c, c + 1), self.camera.stamp_offset**2))
            errors.append((slice(c + 1, c + 4), self.camera.bias**2))
        return tuple([each for each in errors if each[1] > 0.0])

    def doubted(self, state: TransverseState) -> TransverseState:
        """Return the estimate with the errors weighed against none.

        Most cells have no such error, and a state for it costs accuracy. The evidence for none is
        the ratio of the posterior to the prior density at 0 (Savage and Dickey). The weighted mean
        of the estimates with and without is what ``believed`` returns.
        """
        x, P = state.x.copy(), state.P
        for where, prior in self._errors:
            error, rows = x[where], P[where]
            # One factorisation for the gain's rows and for the error.
            sides = np.concatenate((rows, error[:, None]), axis=1)
            factor, solved, failed = _solve(rows[:, where], sides)
            if failed:
                continue
            gain = solved[:, :-1]
            shift, sigma = error.dot(gain), math.sqrt(prior)
            shares = math.prod([share / sigma for share in factor.diagonal().tolist()])
            nothing = -0.5 * float(shift[where].dot(solved[:, -1]))
            odds = NONE_ODDS * math.exp(max(nothing, -50.0)) / shares
            none = odds / (1.0 + odds)
            x -= none * shift
            # One product for both terms: the gain's rows, and what the shift adds to the spread.
            left = np.concatenate((rows, shift[None])).T
            P = P - left.dot(np.concatenate((none * gain, (none * (none - 1.0) * shift)[None])))
        c = slice(self._camera, self._camera + CAMERA - 1)
        return replace(state, shrinkage=x - state.x, errors=P[c, c])

    def believed(self, state: TransverseState) -> TransverseState:
        """Return the estimate for readers: errors count as far as they are likely."""
        return state if state.shrinkage is None else _believed(self, state)

    def sensitivity(self, state: TransverseState, measured: PoseMeasurement) -> Array | None:
        """Return the change (6, 4) of a measured pose for the camera's errors, None without any.

        A stamp that is late shows the object where the arm has moved it since: by the arm's motion
        relative to the object.
        """
        if self.camera is None or measured.sensitivity is None:
            return None
        moved = measured.sensitivity.copy()
        later = self.swing_now(state, measured.delay - 0.5 * SPEED_SPAN_S)
        earlier = self.swing_now(state, measured.delay + 0.5 * SPEED_SPAN_S)
        column, (x, z) = moved[:, 0].tolist(), self.slopes(state)
        column[0] -= x * state.speed
        column[1] -= state.speed
        column[2] -= z * state.speed
        for mode, now, before in zip(self.swing, later, earlier, strict=True):
            rate = (now - before) / SPEED_SPAN_S
            lever_x, lever_y, lever_z = mode.levers
            column[0] -= lever_x * rate
            column[1] -= lever_y * rate
            column[2] -= lever_z * rate
            column[3 + mode.axis] -= rate
        moved[:, 0] = column
        return moved

    def correct_along(
        self, state: TransverseState, measured: PoseMeasurement, unit: float
    ) -> TransverseState:
        """Return the estimate after the pose's component along the conveyor.

        The object is at a constant offset from the conveyor unit: what changes as the arm moves is
        an error of the camera. An outlier is left out.

        Args:
            unit: position of the conveyor at the exposure, by the distance sensor [m].
        """
        sensitivity = self.sensitivity(state, measured)
        if sensitivity is None:
            return state
        k, h = self._camera, np.zeros(self.size)
        h[k : k + CAMERA - 1], h[k + CAMERA - 1] = sensitivity[1], 1.0
        if self._has_lasting and measured.lasting is not None:
            h[self._lasting : self._lasting + 3] = measured.lasting[0][1]
        value = float(measured.position[1]) - unit
        angles = self.swing_now(state, measured.delay)
        for mode, angle in zip(self.swing, angles, strict=True):
            value -= mode.levers[1] * angle
        Ph = state.P.dot(h)
        S = float(h.dot(Ph)) + state.inflation * float(measured.variance[1]) + ALONG_NOISE**2
        innovation = value - float(h.dot(state.x))
        if not innovation * innovation <= ALONG_GATE * ALONG_GATE * S:
            # The object may have moved on the unit: its offset counts less from now on.
            P = state.P.copy()
            P[k + CAMERA - 1, k + CAMERA - 1] += (ALONG_LEAK * innovation) ** 2
            return replace(state, P=P)
        K = Ph / S
        return self.folded(state, state.x + K * innovation, state.P - K[:, None] * Ph)

    def without_errors(self, state: TransverseState, measured: PoseMeasurement) -> PoseMeasurement:
        """Return a measured pose without the camera's estimated errors, its variance with theirs.

        What is not known of them is the same in every image: it counts as often as images are
        averaged.
        """
        sensitivity = self.sensitivity(state, measured)
        if sensitivity is None:
            return measured
        k = slice(self._camera, self._camera + CAMERA - 1)
        error = sensitivity.dot(self.believed(state).x[k])
        P = state.P[k, k] if state.errors is None else state.errors
        spread = np.add.reduce(sensitivity.dot(P) * sensitivity, axis=1)
        return PoseMeasurement(
            measured.position - error[:3],
            rotations.exp(-error[3:]).dot(measured.rotation),
            measured.delay,
            measured.variance + LASTING * spread,
            measured.sensitivity,
            measured.lasting,
        )

    def _walk(self, delay: float) -> Array:
        """Return the variance (5,) of the object's walk since a measurement ``delay`` s ago."""
        return max(delay, 0.0) * self._drift

    def folded(self, state: TransverseState, x: Array, P: Array) -> TransverseState:
        """Return the estimate with a corrected x (n,), its rotation and frequencies folded in."""
        low, high = FREQUENCY_FACTORS
        values = x.tolist()
        factors = tuple(
            [
                min(max(factor + values[swing.j], low), high) if swing.j >= 0 else factor
                for swing, factor in self._with_factors(state)
            ]
        )
        rotation = rotations.exp(x[TURN:STATIC]).dot(state.rotation)
        x[TURN:STATIC] = 0.0
        x[self._first_factor : self._first_gain] = 0.0
        return replace(state, x=x, P=P, rotation=rotation, frequency_factors=factors)

    def swing_angles(self, state: TransverseState, times: Array) -> Array:
        """Return the swing angles (modes, m) [rad] at ``times`` from now, (9)."""
        angles, values = np.empty((len(self.swing), len(times))), state.x.tolist()
        for m, (swing, factor) in enumerate(self._with_factors(state)):
            w = swing.omega * factor
            turning = self._turning[m](complex(-swing.mode.damping * w, w), times)
            angles[m] = (complex(values[swing.i], -values[swing.i + 1]) * turning).real
        return angles

    @cached_property
    def _turning(self) -> tuple[KeptValues[complex], ...]:
        """Damping, cosine and sine of each swing over the horizon, by its pole."""
        return tuple([KeptValues(exponential) for _ in self.swing])

    @cached_property
    def _lag(self) -> tuple[KeptValues[float], ...]:
        """Share of a steady acceleration's way by which each swing is left behind."""
        return tuple([KeptValues(_left_behind) for _ in self.swing])

    @cached_property
    def is_driven(self) -> bool:
        """Whether stops and starts excite a swing."""
        return any(mode.gain > 0.0 for mode in self.swing)

    def driven_angles(self, state: TransverseState, times: Array, added: Array) -> Array:
        """Return what a change of speed that is predicted adds to the angles (modes, m) [rad].

        A body that is left behind by a steady acceleration moves by g a (1 - cos wt) / w^2.

        Args:
            times: (m,) from now [s].
            added: (m,) way that the change adds to that of the conveyor's steady motion [m].
        """
        angles = np.zeros((len(self.swing), len(times)))
        for m, (swing, factor) in enumerate(self._with_factors(state)):
            if swing.g >= 0:
                share = self._lag[m](swing.omega * factor, times)
                angles[m] = -float(state.x[swing.g]) / swing.mode.lever * share * added
        return angles

    def swing_now(self, state: TransverseState, delay: float) -> tuple[float, ...]:
        """Return the swing angles [rad] ``delay`` s ago."""
        angles, values = [], state.x.tolist()
        for swing, factor in self._with_factors(state):
            c, s = values[swing.i], values[swing.i + 1]
            w = swing.omega * factor
            phase = w * delay
            grown = math.exp(swing.mode.damping * w * delay)
            angles.append(grown * (c * math.cos(phase) - s * math.sin(phase)))
        return tuple(angles)


def _left_behind(omega: float, times: Array) -> Array:
    """Return 2 (1 - cos wt) / (wt)^2 (m,)."""
    return np.asarray(np.sinc(omega / (2.0 * math.pi) * times) ** 2)


def _median(rows: Sequence[Array]) -> Array:
    """Return the median of each column; numpy's own imports 20 ms of modules when first called."""
    ordered = np.sort(rows, axis=0)
    upper = len(rows) // 2
    middle: Array = ordered[upper]
    return middle if len(rows) % 2 else (ordered[upper - 1] + middle) / 2.0


def _late_way(state: TransverseState, dt: float, unit: float | None) -> float:
    """Return the way [m] that the conveyor has made beyond that of its speed.

    A stop is known late: until then the conveyor has lost way, and the body on it has not.
    """
    if unit is None or state.unit is None:
        return 0.0
    late = unit - state.unit - state.speed * dt
    # The sensor has jumped, not the conveyor.
    return late if abs(late) < LARGEST_LATE else 0.0


# A step reads an estimate up to four times, the next step once more.
@lru_cache(maxsize=4)
def _believed(model: Transverse, state: TransverseState) -> TransverseState:
    """Return the estimate with its shrinkage added, by the identity of model and estimate."""
    shrinkage = state.shrinkage
    assert shrinkage is not None  # noqa: S101 - the caller has checked
    return model.folded(state, state.x + shrinkage, state.P)


def _innovation(state: TransverseState, measured: PoseMeasurement, H: Array) -> Array:
    """Return the innovation (5,) of a measured pose with the rows ``H``."""
    swing = H[TURN:STATIC, STATIC:].dot(state.x[STATIC:])
    expected = rotations.exp(swing).dot(state.rotation)
    turn = rotations.log(measured.rotation.dot(expected.T))
    x, z = H[:TURN].dot(state.x).tolist()
    seen_x, _, seen_z = measured.position.tolist()
    return np.array((seen_x - x, seen_z - z, *turn.tolist()))


def _average_nis(nis: float, inflation: float, beyond: Array, variance: Array) -> float:
    """Return the average NIS with one more pose.

    Args:
        inflation: of the pose's variance.
        beyond: (5,) squared innovations minus their expected variance.
        variance: (5,) of the pose, inflated.
    """
    missed = inflation * (1.0 + float(sum((beyond / variance).tolist())) / STATIC)
    # At first the expected variance is that of the estimate: no information on the camera.
    return nis + (max(missed, 0.0) - nis) / MEMORY
