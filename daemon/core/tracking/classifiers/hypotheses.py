"""A bank of hypotheses "something began u seconds ago", each held by two sums.

Law of this file: Willsky's test without a second filter. What the null filter errs by if a
hypothesis holds is propagated with the filter's own F and K, and its evidence is two sums (reading
notes, "One bank for everything"):

    rho = z - h'f,   A += rho^2 / S,   B += rho nu / S,   f <- F f + K rho.

Of a change of class f is the whole error, which begins as the acceleration that it adds and needs
no z. A push swings at a frequency that F does not know: its signature z is known in closed form,
and f is what the null filter has absorbed of it.
Its amplitude is N(mean, variance) and integrated out.
"""

import math
from dataclasses import dataclass

import numpy as np
from msgspec import Struct

from linemate.daemon.core.horizon import Array


class Bank(Struct, frozen=True, eq=False):
    """Hypotheses, youngest first.

    Attributes:
        error: f (n, m), of the null filter if the hypothesis holds at amplitude 1, as far as that
            goes with F.
        sums: (4, m): A and B, the evidence; the time since each onset [s]; and the frequency of
            those that swing [rad/s].
    """

    error: Array
    sums: Array

    def __len__(self) -> int:
        return len(self.sums[0])

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


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of an amplitude before it is seen: N(mean, variance)."""

    mean: float
    variance: float


class Verdict(Struct, frozen=True, eq=False):
    """What a bank's evidence says.

    Attributes:
        odds: log of all hypotheses' likelihood ratios together.
        weights: (m,) posterior of the onsets.
        amplitudes: (m,) posterior mean of each one's amplitude.
    """

    odds: float
    weights: Array
    amplitudes: Array


NOTHING = Verdict(-30.0, np.zeros(0), np.zeros(0))


def empty(states: int) -> Bank:
    """Return a bank without hypotheses for a filter of some states."""
    return Bank(np.zeros((states, 0)), np.zeros((4, 0)))


def begun(error: Array, omegas: tuple[float, ...]) -> Bank:
    """Return hypotheses that begin now.

    Args:
        error: f of each at its onset (n,).
        omegas: frequency of each [rad/s]; 0 for one that does not swing.
    """
    sums = np.zeros((4, len(omegas)))
    sums[3] = omegas
    return Bank(np.repeat(error[:, None], len(omegas), axis=1), sums)


def aged(bank: Bank, began: Bank, F: Array, dt: float, longest: float) -> Bank:
    """Return the bank one step older, with hypotheses that began before it, without the oldest.

    Args:
        began: hypotheses that are added.
        F: the null filter's transition (n, n).
        dt: [s].
        longest: age of the oldest onset [s].
    """
    keep = min(len(bank), len(began) * (round(longest / dt) - 1))
    error = F.dot(np.concatenate((began.error, bank.error[:, :keep]), axis=1))
    sums = np.concatenate((began.sums, bank.sums[:, :keep]), axis=1)
    age = sums[2]
    age += dt
    return Bank(error, sums)


def evidence(bank: Bank, prior: Prior) -> tuple[Array, Array]:
    """Return each hypothesis' log likelihood ratio (m,), its amplitude integrated out.

    And the posterior mean (m,) of that: its precision is ``A + 1 / variance``.
    """
    precision = bank.A + 1.0 / prior.variance
    weighted = bank.B + prior.mean / prior.variance
    mean: Array = weighted / precision
    ratio: Array = weighted * mean - np.log(precision)
    ratio -= prior.mean**2 / prior.variance + math.log(prior.variance)
    ratio *= 0.5
    return ratio, mean


def verdict(bank: Bank, prior: Prior) -> Verdict:
    """Return what the evidence says: of no hypothesis odds of -30 and no weights."""
    if not len(bank):
        return NOTHING
    ratios, amplitudes = evidence(bank, prior)
    top = float(ratios[ratios.argmax()])
    raw = np.exp(ratios - top)
    total = float(np.add.reduce(raw))
    return Verdict(top + math.log(total), raw / total, amplitudes)


def moments(bank: Bank, unit: Array, prior: Prior) -> tuple[Array, Array]:
    """Return by how much the bank moves the null estimate (n,), and its spread (n, n).

    Onsets are matched in their moments, and what is left open of the amplitude is added.

    Args:
        bank: with at least one hypothesis.
        unit: (n, m) by how much each would at amplitude 1.
    """
    told = verdict(bank, prior)
    shift = unit * told.amplitudes
    mean: Array = shift.dot(told.weights)
    off = shift - mean[:, None]
    left = told.weights / (bank.A + 1.0 / prior.variance)
    spread: Array = (told.weights * off) @ off.T + (left * unit) @ unit.T
    return mean, spread
