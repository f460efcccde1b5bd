"""Dead time that drifts while the robot moves, tracked from reported positions and setpoints.

A controller that warms up answers later and later; the drift d is the same for all its axes. With y
the response of the identified servo without its dead time D, at each telegram:

    e = q - y(t - D - d),   s = dy/dd = -v,   d <- d + T0 / tau * (s'e / (s's + v0^2)).

Invariants:
- Pure. What is kept is bounded by the longest dead time.
- The drift stays between its bounds and moves no faster than ``rate``.
- An arm at rest, or axes that contradict each other, leave it as it is.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from msgspec import Struct

from linemate.daemon.core.control import inverse_filter
from linemate.daemon.core.control.settings import ControlSettings, FilterSettings, ServoModel
from linemate.daemon.core.horizon import Array

TIME_CONSTANT_S = 0.3  # with which the drift follows a difference [s]
SLOW = 0.02  # v0: speed of all axes together that weighs half as much [rad/s, m/s]
CONTRADICTION_S = 0.012  # difference between the axes that servo models of 10 % may have [s]
NOISE = 3e-4  # the same of an arm at rest: windup, friction, rounding [rad, m]
SPACING_S = 0.004  # between two drifts for which (12) is designed; between them it is interpolated
LEAD_S = 0.06  # reach of (12) beyond the dead time: the lag of the servo itself [s]
_NODES = np.arange(-1, 3)  # of the interpolation of third degree, around the step before


@dataclass(frozen=True, slots=True, eq=False)
class DriftModel:
    """Compiled parameters of the tracking.

    Attributes:
        dead_times: (axes,) without drift [s].
        bounds: least and largest drift [s].
        rate: largest change of the drift in a cycle [s].
        recursion: (5, axes) y(k) of y(k-1), y(k-2), q_c(k-1), q_c(k-2), q_c(k-3).
        drifts: (g,) for which the taps are designed [s].
        taps: (g, m, axes) of (12) for each of them.
        length: of the responses that are kept [steps].
    """

    dead_times: Array
    bounds: tuple[float, float]
    rate: float
    cycle_s: float
    recursion: Array
    drifts: Array
    taps: Array
    length: int


class DriftState(Struct, frozen=True, eq=False):
    """The drift, and what its next correction needs.

    Attributes:
        drift: of all dead times from the identified ones [s].
        setpoints: (3, axes) the last three, newest first [rad, m].
        responses: (length, axes) of the servos without dead time, newest first [rad, m].
    """

    drift: float
    setpoints: Array
    responses: Array


def bounds(settings: ControlSettings) -> tuple[float, float]:
    """Return the least and the largest drift [s]; both are 0 if the dead time is fixed."""
    drift = settings.drift
    shortest = min(model.dead_time for model in settings.servos)
    return -min(drift.shorter, shortest), drift.longer


def future_reach(settings: ControlSettings) -> float:
    """Return how far (12) reads into the future [s]: at least as far as the longest dead time."""
    longest = max(model.dead_time for model in settings.servos) + bounds(settings)[1]
    set_reach = settings.filters.servo_future_s
    return max(set_reach, longest + LEAD_S) if longest > set_reach - 0.5 * LEAD_S else set_reach


def compile_drift(settings: ControlSettings, axes: int, cycle_s: float) -> DriftModel | None:
    """Return the parameters of the tracking, None if the dead time is fixed."""
    least, most = bounds(settings)
    if most <= least or not settings.feed_forward:
        return None
    servos = settings.servos[:axes]
    drifts = np.linspace(least, most, math.ceil((most - least) / SPACING_S - 1e-9) + 1)
    dead_times = np.array([servo.dead_time for servo in servos])
    return DriftModel(
        dead_times=dead_times,
        bounds=(least, most),
        rate=settings.drift.rate * cycle_s,
        cycle_s=cycle_s,
        recursion=np.column_stack([_recursion(servo, cycle_s) for servo in servos]),
        drifts=drifts,
        taps=np.stack([_design(settings, axes, float(drift), cycle_s) for drift in drifts]),
        length=math.ceil((float(dead_times.max()) + most) / cycle_s) + 4,
    )


def begin(model: DriftModel, joints: Array, drift: float = 0.0) -> DriftState:
    """Return the state of an arm that rests at ``joints`` (axes,).

    Args:
        drift: known from before [s].
    """
    drift = min(max(drift, model.bounds[0]), model.bounds[1])
    return DriftState(drift, np.tile(joints, (3, 1)), np.tile(joints, (model.length, 1)))


def follow(
    model: DriftModel, state: DriftState, setpoint: Array, reported: Array | None
) -> DriftState:
    """Return the state one cycle later.

    Args:
        setpoint: (axes,) in force since the last telegram [rad, m].
        reported: (axes,) positions in that telegram, None without one [rad, m].
    """
    a1, a2, b1, b2, b3 = model.recursion
    last, before = state.responses[0], state.responses[1]
    newest, older, oldest = state.setpoints
    response = a1 * last + a2 * before + b1 * newest + b2 * older + b3 * oldest
    responses = np.concatenate((response[None], state.responses[:-1]))
    drift = state.drift
    if reported is not None:
        drift = _corrected(model, responses, drift, reported)
    return DriftState(drift, np.stack((setpoint, newest, older)), responses)


def servo_taps(model: DriftModel, state: DriftState) -> Array:
    """Return the taps (m, axes) of (12) for the drift.

    They are interpolated: two filters that are exact on a ramp give a third that is.
    """
    spacing = float(model.drifts[1] - model.drifts[0])
    place = (state.drift - model.bounds[0]) / spacing
    low = min(max(math.floor(place), 0), len(model.drifts) - 2)
    share = place - low
    taps: Array = (1.0 - share) * model.taps[low] + share * model.taps[low + 1]
    return taps


def _corrected(model: DriftModel, responses: Array, drift: float, reported: Array) -> float:
    expected, slope = _delayed(model, responses, drift)
    error = reported - expected
    power, product = float(slope.dot(slope)), float(slope.dot(error))
    if not math.isfinite(product) or power < SLOW**2:
        return drift
    unexplained = float(error.dot(error)) - product * product / power
    if unexplained > (CONTRADICTION_S**2) * power + NOISE**2:
        return drift
    change = model.cycle_s / TIME_CONSTANT_S * product / (power + SLOW**2)
    change = min(max(change, -model.rate), model.rate)
    return min(max(drift + change, model.bounds[0]), model.bounds[1])


def _delayed(model: DriftModel, responses: Array, drift: float) -> tuple[Array, Array]:
    """Return the expected positions (axes,) and their slope over the drift [1/s]."""
    lags = (model.dead_times + drift) / model.cycle_s
    base = np.maximum(lags.astype(np.intp), 1)
    s = lags - base
    rows = responses[base + _NODES[:, None], np.arange(len(lags))]
    left, right, far = s + 1.0, s - 1.0, s - 2.0
    weights = np.stack((-s * right * far / 6, left * right * far / 2, -left * s * far / 2,
                        left * s * right / 6))  # fmt: skip
    slopes = np.stack((-(3 * s * s - 6 * s + 2) / 6, (3 * s * s - 4 * s - 1) / 2,
                       -(3 * s * s - 2 * s - 2) / 2, (3 * s * s - 1) / 6))  # fmt: skip
    return (weights * rows).sum(axis=0), (slopes * rows).sum(axis=0) / model.cycle_s


def _recursion(servo: ServoModel, cycle_s: float) -> Array:
    """Return the five coefficients of a servo without dead time, exact for setpoints in ramps."""
    omega, z = 2.0 * math.pi * servo.frequency_hz, servo.damping
    root = complex(z * z - 1.0) ** 0.5
    p, m = (complex(np.exp((-z + sign * root) * omega * cycle_s)) for sign in (1.0, -1.0))
    a1, a2 = (p + m).real, -(p * m).real
    h = inverse_filter.servo_pulse(replace(servo, dead_time=0.0), cycle_s)
    # h(0) is 0: a setpoint is reached at the end of its cycle.
    b = np.array((h[1], h[2] - a1 * h[1], h[3] - a1 * h[2] - a2 * h[1]))
    # An axis at rest stands at its setpoint, exactly.
    b *= (1.0 - a1 - a2) / b.sum()
    return np.array((a1, a2, *b))


def _design(settings: ControlSettings, axes: int, drift: float, cycle_s: float) -> Array:
    """Return the taps (m, axes) of (12) for one drift, with zeros up to the longest reach."""
    filters = settings.filters
    count = len(inverse_filter.tap_steps(filters.servo_past_s, future_reach(settings), cycle_s))
    later = [replace(each, dead_time=each.dead_time + drift) for each in settings.servos]
    reach = future_reach(replace(settings, servos=tuple(later), drift=replace(
        settings.drift, shorter=0.0, longer=0.0)))  # fmt: skip
    own = replace(filters, servo_future_s=reach)
    return np.column_stack([_padded(each, own, cycle_s, count) for each in later[:axes]])


def _padded(servo: ServoModel, filters: FilterSettings, cycle_s: float, count: int) -> Array:
    taps = inverse_filter.servo_inverse(servo, filters, cycle_s)
    return np.concatenate((taps, np.zeros(count - len(taps))))
