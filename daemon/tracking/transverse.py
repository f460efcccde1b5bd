"""The object across the conveyor: x, z, orientation and swing, an error-state filter.

Law of this file: (2)-(7) with the rows of (8) for all components but y. Orientation is
multiplicative: the estimate is a rotation matrix, the filter's states are a small turn about the
axes of c, so that 23 degrees and a swing cost nothing. Swing states are kept in the rotating form
of (8): the oscillator is in A, and no phase grows with k. Its frequency is known to some share
only and is estimated beside it, folded away after each correction like the turn.
"""

import math
from collections.abc import Iterator
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
PACES = (0.9, 1.1)  # of the identified frequency, between which the estimate stays
SWING_DEVIATION = 0.008  # of a swing nobody has seen yet [rad]
REFUSALS = 4  # gated sightings in a row after which the filter widens
JUMP = 3.0  # times the gate: so far off is no wrong model, and is believed much later
DOUBTED = 2.0  # times the variance that it tells: from here on a camera is not believed in it
MEMORY = 40  # sightings over which that is found out; honest ones come to 1.2 at most
MOST_DOUBT = 25.0
JUMPED = 20  # so many in a row, half a second: by then it was somebody else's to end the motion


@frozen(slots=False, eq=False)
class TransverseState:
    """Belief across the conveyor.

    Attributes:
        x: (5 + 2 m,): x, z [m], a turn [rad] that is folded into ``rotation`` after each
            correction and then 0, and for each swing its angle and its quadrature [rad]; then for
            each swing with a ``spread`` the error of its pace, folded into ``paces`` and 0 as well.
        P: covariance.
        rotation: (3, 3) the object at rest in c.
        refused: sightings gated in a row.
        paces: each swing's frequency, as a multiple of the identified one.
        scatter: mean square by which sightings miss, as a multiple of the variance they tell.
    """

    x: Array
    P: Array
    rotation: Array
    refused: int = 0
    paces: tuple[float, ...] = ()
    scatter: float = 1.0

    @property
    def doubt(self) -> float:
        """Factor of the variance a camera tells: 1, or what it shows if that is far from it."""
        return min(self.scatter, MOST_DOUBT) if self.scatter > DOUBTED else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Transverse:
    """The filter's model."""

    fusion: FusionSettings
    swing: tuple[SwingMode, ...]

    @property
    def size(self) -> int:
        """Length of the state's x."""
        return STATIC + 2 * len(self.swing) + sum(mode.spread > 0.0 for mode in self.swing)

    def _places(self, state: TransverseState) -> Iterator[tuple[SwingMode, float, int, int]]:
        """Yield each swing with its pace, and where it and its pace are in x, -1 for none."""
        i, j = STATIC, STATIC + 2 * len(self.swing)
        for mode, pace in zip(self.swing, state.paces or (1.0,) * len(self.swing), strict=True):
            if mode.spread > 0.0:
                yield mode, pace, i, j
                j += 1
            else:
                yield mode, pace, i, -1
            i += 2

    def initial(self, sightings: list[Sighting]) -> TransverseState:
        """Return the belief from some sightings: their median, immune to outliers."""
        middle = np.median([each.position for each in sightings], axis=0)
        first = sightings[len(sightings) // 2].rotation
        turns = [rotations.log(each.rotation @ first.T) for each in sightings]
        rotation = rotations.exp(np.median(turns, axis=0)) @ first
        size = self.size
        x = np.zeros(size)
        x[X], x[Z] = middle[0], middle[2]
        variance = sightings[-1].variance
        P = np.zeros((size, size))
        P[X, X], P[Z, Z] = 0.02**2 + variance[0], 0.02**2 + variance[2]
        for i in range(3):
            P[TURN + i, TURN + i] = 0.02**2 + variance[3 + i]
        state = TransverseState(x, P, rotation, paces=(1.0,) * len(self.swing))
        for mode, _, i, j in self._places(state):
            P[i, i] = P[i + 1, i + 1] = SWING_DEVIATION**2
            if j >= 0:
                P[j, j] = mode.spread**2
        return state

    def predict(
        self, state: TransverseState, dt: float, *, seating: bool = False
    ) -> TransverseState:
        """Return (5), (6): what stands stays, what swings turns its phase.

        While the tool is seating itself on the object, the orientation may step. A filter that
        does not expect it takes the step for a swing, and a milliradian of that is a millimetre
        at the hub.
        """
        turning = self.fusion.seating if seating else self.fusion.angle
        F, Q = _model(self.fusion, self.swing, dt, turning)
        if len(F) > STATIC + 2 * len(self.swing):
            F = F.copy()
            for mode, pace, i, j in self._places(state):
                if j >= 0:
                    _turn(F, mode, pace, dt, state.x, i, j)
        P = F @ state.P @ F.T + Q
        return changed(state, x=F @ state.x, P=P)

    def _walk(self, delay: float) -> Array:
        """Return the variance (5,) that the object has walked since a sighting ``delay`` s ago."""
        late = max(delay, 0.0)
        x, turn = self.fusion.position**2 * late, self.fusion.angle**2 * late
        return np.array((x, x, turn, turn, turn))

    def rows(self, state: TransverseState, delay: float) -> Array:
        """Return the rows (5, n) of (8) for x, z and the three turns, ``delay`` s ago."""
        H = np.eye(STATIC, self.size)
        for mode, pace, i, j in self._places(state):
            c, s = _advance(mode, -delay, pace)
            (x, _, z), axis = mode.levers, TURN + mode.axis
            H[X, i], H[Z, i], H[axis, i] = x * c, z * c, c
            k = i + 1
            H[X, k], H[Z, k], H[axis, k] = x * s, z * s, s
            if j >= 0:
                angle, quadrature = state.x[i : i + 2].tolist()
                slope = -_omega(mode) * delay * (c * quadrature - s * angle)
                H[X, j], H[Z, j], H[axis, j] = x * slope, z * slope, slope
        return H

    def correct(
        self, state: TransverseState, sighting: Sighting, gate: float, *, doubted: bool = False
    ) -> tuple[TransverseState, bool]:
        """Return the belief after one sighting, and whether it was believed.

        (2)-(4) for all components at once, which for independent noise is the same as one after
        another; a sighting of which any component lies beyond the gate is refused whole. After
        some refusals in a row the filter widens instead: gates that cannot open again would lock
        a real step out for ever.

        Args:
            state: before.
            sighting: of the object.
            gate: refused beyond so many sigma.
            doubted: its variance is weighed against how far its like missed lately.
        """
        H = self.rows(state, sighting.delay)
        swing = H[TURN:STATIC, STATIC:] @ state.x[STATIC:]
        turn = rotations.log(sighting.rotation @ (rotations.exp(swing) @ state.rotation).T)
        measured = np.empty(STATIC)
        measured[:TURN] = sighting.position[_ACROSS] - H[:TURN] @ state.x
        measured[TURN:] = turn
        P, variance = state.P, sighting.variance[_SEEN] + self._walk(sighting.delay)
        if doubted:
            variance = state.doubt * variance
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
        elif doubted:
            state = _scattered(state, measured * measured - S.diagonal(), variance)
        # LAPACK itself: numpy's wrapper costs three times what these five rows do.
        _, K, failed = _solve(S, PH.T)
        if failed:
            return changed(state, refused=state.refused + 1), False
        x = state.x + measured @ K
        P = P - PH @ K
        rotation = rotations.exp(x[TURN:STATIC]) @ state.rotation
        x[TURN:STATIC] = 0.0
        paces = self._paces(state, x)
        x[STATIC + 2 * len(self.swing) :] = 0.0
        P = 0.5 * (P + P.T)
        return changed(state, x=x, P=P, rotation=rotation, refused=0, paces=paces), True

    def _paces(self, state: TransverseState, x: Array) -> tuple[float, ...]:
        """Return the paces with what a correction has found of their errors."""
        low, high = PACES
        return tuple(
            min(max(pace + float(x[j]), low), high) if j >= 0 else pace
            for _, pace, _, j in self._places(state)
        )

    def swing_angles(self, state: TransverseState, times: Array) -> Array:
        """Return the swing angles (modes, m) [rad] at ``times`` from now, (9)."""
        angles = np.empty((len(self.swing), len(times)))
        for m, (mode, pace, i, _) in enumerate(self._places(state)):
            c, s = state.x[i : i + 2].tolist()
            w = _omega(mode) * pace
            # One complex exponential is damping, cosine and sine at once.
            angles[m] = (complex(c, -s) * np.exp(complex(-mode.damping * w, w) * times)).real
        return angles

    def swing_now(self, state: TransverseState, delay: float) -> tuple[float, ...]:
        """Return the swing angles [rad] ``delay`` s ago."""
        angles = []
        for mode, pace, i, _ in self._places(state):
            c, s = state.x[i : i + 2].tolist()
            w = _omega(mode) * pace
            grown = math.exp(mode.damping * w * delay)
            angles.append(grown * (c * math.cos(w * delay) - s * math.sin(w * delay)))
        return tuple(angles)


def _scattered(state: TransverseState, beyond: Array, variance: Array) -> TransverseState:
    """Return the state with a sighting's miss in its memory.

    Args:
        state: before.
        beyond: (5,) squared misses, less what was expected of them.
        variance: (5,) with the doubt in it.
    """
    missed = state.doubt * (1.0 + float((beyond / variance).sum()) / STATIC)
    # As it begins, everything is expected of a miss: that tells nothing of the camera.
    missed = max(missed, 0.0)
    return changed(state, scatter=state.scatter + (missed - state.scatter) / MEMORY)


@lru_cache(maxsize=16)
def _model(
    fusion: FusionSettings, swing: tuple[SwingMode, ...], dt: float, turning: float
) -> tuple[Array, Array]:
    """Return A of (5) and Q: what stands stays, what swings turns its phase."""
    size = STATIC + 2 * len(swing) + sum(mode.spread > 0.0 for mode in swing)
    F = np.eye(size)
    noise = np.empty(size)
    noise[:TURN] = fusion.position**2 * dt
    noise[TURN:STATIC] = turning**2 * dt
    noise[STATIC : STATIC + 2 * len(swing)] = fusion.swing**2 * dt
    noise[STATIC + 2 * len(swing) :] = fusion.pace**2 * dt
    for m, mode in enumerate(swing):
        i = STATIC + 2 * m
        c, s = _advance(mode, dt, 1.0)
        F[i : i + 2, i : i + 2] = (c, s), (-s, c)
    Q = np.diag(noise)
    F.setflags(write=False)
    Q.setflags(write=False)
    return F, Q


def _omega(mode: SwingMode) -> float:
    """Return a swing's identified frequency [rad/s]."""
    return 2.0 * math.pi * mode.frequency_hz


def _turn(F: Array, mode: SwingMode, pace: float, dt: float, x: Array, i: int, j: int) -> None:
    """Write a swing's transition at its pace into A, and how an error of the pace enters it."""
    c, s = _advance(mode, dt, pace)
    angle, quadrature = x[i : i + 2].tolist()
    way = _omega(mode) * dt
    F[i, i], F[i, i + 1], F[i, j] = c, s, way * (c * quadrature - s * angle)
    k = i + 1
    F[k, i], F[k, k], F[k, j] = -s, c, -way * (c * angle + s * quadrature)


def _advance(mode: SwingMode, dt: float, pace: float) -> tuple[float, float]:
    """Return what angle and quadrature now add to the angle in ``dt``, backwards if negative."""
    w = _omega(mode) * pace
    decay = math.exp(-mode.damping * w * dt)
    return decay * math.cos(w * dt), decay * math.sin(w * dt)
