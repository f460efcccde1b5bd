"""Identify the body's fore-aft sway: frequency, gain, amplitude and phase.

The body hangs from the conveyor and sways along the line, by itself and because the conveyor
accelerates. Camera and force-torque sensor see the body, the distance sensor sees the conveyor:

    s'' + 2 zeta w s' + w^2 s = -g a(t)

Here s is the sway [m], a the acceleration by the class in force and by the ripple, and g the gain,
about 1 for a pendulum. With the pole p = -zeta w + i w and Z = s - i s'/w this is one complex
number:

    Z(t + dt) = e^(p dt) Z(t) + g a B(dt),    B(t) = (i / w) (e^(p t) - 1) / p.

The frequency is not known. So a grid of frequencies is held, and for each a linear regression of
what the body does against the conveyor: an offset, a drift, the forced response, and a free sway.
The evidence of each frequency is its marginal likelihood. Old readings are forgotten. In contact
the tool's force drives the body, so its free sway is a random walk there.
"""

import math
from functools import lru_cache

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers.unit_estimate import UnitEstimate, first_estimate
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import SwaySettings

ComplexArray = NDArray[np.complex128]

FARTHEST = 0.05  # of the body from where it was first seen [m]
TERMS = 5  # offset [m], drift [m/s], gain, and the two parts of a free sway [m]
GAIN = 2
OFFSET_DEVIATION, DRIFT_DEVIATION, FREE_DEVIATION = 0.005, 0.003, 0.002
# Prior gain of a sway that is not identified. The conveyor accelerates the whole body, so the gains
# of all its modes are 1 together, at each point; one mode that is seen has most of that. With a
# deviation of 0.5 the gain took up what is an error of the frequency.
CARRIED_GAIN, GAIN_DEVIATION = 1.0, 0.2
TOUCHED_DEVIATION = 0.5  # of it in contact: the tool excites the body too, and changes its modes
READING_S = 0.02  # least time between two readings that are used [s]
EVALUATION_S = 0.15  # between two evaluations of the grid [s]
FLOOR = 0.00015  # of a reading's sigma: what a unit moves that its class does not [m]
SWITCHED = 0.003  # one sigma of what two sensors of the body differ by [m]
DRIVEN_OMEGA = 2.0 * math.pi * 1.2  # frequency that ``SwaySettings.driven`` is meant for [rad/s]
PUSHES_S = 3.0  # time constant of the pushes that are remembered [s]
SINGLE, REPEATED = 0.5, 2.0  # pushes that one push leaves after 2 s, and that make a sway
FIRST_S = 1.0  # of readings before the first evaluation [s]
MOST_REJECTED = 8  # readings in a row that the unit alone rejects, after which it is wrong


class SwayFit(Struct, frozen=True, eq=False):
    """Likeliest sway.

    Attributes:
        score: log odds of a sway against none.
        omega: frequency of this sway [rad/s].
        spread: one sigma of the frequency, as a share.
        values: s and s'/w now, the gain, and the body's offset without the sway (4,) [m].
        covariance: of these at that frequency (4, 4).
        slope: change of these with the frequency, for a share of it (4,).
    """

    score: float
    omega: float
    spread: float
    values: Array
    covariance: Array
    slope: Array

    @property
    def amplitude(self) -> float:
        """The amplitude now [m]."""
        return math.hypot(float(self.values[0]), float(self.values[1]))


class SwayBank(Struct, frozen=True, eq=False):
    """Regressions over the grid of m frequencies.

    Attributes:
        forced: (m,) Z for gain 1.
        free: (m,) e^(i w t) of a free sway.
        information: (m, 5, 5) of the regression.
        weighted: (m, 5) its right side.
        still: (1, 2, 3) information of offset and drift without a sway, and the right side.
        lost: (2, m + 1) what was forgotten of the explained energy, and of the log determinant;
            last that without a sway.
        energy: weighted sum of squares.
        count: number of readings that it remembers.
        unit: of the conveyor as the distance sensor alone sees it.
        rejected: readings in a row that the unit alone rejected.
        base: the first reading of the body against the unit [m]; None before.
        source: of the last reading of the body.
        pushes: number of pushes that it remembers.
        since_reading, since_evaluation, age: time since then, and since the bank began [s].
    """

    forced: ComplexArray
    free: ComplexArray
    information: Array
    weighted: Array
    still: Array
    lost: Array
    energy: float = 0.0
    count: float = 0.0
    unit: UnitEstimate | None = None
    base: float | None = None
    source: Source | None = None
    pushes: float = 0.0
    since_reading: float = 0.0
    since_evaluation: float = 0.0
    age: float = 0.0
    rejected: int = 0


