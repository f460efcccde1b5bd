"""Onset bank: a generalised likelihood ratio test over the time at which something began.

Each hypothesis "it began u seconds ago" is held by two sums, without a second filter (Willsky and
Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear
systems", IEEE Transactions on Automatic Control, 1976). The error f of the null filter under the
hypothesis is propagated with the filter's own F and K:

    rho = z - h'f,   A += rho^2 / S,   B += rho nu / S,   f <- F f + K rho.

For a change of class, f is the whole error: it begins as the added acceleration and needs no z. An
impulse response has a frequency that F does not know. Its signature z is known in closed form, and
f is the part of it that the null filter has absorbed. The amplitude is N(mean, variance) and
integrated out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array

# Time between two onsets [s], or a cycle. Each adds its likelihood to the odds, 1 while it is too
# young for evidence: with one a millisecond the odds of a steady conveyor were 4.8 instead of 2.8.
SPACING_S = 0.004
# Time for which an onset counts as one. How likely a conveyor stops does not depend on the cycle:
# with each onset as one, every stop was e times as likely at 4 ms as at 12 ms.
COUNTED_S = 0.012
LEAST_SHARE = 1e-6  # by which the share of an onset differs from 1
MOST = 125  # hypotheses of a bank; a cycle of 12 ms has so many in 1.5 s without leaving one out
# Largest distance of two onsets over their age in a full bank, times ``MOST``: 6 % of the age. That
# makes the way of a change uncertain by 6 % at most, where its acceleration is by 15 %.
COARSENESS = 7.5
NONE = -30.0  # log likelihood ratio of a change against its own class


class OnsetBank(Struct, frozen=True, eq=False):
    """Hypotheses, youngest first.

    Attributes:
        error: f (n, m), error of the null filter for amplitude 1, as far as F propagates it.
        sums: (5, m): A and B, the evidence; the time since each onset [s]; the frequency of the
            impulse response [rad/s], 0 for a change of class; the usual amplitude.
        shares: (m,) number of onsets, each of ``COUNTED_S``, that each stands for; None while it
            is 1 for all.
    """

    error: Array
    sums: Array
    shares: Array | None = None

    def __len__(self) -> int:
        return int(self.sums.shape[1])

    @property
    def A(self) -> Array:
        """(m,) sum of rho^2 / S."""
        row: Array = self.sums[0]
        return row

    @property
    def B(self) -> Array:
        """(m,) sum of rho nu / S."""
        row: Array = self.sums[1]
        return row

    @property
    def age(self) -> Array:
        """(m,) time since each onset [s]."""
        row: Array = self.sums[2]
        return row

    @property
    def omega(self) -> Array:
        """(m,) frequency [rad/s]."""
        row: Array = self.sums[3]
        return row

    @property
    def usual(self) -> Array:
        """(m,) amplitude that each has if a prior's mean is 1."""
        row: Array = self.sums[4]
        return row


@dataclass(frozen=True, slots=True)
class AmplitudePrior:
    """Prior N(mean, variance) of an amplitude.

    Attributes:
        least: amplitude below which the prior does not hold.
        odds: log odds of this prior before any reading.
    """

    mean: float
    variance: float
    least: float = -math.inf
    odds: float = 0.0


class OnsetPosterior(Struct, frozen=True, eq=False):
    """Posterior of a bank.

    Attributes:
        odds: log of the sum of all likelihood ratios.
        weights: (m,) posterior of the onsets.
        amplitudes: (m,) posterior mean of each amplitude.
        variance: of the amplitude before any reading; 0 without a hypothesis.
    """

    odds: float
    weights: Array
    amplitudes: Array
    variance: float = 0.0


NO_POSTERIOR = OnsetPosterior(-30.0, np.zeros(0), np.zeros(0))


def empty(states: int) -> OnsetBank:
    """Return a bank without hypotheses for a filter of some states."""
    return OnsetBank(np.zeros((states, 0)), np.zeros((5, 0)))


