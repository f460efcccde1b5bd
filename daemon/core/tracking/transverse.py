"""The object across the conveyor: x, z, orientation and swing, an error-state filter.

Law of this file: (2)-(7) with the rows of (8) for all components but y. Orientation is
multiplicative: the estimate is a rotation matrix, the filter's states are a small turn about the
axes of c, so that 23 degrees and a swing cost nothing. Swing states are kept in the rotating form
of (8): the oscillator is in A, and no phase grows with k. Its frequency is known to some share
only and is estimated beside it, folded away after each correction like the turn.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from scipy.linalg.lapack import dposv as _solve

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.observation import Sighting
from linemate.daemon.core.tracking.settings import FusionSettings, SwingMode

X, Z, TURN = 0, 1, 2  # rows of x, z, and of the first of three turns
STATIC = 5  # states that do not swing
_SEEN = np.array((0, 2, 3, 4, 5))
PACES = (0.9, 1.1)  # of the identified frequency, between which the estimate stays
SWING_DEVIATION = 0.008  # of a swing nobody has seen yet [rad]
REFUSALS = 4  # gated sightings in a row after which the filter widens
JUMP = 3.0  # times the gate: so far off is no wrong model, and is believed much later
DOUBTED = 2.0  # times the variance that it tells: from here on a camera is not believed in it
MEMORY = 40  # sightings over which that is found out; honest ones come to 1.2 at most
MOST_DOUBT = 25.0
JUMPED = 20  # so many in a row, half a second: by then it was somebody else's to end the motion


class TransverseState(Struct, frozen=True, eq=False):
    """Belief across the conveyor.

    Attributes:
        x: (5 + 2 m,): x, z [m], a turn [rad] that is folded into ``rotation`` after each
            correction and then 0, and for each swing its angle and its quadrature [rad]; then for
            each swing with a ``spread`` the error of its pace, folded into ``paces`` and 0 as well.
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


@dataclass(frozen=True, slots=True)
class _Swing:
    """A swing as the filter has it.

    Attributes:
        mode: as it was identified.
        i: where its angle is in x; its quadrature is next to it.
        j: where the error of its pace is in x, -1 if it has none.
    """

    mode: SwingMode
    omega: float
    i: int
    j: int

    def advance(self, dt: float, pace: float) -> tuple[float, float]:
        """Return what angle and quadrature now add to the angle in ``dt``, backwards if < 0."""
        w = self.omega * pace
        decay = math.exp(-self.mode.damping * w * dt)
        return decay * math.cos(w * dt), decay * math.sin(w * dt)


