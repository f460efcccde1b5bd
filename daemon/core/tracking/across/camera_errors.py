"""Errors of the camera in the filter across the conveyor: its stamp, and biases with the range."""

import math
from functools import cached_property, lru_cache

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.lapack import dposv as _solve
from linemate.daemon.core.tracking.across.transverse_model import CAMERA, TransverseModel
from linemate.daemon.core.tracking.across.transverse_state import TransverseState
from linemate.daemon.core.tracking.observation import PoseMeasurement

ALONG_NOISE = 0.0005  # sigma of the unit's position at an exposure [m]
ALONG_LEAK = 0.1  # share of a rejected innovation by which the unit's offset becomes less certain
ALONG_GATE = 4.0  # reject an innovation along the conveyor beyond this many sigma
SPEED_SPAN_S = 0.02  # over which the object's speed is taken [s]
NONE_ODDS = 4.0  # prior odds that an error of the camera or the conveyor's direction is not there
LASTING = 20.0  # images over which an unknown error of the camera stays the same


class CameraErrorModel(TransverseModel):
    """Model whose states for errors of the camera are corrected, weighed and taken off a pose."""

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


# A step reads an estimate up to four times, the next step once more.
@lru_cache(maxsize=4)
def _believed(model: CameraErrorModel, state: TransverseState) -> TransverseState:
    """Return the estimate with its shrinkage added, by the identity of model and estimate."""
    shrinkage = state.shrinkage
    assert shrinkage is not None  # noqa: S101 - the caller has checked
    return model.folded(state, state.x + shrinkage, state.P)