def begin(error: Array, omegas: tuple[float, ...], age: float = 0.0) -> OnsetBank:
    """Return hypotheses without evidence.

    Args:
        error: f of each now (n,).
        omegas: frequency of each [rad/s]; 0 for a change of class.
        age: time since their onset [s].
    """
    sums = np.ones((5, len(omegas)))
    sums[:2], sums[2], sums[3] = 0.0, age, omegas
    return OnsetBank(np.repeat(error[:, None], len(omegas), axis=1), sums)


def propagate(bank: OnsetBank, onsets: OnsetBank, F: Array, dt: float, longest: float) -> OnsetBank:
    """Return the bank one step later: new onsets before the step, without the oldest.

    Args:
        onsets: hypotheses that are added once the youngest are ``SPACING_S`` old.
        F: the null filter's transition (n, n).
        longest: age of the oldest onset [s].
    """
    stride = max(1, round(SPACING_S / dt))
    share, shares = stride * dt / COUNTED_S, bank.shares
    if shares is None and abs(share - 1.0) > LEAST_SHARE:
        shares = np.full(len(bank), share)
    if len(bank) and bank.sums[2, 0] < (stride - 0.5) * dt:
        error, sums = F.dot(bank.error), bank.sums.copy()
    else:
        keep = len(bank)
        if longest < math.inf:
            oldest = (round(longest / (stride * dt)) * stride - 0.5) * dt
            keep = int(bank.sums[2].searchsorted(oldest))
        error = F.dot(np.concatenate((onsets.error, bank.error[:, :keep]), axis=1))
        sums = np.concatenate((onsets.sums, bank.sums[:, :keep]), axis=1)
        if shares is not None:
            shares = np.concatenate(([share] * len(onsets), shares[:keep]))
    age = sums[2]
    age += dt
    later = OnsetBank(error, sums, shares)
    return later if sums.shape[1] <= MOST else _thinned(later, len(onsets))


def _thinned(bank: OnsetBank, count: int) -> OnsetBank:
    """Return the bank with its older onsets farther apart; those that stay stand for the others.

    Args:
        count: hypotheses of each onset.
    """
    shares = np.ones(len(bank)) if bank.shares is None else bank.shares
    kept, stand_for = _merged(bank.age[::count].tolist(), shares[::count].tolist(), count)
    columns = (np.array(kept)[:, None] * count + np.arange(count)).reshape(-1)
    return OnsetBank(bank.error[:, columns], bank.sums[:, columns], np.repeat(stand_for, count))


def _merged(
    ages: Sequence[float], shares: Sequence[float], count: int
) -> tuple[list[int], list[float]]:
    """Return which onsets stay, and the number of onsets that each stands for."""
    share, kept, stand_for = COARSENESS * count / MOST, [0], [shares[0]]
    for i in range(1, len(ages)):
        is_needed = i + 1 == len(ages) or ages[i + 1] - ages[kept[-1]] > share * ages[i]
        if is_needed:
            kept.append(i)
            stand_for.append(shares[i])
        else:
            stand_for[-1] += shares[i]
    return kept, stand_for


def likelihood_ratios(bank: OnsetBank, prior: AmplitudePrior) -> tuple[Array, Array]:
    """Return each log likelihood ratio (m,), the amplitude integrated out, and its mean (m,).

    The posterior precision of the amplitude is ``A + 1 / variance``.
    """
    precision = bank.A + 1.0 / prior.variance
    usual = prior.mean * bank.usual
    weighted = bank.B + usual / prior.variance
    mean: Array = weighted / precision
    ratio: Array = weighted * mean - np.log(precision)
    ratio -= usual * usual / prior.variance + math.log(prior.variance)
    ratio *= 0.5
    # A conveyor that speeds up does not stop, however badly the null filter fits it.
    ratio[mean * prior.mean < 0.0] = NONE
    if prior.odds:
        ratio += prior.odds
    if prior.least > -math.inf:
        ratio[mean - usual < prior.least - prior.mean] = NONE
    return ratio, mean


