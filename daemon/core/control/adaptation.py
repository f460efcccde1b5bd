"""Adaptation of the servo models: the natural frequency of each axis, estimated while running.

Invariants:
- A frequency stays within ``reach`` of the identified one and changes no faster than ``rate``.
- An axis that hardly moved keeps its frequency.
- Models are fitted forward, from setpoints without noise to measured answers. The inverse
  regression would be biased by the noise of the answers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from linemate.daemon.core.control.inverse_filter import servo_pulse
from linemate.daemon.core.control.settings import ServoModel
from linemate.daemon.core.horizon import Array

Share = Annotated[float, Gt(0.0), Lt(0.5)]

_STEP = 1e-3  # of ln f, in the numeric derivative
_ITERATIONS = 2  # of Gauss-Newton
_OUTLIER = 5.0  # standard deviations of the residual
_SETTLED = 8.0  # time constants after which a setpoint has no effect
_LEAST_ROWS = 20  # answers for a fit


@dataclass(frozen=True, slots=True)
class AdaptationSettings:
    """Bounds and evidence for the adaptation of servo models.

    Attributes:
        window_s: length of a window of setpoints and answers [s].
        reach: largest change of a frequency from the identified one, as a share.
        rate: largest change of a frequency per second, as a share [1/s].
        noise: least standard deviation of an answer [rad, m].
        sure: largest standard deviation of a frequency, as a share, that a window may have.
        misfit: largest share of the servo lag that the model may leave unexplained.
        memory_s: time constant with which older windows lose their weight [s].
    """

    window_s: Annotated[float, Ge(0.1), Le(60.0)] = 3.0
    reach: Share = 0.3
    rate: Annotated[float, Gt(0.0), Le(1.0)] = 0.03
    noise: Annotated[float, Gt(0.0), Le(0.01)] = 1e-5
    sure: Share = 0.02
    misfit: Annotated[float, Gt(0.0), Le(10.0)] = 0.3
    memory_s: Annotated[float, Ge(0.1), Le(3600.0)] = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class ServoWindow:
    """Consecutive cycles of all axes, oldest first.

    Attributes:
        commands: (m, axes) setpoints in force [rad, m].
        answers: (m, axes) measured at the same cycles' telegrams, NaN without one [rad, m].
    """

    commands: Array
    answers: Array


@dataclass(frozen=True, slots=True)
class AxisEstimate:
    """Frequency estimate of one axis.

    Attributes:
        factor: frequency over the identified one, limited by the rate; in force.
        estimate: the same without the limit of the rate.
        variance: of ``estimate``; at first that of the identified model.
        rejection: why the last window was not used, None if it was.
    """

    factor: float = 1.0
    estimate: float = 1.0
    variance: float = 1e-4
    rejection: str | None = None


@dataclass(frozen=True, slots=True)
class ServoEstimates:
    """Estimates and models in force, one an axis."""

    axes: tuple[AxisEstimate, ...]
    models: tuple[ServoModel, ...]


def initial(identified: Sequence[ServoModel]) -> ServoEstimates:
    """Return the identified models as estimates."""
    return ServoEstimates(tuple(AxisEstimate() for _ in identified), tuple(identified))


def update(
    settings: AdaptationSettings,
    identified: Sequence[ServoModel],
    estimates: ServoEstimates,
    window: ServoWindow,
    cycle_s: float,
    elapsed: float,
) -> ServoEstimates:
    """Return the estimates corrected by one window; some milliseconds an axis.

    Args:
        identified: models of the axes, the centres of the bounds.
        elapsed: time since the last update [s].
    """
    axes = tuple(
        _update_axis(settings, model, estimate, window, axis, cycle_s, elapsed)
        for axis, (model, estimate) in enumerate(zip(identified, estimates.axes, strict=True))
    )
    models = tuple(
        replace(model, frequency_hz=model.frequency_hz * estimate.factor)
        for model, estimate in zip(identified, axes, strict=True)
    )
    return ServoEstimates(axes, models)


def _update_axis(
    settings: AdaptationSettings,
    identified: ServoModel,
    prior: AxisEstimate,
    window: ServoWindow,
    axis: int,
    cycle_s: float,
    elapsed: float,
) -> AxisEstimate:
    """Return the estimate of one axis after one window: a scalar Kalman filter over windows."""
    fitted = _fit(settings, identified, prior.estimate, window, axis, cycle_s)
    if isinstance(fitted, str):
        return _limit_rate(settings, replace(prior, rejection=fitted), elapsed)
    factor, variance = fitted
    # Older windows fade: a drift is to be followed, and windows that overlap are not independent.
    keep = math.exp(-elapsed / settings.memory_s)
    prior_variance = prior.variance / max(keep, 1e-6)
    share = min(elapsed / settings.window_s, 1.0)
    gain = prior_variance / (prior_variance + variance / max(share, 1e-6))
    estimate = prior.estimate + gain * (factor - prior.estimate)
    posterior = AxisEstimate(
        factor=prior.factor,
        estimate=min(max(estimate, 1.0 - settings.reach), 1.0 + settings.reach),
        variance=max((1.0 - gain) * prior_variance, 1e-10),
    )
    return _limit_rate(settings, posterior, elapsed)


def _limit_rate(
    settings: AdaptationSettings, estimate: AxisEstimate, elapsed: float
) -> AxisEstimate:
    """Return the estimate with its factor moved towards it, no faster than allowed."""
    largest = settings.rate * elapsed
    step = min(max(estimate.estimate - estimate.factor, -largest), largest)
    return replace(estimate, factor=estimate.factor + step)


def _fit(
    settings: AdaptationSettings,
    identified: ServoModel,
    start: float,
    window: ServoWindow,
    axis: int,
    cycle_s: float,
) -> tuple[float, float] | str:
    """Return factor and variance that one window gives, or why it gives none."""
    slowest = replace(identified, frequency_hz=identified.frequency_hz * (1.0 - settings.reach))
    commands, answers = window.commands[:, axis], window.answers[:, axis]
    is_usable = np.isfinite(answers)
    is_usable[: _memory_steps(slowest, cycle_s)] = False
    rows = np.flatnonzero(is_usable)
    if len(rows) < _LEAST_ROWS:
        return "the window is not full yet"
    low, high = math.log(1.0 - settings.reach), math.log(1.0 + settings.reach)
    log_factor = min(max(math.log(start), low), high)

    def residual(value: float, rows: NDArray[np.intp]) -> Array:
        model = replace(identified, frequency_hz=identified.frequency_hz * math.exp(value))
        e = (answers - _answer(model, commands, cycle_s))[rows]
        centred: Array = e - e.mean()
        return centred

    power = 0.0
    e = residual(log_factor, rows)
    for _ in range(_ITERATIONS):
        slope = (residual(log_factor + _STEP, rows) - e) / _STEP
        power = float(slope @ slope)
        if power * settings.sure**2 < settings.noise**2:
            return "the axis hardly moved"
        log_factor = min(max(log_factor - float(slope @ e) / power, low), high)
        e = residual(log_factor, rows)
        deviation = 1.4826 * median(np.abs(e).tolist())
        inliers = np.abs(e) <= max(_OUTLIER * deviation, _OUTLIER * settings.noise)
        rows = rows[inliers]
        e = e[inliers] - e[inliers].mean()
    lag = (answers - commands)[rows]
    lag = lag - lag.mean()
    if float(e @ e) > settings.misfit**2 * float(lag @ lag) + len(e) * settings.noise**2:
        return "the model does not explain the answers"
    # The residual is mostly correlated model error: one independent value a rise time.
    rise = max(0.5 / (identified.frequency_hz * cycle_s), 1.0)
    variance = max(float(e @ e) / len(e), settings.noise**2) * rise / power
    if variance > settings.sure**2:
        return f"standard deviation of the frequency: {100.0 * math.sqrt(variance):.0f} %"
    factor = math.exp(log_factor)
    return factor, variance * factor * factor


def _memory_steps(model: ServoModel, cycle_s: float) -> int:
    """Return after how many cycles a setpoint has no effect."""
    omega, z = 2.0 * math.pi * model.frequency_hz, model.damping
    slowest = omega * (z - math.sqrt(max(z * z - 1.0, 0.0)))
    return math.ceil((model.dead_time + _SETTLED / slowest) / cycle_s) + 2


def _answer(model: ServoModel, commands: Array, cycle_s: float) -> Array:
    """Return the predicted answers (m,) of an axis that stood at the first setpoint before."""
    pulse = servo_pulse(model, cycle_s)
    answer: Array = np.convolve(commands - commands[0], pulse)[: len(commands)] + commands[0]
    return answer
