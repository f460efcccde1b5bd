"""Elastic modes of the tool, from its oscillation after the robot has come to rest.

Invariants:
- Only stretches are used in which the robot stands and the tool has no contact.
- Readings count at their own stamps, whatever the cycle. Too few a second are refused.
- There is one mode along or about each tool axis. Its frequency is the undamped one.
- Amplitudes and offsets of each stretch are linear and are projected out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares

from linemate.daemon.core.control.settings import EffectorMode
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.trace import Trace, tcp_path

AXES = ("x", "y", "z", "rx", "ry", "rz")
STILL = (0.002, 0.002)  # speed of the tcp below which the robot stands [m/s, rad/s]
SHORTEST = 0.5  # of a stretch [s]
LONGEST = 4.0  # of a stretch; the rest of it is noise [s]
AFTER_CONTACT = 0.5  # [s]
SEARCH_HZ = (1.5, 20.0)
LEAST_RATE_HZ = 2.5 * SEARCH_HZ[1]  # of readings: below, a fast mode appears as a slow one
DAMPING = (1e-4, 0.5)
PERIODS = 3.0  # least periods in a stretch
CLEAR = 12.0  # least amplitude, in its deviations
FREQUENCY_SHARE = 0.02
DAMPING_DEVIATION = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """One stretch of rest.

    Attributes:
        times: (n,) since its begin [s].
        values: (n, 6) force [N] and torque [Nm].
    """

    times: Array
    values: Array


@dataclass(frozen=True, slots=True)
class ModeResult:
    """One axis of the tool.

    Attributes:
        mode: what goes into an overlay, None if refused.
        noise: deviation of a single reading [N, Nm], None if refused.
    """

    axis: int
    mode: EffectorMode | None
    frequency_hz: Outcome
    damping: Outcome
    noise: float | None


def stretches(trace: Trace) -> list[Stretch]:
    """Return the stretches in which the robot stands in free space."""
    if len(trace.wrenches) < 10:
        return []
    times = trace.wrenches[:, 0]
    path = tcp_path(trace)
    rates = np.abs(path.rates(times))
    still = (rates[:, :3].max(axis=1) < STILL[0]) & (rates[:, 3:].max(axis=1) < STILL[1])
    still &= path.known(times) & ~trace.in_contact(times, AFTER_CONTACT)
    edges = np.flatnonzero(np.diff(np.concatenate(((False,), still, (False,)))))
    ringing = []
    for begin, end in pairwise(edges):
        if not still[begin] or times[end - 1] - times[begin] < SHORTEST:
            continue
        rows = slice(begin, begin + int(np.searchsorted(times[begin:end] - times[begin], LONGEST)))
        ringing.append(Stretch(times[rows] - times[begin], trace.wrenches[rows, 1:]))
    return ringing


def identify_modes(traces: Sequence[Trace]) -> tuple[ModeResult, ...]:
    """Return the elastic mode of each of the tool's six axes."""
    ringing = [stretch for trace in traces for stretch in stretches(trace)]
    rate_hz = reading_rate(ringing)
    if ringing and rate_hz < LEAST_RATE_HZ:
        reason = (
            f"readings come at {rate_hz:.1f} Hz, at least {LEAST_RATE_HZ:.0f} Hz are needed: a "
            f"mode above {0.5 * rate_hz:.1f} Hz would appear as a slower one. Raise the sensor's "
            "rate"
        )
        return tuple(_refused(axis, reason) for axis in range(6))
    return tuple(_mode(axis, ringing, rate_hz) for axis in range(6))


def reading_rate(ringing: Sequence[Stretch]) -> float:
    """Return the usual rate of readings with stamps of their own [Hz], 0 without any."""
    gaps = np.concatenate([np.diff(stretch.times) for stretch in ringing] or [np.zeros(0)])
    gaps = gaps[gaps > 0.0]
    return 1.0 / float(np.median(gaps)) if len(gaps) else 0.0


def _refused(axis: int, reason: str) -> ModeResult:
    refusal = Refusal(reason)
    return ModeResult(axis, None, refusal, refusal, None)