def posterior(
    bank: OnsetBank, prior: AmplitudePrior, onset_odds: Array | None = None
) -> OnsetPosterior:
    """Return the posterior; an empty bank has log odds of -30 and no weights.

    Args:
        onset_odds: log odds (m,) of each onset before any reading; None without a difference.
    """
    count = bank.sums.shape[1]
    if not count:
        return NO_POSTERIOR
    if count == 1 and bank.shares is None and onset_odds is None:
        return _of_one(bank, prior)
    ratios, amplitudes = likelihood_ratios(bank, prior)
    if bank.shares is not None:
        ratios += np.log(bank.shares)
    if onset_odds is not None:
        ratios += onset_odds
    top = float(ratios[ratios.argmax()])
    raw = np.exp(ratios - top)
    total = float(np.add.reduce(raw))
    return OnsetPosterior(top + math.log(total), raw / total, amplitudes, prior.variance)


def _of_one(bank: OnsetBank, prior: AmplitudePrior) -> OnsetPosterior:
    """Return the posterior of one hypothesis, bit for bit as of more, in a third of the time."""
    a, b, _, _, usual = bank.sums[:, 0].tolist()
    usual *= prior.mean
    precision, weighted = a + 1.0 / prior.variance, b + usual / prior.variance
    mean = weighted / precision
    # numpy's logarithm, whose last bit may be another than that of math.
    ratio = weighted * mean - float(np.log(precision))
    ratio = 0.5 * (ratio - (usual * usual / prior.variance + math.log(prior.variance)))
    ratio = prior.odds + (NONE if mean * prior.mean < 0.0 else ratio)
    odds = NONE if mean - usual < prior.least - prior.mean else ratio
    return OnsetPosterior(odds, np.array((1.0,)), np.array((mean,)), prior.variance)


def likelier(
    bank: OnsetBank, result: OnsetPosterior, other: AmplitudePrior, asked: float
) -> OnsetPosterior:
    """Return the posterior with another prior of the amplitude if that explains more.

    Args:
        result: posterior with the usual prior.
        asked: log likelihood ratio that the best amplitude must have for the other to be asked.
    """
    if not result.variance:
        return result
    beyond = bank.B * bank.B - 2.0 * asked * bank.A
    if float(beyond[beyond.argmax()]) <= 0.0:
        return result
    wider = posterior(bank, other)
    return wider if wider.odds > result.odds else result


def without_support(bank: OnsetBank, prior: AmplitudePrior) -> OnsetBank:
    """Return the bank once another cause explains what the readings show.

    What supports an onset is dropped: it may be that cause's. What denies one stays.
    """
    shares = np.exp(np.minimum(likelihood_ratios(bank, prior)[0], 0.0))
    sums = bank.sums.copy()
    sums[:2] = 0.0
    return OnsetBank(bank.error, sums, shares if bank.shares is None else shares * bank.shares)


def oldest(bank: OnsetBank) -> OnsetBank:
    """Return the oldest hypothesis of a bank alone."""
    return OnsetBank(bank.error[:, -1:], bank.sums[:, -1:])


def merge_moments(bank: OnsetBank, unit: Array, result: OnsetPosterior) -> tuple[Array, Array]:
    """Return by how much the bank moves the null estimate (n,), and its spread (n, n).

    Onsets are merged by their moments; the posterior variance of the amplitude is added.

    Args:
        bank: with at least one hypothesis.
        unit: (n, m) by how much each would at amplitude 1.
        result: posterior of the bank.

    Raises:
        ValueError: the posterior is that of no hypothesis.
    """
    if not result.variance:
        raise ValueError("no hypothesis to merge")
    shift = unit * result.amplitudes
    mean: Array = shift.dot(result.weights)
    off = shift - mean[:, None]
    variances = result.weights / (bank.A + 1.0 / result.variance)
    spread: Array = (result.weights * off) @ off.T + (variances * unit) @ unit.T
    return mean, spread