class Grid(Struct, frozen=True, eq=False):
    """Frequencies of the grid (m,) [rad/s], and their poles [1/s]."""

    omegas: Array
    poles: ComplexArray


@lru_cache(maxsize=8)
def grid(settings: SwaySettings) -> Grid:
    """Return the grid of some settings: evenly spaced logarithms, an identified frequency on it."""
    low, high = settings.range_hz
    count = 1 + math.ceil(math.log(high / low) / settings.step)
    omegas = 2.0 * math.pi * np.geomspace(low, high, count)
    if settings.frequency_hz:
        # Half a step off it, its phase is wrong by 1 rad after 3 s: another one seems likelier.
        known = 2.0 * math.pi * settings.frequency_hz
        omegas *= known / omegas[int(np.abs(np.log(omegas / known)).argmin())]
    poles = np.asarray(omegas * complex(-settings.damping, 1.0), dtype=np.complex128)
    return Grid(omegas, poles)


def response(
    omega: Array | float, pole: ComplexArray | complex, times: Array | float
) -> ComplexArray:
    """Return B at some times: Z after an acceleration of 1 that began so long ago."""
    return np.asarray(1j / omega * np.expm1(np.multiply(pole, times)) / pole, dtype=np.complex128)


def response_at(omega: float, pole: complex, time: float) -> complex:
    """Return B at one time, as ``response`` bit for bit, in half of its time."""
    decay, turn = pole.real * time, pole.imag * time
    half = math.sin(0.5 * turn)
    real = math.expm1(decay) * math.cos(turn) - 2.0 * half * half
    forced = 1j / omega * complex(real, math.exp(decay) * math.sin(turn))
    x, y, p, q = forced.real, forced.imag, pole.real, pole.imag
    if abs(p) >= abs(q):  # numpy's order of a complex division
        ratio = q / p
        scale = 1.0 / (p + q * ratio)
        return complex((x + y * ratio) * scale, (y - x * ratio) * scale)
    ratio = p / q
    scale = 1.0 / (q + p * ratio)
    return complex((x * ratio + y) * scale, (y * ratio - x) * scale)


def empty(settings: SwaySettings) -> SwayBank:
    """Return the bank before the first reading."""
    count = len(grid(settings).omegas)
    # Frequencies are next to each other in memory: loops over them are longer than over terms.
    return SwayBank(
        forced=np.zeros(count, dtype=complex),
        free=np.ones(count, dtype=complex),
        information=np.zeros((count, TERMS, TERMS), order="F"),
        weighted=np.zeros((count, TERMS), order="F"),
        still=np.zeros((1, GAIN, GAIN + 1)),
        lost=np.zeros((2, count + 1)),
    )


