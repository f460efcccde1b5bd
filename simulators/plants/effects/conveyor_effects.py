"""Effects of a real conveyor: shape of ramps, direction of travel, chain, stick-slip, creep.

Invariants:
    The motion stays a function of time alone, in closed form.
    Every effect is 0 by default and then absent.
    The acceleration of the drive is continuous in time only where ``ramp_s`` is not 0.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REST_SPEED = 0.2e-3
"""A coasting unit stops below this speed [m/s]: dry friction ends the exponential."""

STICKING = 0.8
"""Share of a stick-slip step's travel in which the unit stands; in the rest it catches up."""


@dataclass(frozen=True, slots=True)
class ConveyorEffects:
    """What a real conveyor does in addition to running, stopping and starting.

    Attributes:
        askew: direction of travel turned off the line, to the car and upwards [rad].
        sag: depth of the rail between two supports [m].
        sag_span: distance of the supports [m].
        ramp_s: time in which an acceleration builds up and fades: S-shaped ramps [s].
        coast_s: time constant with which the end of a stop coasts out [s].
        creep_speed: speed that is left while the conveyor is stopped [m/s].
        stick_slip: travel of the drive for one step of stick-slip at a start [m].
        stick_slip_speed: stick-slip fades until this speed of the drive [m/s].
        teeth: teeth of the chain's sprocket, 0 for a chain without polygon effect.
        pitch: pitch of the chain [m].
    """

    askew: tuple[float, float] = (0.0, 0.0)
    sag: float = 0.0
    sag_span: float = 3.0
    ramp_s: float = 0.0
    coast_s: float = 0.0
    creep_speed: float = 0.0
    stick_slip: float = 0.0
    stick_slip_speed: float = 0.010
    teeth: int = 0
    pitch: float = 0.100

    @property
    def shapes_ramps(self) -> bool:
        """Whether the ramps differ from constant accelerations between rest and speed."""
        return self.ramp_s > 0.0 or self.coast_s > 0.0 or self.creep_speed != 0.0

    @property
    def leaves_line(self) -> bool:
        """Whether the unit leaves the straight line of the nominal conveyor."""
        return self.askew != (0.0, 0.0) or self.sag != 0.0


@dataclass(frozen=True, slots=True)
class Order:
    """An order that changes the motion.

    Attributes:
        starts: it is a start, else a stop.
        onset_s: when the speed begins to change [s].
        acceleration: magnitude of the change of speed, not signed [m/s^2].
    """

    starts: bool
    onset_s: float
    acceleration: float


Segment = tuple[float, float, float, float, float]
"""Onset [s], position [m], speed [m/s], acceleration [m/s^2], coasting speed [m/s]."""


class ShapedRamps:
    """Motion of the drive: constant accelerations, an exponential end, a moving average.

    The moving average of a motion over ``ramp_s`` limits its jerk to a / ramp_s.
    """

    def __init__(
        self, nominal_speed: float, orders: Sequence[Order], effects: ConveyorEffects
    ) -> None:
        self._nominal = nominal_speed
        self._creep = effects.creep_speed
        # No segment coasts where this is 0.
        self._tau = effects.coast_s or 1.0
        self._coasts = effects.coast_s > 0.0
        self._average_s = effects.ramp_s
        self._segments: list[Segment] = [(0.0, 0.0, nominal_speed, 0.0, 0.0)]
        self.settled: list[float] = []
        self.speeds: list[float] = []
        for order in orders:
            self._append(order)
        self._table = np.array(self._segments)
        self._integrals = self._integrated()

    def motion(self, times: Array) -> tuple[Array, Array, Array]:
        """Position [m], speed [m/s] and acceleration [m/s^2] of the drive at times, (n,)."""
        if not self._average_s:
            _, position, speed, acceleration = self._plain(times)
            return position, speed, acceleration
        both = self._plain(np.concatenate((times, times - self._average_s)))
        n = len(times)
        total, position, speed = ((sum_[:n] - sum_[n:]) / self._average_s for sum_ in both[:3])
        # The average lags by half its length; the unit still passes 0 at t = 0.
        return total + 0.5 * self._nominal * self._average_s, position, speed

    def at(self, t: float) -> tuple[float, float, float]:
        """Position, speed and acceleration of the drive at one time."""
        position, speed, acceleration = self.motion(np.array([t]))
        return float(position[0]), float(speed[0]), float(acceleration[0])

    def _append(self, order: Order) -> None:
        """Append the segments of an order to those before it."""
        t, a = order.onset_s, order.acceleration
        # What was to come after this order does not come any more.
        while len(self._segments) > 1 and self._segments[-1][0] >= t:
            self._segments.pop()
        position, speed = self._state(t)
        self.speeds.append(speed)
        if order.starts:
            begin, goal, coasting = self._nominal, self._nominal, 0.0
        else:
            goal = min(self._creep, speed)
            coasting = min(a * self._tau, speed - goal) if self._coasts else 0.0
            begin = goal + coasting
        signed = a if order.starts else -a
        self._segments.append((t, position, speed, signed, 0.0))
        t += abs(begin - speed) / a
        if coasting > REST_SPEED:
            self._segments.append((t, self._state(t)[0], goal, 0.0, coasting))
            t += self._tau * math.log(coasting / REST_SPEED)
        self._segments.append((t, self._state(t)[0], goal, 0.0, 0.0))
        self.settled.append(t + self._average_s)

    def _state(self, t: float) -> tuple[float, float]:
        onset, position, speed, acceleration, coasting = self._segments[-1]
        age = t - onset
        left = math.exp(-age / self._tau)
        return (
            position + (speed + 0.5 * acceleration * age) * age + coasting * self._tau * (1 - left),
            speed + acceleration * age + coasting * left,
        )

    def _plain(self, times: Array) -> tuple[Array, Array, Array, Array]:
        """Integral of the position, position, speed, acceleration before averaging."""
        index = self._table[1:, 0].searchsorted(times, side="right")
        onset, position, speed, acceleration, coasting = self._table[index].T
        age, tau = times - onset, self._tau
        gone = np.where(coasting > 0.0, -np.expm1(-np.maximum(age, 0.0) / tau), 0.0)
        return (
            self._integrals[index]
            + (position + (speed / 2 + acceleration * age / 6) * age) * age
            + coasting * tau * (age - tau * gone),
            position + (speed + 0.5 * acceleration * age) * age + coasting * tau * gone,
            speed + acceleration * age + coasting * (1.0 - gone),
            acceleration - coasting / tau * (1.0 - gone),
        )

    def _integrated(self) -> Array:
        """Integral of the position from t = 0 to the begin of each segment."""
        self._integrals = np.zeros(len(self._segments))
        for i, segment in enumerate(self._segments[1:], start=1):
            # Just before the onset the segment before it holds.
            end = np.array([math.nextafter(segment[0], -math.inf)])
            self._integrals[i] = float(self._plain(end)[0][0])
        return self._integrals


