"""Change of class that the distance sensor alone shows, while the object in contact gives way.

The tool holds such an object, and both swing on the mount. Camera and force-torque sensor then see
the swing, and the bank takes the change of class for it. The distance sensor sees the conveyor: a
start of 13 mm/s^2 is certain after 0.5 s. Each onset of a grid is fitted to its last readings,
with and without the change. The estimate is the mean over onsets and accelerations: the sensor is
too coarse to show whether a change is faster or began earlier.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import onset_bank
from linemate.daemon.core.tracking.classifiers.distance.distance_check import (
    LEAST_READINGS,
    LEVEL_DEVIATION,
)
from linemate.daemon.core.tracking.classifiers.onset_bank import (
    COUNTED_S,
    AmplitudePrior,
    OnsetBank,
)

ONSETS = np.geomspace(0.06, 0.84, 24)  # time since the change began [s]
LEAST_BEFORE_S = 0.12  # of readings before the onset, which show the motion without the change [s]
MOST_ONSETS = math.log((ONSETS[-1] - ONSETS[0]) / COUNTED_S) + 1.0  # log of their number, and more
MOVED_DEVIATION = 0.01  # one sigma of the speed of a change that began before [m/s]
ACCELERATION_SHARE = 1.0  # one sigma of its acceleration, as a share of the nominal one
LARGEST_RESIDUAL = 1.6  # rms residual of all readings and of those since the onset, in sigmas


class DistanceChange(Struct, frozen=True, eq=False):
    """A change of class, fitted to readings of the distance sensor.

    Attributes:
        odds: log odds of the change against none.
        onset: time since it began [s].
        values: reading now [m], speed now [m/s], added acceleration [m/s^2], and what the change
            adds to other states.
        covariance: of the values, onset and acceleration unknown.
    """

    odds: float
    onset: float
    values: Array
    covariance: Array


def find(
    readings: Array,
    change: float,
    speed: float,
    speed_deviation: float,
    deviation: float,
    priors: Sequence[AmplitudePrior],
    least_odds: float,
    others: OnsetBank | None = None,
) -> DistanceChange | None:
    """Return the change; None if there is none so likely that fits the readings.

    A step or a frozen value is no change: its residual is too large.

    Args:
        readings: (2, m), ages [s] and positions [m], newest last.
        change: nominal acceleration that the change adds [m/s^2].
        speed: steady one before the change [m/s].
        speed_deviation: one sigma of it [m/s].
        deviation: one sigma of a reading [m].
        priors: of the share of ``change``, with their odds.
        least_odds: log odds from which it counts.
        others: errors that the change has made of other states, by its age.
    """
    ages, values = readings
    if len(ages) < LEAST_READINGS:
        return None
    onsets = ONSETS[ages[0] - LEAST_BEFORE_S >= ONSETS]
    if len(onsets) < 2:
        return None
    fit = _fit(ages, values - values[-1] + speed * ages, onsets, change, speed_deviation, deviation)
    # No prior makes a change likelier than the best acceleration does.
    A, B = fit.bank.A, fit.bank.B
    if float((B * B - 2.0 * (least_odds - MOST_ONSETS) * A).max()) < 0.0:
        return None
    results = [onset_bank.posterior(fit.bank, each) for each in priors]
    odds = float(np.logaddexp.reduce([each.odds for each in results]))
    if odds <= least_odds:
        return None
    weights = np.concatenate([each.weights * math.exp(each.odds - odds) for each in results])
    shares = np.concatenate([each.amplitudes for each in results])
    best = int(weights.argmax())
    if not _explains(fit, ages, best % len(onsets), float(shares[best]), deviation):
        return None
    # What a share of 1 makes of the values, the steady motion fitted.
    reading = 0.5 * change * onsets * onsets - fit.absorbed[:, 0]
    rows = [reading, change * onsets - fit.absorbed[:, 1], np.full(len(onsets), change)]
    if others is not None and len(others):
        rows += [-np.interp(onsets, others.age, error) for error in others.error]
    unit = np.tile(np.array(rows), len(results))
    each = unit * shares
    each[0] += float(values[-1]) + fit.steady[0]
    each[1] += speed + fit.steady[1]
    mean = each @ weights
    off = each - mean[:, None]
    variances = np.concatenate([1.0 / (A + 1.0 / r.variance) for r in results]) * weights
    covariance = (weights * off) @ off.T + (variances * unit) @ unit.T
    covariance[:2, :2] += deviation**2 * fit.inverse
    onset = float(np.tile(onsets, len(results)) @ weights)
    return DistanceChange(odds, onset, mean, covariance)


def begun_before(
    readings: Array,
    declared: DistanceChange,
    change: float,
    speed_deviation: float,
    deviation: float,
) -> DistanceChange:
    """Return the change as one that began before the readings if that explains them better.

    A conveyor that is started again before it stands has a speed from the first reading on. Taken
    for a start since then, 6 mm/s of it were 180 mm/s^2, and 22 mm/s at once.

    Args:
        readings: (2, m), ages [s] and positions [m], newest last: since the class began.
        declared: change since then, from a steady motion without speed.
        change, speed_deviation, deviation: as ``find`` takes them.
    """
    ages, values = readings
    way, times = values - values[-1], ages[0] - ages
    ramped = 0.5 * change * times * times
    basis = np.stack((np.ones_like(times), times, ramped))
    moved = np.array((LEVEL_DEVIATION, MOVED_DEVIATION, ACCELERATION_SHARE)) ** 2
    odds, fit, covariance = _evidence(basis, way - ramped, moved, deviation)
    stood = np.array((LEVEL_DEVIATION, speed_deviation)) ** 2
    if odds - _evidence(basis[:2], way, stood, deviation)[0] < declared.odds or fit[1] <= 0.0:
        return declared
    span = float(ages[0])
    to_now = np.array(((1.0, span, ramped[-1]), (0.0, 1.0, change * span), (0.0, 0.0, change)))
    # It adds nothing to the other states: they have followed it from the first reading on.
    mean, spread = np.zeros_like(declared.values), np.zeros_like(declared.covariance)
    mean[:3] = to_now @ (fit + np.array((0.0, 0.0, 1.0)))
    mean[0] += float(values[-1])
    spread[:3, :3] = to_now @ covariance @ to_now.T
    return DistanceChange(declared.odds, span, mean, spread)


def _evidence(
    basis: Array, way: Array, variances: Array, deviation: float
) -> tuple[float, Array, Array]:
    """Return the log evidence of a basis (r, m) for a way (m,), its shares and their covariance.

    Args:
        variances: (r,) of the shares before any reading.
        deviation: one sigma of a reading [m].
    """
    information = basis @ basis.T / deviation**2 + np.diag(1.0 / variances)
    covariance = np.linalg.inv(information)
    heard = basis @ way / deviation**2
    fit = covariance @ heard
    occam = np.linalg.slogdet(information)[1] + np.log(variances).sum()
    return 0.5 * float(heard @ fit - way @ way / deviation**2 - occam), fit, covariance


class _ChangeFit(NamedTuple):
    """Readings fitted with and without a change, for each onset of a grid.

    Attributes:
        way: (m,) readings against the newest one, without the steady speed [m].
        changed: (k, m) way of a change of share 1 [m].
        absorbed: (k, 2) level [m] and speed [m/s] that explain most of it.
        steady: (2,) level and speed of the readings without a change.
        inverse: (2, 2) of their normal matrix.
        bank: sums of the onsets, which ``onset_bank`` weighs.
    """

    way: Array
    changed: Array
    absorbed: Array
    steady: Array
    inverse: Array
    bank: OnsetBank


def _fit(
    ages: Array, way: Array, onsets: Array, change: float, speed_deviation: float, deviation: float
) -> _ChangeFit:
    """Return the least squares of a steady motion and a change, for each onset (k,)."""
    begun = np.maximum(onsets[:, None] - ages, 0.0)
    changed = 0.5 * change * begun * begun
    steady = np.stack((np.ones_like(ages), -ages))
    prior = np.diag((LEVEL_DEVIATION**-2, speed_deviation**-2)) * deviation**2
    inverse = np.linalg.inv(steady @ steady.T + prior)
    products, with_steady = changed @ np.vstack((steady, way)).T, steady @ way
    absorbed = products[:, :2] @ inverse
    sums = np.zeros((5, len(onsets)))
    A = np.einsum("ij,ij->i", changed, changed) - np.einsum("ij,ij->i", absorbed, products[:, :2])
    B = products[:, 2] - absorbed @ with_steady
    sums[0], sums[1], sums[2], sums[4] = A / deviation**2, B / deviation**2, onsets, 1.0
    bank = OnsetBank(absorbed.T, sums, np.gradient(onsets) / COUNTED_S)
    return _ChangeFit(way, changed, absorbed, inverse @ with_steady, inverse, bank)


def _explains(fit: _ChangeFit, ages: Array, onset: int, share: float, deviation: float) -> bool:
    """Return whether a change explains all readings, and by themselves those since its onset.

    Args:
        onset: index of the onset in the grid.
        share: of the nominal acceleration.
    """
    level, more = (fit.steady - share * fit.absorbed[onset]).tolist()
    residual = fit.way - share * fit.changed[onset] - level + more * ages
    recent = residual[ages <= fit.bank.age[onset]]
    limit = (LARGEST_RESIDUAL * deviation) ** 2
    return all(float(each @ each) < limit * len(each) for each in (residual, recent))
