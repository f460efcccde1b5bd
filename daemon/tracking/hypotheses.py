"""A bank of hypotheses "something began u seconds ago", each held by two sums.

Law of this file: Willsky's test without a second filter. A hypothesis' raw signature is known in
closed form, what the null filter has absorbed of it is propagated with the filter's own F and K,
and its evidence is two sums (reading notes, "One bank for everything"):

    rho = d - h'f,   A += rho^2 / S,   B += rho nu / S,   f <- F f + K rho.

Its amplitude is N(mean, variance) and integrated out.
"""

import math
from dataclasses import dataclass

import numpy as np

from linemate.daemon.horizon import Array


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """Hypotheses, youngest first.

    Attributes:
        absorbed: f (m, n), what the null filter has taken in of each signature.
        A, B: (m,) evidence.
        age: (m,) time since each onset [s].
        omega: (m,) frequency of those that swing [rad/s].
    """

    absorbed: Array
    A: Array
    B: Array
    age: Array
    omega: Array

    def __len__(self) -> int:
        return len(self.age)


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of an amplitude before it is seen: N(mean, variance)."""

    mean: float
    variance: float


def empty(states: int) -> Bank:
    """Return a bank without hypotheses for a filter of some states."""
    nothing = np.zeros(0)
    return Bank(np.zeros((0, states)), nothing, nothing, nothing, nothing)


def aged(bank: Bank, F: Array, dt: float, longest: float, omegas: tuple[float, ...]) -> Bank:
    """Return the bank one step older, with new hypotheses "now" and without the oldest.

    Args:
        bank: before.
        F: the null filter's transition (n, n).
        dt: [s].
        longest: age of the oldest onset [s].
        omegas: frequency of each hypothesis that is added [rad/s]; 0 for one that does not swing.
    """
    new = len(omegas)
    size = min(len(bank) + new, new * round(longest / dt))
    keep = size - new
    absorbed = np.zeros((size, F.shape[0]))
    rest = np.zeros((4, size))
    rest[3, :new] = omegas
    if keep:
        absorbed[new:] = bank.absorbed[:keep] @ F.T
        rest[0, new:] = bank.A[:keep]
        rest[1, new:] = bank.B[:keep]
        rest[2, new:] = bank.age[:keep]
        rest[3, new:] = bank.omega[:keep]
    rest[2] += dt
    return Bank(absorbed, rest[0], rest[1], rest[2], rest[3])


def learned(bank: Bank, signature: Array, h: Array, K: Array, S: float, nu: float) -> Bank:
    """Return the bank after one correction of the null filter.

    Args:
        bank: before.
        signature: d (m,), what each hypothesis of amplitude 1 adds to the measurement.
        h: the measurement's row (n,).
        K: the null filter's gain (n,).
        S: variance of its innovation.
        nu: its innovation.
    """
    rho = signature - bank.absorbed @ h
    return Bank(
        bank.absorbed + rho[:, None] * K,
        bank.A + rho * rho / S,
        bank.B + rho * (nu / S),
        bank.age,
        bank.omega,
    )


def evidence(bank: Bank, prior: Prior) -> Array:
    """Return each hypothesis' log likelihood ratio (m,), its amplitude integrated out."""
    m, s2 = prior.mean, prior.variance
    spread = 1.0 + s2 * bank.A
    ratio: Array = (s2 * bank.B * bank.B + 2.0 * m * bank.B - m * m * bank.A) / (2.0 * spread)
    ratio -= 0.5 * np.log(spread)
    return ratio


def odds(bank: Bank, prior: Prior) -> float:
    """Return the log of all hypotheses' likelihood ratios together; -30 of none."""
    if not len(bank):
        return -30.0
    ratios = evidence(bank, prior)
    top = float(ratios.max())
    return top + math.log(float(np.exp(ratios - top).sum()))


def weights(bank: Bank, prior: Prior) -> Array:
    """Return the posterior weights (m,) of the onsets."""
    ratios = evidence(bank, prior)
    raw = np.exp(ratios - ratios.max())
    normed: Array = raw / raw.sum()
    return normed


def amplitude(bank: Bank, prior: Prior) -> Array:
    """Return the posterior mean amplitude (m,) of each hypothesis."""
    mean: Array = (prior.variance * bank.B + prior.mean) / (prior.variance * bank.A + 1.0)
    return mean


def moments(bank: Bank, raw: Array, prior: Prior) -> tuple[Array, Array]:
    """Return by how much the bank moves the null estimate (n,), and its spread (n, n).

    Onsets are matched in their moments, and what is left open of the amplitude is added.

    Args:
        bank: with at least one hypothesis.
        raw: D (m, n), the state's own signature at amplitude 1.
        prior: of the amplitude.
    """
    share = weights(bank, prior)
    unit = raw - bank.absorbed
    shift = unit * amplitude(bank, prior)[:, None]
    mean: Array = share @ shift
    off = shift - mean
    left = share * prior.variance / (1.0 + prior.variance * bank.A)
    spread: Array = off.T @ (share[:, None] * off) + unit.T @ (left[:, None] * unit)
    return mean, spread