@dataclass(frozen=True, eq=False)
class Transverse:
    """The filter's model."""

    fusion: FusionSettings
    swing: tuple[SwingMode, ...]

    @property
    def size(self) -> int:
        """Length of the state's x."""
        return self._first_pace + sum(mode.spread > 0.0 for mode in self.swing)

    @cached_property
    def _first_pace(self) -> int:
        """Tell where in x the errors of the paces begin."""
        return STATIC + 2 * len(self.swing)

    @cached_property
    def _swings(self) -> tuple[_Swing, ...]:
        """Return each swing with its places in x."""
        found, j = [], self._first_pace
        for m, mode in enumerate(self.swing):
            paced = mode.spread > 0.0
            i, omega = STATIC + 2 * m, 2.0 * math.pi * mode.frequency_hz
            found.append(_Swing(mode, omega, i, j if paced else -1))
            j += paced
        return tuple(found)

    @cached_property
    def _still(self) -> Array:
        """Return the rows (5, n) of (8) of what does not swing."""
        H = np.eye(STATIC, self.size)
        H.setflags(write=False)
        return H

    @cached_property
    def _drift(self) -> Array:
        """Return how fast the variance (5,) of an object grows that nobody sees."""
        x, turn = self.fusion.position**2, self.fusion.angle**2
        return np.array((x, x, turn, turn, turn))

    def _at_paces(self, state: TransverseState) -> Iterable[tuple[_Swing, float]]:
        """Return each swing with its pace: 1 in a state that has not been told any."""
        return zip(self._swings, state.paces or (1.0,) * len(self.swing), strict=True)

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
        for swing in self._swings:
            i, j = swing.i, swing.j
            P[i, i] = P[i + 1, i + 1] = SWING_DEVIATION**2
            if j >= 0:
                P[j, j] = swing.mode.spread**2
        return TransverseState(x, P, rotation, paces=(1.0,) * len(self.swing))

    def predict(
        self, state: TransverseState, dt: float, *, seating: bool = False
    ) -> TransverseState:
        """Return (5), (6): what stands stays, what swings turns its phase.

        While the tool is seating itself on the object, the orientation may step. A filter that
        does not expect it takes the step for a swing, and a milliradian of that is a millimetre
        at the hub.
        """
        F, Q = self._model(dt, seating)
        F = self._paced(F, state, dt)
        P = F.dot(state.P).dot(F.T)
        P += Q
        return replace(state, x=F.dot(state.x), P=P)

    def _paced(self, F: Array, state: TransverseState, dt: float) -> Array:
        """Return A with each swing at its pace, and with how an error of the pace enters it."""
        if len(F) == self._first_pace:
            return F
        F, values = F.copy(), state.x.tolist()
        for swing, pace in self._at_paces(state):
            i, k, j = swing.i, swing.i + 1, swing.j
            if j >= 0:
                c, s = swing.advance(dt, pace)
                angle, quadrature, way = values[i], values[k], swing.omega * dt
                F[i, i], F[i, k], F[i, j] = c, s, way * (c * quadrature - s * angle)
                F[k, i], F[k, k], F[k, j] = -s, c, -way * (c * angle + s * quadrature)
        return F

    @lru_cache(maxsize=16)  # noqa: B019 - a few small models, and no more of them
    def _model(self, dt: float, seating: bool) -> tuple[Array, Array]:
        """Return A of (5) at the identified frequencies, and Q."""
        turning = self.fusion.seating if seating else self.fusion.angle
        F = np.eye(self.size)
        noise = np.empty(self.size)
        noise[:TURN] = self.fusion.position**2 * dt
        noise[TURN:STATIC] = turning**2 * dt
        noise[STATIC : self._first_pace] = self.fusion.swing**2 * dt
        noise[self._first_pace :] = self.fusion.pace**2 * dt
        for swing in self._swings:
            i = swing.i
            c, s = swing.advance(dt, 1.0)
            F[i : i + 2, i : i + 2] = (c, s), (-s, c)
        Q = np.diag(noise)
        F.setflags(write=False)
        Q.setflags(write=False)
        return F, Q

    def widened(self, state: TransverseState, deviation: float) -> TransverseState:
        """Return the belief with a place that is known less well by ``deviation`` [m]."""
        P = state.P.copy()
        P[X, X] += deviation**2
        P[Z, Z] += deviation**2
        return replace(state, P=P)

    def rows(self, state: TransverseState, delay: float) -> Array:
        """Return the rows (5, n) of (8) for x, z and the three turns, ``delay`` s ago."""
        H, values = self._still.copy(), state.x.tolist()
        for swing, pace in self._at_paces(state):
            i, k, j = swing.i, swing.i + 1, swing.j
            c, s = swing.advance(-delay, pace)
            (x, _, z), axis = swing.mode.levers, TURN + swing.mode.axis
            H[X, i], H[Z, i], H[axis, i] = x * c, z * c, c
            H[X, k], H[Z, k], H[axis, k] = x * s, z * s, s
            if j >= 0:
                slope = -swing.omega * delay * (c * values[k] - s * values[i])
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
            gate: refused beyond so many sigma.
            doubted: its variance is weighed against how far its like missed lately.
        """
        H = self.rows(state, sighting.delay)
        measured = _missed(state, sighting, H)
        P, variance = state.P, sighting.variance[_SEEN] + self._walk(sighting.delay)
        doubt = state.doubt if doubted else 1.0
        if doubt != 1.0:
            variance = doubt * variance
        PH = P.dot(H.T)
        S = H.dot(PH)
        S.reshape(-1)[:: STATIC + 1] += variance
        squared = measured * measured
        ratios = squared / S.diagonal()
        # By argmax, for which a NaN is the largest as well: half of what max takes.
        beyond = float(ratios[ratios.argmax()]) / (gate * gate)
        scatter = state.scatter
        if not beyond <= 1.0:
            enough = REFUSALS if beyond <= JUMP * JUMP else JUMPED
            if state.refused + 1 < enough:
                return replace(state, refused=state.refused + 1), False
            P = P.copy()
            P.flat[: STATIC * (len(P) + 1) : len(P) + 1] += squared
            PH = P.dot(H.T)
            S = H.dot(PH)
            S.reshape(-1)[:: STATIC + 1] += variance
        elif doubted:
            scatter = _scattered(scatter, doubt, squared - S.diagonal(), variance)
        # LAPACK itself: numpy's wrapper costs three times what these five rows do.
        _, K, failed = _solve(S, PH.T)
        if failed:
            return replace(state, refused=state.refused + 1, scatter=scatter), False
        x = state.x + measured.dot(K)
        P = P - PH.dot(K)
        P = 0.5 * (P + P.T.copy())  # two that lie alike are added sooner
        rotation = rotations.exp(x[TURN:STATIC]).dot(state.rotation)
        paces = self._corrected(state, x)
        x[TURN:STATIC] = 0.0
        x[self._first_pace :] = 0.0
        state = replace(state, x=x, P=P, rotation=rotation, refused=0, paces=paces, scatter=scatter)
        return state, True

    def _walk(self, delay: float) -> Array:
        """Return the variance (5,) that the object has walked since a sighting ``delay`` s ago."""
        return max(delay, 0.0) * self._drift

    def _corrected(self, state: TransverseState, x: Array) -> tuple[float, ...]:
        """Return the paces with what a correction has found of their errors."""
        low, high = PACES
        return tuple(
            [
                min(max(pace + float(x[swing.j]), low), high) if swing.j >= 0 else pace
                for swing, pace in self._at_paces(state)
            ]
        )

    def swing_angles(self, state: TransverseState, times: Array) -> Array:
        """Return the swing angles (modes, m) [rad] at ``times`` from now, (9)."""
        angles, values = np.empty((len(self.swing), len(times))), state.x.tolist()
        for m, (swing, pace) in enumerate(self._at_paces(state)):
            w = swing.omega * pace
            # One complex exponential is damping, cosine and sine at once.
            turning = np.exp(complex(-swing.mode.damping * w, w) * times)
            angles[m] = (complex(values[swing.i], -values[swing.i + 1]) * turning).real
        return angles

    def swing_now(self, state: TransverseState, delay: float) -> tuple[float, ...]:
        """Return the swing angles [rad] ``delay`` s ago."""
        angles, values = [], state.x.tolist()
        for swing, pace in self._at_paces(state):
            c, s = values[swing.i], values[swing.i + 1]
            w = swing.omega * pace
            grown = math.exp(swing.mode.damping * w * delay)
            angles.append(grown * (c * math.cos(w * delay) - s * math.sin(w * delay)))
        return tuple(angles)


def _missed(state: TransverseState, sighting: Sighting, H: Array) -> Array:
    """Return by how much (5,) a sighting misses what the rows ``H`` of it expect."""
    swing = H[TURN:STATIC, STATIC:].dot(state.x[STATIC:])
    expected = rotations.exp(swing).dot(state.rotation)
    turn = rotations.log(sighting.rotation.dot(expected.T))
    x, z = H[:TURN].dot(state.x).tolist()
    seen_x, _, seen_z = sighting.position.tolist()
    return np.array((seen_x - x, seen_z - z, *turn.tolist()))


def _scattered(scatter: float, doubt: float, beyond: Array, variance: Array) -> float:
    """Return the memory of how sightings scatter, with one more in it.

    Args:
        doubt: in which the sighting was held.
        beyond: (5,) squared misses, less what was expected of them.
        variance: (5,) with the doubt in it.
    """
    missed = doubt * (1.0 + float(sum((beyond / variance).tolist())) / STATIC)
    # As it begins, everything is expected of a miss: that tells nothing of the camera.
    return scatter + (max(missed, 0.0) - scatter) / MEMORY
