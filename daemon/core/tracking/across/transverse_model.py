"""Model of the filter across the conveyor: layout of its state, A, Q and the rows of (8).

Orientation is multiplicative: the estimate is a rotation matrix, and the filter's states are a
small rotation about the axes of c.
A conveyor that is askew moves the object in x and z as well: by two slopes times its way along y.
A body that pitches as it sways along the conveyor lifts its object by a ratio of that way, in x.
Swing states are in the rotating form of (8): the oscillator is in A, and no phase grows with k. The
frequency of a swing is estimated with it.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array, KeptValues, exponential
from linemate.daemon.core.tracking.across.transverse_state import (
    STATIC,
    TURN,
    TransverseState,
    X,
    Z,
)
from linemate.daemon.core.tracking.settings import CameraNoise, FusionSettings, SwingMode

FREQUENCY_FACTORS = (0.9, 1.1)  # range of the estimated frequency over the identified one
CAMERA = 5  # states of the camera's errors: stamp, three biases, offset along the conveyor
LASTING_NOISE = 6  # states of its correlated noise: along its axes, and three rotations
STAMP_WALK = 0.05  # random walk of the stamp's error, as a share of its sigma [1/sqrt(s)]
BIAS_WALK = 0.02  # of a bias, likewise
RATIO_WALK = 0.05  # random walk of the way in x for each metre of sway [1/sqrt(s)]
ALONG_WALK = 0.0002  # random walk of the object's offset from the unit [m/sqrt(s)]


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
class TransverseModel:
    """Model of x, z, orientation and swing, with the camera's errors as states."""

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
    def _ratio(self) -> int:
        """Index of the ratio of x to a sway along the conveyor."""
        return self._slope + 2

    @cached_property
    def _camera(self) -> int:
        """Index of the stamp's error; behind it three biases and the offset along the conveyor."""
        return self._ratio + 1

    @cached_property
    def _lasting(self) -> int:
        """Index of the camera's correlated noise, in its sigma."""
        return self._camera + (CAMERA if self.camera is not None else 0)

    @cached_property
    def _has_lasting(self) -> bool:
        """Whether the camera's noise is correlated from image to image."""
        return self.camera is not None and self.camera.lasting > 0.0

    @cached_property
    def _first_factor(self) -> int:
        """Index of the first frequency error in x."""
        return self._lasting + (LASTING_NOISE if self._has_lasting else 0)

    @cached_property
    def _first_gain(self) -> int:
        """Index of the first gain in x."""
        return self._first_factor + sum(mode.spread > 0.0 for mode in self.swing)

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

    def slopes(self, state: TransverseState) -> tuple[float, float]:
        """Return the way of the object in x and z for each metre of the conveyor's way."""
        k = self._slope
        x, z = state.x[k : k + 2].tolist()
        return x, z

    def ratio(self, state: TransverseState) -> float:
        """Return the way of the object in x for each metre of its sway along the conveyor."""
        return float(state.x[self._ratio])

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


def _left_behind(omega: float, times: Array) -> Array:
    """Return 2 (1 - cos wt) / (wt)^2 (m,)."""
    return np.asarray(np.sinc(omega / (2.0 * math.pi) * times) ** 2)
