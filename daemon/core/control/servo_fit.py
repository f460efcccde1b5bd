"""Fit of the servo's forward model to setpoints and measured answers.

The model is the one that ``inverse_filter`` inverts. The fit is always forward, from commands
without noise to answers with noise: the inverse regression is biased by the answers' noise.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from linemate.daemon.core.control.inverse_filter import servo_pulse
from linemate.daemon.core.control.settings import ServoModel
from linemate.daemon.core.horizon import Array

Mask = NDArray[np.bool_]
Residuals = Callable[[Array], Array]  # from free parameters (3,) to residuals (m,)
# From a model and the positions (n,) that it gives to what else moves the axis, of unknown size.
Disturbance = Callable[[ServoModel, Array], Array]

FREQUENCY_HZ = (0.5, 25.0)
DAMPING = (0.2, 2.0)
DEAD_TIME = (0.0, 0.25)
ITERATIONS = 40
OUTLIER = 6.0  # standard deviations of the residual beyond which an answer is excluded
STARTS = tuple(
    ServoModel(frequency_hz, 0.8, dead_time)
    for frequency_hz in (2.5, 4.0, 6.5, 10.0)
    for dead_time in (0.005, 0.030, 0.060, 0.110, 0.170)
)
_STEPS = np.array((1e-4, 1e-4, 1e-5))  # of the numeric derivatives: ln Hz, ln 1, s


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """An unbroken stretch of one axis.

    Attributes:
        commands: (n,) setpoint in force at each cycle, held where none was sent [rad, m].
        answers: (n,) measured at each cycle's telegram, NaN where there was none.
    """

    commands: Array
    answers: Array


@dataclass(frozen=True, slots=True, eq=False)
class ServoFit:
    """A fitted model.

    Attributes:
        covariance: (3, 3) of frequency [Hz], damping and dead time [s].
        residual: root mean square of the residuals [rad, m].
        motion: root mean square of the modelled servo lag [rad, m].
        rows: number of answers that were used.
        left_out: number of answers excluded as outliers.
        converged: the iteration converged within the bounds.
        disturbed: multiple of the disturbance, and its deviation; 0 without one.
    """

    model: ServoModel
    covariance: Array
    residual: float
    motion: float
    rows: int
    left_out: int
    converged: bool
    disturbed: tuple[float, float] = (0.0, 0.0)


def simulate(model: ServoModel, commands: Array, cycle_s: float) -> Array:
    """Return the answers (n,) of an axis to commands (n,) after a long stand at the first."""
    pulse = servo_pulse(model, cycle_s)
    first = commands[0]
    answer: Array = np.convolve(commands - first, pulse)[: len(commands)] + first
    return answer


def fit(
    passages: Sequence[Passage],
    cycle_s: float,
    start: ServoModel | None = None,
    disturbance: Disturbance | None = None,
) -> ServoFit | None:
    """Return the model with the least squared error; outliers are excluded.

    A constant difference of answers and commands is fitted for each segment: the zero of an
    encoder is no property of the servo.

    Args:
        start: first guess; without one a coarse grid is searched.
        disturbance: its size is fitted with the model.

    Returns:
        The fit, or None where there are too few answers.
    """
    slowest = ServoModel(1.0, 0.8, 0.06)
    skip = min(len(servo_pulse(slowest, cycle_s)), math.ceil(1.0 / cycle_s))
    cuts = [skip if _begins_moving(passage) else 0 for passage in passages]
    masks = []
    for passage, cut in zip(passages, cuts, strict=True):
        mask = np.isfinite(passage.answers)
        mask[:cut] = False
        masks.append(mask)
    if sum(int(mask.sum()) for mask in masks) < 20:
        return None

    def parts(theta: Array) -> tuple[Array, Array | None]:
        model = _model(theta)
        moved = [simulate(model, passage.commands, cycle_s) for passage in passages]
        e = _joined([p.answers - q for p, q in zip(passages, moved, strict=True)], masks)
        if disturbance is None:
            return e, None
        return e, _joined([disturbance(model, q) for q in moved], masks)

    def residuals(theta: Array) -> Array:
        e, column = parts(theta)
        return e if column is None else e - _size_of(column, e) * column

    if start is None:
        start = min(STARTS, key=lambda model: float(np.sum(residuals(_theta(model)) ** 2)))
    theta, converged, left_out = _theta(start), False, 0
    for _ in range(3):
        theta, converged = _descend(residuals, theta)
        dropped = _drop(residuals(theta), masks)
        left_out += dropped
        if not dropped:
            break
    fitted = _summary(passages, masks, residuals, theta, cycle_s, left_out, converged)
    e, column = parts(theta)
    if fitted is None or column is None:
        return fitted
    size, rest = _size_of(column, e), residuals(theta)
    spread = math.sqrt(max(float(column @ column), 1e-300) / _coloured(rest))
    return replace(fitted, disturbed=(size, fitted.residual / spread))


def _size_of(column: Array, e: Array) -> float:
    """Return the multiple of a column (m,) that explains most of residuals (m,)."""
    weight = float(column @ column)
    return float(column @ e) / weight if weight > 0.0 else 0.0


def _joined(rows: Sequence[Array], masks: Sequence[Mask]) -> Array:
    return np.concatenate([_centred(row, mask) for row, mask in zip(rows, masks, strict=True)])


def _summary(
    passages: Sequence[Passage],
    masks: list[Mask],
    residuals: Residuals,
    theta: Array,
    cycle_s: float,
    left_out: int,
    converged: bool,
) -> ServoFit | None:
    e = residuals(theta)
    if len(e) < 20:
        return None
    J = _jacobian(residuals, theta)
    model = _model(theta)
    chain = np.diag((model.frequency_hz, model.damping, 1.0))
    variance = float(e @ e) / max(len(e) - 4, 1)
    information = J.T @ J
    scale = np.sqrt(np.maximum(information.diagonal(), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    covariance = chain @ (inverse / np.outer(scale, scale)) @ chain * variance * _coloured(e)
    lag = np.concatenate(
        [
            _centred(simulate(model, p.commands, cycle_s) - p.commands, mask)
            for p, mask in zip(passages, masks, strict=True)
        ]
    )
    return ServoFit(
        model=model,
        covariance=covariance,
        residual=float(np.sqrt(np.mean(e * e))),
        motion=float(np.sqrt(np.mean(lag * lag))),
        rows=len(e),
        left_out=left_out,
        converged=converged,
    )


def _begins_moving(passage: Passage) -> bool:
    """Return whether setpoints before the segment may still act in it."""
    known = passage.answers[:3][np.isfinite(passage.answers[:3])]
    if not len(known):
        return True
    reach = float(np.ptp(passage.commands))
    return float(np.abs(known - passage.commands[0]).max()) > 1e-6 + 1e-4 * reach


def _centred(e: Array, mask: Mask) -> Array:
    kept = e[mask]
    return kept - kept.mean() if len(kept) else kept


def _theta(model: ServoModel) -> Array:
    """Return a model as free parameters: ln f, ln zeta, dead time."""
    return np.array((math.log(model.frequency_hz), math.log(model.damping), model.dead_time))


def _model(theta: Array) -> ServoModel:
    f, z = (math.exp(min(max(float(value), -20.0), 20.0)) for value in theta[:2])
    return ServoModel(
        min(max(f, FREQUENCY_HZ[0]), FREQUENCY_HZ[1]),
        min(max(z, DAMPING[0]), DAMPING[1]),
        min(max(float(theta[2]), DEAD_TIME[0]), DEAD_TIME[1]),
    )


def _jacobian(residuals: Residuals, theta: Array) -> Array:
    """Return the derivatives (m, 3) of the residuals, central within the bounds."""
    columns = []
    for i, step in enumerate(_STEPS):
        shift = np.zeros(3)
        shift[i] = step
        low = theta - shift
        low[2] = max(low[2], DEAD_TIME[0])
        high = theta + shift
        columns.append((residuals(high) - residuals(low)) / (high[i] - low[i]))
    return np.column_stack(columns)


def _descend(residuals: Residuals, theta: Array) -> tuple[Array, bool]:
    """Return the nearest minimum by Levenberg-Marquardt, and whether it converged."""
    e = residuals(theta)
    cost, damping = float(e @ e), 1e-3
    for _ in range(ITERATIONS):
        J = _jacobian(residuals, theta)
        A, g = J.T @ J, J.T @ e
        diagonal = np.maximum(A.diagonal(), 1e-12 * float(A.diagonal().max()) + 1e-300)
        moved = False
        while damping < 1e8:
            step = -np.linalg.solve(A + damping * np.diag(diagonal), g)
            trial = _theta(_model(theta + step))
            e_trial = residuals(trial)
            cost_trial = float(e_trial @ e_trial)
            if cost_trial <= cost:
                moved = True
                break
            damping *= 5.0
        if not moved:
            return theta, True
        change = np.abs(trial - theta)
        theta, e, cost = trial, e_trial, cost_trial
        damping = max(damping / 10.0, 1e-12)
        if bool((change < (1e-8, 1e-8, 1e-9)).all()):
            return theta, True
    return theta, False


def _drop(e: Array, masks: list[Mask]) -> int:
    """Exclude gross outliers from the masks; return how many."""
    deviation = 1.4826 * float(np.median(np.abs(e - np.median(e))))
    # Residuals of clean encoders are tiny and heavy-tailed: both limits must be exceeded.
    limit = max(OUTLIER * deviation, 3.0 * float(np.sqrt(np.mean(e * e))))
    dropped, begin = 0, 0
    for mask in masks:
        rows = np.flatnonzero(mask)
        gross = np.abs(e[begin : begin + len(rows)]) > limit
        begin += len(rows)
        mask[rows[gross]] = False
        dropped += int(gross.sum())
    return dropped


def _coloured(e: Array) -> float:
    """Return the factor by which correlation of the residuals enlarges a variance."""
    n = len(e)
    power = float(e @ e)
    if power <= 0.0:
        return 1.0
    factor = 1.0
    for lag in range(1, n // 4):
        share = float(e[lag:] @ e[:-lag]) / power
        if share < 2.0 / math.sqrt(n):
            break
        factor += 2.0 * share
    return factor
