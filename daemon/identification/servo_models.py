"""Servo model of each axis: frequency, damping and dead time, with their deviations.

Invariants:
- Each axis is fitted by itself, with all recordings together.
- An axis is refused if its motion cannot separate the frequency from the dead time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linemate.daemon.core.control import servo_fit
from linemate.daemon.core.control.servo_fit import Passage, ServoFit
from linemate.daemon.core.control.settings import ServoModel
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.trace import Trace

LEAST_LAG = 1e-5  # least root mean square of the servo lag [rad, m]
FREQUENCY_SHARE = 0.02  # largest deviation of an accepted frequency, as a share of it
DAMPING_DEVIATION = 0.05
DEAD_TIME_DEVIATION = 0.002  # [s]
MISFIT = 0.1  # largest residual, as a share of the lag
LEAST_MISFIT = 1e-6  # assumed nonlinearity of a servo [rad, m]


@dataclass(frozen=True, slots=True)
class ServoResult:
    """One axis.

    Attributes:
        axis: 0..5 for A1..A6, 6 for E1.
        model: what goes into an overlay, None if refused.
        frequency_hz, damping, dead_time: outcomes.
    """

    axis: int
    model: ServoModel | None
    frequency_hz: Outcome
    damping: Outcome
    dead_time: Outcome


def identify_servos(traces: Sequence[Trace]) -> tuple[ServoResult, ...]:
    """Return every axis' servo.

    Args:
        traces: of one cell, at one cycle time.
    """
    if not traces:
        return ()
    axes = traces[0].commands.shape[1]
    cycle_s = float(np.mean([trace.cycle_s for trace in traces]))
    return tuple(
        _judged(
            axis,
            servo_fit.fit(
                [Passage(t.commands[:, axis], t.answers[:, axis]) for t in traces], cycle_s
            ),
        )
        for axis in range(axes)
    )


def _judged(axis: int, fit: ServoFit | None) -> ServoResult:
    refusal = _refusal(fit)
    if refusal is not None or fit is None:
        refusal = refusal or Refusal("too few answers in the recording")
        return ServoResult(axis, None, refusal, refusal, refusal)
    deviations = _deviations(fit)
    basis = f"{fit.rows} answers, {fit.residual:.1e} left of {fit.motion:.1e}"
    model = fit.model
    return ServoResult(
        axis,
        model,
        Estimate(model.frequency_hz, float(deviations[0]), basis),
        Estimate(model.damping, float(deviations[1]), basis),
        Estimate(model.dead_time, float(deviations[2]), basis),
    )


def _refusal(fit: ServoFit | None) -> Refusal | None:
    """Return why a fit is refused, None if it is accepted."""
    if fit is None:
        return Refusal("too few answers in the recording")
    if fit.motion < LEAST_LAG:
        return Refusal(f"the axis hardly moved: it lags {fit.motion:.1e} rad or m behind")
    if not fit.converged:
        return Refusal("no second-order servo within reason explains the answers")
    deviations = _deviations(fit)
    shares = (
        ("frequency", deviations[0] / fit.model.frequency_hz, FREQUENCY_SHARE, "%", 100.0),
        ("damping", deviations[1], DAMPING_DEVIATION, "", 1.0),
        ("dead time", deviations[2], DEAD_TIME_DEVIATION, "ms", 1e3),
    )
    for name, deviation, limit, unit, scale in shares:
        if not deviation <= limit:
            known = f"+-{scale * deviation:.2g} {unit}".rstrip()
            return Refusal(f"not enough excitation: its {name} is known only to {known}")
    if fit.residual > MISFIT * fit.motion:
        share = fit.residual / fit.motion
        return Refusal(f"a second-order servo leaves {100.0 * share:.0f} % of the lag unexplained")
    return None


def _deviations(fit: ServoFit) -> Array:
    """Return the deviations (3,) of frequency [Hz], damping and dead time [s]."""
    misfit = max(LEAST_MISFIT / max(fit.residual, 1e-15), 1.0)
    deviations: Array = misfit * np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    return deviations