def _mode(axis: int, ringing: list[Stretch], rate_hz: float) -> ModeResult:
    if not ringing:
        return _refused(axis, "the robot never stands still in free space while a wrench is read")
    fitted = _fit(axis, ringing, _search(axis, ringing))
    f, z = fitted.frequency_hz, fitted.damping
    if fitted.clear < CLEAR:
        return _refused(
            axis, f"not enough excitation: what rings is {fitted.clear:.1f} times its deviation"
        )
    longest = max(float(stretch.times[-1]) for stretch in ringing)
    if longest * f < PERIODS:
        return _refused(axis, f"too short: {longest:.1f} s of rest for {f:.1f} Hz")
    if not fitted.deviations[0] < FREQUENCY_SHARE * f:
        return _refused(axis, f"its frequency is known only to +-{fitted.deviations[0]:.2g} Hz")
    if not fitted.deviations[1] < DAMPING_DEVIATION or not DAMPING[0] < z < 0.95 * DAMPING[1]:
        return _refused(axis, f"its damping is known only to +-{fitted.deviations[1]:.2g}")
    basis = f"{len(ringing)} stretches of rest, ringing {fitted.clear:.0f} times its deviation, "
    basis += f"{rate_hz:.0f} readings a second"
    return ModeResult(
        axis,
        EffectorMode(f, z),
        Estimate(f, fitted.deviations[0], basis),
        Estimate(z, fitted.deviations[1], basis),
        fitted.noise,
    )


@dataclass(frozen=True, slots=True)
class _Fitted:
    frequency_hz: float
    damping: float
    deviations: tuple[float, float]
    noise: float
    clear: float


def _basis(t: Array, frequency_hz: float, damping: float) -> Array:
    """Return the basis of a stretch (n, 4): oscillation of a mode, offset, drift."""
    w = 2.0 * math.pi * frequency_hz
    decay = np.exp(-damping * w * t)
    damped = w * math.sqrt(max(1.0 - damping * damping, 1e-6)) * t
    columns = (decay * np.cos(damped), decay * np.sin(damped), np.ones_like(t), t)
    return np.column_stack(columns)


def _left(axis: int, ringing: list[Stretch], frequency_hz: float, damping: float) -> Array:
    """Return the residuals of all stretches (n,)."""
    rest = []
    for stretch in ringing:
        A = _basis(stretch.times, frequency_hz, damping)
        y = stretch.values[:, axis]
        rest.append(y - A @ np.linalg.lstsq(A, y, rcond=None)[0])
    return np.concatenate(rest)


def _search(axis: int, ringing: list[Stretch]) -> tuple[float, float]:
    """Return frequency and damping at the highest peak of the summed spectra."""
    longest = max(float(stretch.times[-1]) for stretch in ringing)
    grid = np.arange(SEARCH_HZ[0], SEARCH_HZ[1], 0.2 / longest)
    power = np.zeros(len(grid))
    for stretch in ringing:
        A = _basis(stretch.times, 1.0, 0.0)[:, 2:]
        y = stretch.values[:, axis]
        rest = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
        turns = np.exp(-2j * math.pi * np.outer(grid, stretch.times))
        power += np.abs(turns @ rest) ** 2 / len(rest)
    peak = float(grid[int(np.argmax(power))])
    near = [(peak + shift, z) for shift in (-0.1, 0.0, 0.1) for z in (0.005, 0.02, 0.08)]
    return min(near, key=lambda pair: float(np.sum(_left(axis, ringing, *pair) ** 2)))


def _fit(axis: int, ringing: list[Stretch], start: tuple[float, float]) -> _Fitted:
    """Return the best frequency and damping near ``start``."""

    def residuals(theta: Array) -> Array:
        return _left(axis, ringing, math.exp(theta[0]), math.exp(theta[1]))

    solved = least_squares(
        residuals,
        (math.log(start[0]), math.log(start[1])),
        bounds=(
            (math.log(0.8 * start[0]), math.log(DAMPING[0])),
            (math.log(1.25 * start[0]), math.log(DAMPING[1])),
        ),
        x_scale=(0.01, 0.5),
        jac="3-point",
    )
    f, z = math.exp(solved.x[0]), math.exp(solved.x[1])
    e = solved.fun
    free = max(len(e) - 4 * len(ringing) - 2, 1)
    variance = float(e @ e) / free
    slope: Array = np.asarray(solved.jac, dtype=float)
    inverse = np.linalg.pinv(slope.T @ slope, hermitian=True)
    deviations = np.sqrt(np.maximum(inverse.diagonal() * variance, 0.0)) * (f, z)
    return _Fitted(
        f, z, (float(deviations[0]), float(deviations[1])), math.sqrt(variance),
        _clear(axis, ringing, f, z, variance),
    )  # fmt: skip


def _clear(
    axis: int, ringing: list[Stretch], frequency_hz: float, damping: float, variance: float
) -> float:
    """Return the amplitude of the oscillation over all stretches, in its deviations."""
    with_mode = float(np.sum(_left(axis, ringing, frequency_hz, damping) ** 2))
    without = 0.0
    for stretch in ringing:
        A = _basis(stretch.times, frequency_hz, damping)[:, 2:]
        y = stretch.values[:, axis]
        rest = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
        without += float(rest @ rest)
    return math.sqrt(max(without - with_mode, 0.0) / max(variance, 1e-300))
