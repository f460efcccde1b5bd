"""The object across the conveyor: x, z, orientation and swing, an error-state filter.

Law of this file: (2)-(7) with the rows of (8) for all components but y. Orientation is
multiplicative: the estimate is a rotation matrix, the filter's states are a small turn about the
axes of c, so that 23 degrees and a swing cost nothing. Swing states are kept in the rotating form
of (8): the oscillator is in A, and no phase grows with k.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg.lapack import dposv as _solve

from linemate.daemon import rotations
from linemate.daemon.changed import changed
from linemate.daemon.horizon import Array
from linemate.daemon.tracking.observation import Sighting
from linemate.daemon.tracking.settings import FusionSettings, SwingMode
from linemate.protocol.frozen import frozen

X, Z, TURN = 0, 1, 2  # rows of x, z, and of the first of three turns
STATIC = 5  # states that do not swing
_ACROSS = np.array((0, 2))
_SEEN = np.array((0, 2, 3, 4, 5))
SWING_DEVIATION = 0.008  # of a swing nobody has seen yet [rad]
REFUSALS = 4  # gated sightings in a row after which the filter widens
JUMP = 3.0  # times the gate: so far off is no wrong model, and is believed much later
JUMPED = 20  # so many in a row, half a second: by then it was somebody else's to end the motion


@frozen(slots=False, eq=False)
class TransverseState:
    """Belief across the conveyor.

    Attributes:
        x: (5 + 2 m,): x, z [m], a turn [rad] that is folded into ``rotation`` after each
            correction and then 0, and for each swing its angle and its quadrature [rad].
        P: covariance.
        rotation: (3, 3) the object at rest in c.
        refused: sightings gated in a row.
    """

    x: Array
    P: Array
    rotation: Array
    refused: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Transverse:
    """The filter's model."""

    fusion: FusionSettings
    swing: tuple[SwingMode, ...]

    def initial(self, sightings: list[Sighting]) -> TransverseState:
        """Return the belief from some sightings: their median, immune to outliers."""
        middle = np.median([each.position for each in sightings], axis=0)
        first = sightings[len(sightings) // 2].rotation
        turns = [rotations.log(each.rotation @ first.T) for each in sightings]
        rotation = rotations.exp(np.median(turns, axis=0)) @ first
        size = STATIC + 2 * len(self.swing)
        x = np.zeros(size)
        x[X], x[Z] = middle[0], middle[2]
        variance = sightings[-1].variance
        P = np.zeros((size, size))
        P[X, X], P[Z, Z] = 0.02**2 + variance[0], 0.02**2 + variance[2]
        for i in range(3):
            P[TURN + i, TURN + i] = 0.02**2 + variance[3 + i]
        for i in range(STATIC, size):
            P[i, i] = SWING_DEVIATION**2
        return TransverseState(x, P, rotation)

    def predict(self, state: TransverseState, dt: float) -> TransverseState:
        """Return (5), (6): what stands stays, what swings turns its phase."""
        F, Q = _model(self.fusion, self.swing, dt)
        P = F @ state.P @ F.T + Q
        return TransverseState(F @ state.x, P, state.rotation, state.refused)

    def _walk(self, delay: float) -> Array:
        """Return the variance (5,) that the object has walked since a sighting ``delay`` s ago."""
        late = max(delay, 0.0)
        x, turn = self.fusion.position**2 * late, self.fusion.angle**2 * late
        return np.array((x, x, turn, turn, turn))

    def rows(self, delay: float) -> Array:
        """Return the rows (5, n) of (8) for x, z and the three turns, ``delay`` s ago."""
        H = np.eye(STATIC, STATIC + 2 * len(self.swing))
        for m, mode in enumerate(self.swing):
            i = STATIC + 2 * m
            back = _oscillation(mode, -delay)[0]
            H[X, i : i + 2] = mode.levers[0] * back
            H[Z, i : i + 2] = mode.levers[2] * back
            H[TURN + mode.axis, i : i + 2] = back
        return H

    def correct(
        self, state: TransverseState, sighting: Sighting, gate: float
    ) -> tuple[TransverseState, bool]:
        """Return the belief after one sighting, and whether it was believed.

        (2)-(4) for all components at once, which for independent noise is the same as one after
        another; a sighting of which any component lies beyond the gate is refused whole. After
        some refusals in a row the filter widens instead: gates that cannot open again would lock
        a real step out for ever.
        """
        H = self.rows(sighting.delay)
        swing = H[TURN:STATIC, STATIC:] @ state.x[STATIC:]
        turn = rotations.log(sighting.rotation @ (rotations.exp(swing) @ state.rotation).T)
        measured = np.empty(STATIC)
        measured[:TURN] = sighting.position[_ACROSS] - H[:TURN] @ state.x
        measured[TURN:] = turn
        P, variance = state.P, sighting.variance[_SEEN] + self._walk(sighting.delay)
        PH = P @ H.T
        S = H @ PH
        S.reshape(-1)[:: STATIC + 1] += variance
        beyond = float((measured * measured / S.diagonal()).max()) / (gate * gate)
        if not beyond <= 1.0:
            enough = REFUSALS if beyond <= JUMP * JUMP else JUMPED
            if state.refused + 1 < enough:
                return changed(state, refused=state.refused + 1), False
            P = P.copy()
            P.flat[: STATIC * (len(P) + 1) : len(P) + 1] += measured * measured
            PH = P @ H.T
            S = H @ PH
            S.reshape(-1)[:: STATIC + 1] += variance
        # LAPACK itself: numpy's wrapper costs three times what these five rows do.
        _, K, failed = _solve(S, PH.T)
        if failed:
            return changed(state, refused=state.refused + 1), False
        x = state.x + measured @ K
        P = P - PH @ K
        rotation = rotations.exp(x[TURN:STATIC]) @ state.rotation
        x[TURN:STATIC] = 0.0
        return TransverseState(x, 0.5 * (P + P.T), rotation), True

    def swing_angles(self, state: TransverseState, times: Array) -> Array:
        """Return the swing angles (modes, m) [rad] at ``times`` from now, (9)."""
        angles = np.empty((len(self.swing), len(times)))
        for m, mode in enumerate(self.swing):
            c, s = state.x[STATIC + 2 * m : STATIC + 2 * m + 2].tolist()
            w = 2.0 * math.pi * mode.frequency_hz
            # One complex exponential is damping, cosine and sine at once.
            angles[m] = (complex(c, -s) * np.exp(complex(-mode.damping * w, w) * times)).real
        return angles

    def swing_now(self, state: TransverseState, delay: float) -> tuple[float, ...]:
        """Return the swing angles [rad] ``delay`` s ago."""
        angles = []
        for m, mode in enumerate(self.swing):
            c, s = state.x[STATIC + 2 * m : STATIC + 2 * m + 2].tolist()
            w = 2.0 * math.pi * mode.frequency_hz
            grown = math.exp(mode.damping * w * delay)
            angles.append(grown * (c * math.cos(w * delay) - s * math.sin(w * delay)))
        return tuple(angles)


@lru_cache(maxsize=16)
def _model(fusion: FusionSettings, swing: tuple[SwingMode, ...], dt: float) -> tuple[Array, Array]:
    """Return A of (5) and Q: what stands stays, what swings turns its phase."""
    size = STATIC + 2 * len(swing)
    F = np.eye(size)
    noise = np.empty(size)
    noise[:TURN] = fusion.position**2 * dt
    noise[TURN:STATIC] = fusion.angle**2 * dt
    noise[STATIC:] = fusion.swing**2 * dt
    for m, mode in enumerate(swing):
        i = STATIC + 2 * m
        F[i : i + 2, i : i + 2] = _oscillation(mode, dt)
    Q = np.diag(noise)
    F.setflags(write=False)
    Q.setflags(write=False)
    return F, Q


def _oscillation(mode: SwingMode, dt: float) -> Array:
    """Return the transition (2, 2) of angle and quadrature over ``dt``, backwards if negative."""
    w = 2.0 * math.pi * mode.frequency_hz
    decay = math.exp(-mode.damping * w * dt)
    c, s = decay * math.cos(w * dt), decay * math.sin(w * dt)
    return np.array(((c, s), (-s, c)))
