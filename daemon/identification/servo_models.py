"""Servo model of each axis: frequency, damping, dead time and friction, with their deviations.

    q = servo(q_c - level (s - r)),   s by Dahl, r of the integral action   (control/friction.py)

Invariants:
- Each axis is fitted by itself, with all recordings together.
- An axis is refused if its motion cannot separate the frequency from the dead time, and if its
  recordings show different servos.
- A friction that the motion does not show is refused, and its servo stays as it was fitted.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from linemate.daemon.core.control import servo_fit
from linemate.daemon.core.control.servo_fit import Passage, ServoFit
from linemate.daemon.core.control.settings import AxisFriction, ServoModel
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.arm_windup import dahl
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.trace import Trace

LEAST_LAG = 1e-5  # least root mean square of the servo lag [rad, m]
FREQUENCY_SHARE = 0.02  # largest deviation of an accepted frequency, as a share of it
DAMPING_DEVIATION = 0.05
DEAD_TIME_DEVIATION = 0.002  # [s]
MISFIT = 0.1  # largest residual, as a share of the lag
LEAST_MISFIT = 1e-6  # assumed nonlinearity of a servo [rad, m]
UNIT = 1e-3  # level of the friction whose multiple is fitted [rad, m]
TRAVELS = (0.05e-3, 0.2e-3, 0.4e-3)  # other than the usual one [rad, m]
RECOVERIES_S = (0.1, 0.2, 0.5, 1.0, 3.0)  # likewise [s]
SHOWN = 4.0  # least level, in deviations
LEAST_LEVEL = 5e-6  # [rad, m]
LARGEST_LEVEL = 0.005  # that a configuration takes [rad, m]
LEAST_SHARE = 0.1  # of the variance that a servo alone leaves, which friction has to explain


@dataclass(frozen=True, slots=True)
class ServoResult:
    """One axis.

    Attributes:
        axis: 0..5 for A1..A6, 6 for E1.
        model: what goes into an overlay, None if refused.
        friction: of the drive, with a level of 0 if it is refused.
        level: outcome of that level [rad, m].
    """

    axis: int
    model: ServoModel | None
    frequency_hz: Outcome
    damping: Outcome
    dead_time: Outcome
    friction: AxisFriction
    level: Outcome


@dataclass(frozen=True, slots=True)
class RubbingAxis:
    """One axis.

    Attributes:
        friction: what goes into an overlay; its level is 0 if refused.
        fit: of the servo, to the answers without the friction.
        level: outcome, of that following error [rad, m].
    """

    friction: AxisFriction
    fit: ServoFit
    level: Outcome


def identify_servos(traces: Sequence[Trace], names: Sequence[str] = ()) -> tuple[ServoResult, ...]:
    """Return every axis' servo.

    Args:
        traces: of one cell, at one cycle time.
        names: of their recordings, for refusals.
    """
    if not traces:
        return ()
    axes = traces[0].commands.shape[1]
    cycle_s = float(np.mean([trace.cycle_s for trace in traces]))
    return tuple(
        _identified(
            axis, [Passage(t.commands[:, axis], t.answers[:, axis]) for t in traces], cycle_s, names
        )
        for axis in range(axes)
    )


def _identified(
    axis: int, passages: Sequence[Passage], cycle_s: float, names: Sequence[str]
) -> ServoResult:
    """Return one axis: friction is taken out before its servo is judged."""
    fit = servo_fit.fit(passages, cycle_s)
    if fit is None or fit.motion < LEAST_LAG:
        unmoved = _refusal(fit) or Refusal("too few answers in the recording")
        return ServoResult(axis, None, unmoved, unmoved, unmoved, AxisFriction(), unmoved)
    rubbing = identify_friction(passages, fit, cycle_s)
    refusal = _refusal(rubbing.fit)
    if refusal is not None:
        refusal = _contradiction(passages, cycle_s, names) or refusal
    return _judged(axis, rubbing, refusal)


def _contradiction(
    passages: Sequence[Passage], cycle_s: float, names: Sequence[str]
) -> Refusal | None:
    """Return that recordings show different servos: each alone is accepted, together they are not.

    What together they leave looks like noise of long correlation, so that nothing would be known.
    """
    fits = [servo_fit.fit([passage], cycle_s) for passage in passages]
    known = [
        (_lag_ms(fit.model), name)
        for fit, name in zip(fits, names, strict=False)
        if fit is not None and _refusal(fit) is None
    ]
    if len(known) < 2:
        return None
    (least, earlier), (most, later) = min(known), max(known)
    return Refusal(
        f"the recordings show different servos: {least:.1f} ms late in {earlier}, {most:.1f} ms in "
        f"{later}. Identify from recordings of one arm with one setting of its controller"
    )


def _lag_ms(model: ServoModel) -> float:
    """Return how late an axis follows a ramp."""
    return 1e3 * (model.dead_time + model.damping / (math.pi * model.frequency_hz))


def _judged(axis: int, rubbing: RubbingAxis, refusal: Refusal | None) -> ServoResult:
    fit, friction, level = rubbing.fit, rubbing.friction, rubbing.level
    if refusal is not None:
        return ServoResult(axis, None, refusal, refusal, refusal, friction, level)
    deviations = _deviations(fit)
    basis = f"{fit.rows} answers, {fit.residual:.1e} left of {fit.motion:.1e}"
    model = fit.model
    return ServoResult(
        axis,
        model,
        Estimate(model.frequency_hz, float(deviations[0]), basis),
        Estimate(model.damping, float(deviations[1]), basis),
        Estimate(model.dead_time, float(deviations[2]), basis),
        friction,
        level,
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
            return Refusal(
                f"not enough excitation: its {name} is known only to {known}, at most "
                f"{scale * limit:g} {unit}".rstrip()
                + ". Record more brisk moves of this axis: linemate commission --step servos"
            )
    if fit.residual > MISFIT * fit.motion:
        share = fit.residual / fit.motion
        return Refusal(f"a second-order servo leaves {100.0 * share:.0f} % of the lag unexplained")
    return None


def _deviations(fit: ServoFit) -> Array:
    """Return the deviations (3,) of frequency [Hz], damping and dead time [s]."""
    misfit = max(LEAST_MISFIT / max(fit.residual, 1e-15), 1.0)
    deviations: Array = misfit * np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    return deviations


def identify_friction(passages: Sequence[Passage], fit: ServoFit, cycle_s: float) -> RubbingAxis:
    """Return the friction of one axis, and its servo without it.

    Servo and level are fitted together: each alone takes the other's part of the answers. Recovery
    and travel are searched one after the other, if the usual ones show friction at all.

    Args:
        passages: all recordings of the axis.
        fit: of the servo, to the answers as they are.
    """
    best, shape = fit, AxisFriction(UNIT)
    for part in ("usual", "recovery", "travel"):
        shapes = [shape]
        if part == "recovery":
            shapes = [replace(shape, recovery_s=value) for value in RECOVERIES_S]
        elif part == "travel":
            shapes = [replace(shape, travel=value) for value in TRAVELS]
        for each in shapes:
            held_back = partial(_held_back, friction=each, cycle_s=cycle_s)
            later = servo_fit.fit(passages, cycle_s, best.model, held_back)
            if later is not None and later.converged and later.residual < best.residual:
                best, shape = later, each
        level, deviation = (UNIT * value for value in best.disturbed)
        explained = 1.0 - (best.residual / fit.residual) ** 2 if fit.residual > 0.0 else 0.0
        if level < max(SHOWN * deviation, LEAST_LEVEL) or explained < LEAST_SHARE:
            shown = (
                f"{1e3 * level:.3f} mrad or mm, {100.0 * explained:.0f} % of what a servo leaves"
            )
            return RubbingAxis(AxisFriction(), fit, Refusal(f"no friction shows: {shown}"))
    basis = f"{100.0 * explained:.0f} % of what the servo alone leaves"
    friction = replace(shape, level=min(level, LARGEST_LEVEL))
    return RubbingAxis(friction, best, Estimate(level, deviation, basis))


def _held_back(servo: ServoModel, moved: Array, friction: AxisFriction, cycle_s: float) -> Array:
    """Return what friction adds to the positions (n,) of an axis that moves so."""
    s = dahl(moved, friction.travel)
    kept = math.exp(-cycle_s / friction.recovery_s)
    r, rest = 0.0, []
    for each in s.tolist():
        r = each + (r - each) * kept
        rest.append(r - each)
    # A setpoint is reached a cycle after it was given, friction acts at once.
    acting = friction.level * np.array((*rest[1:], rest[-1]))
    return servo_fit.simulate(replace(servo, dead_time=0.0), acting, cycle_s)