@lru_cache(maxsize=8)
def _steps(settings: SwaySettings, dt: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return what a step does to a forced and to a free sway, and B of it."""
    frequencies = grid(settings)
    turn = np.exp(frequencies.poles * dt)
    free = np.exp(1j * frequencies.omegas * dt)
    return turn, free, response(frequencies.omegas, frequencies.poles, dt)


def predict(
    settings: SwaySettings,
    bank: SwayBank,
    dt: float,
    acceleration: float,
    *,
    stands: bool,
    ripple: float = 0.0,
) -> SwayBank:
    """Return the bank one step later.

    Args:
        acceleration: of the conveyor by the class in force [m/s^2].
        ripple: what its ripple adds [m/s^2].
    """
    turn, free, forced = _steps(settings, dt)
    now = bank.forced * turn
    if acceleration or ripple:
        now += (acceleration + ripple) * forced
    return SwayBank(
        forced=now,
        free=bank.free * free,
        information=bank.information,
        weighted=bank.weighted,
        still=bank.still,
        lost=bank.lost,
        energy=bank.energy,
        count=bank.count,
        unit=None if bank.unit is None else bank.unit.moved(dt, acceleration, stands=stands),
        base=bank.base,
        source=bank.source,
        pushes=bank.pushes * math.exp(-dt / PUSHES_S) if bank.pushes else 0.0,
        since_reading=bank.since_reading + dt,
        since_evaluation=bank.since_evaluation + dt,
        age=bank.age + dt,
        rejected=bank.rejected,
    )


def change_class(settings: SwaySettings, bank: SwayBank, change: float, age: float) -> SwayBank:
    """Return the bank with an acceleration [m/s^2] that turns out to act for ``age`` s already."""
    frequencies = grid(settings)
    late = change * response(frequencies.omegas, frequencies.poles, age)
    unit = bank.unit
    if unit is not None:
        # The estimate has followed a part of the way already.
        unit = unit.changed(0.25 * change * age * age, 0.75 * change * age)
    return replace(bank, forced=bank.forced + late, unit=unit)


def read_unit(
    bank: SwayBank, measurement: PositionMeasurement, speed: float, *, is_accepted: bool = True
) -> SwayBank:
    """Return the bank after one reading of the distance sensor.

    Args:
        speed: of the conveyor [m/s], where it is not estimated yet.
        is_accepted: the filter takes the reading: the sensor is right.
    """
    unit = bank.unit
    if unit is None:
        unit = first_estimate(measurement, speed)
    value = measurement.value + unit.speed * measurement.delay
    later = unit.read(value, measurement.variance, measurement.gate)
    rejected = 0 if later is not unit else bank.rejected + is_accepted
    return replace(bank, unit=later, rejected=rejected)


def with_unit_found(
    settings: SwaySettings, bank: SwayBank, measurement: PositionMeasurement, speed: float
) -> SwayBank:
    """Return the bank begun again where its unit has rejected reading after reading.

    What the body did against a unit that was lost is wrong. A sway that was taken over then moved
    the object by 0.2 m.
    """
    if bank.rejected < MOST_REJECTED:
        return bank
    return replace(empty(settings), unit=first_estimate(measurement, speed), pushes=bank.pushes)


def read(
    settings: SwaySettings,
    bank: SwayBank,
    measurement: PositionMeasurement,
    acceleration: float,
    class_age: float,
) -> SwayBank:
    """Return the bank after one reading of the body.

    Args:
        acceleration: of the class in force [m/s^2], since ``class_age`` s.
    """
    unit = bank.unit
    if unit is None or bank.since_reading < READING_S:
        return bank
    delay, acted = measurement.delay, min(measurement.delay, class_age)
    seen = measurement.value - unit.past(delay, acceleration, acted)
    if bank.base is None:
        bank = replace(bank, base=seen, source=measurement.source)
    seen -= bank.base or 0.0
    if not abs(seen) < FARTHEST:
        return bank
    if measurement.source is not bank.source:
        bank = replace(_with_new_offset(bank), source=measurement.source)
    if measurement.source is Source.TACTILE:
        bank = _driven(settings, bank)
    row = _row(settings, bank, delay, acceleration, acted)
    kept, aged = math.exp(-bank.since_reading / settings.memory), bank.since_reading
    information, weighted = kept * bank.information, kept * bank.weighted
    information[:, 1] -= aged * information[:, 0]
    information[:, :, 1] -= aged * information[:, :, 0]
    weighted[:, 1] -= aged * weighted[:, 0]
    still = kept * bank.still
    still[:, 1] -= aged * still[:, 0]
    still[:, :, 1] -= aged * still[:, :, 0]
    weight = 1.0 / (measurement.variance + unit.variance + FLOOR**2)
    information += (weight * row)[:, :, None] * row[:, None]
    weighted += (weight * seen) * row
    known = np.array((1.0, -delay))
    still += (weight * known)[:, None] * np.array((1.0, -delay, seen))
    return replace(
        bank,
        information=information,
        weighted=weighted,
        still=still,
        lost=kept * bank.lost,
        energy=kept * bank.energy + weight * seen * seen,
        count=kept * bank.count + 1.0,
        since_reading=0.0,
    )


def _row(
    settings: SwaySettings, bank: SwayBank, delay: float, acceleration: float, acted: float
) -> Array:
    """Return the terms (m, 5) of the regression as they were ``delay`` s ago."""
    frequencies = grid(settings)
    forced = bank.forced
    if acceleration and acted > 0.0:
        forced = forced - acceleration * response(frequencies.omegas, frequencies.poles, acted)
    free = bank.free * np.exp((-1j * delay) * frequencies.omegas)
    row = np.empty_like(bank.weighted)
    row[:, 0], row[:, 1] = 1.0, -delay
    row[:, GAIN] = (np.exp(-delay * frequencies.poles) * forced).real
    row[:, 3], row[:, 4] = free.real, free.imag
    return row


def _with_new_offset(bank: SwayBank) -> SwayBank:
    """Return the bank for another sensor of the body: its offset is a little different."""
    way = np.zeros_like(bank.weighted)
    way[:, 0] = 1.0
    information, weighted, lost = _forgotten(bank.information, bank.weighted, way, SWITCHED**2)
    still, right, of_still = _forgotten(
        bank.still[:, :, :GAIN], bank.still[:, :, GAIN], way[:1, :GAIN], SWITCHED**2
    )
    return replace(
        bank,
        information=information,
        weighted=weighted,
        still=np.concatenate((still, right[:, :, None]), axis=2),
        lost=bank.lost + np.concatenate((lost, of_still), axis=1),
    )


def _driven(settings: SwaySettings, bank: SwayBank) -> SwayBank:
    """Return the bank whose free sway the tool's force has driven since the last reading."""
    # A force sets the body in motion by as much at each frequency: s'/w is less at a high one.
    walk = settings.driven * DRIVEN_OMEGA / grid(settings).omegas
    variance = walk**2 * bank.since_reading
    way = np.zeros_like(bank.weighted)
    way[:, 3], way[:, 4] = -bank.free.imag, bank.free.real
    information, weighted, lost = _forgotten(bank.information, bank.weighted, way, variance)
    total = bank.lost.copy()
    total[:, :-1] += lost
    return replace(bank, information=information, weighted=weighted, lost=total)


def _forgotten(
    information: Array, weighted: Array, way: Array, variance: Array | float
) -> tuple[Array, Array, Array]:
    """Return information and right side after a step of the terms, and what they lose (2, m).

    Args:
        way: (m, n) of the terms for a step of 1.
        variance: of the step, (m,) or of all.
    """
    cross = np.einsum("ijk,ik->ij", information, way)
    power = (cross * way).sum(axis=1)
    gain = variance / (1.0 + variance * power)
    along = (weighted * way).sum(axis=1)
    lost = np.stack((gain * along * along, np.log1p(variance * power)))
    left = information - (gain[:, None] * cross)[:, :, None] * cross[:, None]
    return left, weighted - (gain * along)[:, None] * cross, lost


def count_push(bank: SwayBank) -> SwayBank:
    """Return the bank with one push more."""
    return replace(bank, pushes=bank.pushes + 1.0)


def is_pushed(bank: SwayBank) -> bool:
    """Return whether the body moves by a push: pushes that repeat are a sway."""
    return SINGLE < bank.pushes < REPEATED


def gain_deviation(bank: SwayBank) -> float:
    """Return one sigma of a gain that is not identified, before any reading."""
    return TOUCHED_DEVIATION if bank.source is Source.TACTILE else GAIN_DEVIATION


def is_due(bank: SwayBank) -> bool:
    """Return whether the grid is to be evaluated."""
    return bank.since_evaluation >= EVALUATION_S and bank.age > FIRST_S


def evaluate(
    settings: SwaySettings, bank: SwayBank, near: float = 0.0, better: float = -math.inf
) -> tuple[SwayBank, SwayFit | None]:
    """Return the bank and the likeliest sway, None if it is not certain or not another one.

    Args:
        near: frequency of the sway that is known [rad/s], 0 for none.
        better: log odds by which another frequency must be likelier than that one.
    """
    frequencies = grid(settings)
    prior, mean = _prior(settings, gain_deviation(bank))
    A, weighted = bank.information + np.diag(prior), bank.weighted + prior * mean
    still = bank.still[:, :, :GAIN] + np.diag(prior[:GAIN])
    explained, logs = _eliminated(A, weighted) + bank.lost[:, :-1]
    of_still, logs_of_still = _eliminated(still, bank.still[:, :, GAIN])[:, 0] + bank.lost[:, -1]
    constant = float(np.log(prior[GAIN:]).sum() - prior[GAIN:].dot(mean[GAIN:] ** 2))
    scores = 0.5 * (explained - of_still - logs + logs_of_still + constant)
    best = int(scores.argmax())
    left = (bank.energy - float(explained[best])) / max(bank.count, 1.0)
    left = max(left, 1.0)
    scores = scores / left + _likeliness(settings)
    best, bank = int(scores.argmax()), replace(bank, since_evaluation=0.0)
    if not float(scores[best]) > settings.found:
        return bank, None
    if near:
        at = int(np.abs(np.log(frequencies.omegas / near)).argmin())
        if float(scores[best]) < float(scores[at]) + better:
            return bank, None
    return bank, _fit(bank, frequencies, A, weighted, scores, best, left)


def _eliminated(A: Array, weighted: Array) -> Array:
    """Return the energy that regressions explain, and their log determinants, (2, m).

    Gauss' elimination of all regressions at once: LAPACK is called once for each of them.
    """
    count, terms = weighted.shape
    rows = np.concatenate((A, weighted[:, :, None]), axis=2)
    shares, pivots = np.empty((terms, count)), np.empty((terms, count))
    for k in range(terms):
        pivot = pivots[k] = rows[:, k, k]
        shares[k] = rows[:, k, terms] ** 2 / pivot
        share = rows[:, k + 1 :, k] / pivot[:, None]
        rows[:, k + 1 :, k + 1 :] -= share[:, :, None] * rows[:, k, None, k + 1 :]
    return np.stack((shares.sum(axis=0), np.log(pivots).sum(axis=0)))


@lru_cache(maxsize=8)
def _prior(settings: SwaySettings, deviation: float) -> tuple[Array, Array]:
    """Return the information (5,) of the prior, and its mean (5,).

    Args:
        deviation: of a gain that is not identified.
    """
    gain = settings.gain_deviation if settings.frequency_hz else deviation
    deviations = (OFFSET_DEVIATION, DRIFT_DEVIATION, gain, FREE_DEVIATION, FREE_DEVIATION)
    mean = np.zeros(TERMS)
    mean[GAIN] = settings.gain if settings.frequency_hz else CARRIED_GAIN
    return np.array(deviations) ** -2.0, mean


@lru_cache(maxsize=8)
def _likeliness(settings: SwaySettings) -> Array:
    """Return the log probability of each frequency (m,) before any reading."""
    logs = np.log(grid(settings).omegas)
    if not settings.frequency_hz:
        return np.full(len(logs), -math.log(len(logs)))
    off = logs - math.log(2.0 * math.pi * settings.frequency_hz)
    shares = np.exp(-0.5 * (off / math.hypot(settings.spread, settings.step)) ** 2)
    likeliness: Array = np.log(0.99 * shares / shares.sum() + 0.01 / len(logs))
    return likeliness


def _fit(
    bank: SwayBank, frequencies: Grid, A: Array, weighted: Array, scores: Array, i: int, left: float
) -> SwayFit:
    """Return the sway at one frequency of the grid, interpolated in frequency.

    Args:
        left: variance of what the regression leaves, as a factor of the readings' own.
    """
    logs = np.log(frequencies.omegas)
    log_omega, spread = interpolated(logs, scores, i)
    near = (max(i - 1, 0), i, min(i + 1, len(logs) - 1))
    inverse = np.linalg.inv(A[near[0] : near[2] + 1])
    below, here, above = (
        _to_values(bank, k).dot(inverse[k - near[0]]).dot(weighted[k]) for k in near
    )
    slope = (above - below) / (logs[near[2]] - logs[near[0]])
    to_values = _to_values(bank, i)
    covariance = left * inverse[i - near[0]]
    return SwayFit(
        score=float(scores[i]),
        omega=math.exp(log_omega),
        spread=spread,
        values=here + (log_omega - logs[i]) * slope,
        covariance=to_values.dot(covariance).dot(to_values.T),
        slope=slope,
    )


def _to_values(bank: SwayBank, i: int) -> Array:
    """Return what the terms of the regression make of s, s'/w, gain and offset (4, 5)."""
    forced, free = complex(bank.forced[i]), complex(bank.free[i])
    return np.array(
        (
            (0.0, 0.0, forced.real, free.real, free.imag),
            (0.0, 0.0, -forced.imag, -free.imag, free.real),
            (0.0, 0.0, 1.0, 0.0, 0.0),
            (1.0, 0.0, 0.0, 0.0, 0.0),
        )
    )


def interpolated(logs: Array, scores: Array, i: int) -> tuple[float, float]:
    """Return the log frequency at the peak next to point i, and its deviation."""
    step = float(logs[1] - logs[0])
    if not 0 < i < len(logs) - 1:
        return float(logs[i]), step
    low, mid, high = scores[i - 1 : i + 2].tolist()
    curvature = 2.0 * mid - low - high
    if curvature <= 0.0:
        return float(logs[i]), step
    shift = min(max(0.5 * (high - low) / curvature, -0.5), 0.5)
    return float(logs[i]) + shift * step, min(2.0 / math.sqrt(curvature), 1.0) * step
