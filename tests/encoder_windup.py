"""Windup of each axis between motor and link, from recordings of both encoders.

    link - motor = zero - depth w - compliance torque - lag speed
    dw/dq = (sgn(dq) - w) / travel                              (Dahl)

Linear least squares for every travel of a grid; the best travel is kept. Depth and compliance are
not negative: a link lags behind its motor and yields to the load.

Invariants:
- Arrays in, values out. SI units: rad, Nm, s.
- The lag between the stamps of both encoders is a parameter. Without it the windup is estimated
  ten times too large: both have the sign of the speed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.arm_windup import dahl
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal

TRAVELS = tuple(float(f"{value:.2g}") for value in np.geomspace(0.3e-3, 30e-3, 11))
SMOOTHING_S = 0.05  # of torque, whose ripple bends no gear
SETTLING = 3.0  # travels after the beginning whose windup is unknown
USUAL_TRAVEL = 3e-3  # [rad]
FLAT = 1.1  # residuals up to this multiple of the least one do not distinguish travels
LEAST_REVERSALS = 1
LEAST_WAY = 0.05  # of an axis [rad]
CORRELATION_S = 0.2  # of the residual: samples within it count as one


@dataclass(frozen=True, slots=True, eq=False)
class AxisRecord:
    """One axis in one recording.

    Attributes:
        motor, link: (n,) positions by both encoders [rad].
        torque: (n,) of the motor [Nm].
        period_s: time between two samples [s].
    """

    motor: Array
    link: Array
    torque: Array
    period_s: float


@dataclass(frozen=True, slots=True)
class WindupModel:
    """Model of one axis.

    Attributes:
        zero: link minus motor at rest [rad].
        depth: windup after a long way in one direction [rad].
        travel: way after a reversal in which 63 % of the change take place [rad].
        compliance: for each Nm of the motor's torque [rad/Nm].
        lag: of the link encoder's stamps behind the motor encoder's [s].
    """

    zero: float
    depth: float
    travel: float
    compliance: float
    lag: float


@dataclass(frozen=True, slots=True)
class WindupResult:
    """Result for one axis.

    Attributes:
        depth, lag: of the axis, as outcomes [rad], [s].
        residual: root mean square of what the model leaves [rad].
    """

    model: WindupModel | None
    depth: Outcome
    lag: Outcome
    residual: float


def predicted(model: WindupModel, record: AxisRecord) -> Array:
    """Return link minus motor (n,) [rad]."""
    values = np.array((model.zero, model.depth, model.compliance, model.lag))
    result: Array = _columns(record, model.travel) @ values
    return result


def identify_windup(records: Sequence[AxisRecord]) -> WindupResult:
    """Return the windup of one axis from all recordings of it."""
    refusal = _refusal(records)
    if refusal is not None:
        return WindupResult(None, refusal, refusal, math.nan)
    fits = [_fitted(records, travel) for travel in TRAVELS]
    best = _chosen([fit[1] for fit in fits])
    values, residual, deviations = fits[best]
    zero, depth, compliance, lag = values.tolist()
    count = sum(len(record.motor) for record in records)
    basis = f"{count} samples, {1e3 * residual:.3f} mrad left"
    # The travel is flat near its best: the depths of nearby travels are part of the deviation.
    near = [fit[0][1] for fit in fits if fit[1] <= FLAT * residual]
    spread = 0.5 * float(max(near) - min(near))
    return WindupResult(
        WindupModel(zero, depth, TRAVELS[best], compliance, lag),
        Estimate(depth, math.hypot(float(deviations[1]), spread), basis),
        Estimate(lag, float(deviations[3]), basis),
        residual,
    )


def _chosen(residuals: Sequence[float]) -> int:
    """Return the number of the travel: of those that fit nearly alike the most usual one."""
    limit = FLAT * min(residuals)
    alike = [i for i, residual in enumerate(residuals) if residual <= limit]
    return min(alike, key=lambda i: abs(math.log(TRAVELS[i] / USUAL_TRAVEL)))


def _refusal(records: Sequence[AxisRecord]) -> Refusal | None:
    if not records:
        return Refusal("no recording of both encoders")
    way = max(float(np.ptp(record.motor)) for record in records)
    if way < LEAST_WAY:
        return Refusal(f"the axis moved by {1e3 * way:.1f} mrad; {1e3 * LEAST_WAY:.0f} are needed")
    reversals = sum(_reversals(record.motor) for record in records)
    if reversals < LEAST_REVERSALS:
        return Refusal(f"{reversals} reversals; {LEAST_REVERSALS} are needed")
    return None


def _reversals(motor: Array) -> int:
    """Return how often an axis turns by more than a hundredth of its way."""
    limit, count, extreme, sign = 0.01 * float(np.ptp(motor)), 0, float(motor[0]), 0.0
    for q in motor.tolist():
        if sign * (q - extreme) > 0.0 or (sign == 0.0 and abs(q - extreme) > limit):
            sign, extreme = (sign or math.copysign(1.0, q - extreme)), q
        elif sign and sign * (extreme - q) > limit:
            sign, extreme, count = -sign, q, count + 1
    return count


def _fitted(records: Sequence[AxisRecord], travel: float) -> tuple[Array, float, Array]:
    """Return zero, depth, compliance and lag, the residual [rad] and their deviations."""
    rows, wanted, independent = [], [], 0.0
    for record in records:
        begin = int(np.argmax(_way(record.motor) > SETTLING * travel))
        rows.append(_columns(record, travel)[begin:])
        wanted.append((record.link - record.motor)[begin:])
        independent += len(rows[-1]) * record.period_s / CORRELATION_S
    X, y = np.concatenate(rows), np.concatenate(wanted)
    scale = np.sqrt(np.mean(X * X, axis=0))
    low, high = (-math.inf, 0.0, 0.0, -math.inf), math.inf
    values = lsq_linear(X / scale, y, bounds=(low, high)).x / scale
    residual = math.sqrt(float(np.mean((y - X @ values) ** 2)))
    information = (X / scale).T @ (X / scale) / len(X) * max(independent, 1.0)
    deviations = residual * np.sqrt(np.linalg.pinv(information).diagonal()) / scale
    return values, residual, deviations


def _way(motor: Array) -> Array:
    """Return the way (n,) since the beginning [rad]."""
    return np.append(0.0, np.cumsum(np.abs(np.diff(motor))))


def _columns(record: AxisRecord, travel: float) -> Array:
    """Return what zero, depth, compliance and lag are multiplied by, (n, 4)."""
    speed = np.gradient(record.motor, record.period_s)
    torque = _smoothed(record.torque, record.period_s)
    ones = np.ones(len(record.motor))
    return np.column_stack((ones, -dahl(record.motor, travel), -torque, -speed))


def _smoothed(values: Array, period_s: float) -> Array:
    """Return values (n,) under a Hann window without delay."""
    half = max(round(SMOOTHING_S / period_s), 1)
    window = np.hanning(2 * half + 1)
    padded = np.pad(values, half, mode="edge")
    return np.convolve(padded, window / window.sum(), "valid")