class ChainErrors:
    """What the unit does beyond its drive: polygon effect of the chain, stick-slip at starts.

    Polygon effect: a chain on a sprocket of N teeth runs with the cosine of the sprocket's
    angle within a pitch. Stick-slip: the unit stands while the drive winds up, then catches up.
    """

    def __init__(
        self, effects: ConveyorEffects, starts: Sequence[tuple[float, float]], phase: float
    ) -> None:
        """Prepare polygon effect and stick-slip.

        Args:
            starts: onset of each start [s] and the drive's position there [m].
            phase: of the sprocket at position 0, 0..1.
        """
        self._effects = effects
        self._starts = np.array(starts, dtype=np.float64).reshape(-1, 2)
        self._phase = phase

    def deviation(
        self, times: Array, position: Array, speed: Array, acceleration: Array
    ) -> tuple[Array, Array]:
        """Return deviation from the drive [m] and its derivative [m/s], (n,) each."""
        deviation, rate = np.zeros_like(position), np.zeros_like(position)
        if self._effects.teeth:
            shift, slope = self._polygon(position)
            deviation, rate = deviation + shift, rate + slope * speed
        if self._effects.stick_slip and len(self._starts):
            shift, along, with_speed = self._stick_slip(times, position, speed)
            deviation, rate = deviation + shift, rate + along * speed + with_speed * acceleration
        return deviation, rate

    def _polygon(self, position: Array) -> tuple[Array, Array]:
        half, pitch = math.pi / self._effects.teeth, self._effects.pitch
        radius = pitch / (2.0 * math.sin(half))
        turned = (np.mod(position / pitch + self._phase, 1.0) - 0.5) * 2.0 * half
        mean = math.sin(half) / half
        return (
            radius * (np.sin(turned) - mean * turned),
            radius * (np.cos(turned) - mean) * 2.0 * half / pitch,
        )

    def _stick_slip(
        self, times: Array, position: Array, speed: Array
    ) -> tuple[Array, Array, Array]:
        """Deviation, its derivative by the travel, and by the speed of the drive."""
        step, fast = self._effects.stick_slip, self._effects.stick_slip_speed
        index = np.searchsorted(self._starts[:, 0], times, side="right") - 1
        travel = position - self._starts[np.maximum(index, 0), 1]
        active = (index >= 0) & (speed < fast) & (travel >= 0.0)
        part = np.mod(travel / step, 1.0)
        slipping = part > STICKING
        angle = math.pi * (part - STICKING) / (1.0 - STICKING)
        lag = np.where(slipping, 0.5 * STICKING * (1.0 + np.cos(angle)), part)
        slope = np.where(
            slipping, -0.5 * STICKING * math.pi / (1.0 - STICKING) * np.sin(angle), 1.0
        )
        size = np.where(active, 1.0 - speed / fast, 0.0)
        return -step * size * lag, -size * slope, np.where(active, step / fast * lag, 0.0)


def off_line(effects: ConveyorEffects, positions: Array) -> Array:
    """Return how far the unit is off the nominal line at positions, in base, (n, 3) [m]."""
    aside, upwards = effects.askew
    below = effects.sag * np.sin(math.pi * positions / effects.sag_span) ** 2
    along = math.cos(aside) * math.cos(upwards) - 1.0
    return np.column_stack((
        positions * math.sin(aside) * math.cos(upwards),
        positions * along,
        positions * math.sin(upwards) - below,
    ))  # fmt: skip
