"""Filter of the object across the conveyor: x, z, orientation and swing, (2)-(7).

An error-state filter with the rows of (8) for all components but y.
"""

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.lapack import dposv as _solve
from linemate.daemon.core.tracking.across.body_sway import SWAY_S
from linemate.daemon.core.tracking.across.camera_errors import CameraErrorModel
from linemate.daemon.core.tracking.across.transverse_model import CAMERA
from linemate.daemon.core.tracking.across.transverse_state import (
    STATIC,
    TURN,
    TransverseState,
    X,
    Z,
)
from linemate.daemon.core.tracking.observation import PoseMeasurement

_MEASURED = np.array((0, 2, 3, 4, 5))  # components of a pose without y
SWING_DEVIATION = 0.008  # initial sigma of a swing [rad]
RATIO_DEVIATION = 0.4  # initial sigma of an object's way in x for each metre of sway
RATIO_NOISE = 0.0005  # of a felt x next to it: what else bends the mount lasts 1 s [m sqrt(s)]
ALONG_DEVIATION = 0.1  # initial sigma of the object's offset from the conveyor unit [m]
LARGEST_LATE = 0.005  # way of the conveyor that its filter may take back in a step [m]
MOST_REJECTED = 4  # measurements rejected in a row, after which the filter widens
JUMP = 3.0  # times the gate: beyond it the model is not the cause, and more rejections are needed
MOST_JUMPS = 20  # jumps rejected in a row (half a second), after which the filter widens
MEMORY = 40  # measurements over which the NIS is averaged; a correct camera reaches 1.2


class Transverse(CameraErrorModel):
    """The filter: its start, prediction and corrections."""

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
